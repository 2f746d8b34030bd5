"""How natural roads begin: outside the RSS distances that the mask's preset "sim" has."""

from __future__ import annotations

from typing import Any

import pytest

from fast_node.mask import PRESETS
from schemas.driving.measures import rss_same_direction_m
from schemas.driving.road import ID, LANE, VX, X, gap_between
from sim_node.engine.batched import Batched
from sim_node.env import ScenarioEnv
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.scenario import streams

SIM = PRESETS["sim"]
NATURAL = [name for name, scenario in SCENARIOS.items() if scenario.speed_set == "natural" and not name.endswith("-v0")]


def room(rows: Any) -> tuple[float, float]:
    """How much farther away than by RSS the leader and the follower are, in the ego's lane [m]; inf without one."""
    ego, inf = rows[0], float("inf")
    mine = [row for row in rows[1:] if row[ID] >= 0 and row[LANE] == ego[LANE]]
    ahead = min((row for row in mine if row[X] >= ego[X]), key=lambda row: row[X], default=None)
    behind = max((row for row in mine if row[X] < ego[X]), key=lambda row: row[X], default=None)
    before = after = inf
    if ahead is not None:
        need = rss_same_direction_m(ego[VX], ahead[VX], SIM.reaction_s, 0.0, SIM.ego_brake, SIM.lead_brake)
        before = gap_between(ego, ahead) - need
    if behind is not None:
        need = rss_same_direction_m(
            behind[VX], ego[VX], SIM.follower_reaction_s, 0.0, SIM.follower_brake, SIM.shown_brake
        )
        after = gap_between(behind, ego) - need
    return before, after


def test_natural_roads_are_the_ones_that_start_clear() -> None:
    assert sorted(NATURAL) == sorted(name for name, scenario in SCENARIOS.items() if scenario.starts_clear)


@pytest.mark.parametrize("density", [1.0, 2.0])
@pytest.mark.parametrize("name", NATURAL)
def test_every_scene_of_a_natural_road_begins_outside_the_rss_distances(name: str, density: float) -> None:
    scenario = SCENARIOS[name].denser(density)
    world, env = Batched(scenario, 1, 0), ScenarioEnv(name, density=density)
    neighbours = 0
    for seed in range(300):
        world.load(0, scenario.spawn(streams(seed)[0]))
        found = room(world.rows[0].astype(float).tolist())
        assert min(found) >= 0.0, f"seed {seed}: {found}"
        neighbours += sum(gap < float("inf") for gap in found)
        if seed % 10 == 0:
            env.reset(seed=seed)
            assert room(env.rows().astype(float).tolist()) == found
    assert neighbours > 100 or name == "merge-dense"  # where the ego is alone on its ramp
