# `make demo` and `make test` need git, make and Python 3.11 to 3.13. Everything else goes into .venv, made once.
#   PYTHON=python3.12         Python of .venv
#   PIP_ARGS="..."            passed on to pip, for example an index with CPU builds of torch
#   ARGS="..."                passed on to the command that the target runs

PYTHON ?= python3
PIP_ARGS ?=
ARGS ?=
BIN := .venv/bin
# Where this is set, as in many containers, every process compiles torch again, which takes seconds.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help setup demo lab docs test test-fast bench force

help:
	@echo "make demo       explore an apartment, fit a semantic NeRF, evaluate it: runs/demo/report.html"
	@echo "make test       lint, types, import contracts and every test, notebooks included"
	@echo "make test-fast  unit tests only, under three minutes"
	@echo "make lab        JupyterLab on the notebooks"
	@echo "make docs       the manual as a site: build/docs/index.html"
	@echo "make bench      every benchmark (ARGS=--quick for a short run)"
	@echo "make setup      install everything, run nothing else"

# A .venv whose Python is missing (after an upgrade or a move) does not count as installed.
ifneq ($(shell $(BIN)/python -c 'print(1)' 2>/dev/null),1)
broken := force
endif

# The stamp is written after the installation, so that an interrupted installation is continued.
.venv/.installed-%: pyproject.toml constraints.txt apt.txt $(broken)
	@PYTHON='$(PYTHON)' PIP_ARGS='$(PIP_ARGS)' sh .ci/install $*

setup: .venv/.installed-all

demo: .venv/.installed-base
	$(BIN)/autonerf-lab demo --scene val-0 --policy frontier --model semantic-nerfacto --preset fast --out runs/demo $(ARGS)

# dash, a dependency of open3d, would make JupyterLab ask for a build that is not needed.
NO_BUILD := --ServerApp.tornado_settings="{'page_config_data': {'buildCheck': False}}"

lab: .venv/.installed-lab
	$(BIN)/jupyter-lab notebooks $(NO_BUILD) $(ARGS)

# Without a network; warnings are errors. ARGS="-D nb_execution_mode=cache" runs the notebooks first.
docs: .venv/.installed-all
	$(BIN)/python -m sphinx -W --keep-going -q $(ARGS) docs build/docs
	@echo build/docs/index.html

test: .venv/.installed-all
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist worksteal --durations=20 $(ARGS)

# Without the tests that train, render for long, open a browser or run a notebook.
test-fast: .venv/.installed-all
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist worksteal -m "not slow" tests $(ARGS)

bench: .venv/.installed-all
	set -e; for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script $(ARGS); done
