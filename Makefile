# `make demo` and `make test` need git, make and Python 3.11 to 3.13. All else goes into .venv, made once and reused.
#   PYTHON=python3.12         which Python makes .venv
#   PIP_ARGS="..."            passed on to pip, for example an index with CPU builds of torch
#   ARGS="..."                passed on to the command that the target runs

PYTHON ?= python3
PIP_ARGS ?=
ARGS ?=
BIN := .venv/bin

.PHONY: help setup demo lab book test bench force

help:
	@echo "make demo    explore an apartment, fit a semantic NeRF to the walk, score it: runs/demo/report.html"
	@echo "make test    lint, types, import contracts and every test, notebooks included"
	@echo "make lab     JupyterLab on the notebooks"
	@echo "make book    the notebooks, run and made into a site: build/book/index.html"
	@echo "make bench   every benchmark (ARGS=--quick for a look)"
	@echo "make setup   install everything and stop there"

# A .venv whose Python has gone (an upgrade, a moved folder) does not count as installed.
ifneq ($(shell $(BIN)/python -c 'print(1)' 2>/dev/null),1)
broken := force
endif

# The stamp is written when its installation has finished, so that an interrupted one is taken up again.
.venv/.installed-%: pyproject.toml constraints.txt apt.txt $(broken)
	@PYTHON='$(PYTHON)' PIP_ARGS='$(PIP_ARGS)' sh .ci/install $*

setup: .venv/.installed-all

demo: .venv/.installed-base
	$(BIN)/autonerf-lab demo --scene val-0 --policy frontier --model semantic-nerfacto --preset fast --out runs/demo $(ARGS)

# dash, which open3d brings, would have JupyterLab ask for a build that nothing here needs.
NO_BUILD := --ServerApp.tornado_settings="{'page_config_data': {'buildCheck': False}}"

lab: .venv/.installed-lab
	$(BIN)/jupyter-lab notebooks $(NO_BUILD) $(ARGS)

book: .venv/.installed-all
	$(BIN)/python docs/book.py $(ARGS)

test: .venv/.installed-all
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist worksteal $(ARGS)

bench: .venv/.installed-all
	set -e; for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script $(ARGS); done
