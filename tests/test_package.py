"""The package as it would be published: built, checked, installed, and used from an empty folder."""

import os
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

import pecjax

HOUSE = Path(__file__).parents[1]
pytestmark = pytest.mark.slow


def run(*words, cwd, **more):
    """What a command prints; an error shows all of it."""
    done = subprocess.run([*map(str, words)], cwd=cwd, capture_output=True, text=True, check=False, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """(sdist, wheel), the wheel made of the sdist, as an installer makes it."""
    build = pytest.importorskip("build")
    pytest.importorskip("hatchling")
    out = tmp_path_factory.mktemp("dist")
    sdist = build.ProjectBuilder(HOUSE).build("sdist", out)
    with tarfile.open(sdist) as archive:
        archive.extractall(out / "unpacked", filter="data")
    (source,) = (out / "unpacked").iterdir()
    return Path(sdist), Path(build.ProjectBuilder(source).build("wheel", out))


def test_an_index_would_take_both(built):
    pytest.importorskip("twine")
    run(sys.executable, "-m", "twine", "check", "--strict", *built, cwd=HOUSE)


def test_the_wheel_holds_the_package_and_nothing_else(built):
    with zipfile.ZipFile(built[1]) as archive:
        names = set(archive.namelist())
    info = f"pecjax-{pecjax.__version__}.dist-info"
    assert {name.partition("/")[0] for name in names} == {"pecjax", info}
    assert {"pecjax/py.typed", "pecjax/assets/rooms.xml", f"{info}/licenses/LICENSE"} <= names
    modules = {path.relative_to(HOUSE).as_posix() for path in (HOUSE / "pecjax").rglob("*.py")}
    assert {name for name in names if name.endswith(".py")} == modules


def test_the_source_holds_what_git_knows(built):
    """So tests, examples, documents and assets are in it, and nothing that lies about."""
    tracked = run("git", "ls-files", "--cached", "--others", "--exclude-standard", cwd=HOUSE).splitlines()
    with tarfile.open(built[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names - {"PKG-INFO"} == {name for name in tracked if (HOUSE / name).is_file()}


def test_the_wheel_works_in_an_empty_folder(built, tmp_path):
    """Installed without what it depends on, which is taken from the environment of the tests."""
    venv.create(tmp_path / "venv", with_pip=False)
    python = tmp_path / "venv" / "bin" / "python"
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    run(
        sys.executable,
        "-m",
        "pip",
        "install",
        "--no-deps",
        "--quiet",
        "--target",
        site,
        built[1],
        cwd=tmp_path,
    )
    others = [path for path in sys.path if path.endswith("site-packages")]
    (site / "others.pth").write_text("\n".join(others))  # after the wheel: its pecjax is found first
    empty = tmp_path / "empty"
    empty.mkdir()
    settled = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def command(*words):
        return run(python, "-m", "pecjax", *words, cwd=empty, env=settled)

    where = run(python, "-c", "import pecjax; print(pecjax.__file__)", cwd=empty, env=settled)
    assert Path(where.strip()).is_relative_to(site)
    assert command("--version") == f"pecjax {pecjax.__version__}\n"
    assert "20 configurations: every one can be flown" in command("check")
    small = ("--num-envs", "16", "--evaluation.episodes", "20", "--out", "run")
    assert "goal ratio" in command("train", "--iterations", "1", *small)
    assert {path.name for path in empty.iterdir()} == {"check.png", "check.svg", "run"}
