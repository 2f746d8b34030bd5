"""Several cars on one road: PettingZoo's own tests, each car's own directive, and what is refused."""

from __future__ import annotations

import copy
import gc
import warnings
import weakref
from typing import Any

import numpy as np
import pytest

import fastslow
from deploy.environments.single import DrivingEnv

pytest.importorskip("pettingzoo")
with warnings.catch_warnings():  # of its own games
    warnings.simplefilter("ignore")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

from deploy.environments.parallel import DrivingParallelEnv
from deploy.environments.world import RoadWorld
from sim_node.env import ScenarioEnv
from sim_node.road import has_left


@pytest.mark.parametrize("scenario", ["highway", "merge"])
def test_it_passes_pettingzoos_own_test(scenario: str) -> None:
    with pytest.warns(UserWarning, match="no option 'options', it is left out: reset takes 'directives'"):
        parallel_api_test(DrivingParallelEnv(scenario, 2, mask=None, duration_s=3.0), num_cycles=12)


def test_seeds_give_the_same_episodes() -> None:
    parallel_seed_test(lambda: fastslow.parallel_env("highway", 3, duration_s=2.0), num_cycles=8)


def test_one_car_is_the_single_environment_to_the_bit() -> None:
    one, several = DrivingEnv("merge"), DrivingParallelEnv("merge", 1)
    seen, info = one.reset(seed=3)
    their_seen, their_info = several.reset(seed=3)
    for action in [1, 2, 3, 1, 0, 4] * 4:
        np.testing.assert_array_equal(seen, their_seen["car_0"])
        np.testing.assert_equal(info, their_info["car_0"])
        seen, *what, info = one.step(action)
        their_seen, earned, terminated, truncated, their_info = several.step({"car_0": action})
        assert what == [told["car_0"] for told in (earned, terminated, truncated)]


def test_every_car_follows_its_own_directive() -> None:
    env, reached = DrivingParallelEnv("highway", 2), []
    for wished in (15.0, 24.0):
        said = {"car_0": {"speed_mps": 20.0}, "car_1": {"speed_mps": wished}}
        _, infos = env.reset(seed=1, options={"directives": said})
        assert [infos[car]["intent"]["speed_mps"] for car in env.agents] == [20.0, wished]
        for _ in range(30):
            wanted = {car: 2 if infos[car]["speed"] < said[car]["speed_mps"] else 0 for car in env.agents}
            may = {car: a if infos[car]["action_mask"][a] else 1 for car, a in wanted.items()}
            *_, infos = env.step(may)
        reached.append(infos["car_1"]["speed"])
    assert reached[0] == pytest.approx(15.0, abs=1.5)
    assert reached[1] > 18.0
    env.direct("car_1", lane=0)
    assert env.step(dict.fromkeys(env.agents, 1))[-1]["car_1"]["intent"]["lane"] == 0


@pytest.mark.parametrize("scenario", ["highway", "merge", "two-way"])
def test_the_engine_ticks_several_egos_as_highway_env_does_to_the_bit(scenario: str) -> None:
    ours = RoadWorld(ScenarioEnv(scenario, duration_s=None), 3)
    ours.begin(np.ones(3, np.bool_), np.array([5, 0, 0]))
    road, egos = copy.deepcopy((ours.env.road, ours.egos))
    rng, none, style = np.random.default_rng(0), np.full(3, np.inf), np.ones(3, np.int64)
    for _ in range(90):
        meta = rng.integers(0, 6, 3)
        ours.tick(meta, np.full(3, np.nan), none, style)
        for ego, action in zip(egos, meta, strict=True):
            ego.speed_goal, ego.speed_cap = np.nan, np.inf
            ego.act(int(action))
        road.act()
        road.step(1 / 15)
        road.vehicles = [v for v in road.vehicles if not has_left(ours.scenario, v) or v in egos]
        for ego, mine in zip(egos, ours.egos, strict=True):
            assert state(ego) == state(mine)
            assert (ego.acceleration, ego.target_lane, ego.previous_lane) == (
                mine.acceleration,
                mine.target_lane,
                mine.previous_lane,
            )
        assert [state(v) for v in road.vehicles] == [state(v) for v in ours.env.road.vehicles]


def state(vehicle: Any) -> tuple[Any, ...]:
    return (*vehicle.position, vehicle.heading, vehicle.speed, vehicle.crashed)


def test_the_cars_see_each_other() -> None:
    env = DrivingParallelEnv("highway", 2)
    env.reset(seed=0)
    first, second = env._world.rows
    assert np.isin(second[0, 1], first[:, 1])  # its x among those that the first sees
    assert np.isin(first[0, 1], second[:, 1])


def test_a_car_that_has_crashed_is_out_and_the_others_drive_on() -> None:
    env = DrivingParallelEnv("highway", 4, mask=None)
    for seed in range(4):
        env.reset(seed=seed)
        while env.agents:
            before = list(env.agents)
            *_, terminated, truncated, _ = env.step(dict.fromkeys(env.agents, 2))
            if any(terminated.values()):
                alive = [car for car in before if not (terminated[car] or truncated[car])]
                assert env.agents == alive
                assert alive
                assert set(env.step(dict.fromkeys(alive, 1))[0]) == set(alive)
                return
    raise AssertionError("nobody crashed")


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"cars": 0}, "cars 0 is not within 1"),
        ({"cars": 99}, "all that this road has"),
        ({"observation": {"type": "Kinematics"}}, "is for one car"),
        ({"nonsense": 1}, "no setting nonsense"),
        ({"render_mode": "human"}, "is not rgb_array"),
    ],
)
def test_what_several_cars_cannot_do_is_refused_by_name(said: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        DrivingParallelEnv("highway", **said)


def test_an_unknown_car_a_missing_action_and_a_bad_one_are_refused() -> None:
    env = DrivingParallelEnv("highway", 2)
    with pytest.raises(ValueError, match="no car 'car_9': choose from car_0, car_1"):
        env.reset(options={"directives": {"car_9": {}}})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="these cars drive"):
        env.step({"car_0": 1})
    with pytest.raises(ValueError, match="action 7 is not one of"):
        env.step({"car_0": 1, "car_1": 7})


def test_the_spaces_are_the_same_objects_every_time_and_an_environment_that_is_let_go_is_gone() -> None:
    env = DrivingParallelEnv("highway", 2)
    assert env.observation_space("car_0") is env.observation_space("car_0")
    assert env.action_space("car_1") is env.action_space("car_1")
    assert env.action_space("car_0") is not env.action_space("car_1")
    gone = weakref.ref(env)
    del env
    gc.collect()
    assert gone() is None


def test_a_seed_whose_cars_seeds_do_not_fit_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="is above 9223372036853775804, the largest here"):
        DrivingParallelEnv("highway", 2).reset(seed=2**63 - 1)
