"""A scenario in SUMO's traffic: the same road and start, other drivers, and an ego that they see."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from schemas.driving.road import ID, LENGTH, VX, X, Y
from schemas.runtime.errors import ConfigError
from schemas.wire.messages import MetaAction
from sim_node.config import SimConfig
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS, Scenario
from sim_node.scenarios.scenario import streams
from sim_node.sumo.env import SumoEnv
from sim_node.sumo.network import MODELS, edges, network
from sim_node.sumo.traffic import Traffic
from sim_node.sumo.world import SumoWorld

pytest.importorskip("libsumo")
ROADS = ("highway-natural", "merge-natural", "two-way-natural")
HOLD = int(MetaAction.CRUISE)


def world(scenario: Scenario, first_seed: int, scenes: int = 1, ego_model: str | None = None) -> SumoWorld:
    """Scenes of these seeds, at tick 0."""
    made = SumoWorld(scenario, scenes, first_seed, ego_model=ego_model)
    for scene in range(scenes):
        made.load(scene, scenario.spawn(streams(first_seed + scene)[0]))
    made.begin()
    return made


def driven(made: SumoWorld, ticks: int, *actions: MetaAction) -> list[np.ndarray]:
    """The rows after each tick, under these actions and then CRUISE; SUMO's world ends."""
    seen = [made.rows.copy()]
    for k in range(ticks):
        meta = int(actions[k]) if k < len(actions) else HOLD
        made.tick(np.full(made.scenes, meta), np.full(made.scenes, np.nan))
        seen.append(made.rows.copy())
    made.close()
    return seen


@pytest.fixture
def env() -> Iterator[SumoEnv]:
    made = SumoEnv("highway-natural", duration_s=None)
    yield made
    made.close()


@pytest.mark.parametrize("road", [*ROADS, "merge-dense", "roadworks", "exit", "merge-main"])
def test_a_seed_s_cars_start_where_they_do_elsewhere(road: str) -> None:
    scenario = SCENARIOS[road]
    spawn = scenario.spawn(streams(1000)[0])
    traffic = Traffic(scenario, 15)
    traffic.load([spawn], 1000)
    n = len(spawn.x)
    assert traffic.here[0, :n].all()
    assert np.abs(traffic.x[0, :n] - spawn.x).max() < 1e-3
    assert np.abs(traffic.speed[0, :n] - spawn.speed).max() < 1e-3
    traffic.close()


@pytest.mark.parametrize("road", ROADS)
def test_a_scene_depends_on_its_seed_and_on_no_other_scene(road: str) -> None:
    together = driven(world(SCENARIOS[road], 1000, 3), 60)
    alone = driven(world(SCENARIOS[road], 1002), 60)
    again = driven(world(SCENARIOS[road], 1002), 60)
    for of_three, one, same in zip(together, alone, again, strict=True):
        assert np.array_equal(one, same)
        assert np.allclose(of_three[2], one[0], atol=1e-4)


@pytest.mark.parametrize("beyond", [0, 1])
def test_the_largest_seeds_too_depend_on_no_other_scene(beyond: int) -> None:
    scenario, turn = SCENARIOS["highway"], 2**31 // 4  # where SUMO's numbers end, with four lanes
    first = turn if beyond else turn - 3
    together, alone = driven(world(scenario, first, 3), 60), driven(world(scenario, first + 2), 60)
    for of_three, one in zip(together, alone, strict=True):
        assert np.allclose(of_three[2], one[0], atol=1e-4)


def test_seeds_that_sumo_cannot_tell_apart_in_one_world_are_refused_with_those_that_it_can() -> None:
    turn = 2**31 // 4
    with pytest.raises(ValueError, match=rf"let {turn - 1} be the largest, or begin with {turn}"):
        world(SCENARIOS["highway"], turn - 1, 3)


@pytest.mark.parametrize("road", ROADS)
def test_the_live_simulator_and_many_scenes_at_once_are_one_world(road: str) -> None:
    actions = [MetaAction.LEFT, *[MetaAction.SPEED_UP] * 5, MetaAction.RIGHT, *[MetaAction.SLOW_DOWN] * 5]
    scenes = driven(world(SCENARIOS[road], 1000), 40, *actions)
    made = SumoEnv(road, duration_s=None)
    made.reset(seed=1000)
    for k, rows in enumerate(scenes):
        there = {int(row[ID]): row for row in rows[0] if row[ID] >= 0}
        assert {int(row[ID]) for row in made.rows()} == set(there)
        for row in made.rows():
            assert np.array_equal(row, there[int(row[ID])])
        made.tick(int(actions[k]) if k < len(actions) else HOLD)
    made.close()


