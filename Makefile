# make demo: set everything up, then the minimality sweep of the teapot.   make test: set up, then the tests.
# make slow: the longer checks.   make lint: format, lint, types.   make clean: remove the environments.
# make newest: the tests on the newest packages that the index serves for this Python (make newest PYTHON=python3.14).
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
NEWEST := .venv-newest
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo test slow newest lint clean

demo: $(VENV)/opengl
	@echo "The minimality sweep of the teapot: half a minute; its table is shown here, pictures go under runs/" >&2
	$(BIN)/slefejax minimality teapot

# Memory that one thread of XLA's has freed serves the others only where they share it: 2 GB a process otherwise become 2.5.
test: export MALLOC_ARENA_MAX = 2
test: $(VENV)/opengl $(VENV)/test
	@echo "The tests: some minutes on two cores; a dot is a test that passed, the last line says what it came to" >&2
	SLEFEJAX_REQUIRE_OPENGL=1 $(BIN)/python -m pytest --numprocesses 2 --dist worksteal

slow: $(VENV)/opengl $(VENV)/test
	@echo "The longer checks: an hour or more; a dot is a test that passed, the last line says what it came to" >&2
	$(BIN)/python -m pytest -m slow

newest:
	$(PYTHON) -m venv $(NEWEST)
	$(NEWEST)/bin/python -m pip install --quiet --disable-pip-version-check --upgrade --upgrade-strategy eager \
	  --editable '.[test]'
	@$(NEWEST)/bin/python -m pip list | grep -E '^(jax|jaxlib|numpy|scipy|equinox|optimistix|networkx|usd-core) '
	$(NEWEST)/bin/python -m pytest --numprocesses 2 --dist worksteal

lint: $(VENV)/test $(VENV)/lint
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

clean:
	rm -rf $(VENV) $(NEWEST)

$(VENV)/base: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "slefejax needs Python 3.11 or newer as '$(PYTHON)': install it (apt-get install python3)," \
	       "or name another one (make PYTHON=...)" >&2; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "slefejax needs Python's venv module: install it (apt-get install python3-venv)" >&2; exit 2; }
	@command -v git >/dev/null || echo "git is missing: runs will not record the commit (apt-get install git)" >&2
	@echo "Setting up $(VENV): a minute or two, once" >&2
	$(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt $(INSTALL) --editable '.[app]'
	@touch $@

$(VENV)/test $(VENV)/lint: $(VENV)/base
	PIP_CONSTRAINT=constraints.txt $(INSTALL) --editable '.[$(notdir $@)]'
	@touch $@

# An OpenGL device, or a software OpenGL from the distribution's packages. The packages' names are the program's own.
$(VENV)/opengl: $(VENV)/base
	@if ! $(BIN)/slefejax doctor --quiet >/dev/null; then \
	  packages=$$($(BIN)/python -c 'from slefejax.gpu.context import PACKAGES; print(PACKAGES)'); \
	  if ! command -v apt-get >/dev/null; then \
	    echo "No OpenGL device was found, and no apt-get to install a software OpenGL: install Mesa's EGL driver" >&2; exit 2; \
	  elif [ "$$(id -u)" = 0 ]; then as_root=; \
	  elif command -v sudo >/dev/null; then as_root=sudo; \
	  else echo "No OpenGL device was found. As root: apt-get install $$packages" >&2; exit 2; fi; \
	  echo "No OpenGL device was found: installing a software OpenGL ($$packages)" >&2; \
	  $$as_root apt-get update --quiet=2 && \
	  $$as_root env DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends --no-upgrade \
	    $$packages >/dev/null \
	    || { echo "The packages could not be installed. As root: apt-get install $$packages" >&2; exit 2; }; \
	  $(BIN)/slefejax doctor --quiet; \
	fi
	@touch $@
