# Each target does all its own set-up: nothing is needed but Python 3.11 or later (and, for Aravis, the right to install it).
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
WORKERS ?= 2
QUIET := OPENBLAS_NUM_THREADS=1

.PHONY: demo test test-all check bench study docs lock

# The whole loop on the virtual bench.
demo: $(READY)
	$(BIN)/charact demo demo

# Tests that take a second at most; the others run in test-all.
test: $(READY)
	$(BIN)/pytest -q -m "not wires and not slow" -n $(WORKERS) --dist loadfile

# All tests: wire tests one at a time, since their camera has one port; slow tests; statistical tests with three seeds from
# the clock; every index of the compiled loops checked; V4L2 in a guest.
test-all: test
	$(BIN)/pytest -m wires
	$(BIN)/pytest -m "slow and not wires" -n $(WORKERS) --dist loadfile
	for i in 1 2 3; do \
	  seed=$$(date +%N | sed 's/^0*//'); echo "seed from the clock:
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
