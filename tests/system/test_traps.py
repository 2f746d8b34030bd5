"""Every trap that stock highway-env sets for a learner, and that ours does not."""

from __future__ import annotations

import itertools
import json
import math
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from deploy.lab.guard import safety_mask
from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policies.attention import SHIPPED, load_attention
from fast_node.policies.rule import RulePolicy
from schemas.driving.reward import reward
from schemas.driving.road import DECISION_TICKS
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction
from sim_node.config import SimConfig
from sim_node.env import ScenarioEnv
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.scenario import streams
from sim_node.scenarios.stock import KINDS

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = MetaAction
NAMES = tuple(SCENARIOS)
OWN = tuple(name for name in NAMES if name not in KINDS)
"""Without highway-env's own roads, whose cars start as upstream has them."""


def alone(scenario: str, seed: int = 0, **options: object) -> ScenarioEnv:
    env = ScenarioEnv(scenario, **options)  # type: ignore[arg-type]
    env.reset(seed=seed)
    env.road.vehicles = [env.ego]
    return env


@pytest.mark.parametrize("name", NAMES)
def test_every_environment_passes_gymnasiums_own_check_without_a_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"sim_node:FastSlow-{name}-v0").unwrapped, skip_render_check=True)


def test_the_ego_can_brake_to_a_standstill_from_highway_speed() -> None:
    env = alone("highway")
    for _ in range(15 * 6):
        env.tick(BRAKE)
    assert env.ego.speed == pytest.approx(0.0, abs=1e-6)


def test_holding_slower_ends_below_any_traffic() -> None:
    env = alone("highway")
    for _ in range(600):
        env.step(SLOW_DOWN)
    assert env.ego.target_speed == 0.0
    assert env.ego.speed < 0.1


def test_doing_nothing_behind_a_slow_car_is_not_a_crash_once_the_mask_guards() -> None:
    env = ScenarioEnv("highway", guard=safety_mask)
    env.reset(seed=3)
    while env.steps < 300:
        _, _, terminated, _, _ = env.step(CRUISE)
        assert not terminated


def test_doing_nothing_unguarded_is_a_crash() -> None:
    env = ScenarioEnv("highway")
    env.reset(seed=3)
    assert any(env.step(CRUISE)[2] for _ in range(600))


def test_acceleration_stays_within_bounds_whatever_the_set_point() -> None:
    env = alone("highway")
    for target in (0.0, 28.0, 5.0, 28.0):
        env.ego.target_speed = target
        for _ in range(40):
            env.tick(CRUISE)
            assert -8.0 - 1e-9 <= env.ego.acceleration <= 1.8 + 1e-9


def test_faster_and_slower_are_inverse_at_15_hz() -> None:
    env = alone("highway")
    before = env.ego.target_speed
    env.step(SPEED_UP)
    env.step(SLOW_DOWN)
    assert env.ego.target_speed == before


def test_a_lane_action_at_every_tick_is_one_lane() -> None:
    env = alone("highway", seed=next(s for s in range(99) if SCENARIOS["highway"].spawn(streams(s)[0]).lane[0] == 3))
    for _ in range(15):
        env.step(LEFT)
    assert env.ego.target_lane == 2


def test_a_policy_that_flips_at_every_tick_changes_its_mind_three_times_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sim, fast = SimNode(SimConfig(scenario="merge")), FastNode(FastConfig(), RulePolicy())
    flips = iter(np.tile([[9, 0, 0, 0, 0], [0, 0, 9, 0, 0]], (60, 1)).astype(np.float32))
    monkeypatch.setattr(fast._policy, "logits", lambda x: next(flips))
    sim.reset(1)
    seen, done = sim.observation(0), []
    for _ in range(60):
        action, _ = fast.step(seen, None, 0)
        done.append(action.meta_action)
        seen = sim.step(action, 0)
    assert set(done) == {SLOW_DOWN, SPEED_UP}
    assert sum(a != b for a, b in itertools.pairwise(done)) < 60 / DECISION_TICKS


@pytest.mark.parametrize("bad", [2, 4, 7, 10, 0])
def test_a_decision_rate_that_does_not_divide_15_is_refused(bad: int) -> None:
    with pytest.raises(ValueError, match="does not divide"):
        ScenarioEnv("highway", decision_hz=bad)


@pytest.mark.parametrize(("decision_hz", "steps"), [(15, 600), (5, 200), (3, 120), (1, 40)])
def test_forty_seconds_are_forty_seconds_at_every_rate(decision_hz: int, steps: int) -> None:
    env = alone("highway", decision_hz=decision_hz)
    taken = next(k for k in range(1, 999) if env.step(CRUISE)[3])
    assert (taken, env.time) == (steps, pytest.approx(40.0))


def test_the_two_way_road_ends_an_episode_before_it_ends() -> None:
    env = alone("two-way", duration_s=None)
    env.ego.position[0] = env.scenario.end_x_m - 3.0
    assert any(env.step(SPEED_UP)[3] for _ in range(30))
    assert not env.ego.crashed


def test_oncoming_cars_do_not_save_the_ego_but_the_mask_does() -> None:
    wanted = {None: 0, safety_mask: 0}
    for guard in wanted:
        env = ScenarioEnv("two-way", guard=guard)
        for seed in range(4):
            env.reset(seed=seed)
            for _ in range(450):
                if env.step(LEFT)[2]:
                    break
            wanted[guard] += env.ego.crashed
    assert wanted[safety_mask] == 0 < wanted[None]


