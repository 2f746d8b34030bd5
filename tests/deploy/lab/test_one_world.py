"""The gymnasium environment and the world that training learns in are one: traffic, reward, flags, policy input."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from deploy.lab.episodes import task_of
from deploy.lab.guard import safety_mask
from fast_node.training.rollout import Scenes
from schemas.driving.episode import Ending
from schemas.driving.features import CAP, LEFT_OPEN, RIGHT_OPEN
from schemas.driving.intent import ANY_LANE
from schemas.driving.road import HZ, lead_id
from sim_node.engine.batched import Batched
from sim_node.env import ScenarioEnv
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.scenario import streams

OF_THE_MASK = (CAP, LEFT_OPEN, RIGHT_OPEN)
"""Columns of the policy input that the environment, which knows no mask, cannot tell."""


class Pair:
    """One episode in both worlds, under one directive that stays."""

    def __init__(self, name: str, seed: int, *, masked: bool, decision_hz: int, lane: int | None = None) -> None:
        """lane: that is wished; None: drawn, or on two-way to overtake."""
        scenario = SCENARIOS[name]
        self.env = ScenarioEnv(name, decision_hz=decision_hz, guard=safety_mask if masked else None)
        self.env.reset(seed=seed)
        home, rng = self.env.ego.target_lane, np.random.default_rng(seed)
        speed = float(rng.uniform(0.5, 1.0)) * scenario.ego.speed_ceiling_mps
        if lane is None and scenario.wish_lanes:
            lane = int(rng.choice((ANY_LANE, *scenario.wish_lanes)))
        if lane is None:
            told = (home, lead_id(self.env.rows(), home), speed, 1.2)
            self.env.direct(speed_mps=speed, headway_s=1.2, overtake=True)
        else:
            told = (lane, -1, speed, 1.2)
            self.env.direct(lane, speed, 1.2)
        world, task = Batched(scenario, 1, 0), replace(task_of(scenario), draw=lambda *_: told)
        self.scenes = Scenes(world, task, 0, HZ // decision_hz, masked=masked, obeyed=False)
        world.load(0, scenario.spawn(streams(seed)[0]))
        self.scenes._tracks.forget(np.ones(1, np.bool_))
        self.scenes._direct(np.ones(1, np.bool_))
        self.scenes.look()

    def decide(self, action: int) -> tuple[Any, Any]:
        """(reward, terminated, truncated) of the environment and of the scenes."""
        _, *ours, _ = self.env.step(action)
        theirs = [values[0] for values in self.scenes.decide(np.array([action]))]
        return ours, theirs


@pytest.mark.slow
@pytest.mark.parametrize("decision_hz", [1, HZ])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_environment_is_the_training_world_decision_by_decision(name: str, masked: bool, decision_hz: int) -> None:
    endings, seeds = [], (1000, 1001, 1002) if decision_hz == 1 else (1000,)  # up to 600 decisions each
    for seed in seeds:
        pair, rng = Pair(name, seed, masked=masked, decision_hz=decision_hz), np.random.default_rng(seed)
        while True:
            ours, theirs = pair.env.observation_type.observe(), pair.scenes.observe()[0]
            np.testing.assert_array_equal(np.delete(ours, OF_THE_MASK, 1), np.delete(theirs, OF_THE_MASK, 1))
            # Now and then, so that at 15 decisions a second the ego gets somewhere, too.
            action = int(rng.integers(5)) if rng.random() < 2.0 / decision_hz else 1
            ours, theirs = pair.decide(action)
            assert ours == theirs, f"seed {seed}, {pair.env.steps} ticks"
            if ours[1] or ours[2]:
                endings.append(pair.env.ending())
                break
    assert len(endings) == len(seeds)
    if masked:
        assert Ending.COLLISION not in endings


@pytest.mark.parametrize("name", ["merge", "roadworks"])
def test_reaching_the_goal_truncates_in_both(name: str) -> None:
    pair = Pair(name, 1000, masked=True, decision_hz=1, lane=0)
    for k in range(40):
        ours, theirs = pair.decide(3 if k % 2 else 1)
        assert ours == theirs
        if ours[1] or ours[2]:
            break
    assert (pair.env.ending(), ours[1:]) == (Ending.GOAL, [False, True])
