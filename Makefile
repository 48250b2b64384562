# These need Python 3.11 or newer and a C++ compiler: `make demo`, `make check` and `make test`.
PYTHON ?= python3
VENV ?= .venv
OUT ?= demo
JOBS ?= 2
BIN := $(VENV)/bin
# pip says what it does: the first install takes a minute or more. What is imported is compiled then: all of it is half a gigabyte.
PIP := $(BIN)/python -m pip install --disable-pip-version-check --no-compile
BENCHMARKS := PYTHONPATH=packages/viewshed:packages/viewshed-lab $(BIN)/python -m benchmarks
# One thread for each process. Bytecode of the tests is kept: without it each process rewrites all their files. Workers
# take neighbors in a file, so that most fixtures are made once.
PYTEST := OMP_NUM_THREADS=1 MPLBACKEND=Agg PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n $(JOBS) --dist worksteal
# What a command does, and how long it took, passed or not.
timed = begin=$$(date +%s); $(MAKE) --no-print-directory -j2 BESIDE=yes $(2); code=$$?; \
	echo "make $(1): $$([ $$code = 0 ] && echo passed || echo FAILED) after $$(($$(date +%s) - begin)) s"; exit $$code

.DELETE_ON_ERROR:
ifndef BESIDE  # mypy, which uses one core, runs beside the tests; all else goes step by step
.NOTPARALLEL:
endif
.DEFAULT_GOAL := help
.PHONY: help demo check test properties lint types imports quick unit docs bench soak priors fuzz fuzz-library clean

help:  ## list the commands
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(VENV)/.core  ## own environment, install, then estimate what a sensor sees in an embedded sample
	$(BIN)/viewshed demo --out $(OUT)

check: $(VENV)/.test  ## for each commit: lint, types, import contracts, the tests that are not slow (6 minutes)
	@echo "make check: about 6 minutes on two cores of 2.5 GHz; the first run compiles for some more"
	@$(call timed,check,lint types imports quick)

test: $(VENV)/.test  ## lint, types, import contracts, all tests and doctests (10 minutes)
	@echo "make test: about 10 minutes on two cores of 2.5 GHz; the first run compiles for some more"
	@$(call timed,test,lint types imports unit)

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.test
	$(BIN)/mypy

imports: $(VENV)/.test
	$(BIN)/lint-imports

quick: $(VENV)/.test
	$(PYTEST) -m "not slow and not docs"

unit: $(VENV)/.test
	$(PYTEST) -m "not docs"

properties: $(VENV)/.test  ## the property tests with new examples, drawn by chance
	VIEWSHED_HYPOTHESIS=random $(PYTEST) -m hypothesis

docs: $(VENV)/.docs  ## the documentation as a site, warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(VENV)/.test  ## speed against named alternatives; writes docs/results/speed.md
	$(BENCHMARKS)

MINUTES ?= 30
FORGED ?= 1000000
soak: $(VENV)/.test  ## pipeline and ROS 2 node worked for half an hour each (MINUTES=2 for less), a million forged messages; docs/results/soak.md
	OMP_NUM_THREADS=1 $(BENCHMARKS).messages --flood --forged $(FORGED)
	OMP_NUM_THREADS=1 $(BENCHMARKS).soak --minutes $(MINUTES)

