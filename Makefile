# Each target does all its own set-up: nothing is needed but Python 3.11 or later (and, for Aravis, the right to install it).
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
WORKERS ?= 2
QUIET := OPENBLAS_NUM_THREADS=1
# Compiled modules are kept whatever the shell says: to collect the tests anew takes a process half a minute without them.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-all check bench study docs lock

# The whole loop on the virtual bench.
demo: $(READY)
	$(BIN)/charact demo demo --force

# Tests that take half a second at most; the others run in test-all.
test: $(READY)
	$(BIN)/pytest -q -m "not wires and not slow" -n $(WORKERS) --dist loadfile

# All tests: wire tests one at a time, since their camera has one port; slow tests; those that draw by chance with three
# seeds from the clock; every index of the compiled loops checked; V4L2 in a guest; the wheel in a
# fresh environment, and in two with the lowest and the newest packages that pyproject.toml allows.
test-all: test
	$(BIN)/pytest -m wires
	$(BIN)/pytest -m "slow and not wires" -n $(WORKERS) --dist loadfile
	for i in 1 2 3; do \
	  seed=$$(date +%N | sed 's/^0*//'); echo "seed from the clock: $$seed"; \
	  CHARACT_TEST_SEED=$$seed $(BIN)/pytest -q -m "seeded and not wires" -n $(WORKERS) --dist loadfile || exit 1; \
	done
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/build/bounds $(BIN)/pytest -q -m "not wires" -n $(WORKERS) \
	  --dist loadfile tests/simulate tests/charact tests/physics
	$(BIN)/python tests/vivid/guest.py
	PYTHON=$(PYTHON) sh .ci/wheel
	sh .ci/bounds

check: $(READY)
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

# Time ratios against other programs and against limits.
bench: $(READY)
	$(BIN)/python -m benchmarks

# `make study` lists the studies, `make study NAME=edge-map` runs one; QUANTITY and OPTIONS are its arguments.
study: $(READY)
	$(QUIET) $(BIN)/python -m benchmarks.studies $(if $(NAME),run $(NAME) $(QUANTITY) $(OPTIONS),list)

# The documentation as a site, docs/_build/index.html; warnings are errors.
docs: $(READY)
	$(QUIET) $(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build

lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header \
	  --all-extras --group dev pyproject.toml -o requirements.lock

# Other programs that the benchmarks compare with, each in an environment of its own.
.venv-peers/ready .venv-mitsuba/ready: .venv-%/ready: benchmarks/peers/%.lock
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/pip install -q --require-hashes -r $<
	touch $@

$(READY): requirements.lock pyproject.toml .ci/setup
	PYTHON=$(PYTHON) sh .ci/setup
	touch $@
