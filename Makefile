# Two commands matter: `make train` and `make test`. Both create .venv from plain python3.
PYTHON ?= python3
BIN := .venv/bin
TRAIN_ARGS ?=

.PHONY: train test slow check docs dist format clean

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

train: .venv/.installed
	$(BIN)/python -m hybrid_jax.train $(TRAIN_ARGS)

test: .venv/.installed
	$(BIN)/python -m pytest

slow: .venv/.installed
	XLA_FLAGS= $(BIN)/python -m pytest -n 0 -m slow

check: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: .venv/.installed
	$(BIN)/ruff check --fix .

docs: .venv/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

dist: .venv/.installed
	$(BIN)/python -m build

clean:
	rm -rf .venv dist build .pytest_cache .ruff_cache
