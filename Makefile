# SPDX-License-Identifier: BSD-3-Clause
# make demo, make test, make docs: everything from a clean clone (GNU make; on Debian and Ubuntu:
# apt install g++ make python3-venv python3-dev). Another Python: make test PYTHON=python3.13.
# More arguments for pytest or the demo: make test ARGS="-k pose -x". All tests in one process: make test WORKERS=0.

PYTHON ?= python3
VENV ?= .venv
# --editable: a changed Python file counts at once. Empty (make test EDITABLE=): installed as users install it.
EDITABLE ?= --editable
# Processes of the tests. Each takes a file at a time, as fixtures are shared within a file; in their
# order, since the file that starts Ray has few tests and takes the longest.
WORKERS ?= 2
ARGS ?=

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
COMPILER := $(if $(filter default,$(origin CXX)),c++,$(CXX))
SYSTEM_PACKAGES := g++ make python3-venv python3-dev

# Directories are in the list as well: they change when a file comes or goes.
BUILD_SOURCES := pyproject.toml CMakeLists.txt $(shell find native -not -name '.*')
ifeq ($(strip $(EDITABLE)),)
BUILD_SOURCES += $(shell find src -name '*.py' -o -name '*.pyi')
endif

.PHONY: demo test docs pictures lint format clean
.DELETE_ON_ERROR:

demo: $(VENV)/.stamp-install
	$(BIN)/epi360 pair --demo $(ARGS)
	@echo "Your own images: $(BIN)/epi360 pair A.jpg B.jpg   All commands: $(BIN)/epi360 --help"

# The threads of BLAS, of which each process would have some, would wait for work and take its time.
test: $(VENV)/.stamp-test
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

# The documentation as a folder that a browser opens: site/index.html. It needs no build of epi360.
docs: $(VENV)/.stamp-docs
	$(BIN)/python docs/site/build_site.py site

# The pictures of the documentation, which are in the repository; a few minutes.
pictures: $(VENV)/.stamp-test
	$(BIN)/python docs/images/make_pictures.py $(ARGS)

lint: $(VENV)/.stamp-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.stamp-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	find native -name '*.cpp' -o -name '*.hpp' -o -name '*.h' | xargs $(BIN)/clang-format -i

clean:
	rm -rf $(VENV) build dist site .mypy_cache .pytest_cache .ruff_cache
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.stamp-venv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "epi360 needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
	    "Name another one: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, os, sys, sysconfig, venv; \
	  sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' \
	  2>/dev/null && command -v $(COMPILER) >/dev/null || { \
	  echo "A C++ compiler, venv or the headers of $(PYTHON) are missing." \
	    "On Debian and Ubuntu: apt install $(SYSTEM_PACKAGES)" >&2; exit 1; }
	@rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.stamp-install: $(VENV)/.stamp-venv $(BUILD_SOURCES)
	@echo "Building and installing epi360 (about two minutes of processor time) ..."
	$(PIP) install $(EDITABLE) .
	@touch $@

$(VENV)/.stamp-test $(VENV)/.stamp-dev: $(VENV)/.stamp-install

# The requirements of an extra without building the package once more.
$(VENV)/.stamp-test $(VENV)/.stamp-dev $(VENV)/.stamp-docs: $(VENV)/.stamp-%: $(VENV)/.stamp-venv pyproject.toml
	@$(BIN)/python -c 'import tomllib; \
	  extras = tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]; \
	  print(*(line for line in extras["$*"] if not line.startswith("epi360")), sep="\n")' > $(VENV)/$*.txt
	$(PIP) install -r $(VENV)/$*.txt
	@touch $@

$(VENV)/.stamp-dev: $(VENV)/.stamp-test
