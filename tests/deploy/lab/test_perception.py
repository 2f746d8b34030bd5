"""Driving by what an imperfect sensor reports."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.lab.agents import drive
from sim_node.env import ScenarioEnv
from sim_node.observe import senses
from sim_node.scenarios import SCENARIOS


@pytest.mark.parametrize(("noise_m", "noise_mps", "dropout"), [(0.0, 0.0, 0.3), (1.0, 0.5, 0.3)])
@pytest.mark.parametrize("road", ["two-way", "merge"])
def test_noise_and_missed_cars_cause_no_collision(road: str, noise_m: float, noise_mps: float, dropout: float) -> None:
    seeds = range(1000, 1012)
    results = drive("ours", SCENARIOS[road], seeds, noise_m=noise_m, noise_mps=noise_mps, dropout=dropout)
    assert not any(r.collided and not r.struck for r in results)


def test_many_scenes_see_what_the_running_simulator_would_see() -> None:
    env = ScenarioEnv("highway", noise_m=1.0, noise_mps=0.5, dropout=0.3)
    env.reset(seed=1000)
    sense = senses([1000], 1.0, 0.5, 0.3)
    assert sense is not None
    seen = sense(0, env.rows())
    assert np.array_equal(seen[: len(env.seen())], env.seen())
