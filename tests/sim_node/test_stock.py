"""highway-env's own roads as scenarios: upstream's cars on upstream's lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim_node.road import network
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.stock import KINDS


@pytest.mark.parametrize("name", KINDS)
def test_the_cars_are_those_that_upstream_makes_from_the_same_generator(name: str) -> None:
    env = KINDS[name]()
    env.np_random = np.random.default_rng(5)
    env._reset()
    spawn = SCENARIOS[name].spawn(np.random.default_rng(5))
    assert spawn.x.tolist() == [v.position[0] for v in env.road.vehicles]
    assert spawn.speed.tolist() == [v.speed for v in env.road.vehicles]
    assert len(spawn.x) == SCENARIOS[name].vehicles_max


@pytest.mark.parametrize("name", KINDS)
def test_the_lanes_lie_where_upstreams_do(name: str) -> None:
    theirs, ours = KINDS[name]().road.network.lanes_list(), network(SCENARIOS[name]).lanes_list()

    def table(lanes: list[Any]) -> list[tuple[float, ...]]:
        return sorted((*lane.start, *lane.end, lane.width, lane.speed_limit, lane.forbidden) for lane in lanes)

    assert np.allclose(table(theirs), table(ours))


def test_only_the_highway_can_be_denser() -> None:
    dense = SCENARIOS["highway-v0"].denser(2.0).spawn(np.random.default_rng(5))
    assert np.ptp(dense.x) < 0.6 * np.ptp(SCENARIOS["highway-v0"].spawn(np.random.default_rng(5)).x)
    with pytest.raises(ValueError, match="density"):
        SCENARIOS["merge-v0"].denser(2.0)
