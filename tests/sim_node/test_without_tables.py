"""What the simulator's process loads of highway-env's dependencies."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def told(code: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout.splitlines()[-1]


def test_the_simulator_drives_without_pandas_matplotlib_and_torch():
    code = """
import sys
import sim_node.__main__
from sim_node.env import ScenarioEnv
env = ScenarioEnv("highway")
env.reset(seed=0)
env.tick(0)
print(sorted({"pandas", "matplotlib", "torch"} & set(sys.modules)))
"""
    assert told(code) == "[]"


def test_highway_env_s_own_observation_still_finds_pandas():
    code = """
import sim_node.without_tables
import gymnasium, highway_env
observation, _ = gymnasium.make("highway-v0").reset(seed=0)
import pandas
print(observation.shape, pandas.DataFrame.__name__)
"""
    assert told(code) == "(5, 5) DataFrame"
