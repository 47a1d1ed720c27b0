"""Provenance: the commit is that of this very code, whatever repository it happens to lie in."""

import importlib.util
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from pecjax.runtime import provenance


def git(folder, *args):
    clean = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    who = ["-c", "user.name=test", "-c", "user.email=test@localhost", "-c", "commit.gpgsign=false"]
    done = subprocess.run(
        ["git", *who, *args], cwd=folder, env=clean, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def copy(tmp_path):
    """The module as another package's, in a folder that belongs to no repository."""
    path = tmp_path / "site" / "pecjax" / "runtime" / "provenance.py"
    path.parent.mkdir(parents=True)
    shutil.copy(provenance.__file__, path)
    spec = importlib.util.spec_from_file_location("provenance_copy", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def commit_in(folder, *names):
    git(folder, "init", "--quiet")
    git(folder, "add", *names)
    git(folder, "commit", "--quiet", "--message", "first")
    return git(folder, "rev-parse", "HEAD")


def test_a_checkout_has_its_commit_and_says_when_it_is_modified(copy, tmp_path):
    assert copy.git_commit() is None
    package = Path(copy.__file__).parents[1]
    (package / "agent.py").write_text("rate = 1\n")
    (tmp_path / "site" / "notes.txt").write_text("")
    commit = commit_in(tmp_path / "site", ".")
    assert copy.git_commit() == commit
    (package / "new.py").write_text("")  # not tracked
    (tmp_path / "site" / "notes.txt").write_text("not of the package")
    assert copy.git_commit() == commit
    (package / "agent.py").write_text("rate = 2\n")
    assert copy.git_commit() == f"{commit}-dirty"
    git(tmp_path / "site", "add", ".")
    assert copy.git_commit() == f"{commit}-dirty"
    assert provenance.short_commit(copy.git_commit()) == f"{commit[:7]}-dirty"


@pytest.mark.parametrize("ignored", [True, False])
def test_what_is_installed_inside_another_repository_has_no_commit(ignored, copy, tmp_path):
    (tmp_path / "theirs.txt").write_text("")
    (tmp_path / ".gitignore").write_text("site\n" if ignored else "")
    commit_in(tmp_path, "theirs.txt", ".gitignore")
    assert copy.git_commit() is None


def test_git_variables_of_another_repository_change_nothing(copy, tmp_path, monkeypatch):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "theirs.txt").write_text("")
    commit_in(tmp_path / "other", "theirs.txt")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "other" / ".git"))
    monkeypatch.setenv("GIT_WORK_TREE", str(tmp_path / "other"))
    assert copy.git_commit() is None
    commit = commit_in(tmp_path / "site", ".")
    assert copy.git_commit() == commit


def test_without_git_there_is_no_commit(copy, tmp_path, monkeypatch):
    commit_in(tmp_path / "site", ".")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert copy.git_commit() is None
