# Every target makes the environment it needs, in .venv.
PYTHON ?= $(shell command -v python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
COMPILED := $(VENV)/.compiled
KERNELS := $(shell grep -rlE '@(njit|intrinsic)' drivers runtime sim tools --include='*.py')

MINUTES ?= 20
FUZZ_FRAMES ?= 200000
FUZZ_SEED ?= $(shell date +%s)

.PHONY: setup run test test-wide test-long bench bench-against bench-realtime bench-studies bench-view least-stop
.PHONY: load paper campaign torn sto isolation
.PHONY: fuzz robust replay kill soak mutation
.PHONY: lint check-types docs lock clean

setup: $(COMPILED)

$(STAMP): requirements.lock pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "Tonus needs Python 3.11 or newer: make PYTHON=..."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $(STAMP)

# numba looks for a change in a kernel's own file only, and would go on with compiled code that has
# another file's kernel of before in it. Compiled code of another layout would be found, and not load.
$(COMPILED): $(STAMP) $(KERNELS)
	@find config drivers runtime sim tests tools -name '*.nb[ic]' -delete
	@# Bytecode, which the first `tonus view` beside a robot would have to wait for.
	@$(BIN)/python -m compileall -q config drivers runtime sim tools tonus
	@# What is compiled at the first run, and told on standard error, no later command waits for.
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && \
		$(BIN)/tonus run config/can.yaml --virtual --duration 0.1 --out "$$folder" >/dev/null
	@touch $(COMPILED)

run: setup
	$(BIN)/tonus run config/can.yaml --or-virtual

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

check-types: setup
	$(BIN)/mypy

# A file's tests share runs. By number of tests, as pytest-xdist would order them, the files of few
# long tests would come last, and one worker wait for the other.
PARALLEL := -n 2 --dist loadfile --no-loadscope-reorder

test: setup
	@$(MAKE) --no-print-directory --jobs=2 --output-sync lint check-types
	$(BIN)/python -m pytest $(PARALLEL) -m "not realtime and not wide and not long"
	$(BIN)/python -m pytest -m "realtime and not wide and not long"

# What `make test` has no time for and every change has to pass as well: the same behaviour on other
# buses, robots, poses and seeds; a quarter of an hour.
test-wide: setup
	$(BIN)/python -m pytest $(PARALLEL) -m "wide and not realtime and not long"
	$(BIN)/python -m pytest -m "wide and realtime and not long"

# What neither has time for: whole runs once more on other buses, axes and controllers.
test-long: setup
	$(BIN)/python -m pytest $(PARALLEL) -m "long and not realtime"
	$(BIN)/python -m pytest -m "long and realtime"

bench: setup
	$(BIN)/python -m tests.bench

# This revision against an earlier one, in alternation: make bench-against BASE=HEAD~20. A quarter of an
# hour on an idle host, and the time for BASE's environment once.
BASE ?= HEAD~1
bench-against: setup
	$(BIN)/python -m tests.bench.revisions $(BASE)

# The paper's whole protocol: five hours of robot time. Goes on where it was interrupted.
paper: setup
	$(BIN)/tonus paper --out out/paper

# Faults at random in every state, each episode judged against the truth; EPISODES on all buses.
EPISODES ?= 300
CAMPAIGN_SEED ?= 1
campaign: setup
	$(BIN)/tonus campaign faults --episodes $(EPISODES) --seed $(CAMPAIGN_SEED) --out out/campaign

# Every cable torn at 27 poses, at rest and in motion; half an hour on one core. Table and figure go
# into docs/stop_measured.md.
torn: setup
	$(BIN)/python -m tests.bench.torn --write

# The torque of every drive and of each one taken away, with holding brakes and without: some ten
# minutes. Table and figure go into docs/sto.md.
sto: setup
	$(BIN)/python -m tests.bench.sto --write

# Every fault of cables, drums, motors and sensors by itself: what it is taken for, and how soon. A few
# minutes; the table goes into docs/stop_measured.md.
isolation: setup
	$(BIN)/python -m tests.bench.isolation --write

# MINUTES of cyclictest and the daemon in alternation, half of it each; the result goes into docs/timing.md.
bench-realtime: setup
	$(BIN)/python -m tests.bench.realtime --minutes $(MINUTES) --write

# The least that physics allows after a torn cable: half an hour; it goes on where it was interrupted.
# Writes config/least_stop.yaml and docs/least_stop.png.
least-stop: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.bench.least_stop table --write $(shell date +%F)

# What the tick makes of busy processes, a slow disk, a flooding client and a stopped recorder.
load: setup
	$(BIN)/python -m tests.bench.load

# What a study costs beside its runs: 100000 trials that do nothing, on this host and through Dask; half
# an hour. Figures in docs/studies.md.
bench-studies: setup
	$(BIN)/python -m tests.bench.study_scale

# Small errors in the safety path, one at a time, each of which a test has to find: three quarters of an
# hour on one core of a busy host. Table and survivors go into docs/mutation.md.
mutation: setup
	$(BIN)/python -m tests.mutation --write $(shell date +%F)

# What viewers cost the ticks, how soon they show a picture, and whether they keep their pace: a
# quarter of an hour on an idle host. Figures in docs/view.md.
bench-view: setup
	$(BIN)/python -m tests.bench.viewers
	$(BIN)/python -m tests.bench.view_pace

# Prints its seed: make fuzz FUZZ_SEED=... does the same again.
fuzz: setup
	$(BIN)/python -m tests.fuzz --frames $(FUZZ_FRAMES) --seed $(FUZZ_SEED)
	$(BIN)/python -m tests.fuzz --frames $(FUZZ_FRAMES) --seed $(FUZZ_SEED) --against master
	$(BIN)/python -m tests.fuzz --frames $(FUZZ_FRAMES) --seed $(FUZZ_SEED) --against segment

# kill -9 of daemon, recorder and lab, KILLS times each at random moments; about a quarter of an
# hour for 50.
KILLS ?= 50
KILLS_SEED ?= $(shell date +%s)
kill: setup
	TONUS_KILLS=$(KILLS) TONUS_KILLS_SEED=$(KILLS_SEED) $(BIN)/python -m pytest -v tests/hil/test_kills.py

# Half an hour of simulated time; ten minutes or so.
SOAK_MINUTES ?= 30
soak: setup
	$(BIN)/python -m tests.soak --minutes $(SOAK_MINUTES)

# Logs cut, flipped, torn, without segments: every reader ends with data or in one line.
robust: setup
	$(BIN)/python -m tests.fuzz.storm_of_logs --files 500 --seed $(FUZZ_SEED)

# Every scenario with every controller, recorded and replayed.
replay: setup
	$(BIN)/python -m tests.replay.every_pair

# The site, in site/. The variable silences a notice of the theme's makers; docs/dependencies.md has it.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

lock: setup
	$(BIN)/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-emit-index-url \
	  --no-emit-trusted-host --no-emit-find-links --no-header --no-annotate \
	  --extra dev --extra bench --extra docs --output-file requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) out dist build site bench.json
