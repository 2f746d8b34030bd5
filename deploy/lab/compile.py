"""`python -m deploy.lab.compile`: compile the simulator's tick and the loops of training and evaluation, once.

`make setup` calls it, so that the first run drives at once. What has not changed since the last time is only read.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace

from highway_env.envs import HighwayEnv

from deploy.lab.agents import drive
from schemas.driving.road import DT_S
from schemas.runtime.compiled import cache_folder
from sim_node.engine.accelerated import accelerate
from sim_node.engine.batched import Batched
from sim_node.env import ScenarioEnv
from sim_node.scenarios import SCENARIOS

SCENARIO = replace(SCENARIOS["merge"], duration_s=DT_S)
"""One tick long; the compiled code is the same for every road."""


def simulate() -> None:
    """What `fastslow run` needs: the tick under the gymnasium environment."""
    env = ScenarioEnv(SCENARIO)
    env.reset(seed=0)
    env.tick(0)


def train() -> None:
    """What `fastslow evaluate` and `fastslow train` need: many scenes behind the mask."""
    Batched(SCENARIO, 1, 0)
    for agent in ("ours", "rule", "cruise"):
        drive(agent, SCENARIO, [0])


def observe() -> None:
    """What highway-env's own environments need beside the tick: their observation."""
    accelerate(HighwayEnv)({"vehicles_count": 2}).reset(seed=0)


STEPS: dict[str, Callable[[], None]] = {
    "the simulator's tick": simulate,
    "training and evaluation": train,
    "highway-env's observation": observe,
}


def main() -> int:
    for number, (what, step) in enumerate(STEPS.items(), 1):
        print(f"[{number}/{len(STEPS)}] compiling {what} ... ", end="", flush=True)
        start = time.monotonic()
        step()
        print(f"{time.monotonic() - start:.0f} s", flush=True)
    if not os.access(cache_folder(), os.W_OK):
        print(
            f"{cache_folder()} cannot be written: every start will compile again. NUMBA_CACHE_DIR names another folder."
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
