# What a newcomer needs; everything goes into .venv, from the versions in requirements.lock.
# PYTHON: the newest supported Python that runs here, unless given: make train PYTHON=python3.12
SUPPORTED := python3.13 python3.12 python3.11
PYTHON ?= $(or $(firstword $(foreach name,$(SUPPORTED),$(shell $(name) -c 'print("$(name)")' 2>/dev/null))),\
	$(error no Python 3.11 to 3.13 here; install one, or name it by PYTHON=...))
VENV ?= .venv
BIN := $(VENV)/bin
PYTEST := $(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

.PHONY: train test test-slow lint docs lock three

train: $(VENV)/pecjax
	$(BIN)/pecjax train

# The core suite: minutes.
test: $(VENV)/installed
	$(PYTEST)

# Processes, kills, fuzz, notebooks, whole trainings and studies.
test-slow: $(VENV)/installed
	$(PYTEST) -m slow

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

# The docs site, in docs/_build/html; nothing is fetched.
docs: $(VENV)/installed
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs docs/_build/html

# pecjax and what it needs, without what its tests need.
$(VENV)/pecjax: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint requirements.lock --editable .
	touch $@

$(VENV)/installed: $(VENV)/pecjax
	$(BIN)/python -m pip install --quiet --requirement requirements.lock
	touch $@

# Needs npm: three.js for the page of `pecjax watch`, as package.json says.
three:
	cd pecjax/viewing/three && npm install --no-save --no-package-lock && npm run build
	cp pecjax/viewing/three/node_modules/three/LICENSE pecjax/viewing/three/LICENSE
	rm -r pecjax/viewing/three/node_modules

# Needs uv; run it after a change of the dependencies in pyproject.toml.
lock:
	uv pip compile --quiet --universal --python-version 3.11 --extra dev --extra docs --upgrade --output-file requirements.lock pyproject.toml