@pytest.mark.parametrize("name", NAMES)
def test_no_lane_falls_back_to_the_speed_limit_that_upstream_assumes(name: str) -> None:
    env = ScenarioEnv(name)
    env.reset(seed=0)
    limits = {plan.speed_limit_mps for plan in env.scenario.lanes}
    assert {lane.speed_limit for lane in env.road.network.lanes_list()} == limits


def test_drivers_see_a_car_beyond_the_joint_of_two_pieces_of_road() -> None:
    env = alone("merge")
    env.ego.position[:] = (225.0, 4.0)
    ahead = type(env.ego)(env.road, env.scenario, 1 / 15, 1, 240.0, 4.0, 0.0, 5.0)
    env.road.vehicles.append(ahead)
    front, _ = env.road.neighbour_vehicles(env.ego, ("a", "b", 1))
    assert front is ahead


@pytest.mark.parametrize("name", [n for n in OWN if "merge" not in n and n != "roadworks"])
def test_cars_start_behind_the_ego_too(name: str) -> None:
    for seed in range(20):
        s = SCENARIOS[name].spawn(streams(seed)[0])
        assert (s.x[(s.direction > 0)][1:] < s.x[0]).any()


def earned(
    speed: float,
    v_des: float,
    accel2: float = 0.0,
    acted: bool = False,
    in_lane: bool = True,
    ttc_s: float = 100.0,
    short: float = 0.0,
    braked: bool = False,
    crashed: bool = False,
    seconds: float = 1.0,
) -> float:
    one = np.asarray
    return float(
        reward(
            one(speed),
            one(v_des),
            0.5 * v_des,
            one(accel2),
            one(0.0),
            one(acted),
            one(False),
            one(in_lane),
            one(ttc_s),
            one(short),
            one(braked),
            one(crashed),
            seconds,
        )
    )


def test_a_second_of_reward_is_of_the_size_of_one() -> None:
    assert 0.05 < earned(28.0, 28.0) < 0.2
    assert -2.0 < earned(0.0, 28.0, 36.0, True, False, 0.0, 1.0, True, True) < -1.0


def test_a_crash_costs_the_same_at_every_decision_rate() -> None:
    cost = [earned(20.0, 28.0, seconds=t) - earned(20.0, 28.0, seconds=t, crashed=True) for t in (1.0, 1 / 15)]
    assert cost == [pytest.approx(1.0), pytest.approx(1.0)]


def test_parking_in_the_wished_lane_earns_less_than_driving_outside_it() -> None:
    parked = earned(0.0, 8.0)
    assert parked < 0 < earned(7.5, 8.0, 0.1, True, in_lane=False, ttc_s=11.0)


def test_a_policy_that_was_trained_behind_another_mask_is_refused(tmp_path) -> None:
    sidecar = json.loads(SHIPPED.with_suffix(".json").read_text())
    (tmp_path / "p.json").write_text(json.dumps({**sidecar, "mask": "mask/0"}))
    (tmp_path / "p.safetensors").write_bytes(SHIPPED.read_bytes())
    with pytest.raises(ConfigError, match="mask"):
        load_attention(tmp_path / "p.safetensors")


def test_a_user_scenario_is_an_object_and_needs_no_registration() -> None:
    import dataclasses

    short = dataclasses.replace(SCENARIOS["highway"], name="mine", duration_s=1.0)
    env = ScenarioEnv(short, duration_s="scenario")
    env.reset(seed=1)
    assert next(k for k in range(1, 99) if env.step(CRUISE)[3]) == 15


def test_a_lane_wish_of_the_user_replaces_the_random_ones() -> None:
    env = ScenarioEnv("highway")
    env.reset(seed=2)
    env.direct(lane=0, speed_mps=20.0)
    observation, _ = env.reset(seed=5)
    assert (env.intent.lane, env.intent.speed_mps) == (0, 20.0)
    assert observation[0, 14] == 1.0
    assert math.isfinite(float(observation[0, 8]))


def test_density_draws_the_same_cars_closer_together() -> None:
    usual, dense = (SCENARIOS["highway"].denser(f).spawn(streams(4)[0]) for f in (1.0, 2.0))
    assert dense.x[1] - dense.x[0] == pytest.approx(0.5 * (usual.x[1] - usual.x[0]))
    with pytest.raises(ValueError, match="density"):
        SCENARIOS["highway"].denser(9.0)


def test_noise_and_dropout_touch_what_is_seen_and_not_what_is_there() -> None:
    clear, foggy = ScenarioEnv("highway"), ScenarioEnv("highway", noise_m=0.5, noise_mps=0.3, dropout=0.3)
    (a, _), (b, _) = clear.reset(seed=4), foggy.reset(seed=4)
    assert (a[0, 2:8] == b[0, 2:8]).all()  # the ego knows itself
    assert b[:, 0].sum() < a[:, 0].sum()
    assert [v.position.tolist() for v in clear.road.vehicles] == [v.position.tolist() for v in foggy.road.vehicles]


@pytest.mark.parametrize("name", OWN)
def test_no_two_cars_start_inside_each_other(name: str) -> None:
    for seed in range(50):
        s = SCENARIOS[name].spawn(streams(seed)[0])
        for lane in set(s.lane.tolist()):
            assert np.diff(np.sort(s.x[s.lane == lane])).min(initial=99.0) >= 15.0
