# Every target sets up what it needs: a virtual environment in .venv, made from pyproject.toml.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
export OMP_NUM_THREADS ?= 1

.PHONY: help venv demo test test-full check format bench meshes figures clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 12

venv: $(STAMP) ## make or update .venv

$(STAMP): pyproject.toml scripts/make_venv.py
	$(PYTHON) scripts/make_venv.py $(VENV)
	@touch $@

demo: $(STAMP) ## map an object in simulation and print what came of it
	$(BIN)/contour demo

test: check meshes ## style, types, layers and the quick tests
	$(BIN)/python -m pytest -m "not slow"

test-full: check meshes ## everything, the slow proofs too
	$(BIN)/python -m pytest

check: $(STAMP) ## ruff, mypy --strict and the import layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict
	$(BIN)/lint-imports

format: $(STAMP) ## let ruff format and mend
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(STAMP) meshes ## measure speed and accuracy
	$(BIN)/python -m pytest benchmarks --benchmark-only --benchmark-columns=min,median,rounds -m ""

meshes: $(STAMP) ## make the meshes of data/meshes that are absent
	@$(BIN)/python data/meshes/generate.py

figures: $(STAMP) ## draw the figures of docs/
	$(BIN)/python scripts/draw_conventions.py

clean: ## remove .venv and everything made
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .import_linter_cache .benchmarks results
	find contour tests data scripts -name __pycache__ -type d -prune -exec rm -rf {} +
