# Two commands need nothing but Python 3.11 or newer: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
OUT ?= demo
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.DELETE_ON_ERROR:
.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help demo test lint types imports unit docs bench clean

help:  ## list the commands
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(VENV)/.core  ## own environment, install, then estimate what a sensor sees in an embedded sample
	$(BIN)/viewshed demo --out $(OUT)

test: lint types imports unit  ## lint, types, import contracts, tests and doctests

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.test
	$(BIN)/mypy

imports: $(VENV)/.test
	$(BIN)/lint-imports

unit: $(VENV)/.test
	$(BIN)/pytest

docs: $(VENV)/.docs  ## the documentation as a site, warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(VENV)/.bench  ## speed against named alternatives; writes docs/results/speed.md
	$(BIN)/python -m benchmarks

clean:  ## remove what these commands made
	rm -rf $(VENV) $(OUT) site build dist

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"viewshed needs Python 3.11 or newer, this is {v[0]}.{v[1]}; run make PYTHON=python3.11 …")'
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.core: pyproject.toml $(VENV)/.made
	$(PIP) --editable .
	@touch $@

# The CPU build of torch first: a bare range would pull several gigabytes for graphics cards.
$(VENV)/.torch: $(VENV)/.made
	$(PIP) 'torch==2.13.0'
	@touch $@

$(VENV)/.test: pyproject.toml $(VENV)/.torch
	$(PIP) --editable '.[test]'
	@touch $@ $(VENV)/.core

$(VENV)/.bench: pyproject.toml $(VENV)/.made
	$(PIP) --editable '.[bench]'
	@touch $@ $(VENV)/.core

$(VENV)/.docs: pyproject.toml $(VENV)/.made
	$(PIP) --editable '.[docs]'
	@touch $@ $(VENV)/.core
