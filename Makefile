# Everything happens in a virtual environment made here; needs Python 3.11 or newer with venv, and make.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help demo test lint format warmup bench constraints clean

help:  ## Show what there is to make
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /\1\t/' | expand -t 14

demo: $(VENV)/.warm  ## Map an apartment with four simulated robots and two edges
	$(BIN)/recslam demo

test: $(VENV)/.dev $(VENV)/.warm  ## Run all tests; RECSLAM_DATA names a folder of real logs and maps
	$(BIN)/python -m pytest -q

lint: $(VENV)/.dev  ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.dev  ## Bring the code into style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

warmup: $(VENV)/.stamp  ## Compile all kernels
	$(BIN)/recslam warmup

bench: $(VENV)/.dev $(VENV)/.warm  ## Run all benches; tables on the screen, numbers in results/
	@for bench in $(basename $(notdir $(wildcard bench/[a-z]*.py))); do \
		echo "== $$bench"; $(BIN)/python -m bench.$$bench || exit 1; \
	done

constraints:  ## Pin the newest versions of all dependencies
	$(PYTHON) -m venv build/uv
	build/uv/bin/pip install --quiet uv
	build/uv/bin/uv pip compile --quiet --upgrade --universal --all-extras --python-version 3.11 pyproject.toml \
		--no-header --no-annotate --no-emit-package recslam -o constraints.txt

clean:  ## Remove the virtual environment and caches
	rm -rf $(VENV) build .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e ".[all]"
	@touch $@

$(VENV)/.dev: $(VENV)/.stamp
	$(PIP) -e ".[dev]"
	@touch $@

$(VENV)/.warm: $(VENV)/.stamp
	$(BIN)/recslam warmup
	@touch $@
