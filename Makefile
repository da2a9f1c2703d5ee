# Each target does all its own set-up: nothing is needed but Python 3.11 or later (and, for Aravis, the right to install it).
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
WORKERS ?= 2
SECONDS ?= 3600

.PHONY: demo test test-seeds test-bounds check bench bench-acquisition fault-campaign rehearsal study mtf-study calibration bar-study mtf-peers edge-map spectrum-map gain-map events-study docs frontier peers radiance-peers lock bloom-pictures night-light live-check clean

demo: $(READY)
	$(BIN)/charact demo demo

# The wires go one at a time, as their camera has one port, and mostly wait: all else runs beside them and gives way,
# as they promise seconds. What they said is shown when both are done.
test: $(READY)
	mkdir -p build
	$(BIN)/pytest -m wires > build/wires.log 2>&1 & wires=$$!; \
	nice -n 19 $(BIN)/pytest -m "not wires" -n $(WORKERS) --dist loadfile; others=$$?; \
	wait $$wires; wires=$$?; cat build/wires.log; [ $$others -eq 0 ] && [ $$wires -eq 0 ]

# Statistical tests again with three seeds that nobody chose.
test-seeds: $(READY)
	for i in 1 2 3; do \
	  seed=$$(date +%N | sed 's/^0*//'); echo "seed from the clock: $$seed"; \
	  CHARACT_TEST_SEED=$$seed $(BIN)/pytest -q -m "not wires" -n $(WORKERS) --dist loadfile || exit 1; \
	done

# Every index of every compiled loop checked, which they are not else: what lies beside an array is read without a word.
# Quarter of an hour on two cores, with code compiled for it into build/bounds.
test-bounds: $(READY)
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/build/bounds $(BIN)/pytest -q -m "not wires" -n $(WORKERS) --dist loadfile tests/simulate tests/charact tests/physics

check: $(READY)
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

.PHONY: vivid fuzz
# The V4L2 driver against a kernel's own virtual camera, in an emulated machine made of Debian's packages; two
# minutes, and one sentence where the packages cannot be installed.
vivid: $(READY)
	$(BIN)/python tests/vivid/guest.py

# Every parser of bytes from outside, mangled: serial replies, the kernel's structures, documents, pictures; an hour on
# one core, divided among them.
fuzz: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --seconds $(SECONDS)

bench: $(READY)
	$(BIN)/python -m benchmarks

# What acquisition loses at the camera's rate (ten minutes), how fast it stores, and what it adds to each step.
bench-acquisition: $(READY)
	$(BIN)/python -m benchmarks.acquisition

# Every fault that is known, five times at random moments of running plans on the virtual bench: docs/faults.md.
fault-campaign: $(READY)
	$(BIN)/python -m tests.faults.campaign --strikes 5 --seed 20260 --keep docs/faults.md

# A night compressed: 500 steps of gain by light on the virtual bench with faults on, measured and held beside the truth;
# half an hour, mostly waiting. Broken off, it goes on from build/rehearsal.
rehearsal: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.faults.rehearsal --keep docs/rehearsal.md

# Speed against accuracy, and where methods fail: measured again, tables for `auto` rewritten.
study: $(READY)
	for quantity in mtf50 mtf covariance_gain system_gain halo_diameter; do \
	  $(BIN)/charact chart $$quantity --update --out study && $(BIN)/charact stability $$quantity --out study || exit 1; \
	done

# How often the intervals of edge methods hold, whether auto keeps its word on cases that no chart saw, and how often all
# targets of a session agree; half an hour on two cores.
mtf-study: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.edge.coverage
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.held_out_cases
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.session.consistency_table --keep --simulated 100 --workers 2

# Simulation-based calibration: ranks of 600 true blurs among draws from the posteriors of their edges, by Markov chain and
# by importance: table and figures; a few minutes on two cores.
calibration: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.edge.ranks

# Bias of the four-bar method and cover of its intervals, 153 cells of blur, frequency, tilt, noise and phase: table and
# chart; ten minutes on two cores.
bar-study: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.bars.bias
	$(BIN)/python -m charact.study.bars.bias_figure

# Single photoelectrons: how often intervals hold over 200 stacks of known darks, and where the law is lost; table kept.
events-study: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.flats.dark_events_coverage

# Where edges break: 5,000 cells drawn 20 times each; forty minutes on two cores.
edge-map: $(READY)
	$(BIN)/python -m charact.study.edge.map
	$(BIN)/python -m charact.study.edge.map_figure

# Where noise spectra break: 1,000 random cameras; quarter of an hour on two cores.
spectrum-map: $(READY)
	$(BIN)/python -m charact.study.flats.spectrum_map
	$(BIN)/python -m charact.study.flats.spectrum_map_figure

# Where gains break: 3,000 simulated cameras; half an hour on two cores.
gain-map: $(READY)
	$(BIN)/python -m charact.study.flats.gain_map
	$(BIN)/python -m charact.study.flats.gain_map_figure

# Edge methods beside other programs and the Cramer-Rao bound, on the edge that those were measured on: table and chart.
mtf-peers: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.edge.peers

# Every picture by simulation.
docs: $(READY)
	$(BIN)/python docs/pictures.py

# Pictures of docs/bloom.md, from scenes whose truth is known; half a minute on one core.
bloom-pictures: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python docs/bloom_pictures.py

# Pictures of docs/night-light.md; a few seconds on one core.
night-light: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python docs/night_light.py

.PHONY: radiance-economy night-scenes
# Plans of light beside the exact mode, 100 random scenes before random cameras: table and figure; goes on where it was
# interrupted; fifteen minutes on one core.
radiance-economy: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.light.effect_selection_study
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m charact.study.light.effect_selection_figure

# Pictures of docs/night-scenes.md: the shipped scenes and what the default camera makes of them; some minutes.
night-scenes: $(READY)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=. $(BIN)/python docs/night_scenes.py

# The simulator's tiers: worst moment error against frames a second, chart and tables into docs.
frontier: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.frontier

# Other simulators to be timed against, in an environment of their own.
peers: .venv-peers/ready

.venv-peers/ready: benchmarks/peers/requirements.lock
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/pip install -q --require-hashes -r benchmarks/peers/requirements.lock
	touch $@

# Five scenes by our renderer and by Mitsuba, error over time, two threads each: chart and table into docs; an hour on two
# idle cores, most of it references, which are kept. Mitsuba needs LLVM 16 or later: DRJIT_LIBLLVM_PATH says where.
radiance-peers: $(READY) .venv-mitsuba/ready
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.radiance

.venv-mitsuba/ready: benchmarks/peers/mitsuba.lock
	$(PYTHON) -m venv .venv-mitsuba
	.venv-mitsuba/bin/pip install -q --require-hashes -r benchmarks/peers/mitsuba.lock
	touch $@

# The live page in a headless Chromium: updates a second, who is refused, and screenshots to be looked at; two minutes.
live-check: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.live_page live-check

lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header \
	  --all-extras --group dev pyproject.toml -o requirements.lock

clean:
	rm -rf .venv .venv-peers .venv-mitsuba demo study live-check

$(READY): requirements.lock pyproject.toml .ci/setup
	PYTHON=$(PYTHON) sh .ci/setup
	touch $@
