# Two commands matter: `make train` and `make test`. Both create $(VENV) from plain python3.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
TRAIN_ARGS ?=
TESTS ?=
TINY ?=

.PHONY: train test slow tiny shapes check docs figures dist format clean

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

train: $(VENV)/.installed
	$(BIN)/python -m hybrid_jax.train $(TRAIN_ARGS)

test: $(VENV)/.installed
	$(BIN)/python -m pytest $(TESTS)

slow: $(VENV)/.installed
	XLA_FLAGS= $(BIN)/python -m pytest -n 0 -m slow

tiny: $(VENV)/.installed
	$(BIN)/python -m pytest -n 2 -m tiny tests/test_figures.py $(if $(TINY),-k "$(TINY)")

# shapes and types of the kernels' arguments and results, checked while their tests run
SHAPES := hybrid_jax.kernels,hybrid_jax.skills,hybrid_jax.ik,beartype.beartype
SHAPE_TESTS := dualquat kinematics distance collision rays edges_and_inputs ik_and_map skills timing convex_hulls
shapes: $(VENV)/.installed
	$(BIN)/python -m pytest --jaxtyping-packages=$(SHAPES) $(SHAPE_TESTS:%=tests/test_%.py)

check: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(VENV)/.installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

figures: $(VENV)/.installed
	$(BIN)/python -m benchmarks.figures

dist: $(VENV)/.installed
	$(BIN)/python -m build

clean:
	rm -rf .venv dist build .pytest_cache .ruff_cache
