# On a machine with Python 3.12 or later and make: `make demo` and `make test` set up what they need.
PYTHON ?= $(shell for p in python3.12 python3.13 python3.14 python3; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null && { echo "$$p"; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
LOG ?=

.PHONY: demo test slow nightly format bench docs lab notebooks clean

demo: $(VENV)/.ready
	$(BIN)/stickslip-fit demo $(LOG)

# Bytecode is written even where the shell forbids it: without it each command compiles all modules anew.
test: $(VENV)/.ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@echo "$(BIN)/mypy beside pytest"; $(BIN)/mypy & types=$$!; \
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal; tests=$$?; wait $$types && exit $$tests

slow: $(VENV)/.ready-test
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal -m "slow and not nightly"

nightly: $(VENV)/.ready-nightly
	OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal -m ""

format: $(VENV)/.ready-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.ready-bench
	$(BIN)/python -m benchmarks

docs: $(VENV)/.ready-docs
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html
	@echo "built: docs/_build/html/index.html"

lab: $(VENV)/.ready-lab
	$(BIN)/jupyter lab notebooks

notebooks: $(VENV)/.ready-lab
	$(BIN)/python -m notebooks.run

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "No Python 3.12 or later was found; set PYTHON=/path/to/python3.12"; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.ready: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@$(BIN)/python -m compileall -q stickslip_fit
	@touch $@

# .ready-test stands for the extra `test` of pyproject.toml, and so on.
$(VENV)/.ready-%: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[$*]'
	@$(BIN)/python -m compileall -q stickslip_fit
	@touch $@ $(VENV)/.ready

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache docs/_build docs/generated
