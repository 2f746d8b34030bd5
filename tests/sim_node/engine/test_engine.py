"""The engine is highway-env, bit for bit: state, observation, reward and flags, in both of its variants."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from highway_env.envs import HighwayEnv, HighwayEnvFast
from highway_env.envs.merge_env import ConnectedLaneMergeEnv
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.objects import Obstacle

from deploy.bench import sim
from schemas.driving.road import ID, X
from schemas.runtime.compiled import compiled
from schemas.wire.messages import MetaAction
from sim_node.engine import bridge, loops, parity
from sim_node.engine.accelerated import accelerate
from sim_node.engine.batched import Batched
from sim_node.engine.kernel import layout, tick
from sim_node.engine.kernel.layout import ABSENT_X_M
from sim_node.scenarios import SCENARIOS
from sim_node.traffic import TrafficVehicle

AccelEnv = accelerate(HighwayEnv)


# Per case a seed whose short run sees crashes where there are any early ones; `make parity` runs 20 seeds x 40 s.
@pytest.mark.parametrize(
    ("case", "seed", "seconds"),
    [
        ("highway-v0, 20 vehicles", 2, 5.0),
        ("highway-v0, 50 vehicles", 0, 4.0),
        ("merge-v1", 0, 8.0),
        ("two-way-v0, stock ego", 0, 12.0),
        *((name, 1, 6.0) for name in SCENARIOS),
    ],
)
def test_both_variants_equal_highway_env_to_the_last_bit(case: str, seed: int, seconds: float) -> None:
    for figures in parity.compare(case, seed, seconds):
        assert figures.identical, figures
        assert figures.ticks > 30


def test_they_stay_equal_through_crashes() -> None:
    accelerated, batched = parity.compare("two-way-v0, stock ego", 1, 12.0)
    assert accelerated.crashes > 0
    assert accelerated.identical
    assert batched.identical


def test_the_compiled_constants_are_the_installed_highway_envs() -> None:
    for name, value in bridge.CONSTANTS.items():
        for kind in (IDMVehicle, MDPVehicle, Obstacle):
            assert getattr(kind, name, value) == value, name


def test_compiled_calls_of_numpy_give_numpys_own_bits() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.0, 1.0, 999), rng.uniform(3.5, 4.5, 999)
    calls, out = layout.new_calls(), np.empty(999)
    unary = compiled(loops.unary, _nrt=False)
    power = compiled(loops.power, _nrt=False)
    dot = compiled(loops.dot, _nrt=False)
    for which, function in (
        (loops.TAN, np.tan),
        (loops.ARCTAN, np.arctan),
        (loops.ARCSIN, np.arcsin),
        (loops.SIN, np.sin),
        (loops.COS, np.cos),
    ):
        unary(calls.loops, which, calls.args, x, out, 999)
        assert [function(v) for v in x] == out.tolist()
    power(calls.loops, calls.args, x, y, out, 999)
    assert [np.power(a, b) for a, b in zip(x, y, strict=True)] == out.tolist()
    for a, b, c, d in rng.normal(size=(99, 4)):
        assert dot(calls.loops, calls.args, calls.box, a, b, c, d) == np.dot([a, b], [c, d])


@pytest.mark.parametrize(
    "observation",
    [
        {"absolute": True},
        {"normalize": False, "see_behind": True},
        {"order": "shuffled", "clip": False},
        {"features": ["x", "vy", "cos_h", "presence", "sin_h"], "vehicles_count": 20},
        {"features": ["x", "long_off"]},
        {"include_obstacles": False, "features_range": {"x": [-50, 50], "vx": [0, 30]}},
    ],
)
def test_kinematics_observations_of_every_kind_are_upstreams(observation: dict[str, Any]) -> None:
    config = {"observation": {"type": "Kinematics", **observation}, "vehicles_count": 12}
    for kind, action in ((HighwayEnv, 1), (ConnectedLaneMergeEnv, 3)):
        if kind is ConnectedLaneMergeEnv:
            config.pop("vehicles_count", None)
        slow, fast = kind(config), accelerate(kind)(config)
        assert np.array_equal(slow.reset(seed=1)[0], fast.reset(seed=1)[0])
        for _ in range(2):
            assert np.array_equal(slow.step(action)[0], fast.step(action)[0])


def test_cars_that_skip_collision_checks_skip_them() -> None:
    slow, fast = HighwayEnvFast({"vehicles_density": 3.0}), accelerate(HighwayEnvFast)({"vehicles_density": 3.0})
    slow.reset(seed=3)
    fast.reset(seed=3)
    for _ in range(10):
        slow.step(3)
        fast.step(3)
    assert [v.position.tolist() for v in slow.road.vehicles] == [v.position.tolist() for v in fast.road.vehicles]


def test_an_edit_from_outside_counts_at_the_next_tick() -> None:
    slow, fast = HighwayEnv({"vehicles_count": 8}), AccelEnv({"vehicles_count": 8})
    for env in (slow, fast):
        env.reset(seed=0)
        env.step(1)
        car = env.road.vehicles[3]
        car.position = car.position + np.array([3.0, 1.0])
        car.target_speed, car.enable_lane_change, car.heading = 11.0, False, 0.1
        env.road.vehicles.pop()
        env.step(1)
    assert [v.position.tolist() for v in slow.road.vehicles] == [v.position.tolist() for v in fast.road.vehicles]


def test_what_the_engine_does_not_know_runs_upstream_with_one_warning() -> None:
    config = {"other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle", "vehicles_count": 5}
    slow, fast = HighwayEnv(config), accelerate(HighwayEnv)(config)
    slow.reset(seed=0)
    fast.reset(seed=0)
    with pytest.warns(UserWarning, match="does not know AggressiveVehicle"):
        fast.step(1)
    slow.step(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fast.step(1)
    slow.step(1)
    assert [v.position.tolist() for v in slow.road.vehicles] == [v.position.tolist() for v in fast.road.vehicles]


def test_a_driver_with_its_own_constants_runs_upstream() -> None:
    env = accelerate(HighwayEnv)({"vehicles_count": 3})
    env.reset(seed=0)
    env.road.vehicles[1].POLITENESS = 0.5
    with pytest.warns(UserWarning, match="another POLITENESS"):
        env.step(1)


def test_every_frame_is_shown_while_a_viewer_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    slow, fast = (kind({"vehicles_count": 5, "policy_frequency": 5}) for kind in (HighwayEnv, AccelEnv))
    shown: list[list[float]] = []
    for env in (slow, fast):
        env.reset(seed=0)
        monkeypatch.setattr(env, "viewer", object())
        monkeypatch.setattr(env, "_automatic_rendering", lambda e=env: shown.append(e.vehicle.position.tolist()))
        env.enable_auto_render = True
        env.step(3)
    assert shown[:2] == shown[2:]
    assert len(shown) == 4


def test_traffic_stops_where_upstream_would_reverse() -> None:
    for kind, reverses in ((IDMVehicle, True), (TrafficVehicle, False)):
        road = Road(RoadNetwork.straight_road_network(1, length=500.0))
        car = kind(road, [100.0, 0.0], speed=8.0)
        road.vehicles, road.objects = [car], [Obstacle(road, [112.0, 0.0])]
        slowest = 0.0
        for _ in range(90):
            road.act()
            road.step(1 / 15)
            slowest = min(slowest, car.speed)
        assert (slowest < -1e-9) == reverses


def driven(world: Batched, meta: MetaAction, ticks: int) -> Batched:
    for _ in range(ticks):
        world.tick(np.full(world.scenes, meta, np.int64), np.full(world.scenes, np.nan))
    return world


def test_scenes_are_reproducible_and_independent() -> None:
    one, many = Batched(SCENARIOS["highway"], 3, 7), Batched(SCENARIOS["highway"], 5, 7)
    assert np.array_equal(driven(one, MetaAction.CRUISE, 5).rows, driven(many, MetaAction.CRUISE, 5).rows[:3])
    assert not np.array_equal(many.x[0], many.x[1])
    before = many.rows.copy()
    many.reset(np.array([False, True, False, False, False]))
    assert not np.array_equal(before[1], many.rows[1])
    assert np.array_equal(before[[0, 2, 3, 4]], many.rows[[0, 2, 3, 4]])


def test_rows_mirror_the_state_and_the_unseen_are_far_away() -> None:
    world = driven(Batched(SCENARIOS["two-way"], 32, 3), MetaAction.CRUISE, 30)
    unseen = world.rows[..., ID] < 0
    assert world.rows.dtype == np.float32
    assert np.all(world.rows[unseen][:, X] == ABSENT_X_M)
    assert np.array_equal(world.rows[..., X][~unseen], world.x.astype(np.float32)[~unseen])
    assert np.all(world.rows[:, 0, ID] == 0)
    assert unseen.any()


def test_lanes_lie_where_the_ramp_does() -> None:
    scenario = SCENARIOS["merge"]
    world = driven(Batched(scenario, 4, 0), MetaAction.CRUISE, 60)
    for s in range(4):
        published = [lane.y_m for lane in scenario.lanes_at(float(world.x[s, 0]))]
        assert world.lane_y[s] == pytest.approx(published, abs=1e-8)


def test_a_crashed_scene_stands_until_reset() -> None:
    world = driven(Batched(SCENARIOS["two-way"], 1, 0), MetaAction.SPEED_UP, 600)
    assert world.crashed[0]
    ticks, rows = int(world.ticks[0]), world.rows.copy()
    driven(world, MetaAction.CRUISE, 1)
    assert world.ticks[0] == ticks
    assert np.array_equal(rows, world.rows)
    world.reset(np.array([True]))
    assert not world.crashed[0]
    assert world.ticks[0] == 0


def test_an_idm_ego_drives_by_itself_towards_its_speed_goal() -> None:
    world = Batched(SCENARIOS["highway"], 8, 0, ego="idm")
    goal = np.full(8, 22.0)
    for _ in range(300):
        world.tick(np.full(8, MetaAction.SPEED_UP, np.int64), goal)
    assert not world.crashed.any()
    assert np.all(world.target_speed == 22.0)
    assert np.all(world.speed[:, 0] < 22.5)
    with pytest.raises(ValueError, match="neither"):
        Batched(SCENARIOS["highway"], 1, 0, ego="robot")  # type: ignore[arg-type]


def test_one_compilation_serves_every_road_and_every_number_of_scenes() -> None:
    for name in SCENARIOS:
        driven(Batched(SCENARIOS[name], 2, 0), MetaAction.CRUISE, 1)
    env = AccelEnv({"vehicles_count": 4, "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 15, 30]}})
    env.reset(seed=0)
    env.step(3)
    assert len(tick.advance.signatures) == 1  # type: ignore[attr-defined]


def test_the_bench_measures_every_variant_and_reports_parity() -> None:
    result = sim.bench_sim(
        seconds=0.02, turns=1, vehicles=(20,), policy_hz=(15,), scenes=2, names=("batched", "accelerated", "stock")
    )
    assert set(result["rows"][0]) == {
        "variant",
        "scenario",
        "vehicles",
        "policy_hz",
        "ticks_per_cpu_s",
        "decisions_per_cpu_s",
        "p50_ms",
        "p99_ms",
        "max_state_difference",
    }
    assert [r["max_state_difference"] for r in result["rows"]] == [0.0, 0.0, 0.0]
    assert sim.table(result).count("\n") == 3
    with pytest.raises(ValueError, match="does not divide"):
        sim.bench_sim(policy_hz=(4,))
