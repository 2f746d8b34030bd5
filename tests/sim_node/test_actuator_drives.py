"""The actuator where it drives: compiled and plain, on every road, behind the mask and under reckless drivers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.lab.agents import drive
from schemas.driving.measures import EGO_BRAKE_MAX_MPS2
from schemas.runtime.compiled import compiled
from schemas.wire.messages import Action, EventKind, MetaAction
from sim_node.actuator import ADMITTED, check
from sim_node.config import SimConfig
from sim_node.engine.batched import Batched
from sim_node.env import ScenarioEnv
from sim_node.executor import LATERAL_SPEED_MAX_MPS, STYLE_ACCEL_MPS2
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.scenario import streams
from tests.scenes import car

LANES = [0.0, 4.0, 8.0]
SPEED_UP = MetaAction.SPEED_UP


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
