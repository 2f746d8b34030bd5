"""The bare environment refuses what it would otherwise swallow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim_node.env import ScenarioEnv


@pytest.mark.parametrize("action", [7, -1, 6, 2.5, np.array([1]), "left"])
def test_what_is_no_action_is_refused(action: Any) -> None:
    env = ScenarioEnv("merge")
    with pytest.raises(ValueError, match=r"is not one of 0\.\.4"):
        env.step(action)


@pytest.mark.parametrize("name", ["nonsense", "lanes_count", "action", "policy_frequency", "manual_control"])
def test_a_config_that_is_not_honoured_is_refused_by_name(name: str) -> None:
    with pytest.raises(ValueError, match=f"config '{name}' is not honoured: choose from observation"):
        ScenarioEnv("merge", config={name: 1})


def test_what_is_told_too_late_is_refused() -> None:
    env = ScenarioEnv("merge", config={"screen_width": 900})
    with pytest.raises(ValueError, match="make another"):
        env.configure({"screen_width": 600})
    with pytest.raises(ValueError, match="no option 'config'"):
        env.reset(options={"config": {}})


def test_highway_envs_kinematics_are_observed_where_they_are_asked_for() -> None:
    env = ScenarioEnv("merge", config={"observation": {"type": "Kinematics", "vehicles_count": 3}})
    observation, _ = env.reset(seed=0)
    assert observation.shape == (3, 5)
    assert observation in env.observation_space
