# make demo | test | pages | bench | study | docs | dist | lint | clean. Each sets up its own environment.
# `SEED=3 make demo` passes a seed.
SHELL := /bin/sh
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-print-directory
# What is installed uncompiled (below) would be compiled anew by every process.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
PIP := $(BIN)/pip --quiet --disable-pip-version-check --no-input
# --only-binary: a package that has no wheel for this platform is named at once instead of failing in a compiler.
# --no-deps: constraints.txt lists all packages.
LOCKED := --only-binary :all: --require-hashes --no-deps
SEED_OPTION = $(if $(SEED),--seed $(SEED))
# Of pytest: one more than two cores, since one of them mostly waits for ports (tests/conftest.py).
WORKERS ?= 3
PYTHONS := $(or $(PYTHON),python3.13 python3.12 python3.11 python3)

.PHONY: help demo test pages compiled bench study docs dist lint lock clean

help:
	@echo "make demo    the whole loop on mock devices, to a report"
	@echo "make test    ruff, mypy, import contracts, pytest"
	@echo "make pages   every page of the documentation, and analyses of realistic boats"
	@echo "make lint    the checks without pytest"
	@echo "make bench   speed, accuracy and loss, side by side with peers"
	@echo "make study   known truth in, same truth out: bias, coverage, detection rates"
	@echo "make docs    the documentation as a site, in build/site"
	@echo "make dist    wheel and sdist, in dist"
	@echo "make lock    resolve constraints.txt anew"
	@echo "make clean   remove the environment, builds and caches"

# The stamp is taken away first and written last: with it the environment is brought up to date in place, without it
# (new, or interrupted half-way) it is made from nothing. uv, itself from constraints.txt, takes a quarter of pip's time;
# pip does it where uv cannot, as on a platform without a wheel of uv or with an index that only pip's settings name.
# --no-compile: Python compiles the few modules that are used when they are first used, which is sooner done.
.venv/ready: constraints.txt pyproject.toml
	@if [ -e $@ ]; then \
	    echo "bringing .venv up to date"; \
	else \
	    for python in $(PYTHONS) none; do \
	        if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then break; fi; \
	    done; \
	    if [ $$python = none ]; then \
	        echo "seatrial needs Python 3.11 or newer: install it, or name it with make PYTHON=..." >&2; exit 1; \
	    fi; \
	    echo "setting up .venv with $$python (first time, about half a minute)"; \
	    $$python -m venv --clear .venv || \
	        { echo "$$python makes no environments: install its venv module (python3-venv)" >&2; exit 1; }; \
	fi
	@rm -f $@
	@mkdir -p build
	@awk '/^[^ #]/ { wanted = /^uv==/ } wanted' constraints.txt > build/locked-uv.txt
	@{ $(PIP) install --no-compile $(LOCKED) -r build/locked-uv.txt && \
	    $(BIN)/uv pip install --quiet --no-cache --python $(BIN)/python $(LOCKED) -r constraints.txt; } 2>build/uv-errors.txt || \
	    $(PIP) install --no-compile $(LOCKED) -r constraints.txt
	@echo "installing seatrial into .venv"
	@$(PIP) install --no-compile --no-deps --no-build-isolation --editable .
	@touch $@

demo: .venv/ready
	@$(BIN)/seatrial demo $(SEED_OPTION)

# mypy ends before the tests begin: the first of them have deadlines, which it would disturb, even with a low priority.
test: .venv/ready
	@$(MAKE) -j 2 lint compiled
	@echo "pytest"
	@$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not study and not pages"

# Two minutes apart from `make test`: whole analyses, whose parts `make test` tests one by one. `.ci/run` does both.
pages: .venv/ready
	@$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m pages

# What the tests import is compiled once, beside mypy: the workers begin together and would each do all of it.
compiled: .venv/ready
	@$(BIN)/python -m pytest --collect-only -qq >/dev/null 2>&1 || true

lint: .venv/ready
	@echo "ruff"
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check --quiet . || { echo "run: $(BIN)/ruff format ." >&2; exit 1; }
	@echo "mypy"
	@$(BIN)/mypy
	@echo "import contracts"
	@$(BIN)/lint-imports --no-logo

bench: .venv/ready
	@$(BIN)/python -m benchmarks $(SEED_OPTION)

# First what takes minutes rather than hours: the wheel in an empty environment, the tutorials as they are written.
study: .venv/ready
	@$(BIN)/python -m pytest -q -m study
	@$(BIN)/seatrial ident study surge yaw horizontal kinematic thruster noise --replicates 2000 --out build/study \
	    --docs docs/study.md $(SEED_OPTION)
	@$(BIN)/python -m tests.recovery.study $(SEED_OPTION) --docs
	@$(BIN)/python -m tests.recovery.rigs $(SEED_OPTION) --docs
	@$(BIN)/python -m tests.recovery.misuse $(SEED_OPTION) --docs
	@$(BIN)/python -m tests.recovery.bench_study $(SEED_OPTION) --docs
	@$(BIN)/python -m tests.golden.fuzz --n 1000000 $(SEED_OPTION)
	@$(BIN)/python -m tests.daq.hostile_files $(SEED_OPTION)
	@$(BIN)/python -m tests.bench.fault_trials --n $(or $(N),20) $(SEED_OPTION)
	@$(BIN)/python -m tests.bench.autopilot_faults
	@$(BIN)/python -m tests.bench.check_study --each 10 $(SEED_OPTION)
	@$(BIN)/python -m tests.bench.check_study --each 10 --actuators $(SEED_OPTION)

docs: .venv/ready
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "docs: build/site/index.html"

# build/lib is taken away first: what lies there goes into a wheel, whether it is still in the tree or not.
dist: .venv/ready
	@rm -rf build/lib build/bdist.*
	@mkdir -p build
	@$(BIN)/python -c "from setuptools import build_meta as b; b.build_sdist('dist'); b.build_wheel('dist')" \
	    >build/dist.log 2>&1 || { cat build/dist.log >&2; exit 1; }
	@ls dist/*

lock: .venv/ready
	@$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --upgrade --generate-hashes --no-emit-index-url \
	    --no-annotate --no-header --extra dev --output-file constraints.txt pyproject.toml

clean:
	@rm -rf .venv build dist *.egg-info .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
