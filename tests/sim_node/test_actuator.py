"""The actuator: what it lets through, what it refuses, and that nothing reckless comes of what it lets through."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.lab.agents import drive
from schemas.driving.measures import EGO_BRAKE_MAX_MPS2
from schemas.runtime.compiled import compiled
from schemas.wire.messages import Action, EventKind, MetaAction
from sim_node.actuator import ADMITTED, GAP, LANE_END, ONCOMING, TAKEN, check
from sim_node.config import SimConfig
from sim_node.engine.batched import Batched
from sim_node.env import ScenarioEnv
from sim_node.executor import LATERAL_SPEED_MAX_MPS, STYLE_ACCEL_MPS2
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.scenario import streams
from tests.scenes import car

LANES, ENDS = [0.0, 4.0, 8.0], [1000.0, 1000.0, 1000.0]
SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = MetaAction


def asked(
    meta: int, *others: list[float], v: float = 20.0, y: float = 4.0, aim: int = 1, left: int = -1, ends: Any = ENDS
) -> tuple[int, int, int]:
    """What is done, why and for whom, of an ego at x = 100 m on three lanes of one direction."""
    ego = car(0, 100.0, round(y / 4.0), v, y)
    return check([ego, *others], LANES, ends, meta, aim, left)


@pytest.mark.parametrize("meta", list(MetaAction))
def test_on_a_free_road_everything_is_carried_out(meta: int) -> None:
    assert asked(meta) == (meta, ADMITTED, -1)


def test_the_ego_brakes_where_it_could_hardly_stop_behind_the_car_ahead() -> None:
    # From 20 m/s behind a standing car: 2 m in 0.1 s, 25 m to stop, half a metre left.
    assert asked(SPEED_UP, car(7, 100.0 + 5.0 + 27.4, 1, 0.0, 4.0)) == (BRAKE, GAP, 7)
    assert asked(SPEED_UP, car(7, 100.0 + 5.0 + 27.6, 1, 0.0, 4.0)) == (SPEED_UP, ADMITTED, -1)


def test_a_car_that_draws_away_or_is_in_another_lane_is_not_braked_for() -> None:
    assert asked(CRUISE, car(7, 106.0, 1, 20.1, 4.0))[0] == CRUISE
    assert asked(CRUISE, car(7, 106.0, 0, 0.0, 0.0))[0] == CRUISE
    assert asked(CRUISE, car(-1, 106.0, 1, 0.0, 4.0))[0] == CRUISE


def test_a_car_that_drifts_into_the_ego_s_way_is_braked_for() -> None:
    assert asked(CRUISE, car(7, 110.0, 0, 10.0, 1.7))[0] == CRUISE
    assert asked(CRUISE, car(7, 110.0, 0, 10.0, 1.7, vy_mps=1.0)) == (BRAKE, GAP, 7)


def test_a_car_that_stands_askew_takes_up_more_of_the_road() -> None:
    assert asked(CRUISE, car(7, 110.0, 0, 0.0, 1.0), v=10.0)[0] == CRUISE
    assert asked(CRUISE, car(7, 110.0, 0, 0.0, 1.0, heading_rad=0.6), v=10.0) == (BRAKE, GAP, 7)


def test_the_ego_stops_before_an_oncoming_car() -> None:
    facing = car(7, 150.0, 1, -10.0, 4.0)
    assert asked(CRUISE, facing) == (BRAKE, ONCOMING, 7)
    assert asked(CRUISE, car(7, 155.0, 1, -10.0, 4.0))[0] == CRUISE


def test_the_ego_does_not_brake_for_an_oncoming_car_whose_lane_it_has_left_in_time() -> None:
    facing = car(7, 140.0, 0, -10.0, 0.0)
    assert asked(CRUISE, facing, v=10.0, y=0.0, aim=1, left=0)[0] == CRUISE
    assert asked(CRUISE, car(7, 115.0, 0, -10.0, 0.0), v=10.0, y=0.0, aim=1, left=0)[1] == ONCOMING


@pytest.mark.parametrize("x", [92.0, 100.0, 103.0])
def test_no_change_into_a_place_that_is_taken(x: float) -> None:
    assert asked(LEFT, car(7, x, 0, 20.0, 0.0)) == (CRUISE, TAKEN, 7)


def test_no_change_before_a_car_that_comes_too_fast() -> None:
    # 30 m/s to 20 m/s: 15 m in half a second, 75 m to stop, less the ego's 40 m.
    assert asked(LEFT, car(7, 100.0 - 5.0 - 49.0, 0, 30.0, 0.0)) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, car(7, 100.0 - 5.0 - 51.0, 0, 30.0, 0.0)) == (LEFT, ADMITTED, -1)


def test_a_slow_ego_is_noticed_later() -> None:
    behind = car(7, 100.0 - 5.0 - 15.0, 0, 10.0, 0.0)
    assert asked(LEFT, behind, v=5.0)[0] == LEFT
    assert asked(LEFT, behind, v=0.0)[0] == CRUISE


def test_no_change_before_an_oncoming_car_but_behind_one_that_has_gone_by() -> None:
    assert asked(LEFT, car(7, 195.0, 0, -10.0, 0.0)) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, car(7, 200.0, 0, -10.0, 0.0)) == (LEFT, ADMITTED, -1)
    assert asked(LEFT, car(7, 95.0, 0, -10.0, 0.0)) == (LEFT, ADMITTED, -1)


def test_a_change_before_one_is_braked_for_what_is_ahead_all_the_same() -> None:
    others = car(6, 101.0, 0, 20.0, 0.0), car(7, 120.0, 1, 0.0, 4.0)
    assert asked(LEFT, *others) == (BRAKE, GAP, 7)


def test_a_running_change_into_a_place_that_is_taken_is_given_up_while_the_ego_is_in_its_lane() -> None:
    beside = car(7, 99.0, 0, 20.0, 0.0)
    assert asked(CRUISE, beside, y=3.5, aim=0, left=1) == (RIGHT, TAKEN, 7)
    assert asked(BRAKE, beside, y=3.5, aim=0, left=1)[0] == BRAKE
    assert asked(CRUISE, beside, y=1.0, aim=0, left=1)[0] == CRUISE  # too late: it is there


def test_a_change_is_not_given_up_where_the_ego_could_not_stop_in_its_own_lane() -> None:
    ahead, beside = car(6, 120.0, 1, 0.0, 4.0), car(7, 99.0, 0, 20.0, 0.0)
    assert asked(CRUISE, ahead, beside, y=3.5, aim=0, left=1) == (BRAKE, GAP, 6)


def test_giving_a_change_up_is_refused_where_the_lane_that_was_left_is_taken() -> None:
    assert asked(RIGHT, car(7, 101.0, 1, 20.0, 4.0), y=1.0, aim=0, left=1) == (CRUISE, TAKEN, 7)
    assert asked(RIGHT, y=1.0, aim=0, left=1) == (RIGHT, ADMITTED, -1)


def test_the_ego_stops_before_its_lane_ends_unless_it_is_out_of_it_in_time() -> None:
    # 20 m/s: 27 m to stop, 4 m for what stands there, half a metre left.
    ends = [1000.0, 131.4, 1000.0]
    assert asked(CRUISE, ends=ends) == (BRAKE, LANE_END, -1)
    assert asked(CRUISE, ends=[1000.0, 131.6, 1000.0])[0] == CRUISE
    assert asked(CRUISE, y=2.5, aim=0, left=1, ends=ends)[0] == CRUISE  # 10 m are enough for half a metre
    assert asked(CRUISE, y=4.0, aim=0, left=1, ends=[1000.0, 115.0, 1000.0]) == (BRAKE, LANE_END, -1)


def test_a_lane_that_ends_too_soon_is_not_entered() -> None:
    assert asked(RIGHT, ends=[1000.0, 1000.0, 130.0]) == (CRUISE, LANE_END, -1)


@given(
    st.integers(0, 5),
    st.sampled_from([(1, -1), (0, 1), (2, 1), (0, -1), (2, -1)]),
    st.floats(0.0, 35.0),
    st.floats(-1.0, 9.0),
    st.lists(st.tuples(st.floats(0.0, 250.0), st.sampled_from(LANES), st.floats(-30.0, 35.0)), max_size=6),
    st.floats(90.0, 400.0),
)
def test_compiled_and_plain_the_check_says_the_same(
    meta: int, lanes: tuple[int, int], v: float, y: float, others: list[tuple[float, float, float]], end: float
) -> None:
    cars = [car(i, x, round(at / 4), mps) for i, (x, at, mps) in enumerate(others, 1)]
    rows = np.array([car(0, 100.0, min(max(round(y / 4), 0), 2), v, y), *cars], np.float32)
    ends = np.array([1000.0, 1000.0, end])
    assert COMPILED(rows, np.array(LANES), ends, meta, *lanes) == check(
        rows.tolist(), LANES, ends.tolist(), meta, *lanes
    )


COMPILED = compiled(check)


@pytest.mark.parametrize("name", ["highway", "merge", "two-way"])
def test_one_world_and_many_refuse_the_same(name: str) -> None:
    env, many = ScenarioEnv(name, checked=True), Batched(SCENARIOS[name], 1, 0, actuator=True)
    env.reset(seed=1000)
    many.load(0, SCENARIOS[name].spawn(streams(1000)[0]))
    rng, refused = np.random.default_rng(0), 0
    for _ in range(400):
        meta = int(rng.integers(2, 5)) if rng.random() < 0.1 else int(SPEED_UP)
        env.tick(meta)
        many.tick(np.array([meta]), np.array([np.nan]))
        np.testing.assert_array_equal(env.rows()[0], many.rows[0, 0])
        assert env.refused[0] == many.refused[0]
        refused += env.refused[0] != ADMITTED
    assert refused > 0


@pytest.mark.parametrize("driver", ["reckless", "random-checked"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_whatever_is_asked_for_the_ego_causes_no_collision_in_thirty_episodes(name: str, driver: str) -> None:
    results = drive(driver, SCENARIOS[name], range(1000, 1030))
    assert sum(r.collided and not r.struck for r in results) == 0
    assert sum(r.actuator_ticks for r in results) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_behind_the_mask_the_actuator_has_nothing_to_do(name: str) -> None:
    assert sum(r.actuator_ticks for r in drive("ours", SCENARIOS[name], range(1000, 1030))) == 0


@pytest.mark.parametrize("name", ["highway", "merge", "two-way"])
def test_no_action_exceeds_the_limits_of_acceleration_and_sideways_speed(name: str) -> None:
    scenes, rng = 32, np.random.default_rng(0)
    world = Batched(SCENARIOS[name], scenes, 0, actuator=True)
    for _ in range(300):
        style, bounds = rng.integers(3, size=scenes), (0.0, 20.0, 100.0, np.inf)
        before = world.accel.copy()
        cap, goal = rng.choice(bounds, scenes), rng.choice([*bounds, np.nan, -5.0], scenes)
        world.tick(rng.integers(6, size=scenes), goal, cap, style)
        on = ~world.crashed
        stands = world.speed[:, 0] < 1e-6
        assert (world.accel[on] >= -EGO_BRAKE_MAX_MPS2 - 1e-9).all()
        assert (world.accel[on] <= np.array(STYLE_ACCEL_MPS2)[style][on] + 1e-9).all()
        assert (((world.accel - before) * 15 <= 75.0 + 1e-6) | stands)[on].all()
        sideways = world.speed[:, 0] * np.sin(world.heading[:, 0])
        bend = 1.5 if name == "merge" else 0.0
        assert (np.abs(sideways)[on] <= LATERAL_SPEED_MAX_MPS + bend + 0.5).all()


def test_the_running_simulator_counts_and_tells_what_it_does_not_carry_out() -> None:
    sim = SimNode(SimConfig(scenario="highway", seed=1000))
    sim.reset(1)
    told = []
    for tick in range(300):
        action = Action(epoch=1, stamp_ns=0, answers_tick=tick, meta_action=int(SPEED_UP), source="policy", style=2)
        sim.step(action, 0)
        told += [e for e in sim.take_events() if e.kind == EventKind.ACTUATOR]
    assert sim.metrics.collisions == 0
    assert sim.metrics.refused > 0
    assert 0 < len(told) <= 20
    assert told[0].detail == "speed up is not carried out: gap too small"
    assert told[0].vehicle > 0
