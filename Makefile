# Two commands set everything up on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin

.PHONY: demo test test-fast lint docs site lock clean
.DEFAULT_GOAL := help

# The tests have the cores, and BLAS threads that wait for one spin.
export OPENBLAS_NUM_THREADS ?= 1

help:
	@echo "make demo   install, then play the bundled motion on the bridge and record it (demo-out/)"
	@echo "make test   install, then run the whole test suite"
	@echo "make test-fast   the tests that need no DDS and are not slow"
	@echo "make lint   ruff, mypy --strict, import contracts"
	@echo "make docs   write configs/*.toml, the package's stub, the man page and docs/support.md from the code"
	@echo "make site   build the documentation as pages that need no network (build/site/)"
	@echo "make lock   resolve constraints.txt anew"
	@echo "make clean  remove the virtual environment and caches"

# The demo ends with a report, which is an extra.
# pip older than 24 can spin for minutes in its resolver, so it is upgraded first.
$(VENV)/.run: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=24"
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[report]"
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev,meshes]"
	@touch $@

demo: $(VENV)/.run
	$(BIN)/g1stream demo -o demo-out --force

# First what needs no DDS, on all cores, with neighbours, which share fixtures, on the same one: the
# core with the extras hidden, which proves that it needs none, then the extras. Then what is about
# time and processes, file by file, three at once, because it waits for half of its time. Last what
# an armed guard ends, or a figure misses, where another test takes the CPU: one at a time.
test: $(VENV)/.dev
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not dds" --core-alone --ignore tests/extras
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not dds" tests/extras
	$(BIN)/python -m pytest -n 3 --dist loadfile -m "dds and not alone"
	$(BIN)/python -m pytest -m alone

test-fast: $(VENV)/.dev
	$(BIN)/python -m pytest -n auto -m "not dds and not slow"

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.run
	$(BIN)/python tools/make_stub.py
	$(BIN)/python tools/make_configs.py
	$(BIN)/python tools/make_man_page.py
	$(BIN)/python tools/make_support_page.py

site: $(VENV)/.run
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[docs]"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

lock:
	$(PYTHON) -m pip install --quiet uv
	$(PYTHON) -m uv pip compile --universal --all-extras --python-version 3.10 --upgrade \
		--no-header --no-annotate --quiet pyproject.toml -o constraints.txt

clean:
	rm -rf $(VENV) .sdk-venv .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