# Samples are kept in FITTED: what was made is not made again. The core is compiled with a network before the next one is
# fitted to what it says.
FITTED ?= build/priors
FIT := OMP_NUM_THREADS=1 $(BIN)/python tools/
priors: $(VENV)/.test  ## the three networks of the default, fitted anew and compiled in; goes on where it was stopped
	$(FIT)fit_ground.py make learning road --scenes 0:3200 --out $(FITTED)/ground
	$(FIT)fit_ground.py make learning road --scenes 5000:6800 --out $(FITTED)/ground
	$(FIT)fit_ground.py make own road --scenes 40:1240 --out $(FITTED)/ground
	$(FIT)fit_ground.py make training road --scenes 0:1000 --out $(FITTED)/ground
	$(FIT)fit_ground.py make training indoor --scenes 0:500 --sweeps 1 --out $(FITTED)/ground
	$(FIT)fit_ground.py make own indoor --scenes 16:516 --sweeps 1 --out $(FITTED)/ground
	$(FIT)fit_ground.py fit $(FITTED)/ground --minutes 23 --out packages/viewshed/src/core/ground_network.inc
	$(PIP) --editable packages/viewshed
	$(FIT)fit_no_return.py make learning road --scenes 0:1500 --out $(FITTED)/samples
	$(FIT)fit_no_return.py make training road --scenes 0:1000 --out $(FITTED)/samples
	$(FIT)fit_no_return.py make training indoor --scenes 0:500 --out $(FITTED)/samples
	$(FIT)fit_no_return.py fit $(FITTED)/samples --out packages/viewshed/src/core/no_return_network.inc
	$(PIP) --editable packages/viewshed
	$(FIT)fit_calibration.py make learning road --scenes 0:900 --out $(FITTED)/cells
	$(FIT)fit_calibration.py make training road --scenes 0:200 --out $(FITTED)/cells
	$(FIT)fit_calibration.py make training indoor --scenes 0:240 --out $(FITTED)/cells
	$(FIT)fit_calibration.py make own road --scenes 40:640 --out $(FITTED)/cells
	$(FIT)fit_calibration.py make own indoor --scenes 16:416 --out $(FITTED)/cells
	$(FIT)fit_calibration.py fit $(FITTED)/cells --out packages/viewshed/src/core/calibration_network.inc
	$(PIP) --editable packages/viewshed
	$(FIT)fit_calibration.py judge --page docs/results
	$(FIT)model_card.py

FUZZ_SECONDS ?= 600
fuzz: $(VENV)/.test  ## the native core called with damaged arguments, half a minute each function, under sanitizers
	$(BIN)/python tools/fuzz_core.py --sanitize --seconds 30

fuzz-library:  ## libviewshed called with any bytes, ten minutes under sanitizers (clang's libFuzzer)
	cmake -S packages/viewshed -B build/fuzz -DCMAKE_CXX_COMPILER=clang++ -DVIEWSHED_PYTHON=OFF -DVIEWSHED_FUZZ=ON -DVIEWSHED_SANITIZE=ON
	cmake --build build/fuzz --parallel 2 --target fuzz_library
	build/fuzz/fuzz_library -max_total_time=$(FUZZ_SECONDS) -max_len=16000 -timeout=20 -rss_limit_mb=4000

clean:  ## remove what these commands made
	rm -rf $(VENV) $(OUT) site build dist

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"viewshed needs Python 3.11 or newer, this is {v[0]}.{v[1]}; run make PYTHON=python3.11 …")'
	@command -v $${CXX:-c++} >/dev/null || { echo "viewshed's core needs a C++20 compiler (g++ 11 or clang 14): install one, or set CXX" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

# The native core is compiled by the install, and again when its sources change.
CORE := $(addprefix packages/viewshed/,pyproject.toml CMakeLists.txt) $(wildcard packages/viewshed/src/core/* packages/viewshed/src/core/bindings/*)

$(VENV)/.core: $(CORE) $(VENV)/.made
	$(PIP) --editable packages/viewshed
	@touch $@

# Pip's own index may bring gigabytes for graphics cards: PIP_EXTRA_INDEX_URL names one of builds without CUDA.
$(VENV)/.torch: $(VENV)/.made
	$(PIP) 'torch==2.13.0'
	@touch $@

$(VENV)/.test: packages/viewshed-lab/pyproject.toml $(VENV)/.core $(VENV)/.torch
	$(PIP) --editable 'packages/viewshed-lab[test]'
	@touch $@

$(VENV)/.docs: $(VENV)/.core
	$(PIP) --editable 'packages/viewshed-lab[docs]'
	@touch $@