def test_who_follows_the_ego_brakes_for_it() -> None:
    scenario = SCENARIOS["highway-natural"]
    spawn = scenario.spawn(streams(1000)[0])
    behind = [i for i in range(1, len(spawn.x)) if spawn.lane[i] == spawn.lane[0] and spawn.x[i] < spawn.x[0]]
    rows = driven(world(scenario, 1000), 200, *[MetaAction.EMERGENCY_BRAKE] * 200)
    ego, followers = rows[-1][0, 0], rows[-1][0, behind]
    assert ego[VX] == 0.0
    assert len(followers)
    still_there = followers[(followers[:, ID] > 0) & (np.abs(followers[:, Y] - ego[Y]) < 1.0)]
    assert (still_there[:, X] < ego[X] - 5.0).all()


def test_an_oncoming_car_brakes_for_an_ego_in_its_lane() -> None:
    scenario = SCENARIOS["two-way-natural"]
    seen = driven(world(scenario, 1000), 330, MetaAction.LEFT, *[MetaAction.SLOW_DOWN] * 329)
    slowest: dict[int, float] = {}
    for rows in seen:
        for row in rows[0]:
            if row[ID] > 0 and row[VX] < -0.1 and row[X] > rows[0, 0, X]:
                slowest[int(row[ID])] = max(slowest.get(int(row[ID]), -99.0), float(row[VX]))
    assert max(slowest.values()) > -10.0


@pytest.mark.parametrize("model", MODELS)
def test_sumo_s_own_driver_takes_the_ego_s_place_and_merges(model: str) -> None:
    scenario = SCENARIOS["merge-natural"]
    rows = driven(world(scenario, 1000, ego_model=model), 450)
    assert max(row[0, 0, X] for row in rows) > scenario.success.reach_x_m
    assert {round(float(row[0, 0, Y])) for row in rows} >= {14, 4}


def test_a_car_that_sumo_moves_sideways_says_so_by_its_heading() -> None:
    for rows in zip(*[iter(driven(world(SCENARIOS["highway-natural"], 1000), 300))] * 2, strict=False):
        before, after = rows[0][0], rows[1][0]
        both = (before[:, ID] > 0) & (after[:, ID] > 0) & (after[:, VX] > 5.0)
        moved = (after[both, Y] - before[both, Y]) * 15
        said = after[both, VX] * np.tan(after[both, 5])
        assert np.abs(moved - said).max(initial=0.0) < 0.2


def test_trucks_are_as_long_as_the_scenario_has_them() -> None:
    scenario = SCENARIOS["highway-natural"].varied(("trucks",))
    (rows,) = driven(world(scenario, 1003), 0)
    assert rows[0, 1:, LENGTH].max() > 12.0


def test_manners_that_sumo_s_drivers_do_not_know_are_refused() -> None:
    with pytest.raises(ValueError, match="they know trucks and narrow"):
        SumoEnv(SCENARIOS["highway-natural"].varied(("sway",)))


def test_every_lane_of_a_scenario_is_one_of_sumo_s_with_its_opposite() -> None:
    scenario = SCENARIOS["two-way-natural"]
    assert len(edges(scenario)) == 2
    assert network(scenario).count("<neigh") == 2
    assert network(replace(scenario), scenes=3).count("<lane ") == 6


def test_the_simulator_s_node_drives_in_sumo_s_traffic() -> None:
    node = SimNode(SimConfig(scenario="merge-natural", sim="sumo", seed=1000))
    node.reset(1)
    for k in range(12):
        node.step(None, k)
    assert node.tick == 12
    assert node.metrics.failsafes == 10


def test_where_sumo_is_missing_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "libsumo", None)
    with pytest.raises(ConfigError, match=r"pip install 'fastslow\[sumo\]'"):
        SumoEnv("highway-natural")


def test_the_environment_is_gymnasium_s(env: SumoEnv) -> None:
    seen, _ = env.reset(seed=3)
    again, reward, terminated, truncated, info = env.step(HOLD)
    assert seen.shape == again.shape == env.observation_space.shape
    assert np.isfinite(reward)
    assert (terminated, truncated) == (False, False)
    assert info["action_mask"].shape == (5,)
