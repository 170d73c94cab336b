# `make run` and `make test` need nothing but Python 3.11 or newer and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: run study test lint types check format setup bench soak clean
.DEFAULT_GOAL := help

help:
	@echo "make run    set up everything and fly the built-in scenario (results in out/)"
	@echo "make study  do the paper's experiments, ours beside the paper's (results in out/studies)"
	@echo "make test   set up everything, check style and types, run the tests"
	@echo "make bench  time the solver beside its peers (bench.json); BENCH='--help' tells the options"
	@echo "make soak   ten thousand random and nasty programs (an hour)"
	@echo "make format rewrite the sources in the house style"
	@echo "make clean  remove the environment and everything that was built"

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "aerotube needs Python 3.11 or newer; choose one with: make PYTHON=/path/to/python3 ..."; exit 1; }
	@if command -v uv >/dev/null 2>&1; then \
		uv venv --quiet --allow-existing --python $(PYTHON) $(VENV) && uv pip install --quiet --python $(BIN)/python -e '.[dev]'; \
	else \
		$(PYTHON) -m venv $(VENV) && $(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'; \
	fi
	@touch $(STAMP)

setup: $(STAMP)

run: $(STAMP)
	@$(BIN)/aerotube run --out out

study: $(STAMP)
	@$(BIN)/aerotube study all --out out/studies

lint: $(STAMP)
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: $(STAMP)
	@$(BIN)/mypy

test: lint types
	@$(BIN)/python -m pytest

check: test

# Peers that this Python or machine has no build of are left out, and the table says so.
$(VENV)/.bench: $(STAMP)
	@$(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["bench"], sep="\n")' | \
	while read -r peer; do \
		if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python "$$peer"; \
		else $(BIN)/python -m pip install --quiet --disable-pip-version-check "$$peer"; fi \
		|| echo "$$peer does not install here"; \
	done
	@touch $@

soak: $(STAMP)
	@$(BIN)/python -m tests.sos.soak

bench: $(VENV)/.bench
	@$(BIN)/python -m benchmarks $(BENCH)

format: $(STAMP)
	@$(BIN)/ruff check --fix --quiet . ; $(BIN)/ruff format .

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
