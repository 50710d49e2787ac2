# Two commands from a fresh clone: `make run` and `make test`. Both set up what they need in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check --quiet --constraint constraints.txt
WORKERS ?= $(shell $(PYTHON) -c "import os; print(os.cpu_count() or 1)")
# How many of the recorded futures of each scenario; the suite has five.
FUTURES ?= 2
RUN_ARGS ?=
TORCH_ARGS ?=
BENCH_ARGS ?=
PEERS_ARGS ?=
DIST ?= dist
# Tests side by side; who is done takes tests over from the others.
SIDE_BY_SIDE = --numprocesses $(WORKERS) --dist worksteal

.PHONY: run test test-all suite-check bench peers bench-peers docs lint dist clean

run: $(VENV)/.run
	$(BIN)/dosplan run --workers $(WORKERS) --futures $(FUTURES) $(RUN_ARGS)

test: $(VENV)/.dev
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) -m "not slow" --cov --cov-report=term:skip-covered --cov-fail-under=95

test-all: $(VENV)/.dev
	$(PIP) --editable ".[suite]"
	$(BIN)/python -m pytest $(SIDE_BY_SIDE)

suite-check: $(VENV)/.dev
	$(PIP) --editable ".[suite]"
	$(BIN)/python -m pytest tests/suite

bench: $(VENV)/.dev
	$(PIP) --editable ".[onnx]"
	$(BIN)/python -m benchmarks.bench $(BENCH_ARGS)

# Other people's planners; the reactive planner needs Python 3.11.
peers: $(VENV)/.dev
	$(PIP) --editable ".[peers]"
	$(BIN)/python -m benchmarks.peers_table --workers $(WORKERS) $(PEERS_ARGS)

bench-peers: $(VENV)/.dev
	$(PIP) --editable ".[peers]"
	$(BIN)/python -m benchmarks.peers_cycle $(PEERS_ARGS)

# The documentation as a site, in build/site; a warning is an error.
docs: $(VENV)/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What the package index gets: the wheel is built from the source distribution.
dist: $(BIN)/python
	$(PIP) build twine "readme_renderer[md]"
	rm -rf $(DIST)
	$(BIN)/python -m build --outdir $(DIST)
	$(BIN)/python -m twine check --strict $(DIST)/*

clean:
	rm -rf $(VENV) dist build

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# torch comes first and by itself, from where TORCH_ARGS says: the package index's build for Linux
# brings several gigabytes of CUDA, which dosplan has no use for.
$(VENV)/.run: $(BIN)/python pyproject.toml constraints.txt
	$(PIP) $(TORCH_ARGS) torch
	$(PIP) --editable .
	touch $@

# The drivability checker is an oracle of some tests only, and one of its dependencies comes as
# source: where no compiler is at hand, those tests are skipped and say so.
$(VENV)/.dev: $(VENV)/.run
	$(PIP) --editable ".[dev,cluster,onnx,frames,video,docs]"
	$(PIP) --editable ".[oracle]" || echo "no drivability checker: its oracle tests are skipped"
	touch $@
