# Everything a fresh machine needs: `make demo` or `make test` alone set up what is missing and go.
SHELL := /bin/bash
.DEFAULT_GOAL := help
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3; do command -v $$p >/dev/null && $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
BIN := .venv/bin
READY := .venv/ready
TEST_WORKERS ?= 2
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help setup demo test check fix prove clean

help:
	@echo "make demo    set up, render a small study, run it, analyse it, print the report's path"
	@echo "make test    set up, run the whole test suite"
	@echo "make setup   only set up (.venv in this folder)"
	@echo "make check   ruff and mypy          make fix    let ruff mend what it can"
	@echo "make prove   the full-length evidence (hours), into evidence/"

$(READY): pyproject.toml constraints.txt .ci/system-packages
	@.ci/system-packages "$(PYTHON)"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "setup: installing Python packages into .venv"
	@$(BIN)/python -m pip install -q -c constraints.txt pip setuptools wheel
	@PYTHONWARNINGS=ignore $(BIN)/python -m pip install -q -c constraints.txt --no-build-isolation -e '.[dev]'
	@touch $@
	@echo "setup: ready"

setup: $(READY)
	@:

demo: $(READY)
	@$(BIN)/studyapp demo

test: $(READY)
	@$(BIN)/python -m pytest -n $(TEST_WORKERS) --dist loadfile

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

fix: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

prove: $(READY)
	@$(BIN)/python -m tests.prove

clean:
	rm -rf .venv .clips data demo-output evidence
