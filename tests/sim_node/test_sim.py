"""The simulator: its executor, its world, its fail-safe, its process."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from schemas.runtime.bus import BusConfig, open_bus
from schemas.wire.codec import decode, encode, rows_of
from schemas.wire.messages import Action, MetaAction
from schemas.wire.topics import OBSERVATION, STATUS
from sim_node import executor
from sim_node.config import SimConfig
from sim_node.node import FAILSAFE_BRAKE_MPS2, SimNode
from sim_node.scenarios import SCENARIOS

DT = 1 / 15
GATES = [(-1e9, 1e9, -1e9, 0.0)] * 2


def edit(
    meta: MetaAction,
    speed: float = 5.0,
    lane: int = 1,
    previous: int = -1,
    goal: float = math.nan,
    cap: float = math.inf,
) -> tuple[float, int, int]:
    return executor.edit_set_points(int(meta), speed, lane, previous, GATES, 0.0, goal, 0.0, 8.0, cap)


def act(
    node: SimNode,
    meta: MetaAction = MetaAction.CRUISE,
    tick: int | None = None,
    epoch: int | None = None,
    goal: float | None = None,
) -> Action:
    return Action(
        epoch=node.epoch if epoch is None else epoch, stamp_ns=0, source="policy", meta_action=int(meta),
        answers_tick=node.tick if tick is None else tick, speed_goal_mps=goal)  # fmt: skip


def fresh(seed: int = 0) -> SimNode:
    node = SimNode(SimConfig(seed=seed))
    node.reset(7)
    return node


def test_speed_steps_of_a_tenth_are_inverse_of_each_other() -> None:
    up = edit(MetaAction.SPEED_UP)
    assert up == (pytest.approx(5.1), 1, -1)
    assert edit(MetaAction.SLOW_DOWN, *up) == (pytest.approx(5.0), 1, -1)


def test_speed_steps_stay_within_the_scenario() -> None:
    assert edit(MetaAction.SPEED_UP, 7.95)[0] == 8.0
    assert edit(MetaAction.SLOW_DOWN, 0.05)[0] == 0.0


@pytest.mark.parametrize(("meta", "start"), [(MetaAction.SPEED_UP, 5.34), (MetaAction.SLOW_DOWN, 5.66)])
def test_a_step_towards_a_goal_stops_exactly_at_it(meta: MetaAction, start: float) -> None:
    first = edit(meta, start, goal=5.5)[0]
    assert abs(start - first) == pytest.approx(0.1)
    assert edit(meta, first, goal=5.5)[0] == 5.5


def test_a_goal_does_not_stop_a_step_away_from_it() -> None:
    assert edit(MetaAction.SLOW_DOWN, 5.0, goal=5.05)[0] == pytest.approx(4.9)


@pytest.mark.parametrize(("cap", "stepped"), [(math.inf, 4.9), (6.0, 4.9), (3.0, 2.9), (0.05, 0.0), (-2.0, 0.0)])
def test_slowing_down_starts_from_the_speed_that_is_admitted(cap: float, stepped: float) -> None:
    assert edit(MetaAction.SLOW_DOWN, cap=cap)[0] == pytest.approx(stepped)


@pytest.mark.parametrize(("meta", "speed"), [(MetaAction.CRUISE, 5.0), (MetaAction.SPEED_UP, 5.1)])
def test_a_cap_leaves_the_set_point_as_it_is(meta: MetaAction, speed: float) -> None:
    assert edit(meta, cap=3.0)[0] == pytest.approx(speed)


def test_slowing_down_from_a_cap_stops_at_a_goal_below_it() -> None:
    assert edit(MetaAction.SLOW_DOWN, goal=2.95, cap=3.0)[0] == 2.95


def test_a_lane_action_starts_one_change_and_repeating_it_changes_nothing() -> None:
    left = edit(MetaAction.LEFT)
    assert left == (5.0, 0, 1)
    assert edit(MetaAction.LEFT, *left) == left
    assert edit(MetaAction.LEFT, lane=0) == (5.0, 0, -1)
    assert edit(MetaAction.RIGHT, lane=1) == (5.0, 1, -1)


def test_the_opposite_lane_action_aborts_a_change() -> None:
    assert edit(MetaAction.RIGHT, lane=0, previous=1) == (5.0, 1, 0)
    assert edit(MetaAction.LEFT, lane=1, previous=0) == (5.0, 0, 1)


def test_an_emergency_brake_sets_nothing() -> None:
    assert edit(MetaAction.EMERGENCY_BRAKE, lane=0, previous=1) == (5.0, 0, 1)


@pytest.mark.parametrize("speed", [4.0, 5.0, 8.0, 15.0, 25.0])
@pytest.mark.parametrize("y_target", [0.0, 4.0])
def test_a_lane_change_is_done_within_3_s_and_does_not_overshoot(speed: float, y_target: float) -> None:
    x, y, heading = 0.0, 4.0 - y_target, 0.0
    start, side, done_s, fastest = y, math.copysign(1.0, y_target - y), math.inf, 0.0
    for k in range(1, 120):
        slip = math.atan(0.5 * math.tan(executor.steering_command(y, heading, speed, y_target, 0.0)))
        vy = speed * math.sin(heading + slip)
        x, y = x + speed * math.cos(heading + slip) * DT, y + vy * DT
        heading += speed * math.sin(slip) / 2.5 * DT
        fastest = max(fastest, abs(vy))
        assert side * (y - y_target) < 0.3
        if executor.change_finished(y, y_target):
            done_s = min(done_s, k * DT)
    assert abs(start - y_target) == 4.0
    assert 1.5 < done_s < 3.0
    assert fastest <= 2.5 + 1e-9
    assert abs(y - y_target) < 0.05


def test_a_standing_car_does_not_steer() -> None:
    assert executor.steering_command(4.0, 0.0, 0.4, 0.0, 0.0) == 0.0


STYLES = pytest.mark.parametrize(("style", "most", "jerk"), [(0, 1.2, 1.0), (1, 1.8, 2.0), (2, 2.5, 3.0)])
"""Calm, normal, assertive: what the ego speeds up with, and how fast it comes to that [m/s2, m/s3]."""


def accelerated(
    speed: float, target: float, last: float, style: int = 1, meta: MetaAction = MetaAction.CRUISE
) -> float:
    return executor.acceleration_command(speed, target, last, int(meta), style, DT)


@STYLES
def test_acceleration_and_jerk_are_bounded_whatever_is_asked(style: int, most: float, jerk: float) -> None:
    rng = np.random.default_rng(3)
    speed, last, target = 5.0, 0.0, 5.0
    for k in range(3000):
        if k % 20 == 0:
            target = float(rng.uniform(0.0, 25.0))
        accel = accelerated(speed, target, last, style)
        assert -8.0 <= accel <= most
        if speed > 0.5:  # stopping itself ends a braking at once
            released = last < -executor.COMFORT_BRAKE_MPS2
            eased = max(jerk, executor.EASE_JERK_MPS3) if last < 0.0 else jerk
            up = executor.BRAKE_RELEASE_JERK_MPS3 if released else eased
            assert -4.0 - 1e-9 <= (accel - last) / DT <= up + 1e-9
        speed, last = speed + accel * DT, accel
        assert speed >= -1e-9


@pytest.mark.parametrize(("style", "eased"), [(0, 2.0), (1, 2.0), (2, 3.0)])
def test_every_style_lets_a_brake_go_in_time(style: int, eased: float) -> None:
    assert accelerated(5.0, 25.0, -2.0, style) == pytest.approx(-2.0 + eased / 15)


@STYLES
def test_a_style_bounds_how_the_ego_speeds_up(style: int, most: float, jerk: float) -> None:
    first = accelerated(5.0, 25.0, 0.0, style)
    assert first == pytest.approx(jerk / 15)
    accel = first
    for _ in range(60):
        accel = accelerated(5.0, 25.0, accel, style)
    assert accel == most


@pytest.mark.parametrize("style", [0, 1, 2])
def test_every_style_brakes_alike(style: int) -> None:
    assert accelerated(20.0, 5.0, -4.0, style) == pytest.approx(-4.0 - 4.0 / 15)
    assert accelerated(20.0, 5.0, 1.0, style, MetaAction.EMERGENCY_BRAKE) == -8.0


def test_an_emergency_brakes_fully_at_once_and_stops_without_rolling_back() -> None:
    speed, accel = 5.0, 2.0
    accel = accelerated(speed, 8.0, accel, meta=MetaAction.EMERGENCY_BRAKE)
    assert accel == -8.0
    for _ in range(30):
        accel = accelerated(speed, 8.0, accel, meta=MetaAction.EMERGENCY_BRAKE)
        speed += accel * DT
    assert speed == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("style", [0, 1, 2])
def test_a_speed_change_does_not_overshoot(style: int) -> None:
    speed, accel, slowest = 8.0, 0.0, 8.0
    for _ in range(200):
        accel = accelerated(speed, 3.0, accel, style)
        speed += accel * DT
        slowest = min(slowest, speed)
    assert slowest > 2.95
    assert speed == pytest.approx(3.0, abs=0.01)


def test_a_spawn_is_as_the_scenario_says() -> None:
    scenario = SCENARIOS["two-way"]
    for seed in range(50):
        s = scenario.spawn(np.random.default_rng(seed))
        assert 4 <= len(s.x) <= scenario.vehicles_max
        assert (s.x[0], s.lane[0]) == (400.0, 1)
        assert 5.0 <= s.speed[0] <= 7.0
        assert 18.0 <= s.x[1] - s.x[0] <= 30.0
        oncoming = s.direction < 0
        assert (s.lane[oncoming] == 0).all()
        assert (s.lane[~oncoming] == 1).all()
        assert 60.0 <= s.x[oncoming].min() - s.x[0] <= 140.0
        assert np.sort(s.x[~oncoming])[0] == s.x[~oncoming][-1] < s.x[0] - 19.9


def test_the_same_seed_gives_the_same_world() -> None:
    metas = [1, 3, 1, 2, 2, 1, 4, 1, 0, 1] * 6
    runs = []
    for _ in range(2):
        env = gymnasium.make("sim_node:FastSlow-two-way-v0")
        first, _ = env.reset(seed=11)
        assert env.observation_space.contains(first)
        steps = [env.step(meta) for meta in metas]
        runs.append((first, np.array([s[0] for s in steps]), [s[1:4] for s in steps]))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])
    assert runs[0][2] == runs[1][2]


def test_an_observation_shows_the_ego_first_and_fits_in_a_tick() -> None:
    node = fresh()
    observation = node.step(act(node), 5)
    payload = encode(observation)
    assert len(payload) < 3000
    assert decode(OBSERVATION, payload) == observation
    rows = rows_of(observation)
    assert rows[0, 0] == 0
    assert rows[0, 8] == 1
    distance = np.hypot(*(rows[:, 1:3] - rows[0, 1:3]).T)
    assert (np.diff(distance) >= 0).all()
    oncoming = rows[rows[:, 8] == 0]
    assert len(oncoming) >= 1
    assert (oncoming[:, 3] < 0).all()
    assert [lane.kind for lane in observation.lanes] == ["oncoming", "main"]
    assert (observation.tick, observation.applied_tick, observation.stamp_ns, observation.epoch) == (1, 0, 5, 7)


def test_an_action_is_applied_once() -> None:
    node = fresh()
    speed = node.step(act(node), 0).target_speed_mps
    action = act(node, MetaAction.SPEED_UP)
    assert node.step(action, 0).target_speed_mps == pytest.approx(speed + 0.1)
    assert node.step(action, 0).target_speed_mps == pytest.approx(speed + 0.1)
    assert node.metrics.holds == 1


def test_a_speed_goal_of_an_action_is_held_exactly() -> None:
    node = fresh()
    goal = node.step(act(node), 0).target_speed_mps + 0.15
    reached = [node.step(act(node, MetaAction.SPEED_UP, goal=goal), 0).target_speed_mps for _ in range(2)]
    assert reached == [pytest.approx(goal - 0.05), pytest.approx(goal)]


@pytest.mark.parametrize("kind", ["none", "last tick", "future tick", "old epoch", "unknown action"])
def test_without_a_usable_action_the_car_holds_two_ticks_and_then_brakes(kind: str) -> None:
    node = fresh()
    for _ in range(5):
        before = node.step(act(node), 0)
    speed = node.speed_mps
    for k in range(20):
        useless = {
            "none": None,
            "last tick": act(node, MetaAction.LEFT, tick=node.tick - 1),
            "future tick": act(node, MetaAction.LEFT, tick=node.tick + 1),
            "old epoch": act(node, MetaAction.LEFT, epoch=6),
            "unknown action": Action(epoch=7, stamp_ns=0, source="policy", answers_tick=node.tick, meta_action=9),
        }[kind]
        now = node.step(useless, 0)
        assert now.target_lane == before.target_lane
        assert now.acceleration_mps2 >= -FAILSAFE_BRAKE_MPS2 - 1e-6
        if k < 2:
            assert now.target_speed_mps == before.target_speed_mps
    assert (node.metrics.holds, node.metrics.failsafes) == (2, 18)
    assert node.speed_mps < speed - 1.0


def test_a_crash_is_counted_and_followed_by_a_new_epoch() -> None:
    node = fresh()
    env = node._env
    env.road.vehicles[1].position[:] = env.ego.position + np.array([4.0, 0.0])  # the actuator lets nobody drive into it
    assert node.step(act(node, MetaAction.SPEED_UP), 0).crashed
    assert node.metrics.collisions == 1
    node.take_events()
    observation = node.step(None, 9)
    assert (observation.epoch, observation.tick, observation.crashed) == (8, 0, False)
    event = node.take_events()[0]
    assert (event.kind, event.epoch, event.detail) == ("world", 8, "new world after collision, seed 1")
    assert node.take_events() == []
    assert node.metrics.episodes == 2


def test_a_pass_counts_once_the_ego_is_back_in_its_lane() -> None:
    node = fresh()
    road = node._env.road
    road.vehicles = [v for v in road.vehicles if v.number < 2]  # the ego and the first lead
    lead = road.vehicles[1]
    node.step(act(node, MetaAction.LEFT), 0)
    for _ in range(400):
        node.step(act(node, MetaAction.SPEED_UP), 0)
        if node._env.ego.position[0] > lead.position[0] + 12.0:
            break
    assert (node.lane, node.metrics.passed) == (0, 0)
    node.step(act(node, MetaAction.RIGHT), 0)
    assert node.metrics.passed == 0
    for _ in range(60):
        node.step(act(node), 0)
    assert (node.lane, node.metrics.passed, node.metrics.collisions) == (1, 1, 0)


@pytest.mark.parametrize("bad", [{"scenario": "moon"}, {"seed": -1}, {"duration_s": 0.0}, {"hz": 0}])
def test_a_bad_configuration_is_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        SimConfig(**bad)  # type: ignore[arg-type]


def start(socket: Path, **config: object) -> subprocess.Popen[str]:
    text = json.dumps({"bus": {"listen": [f"unixsock-stream/{socket}"]}, **config})
    return subprocess.Popen([sys.executable, "-m", "sim_node", text], stderr=subprocess.PIPE, text=True,
                            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])})  # fmt: skip


@pytest.mark.parametrize("realtime", ["off", "auto"])
def test_the_process_ends_at_sigterm_and_says_nothing_else(realtime: str) -> None:
    with tempfile.TemporaryDirectory(prefix="fs") as folder:  # a socket's path is short
        process = start(Path(folder) / "s", realtime=realtime)
        assert process.stderr is not None
        ready = json.loads(process.stderr.readline())
        assert ready["event"] == "ready"
        process.send_signal(signal.SIGTERM)
        _, rest = process.communicate(timeout=60)  # without a signal it has no end
        assert process.returncode == 0
        assert "Traceback" not in rest


@pytest.mark.realtime
def test_the_process_ticks_without_listeners_and_publishes_its_final_figures() -> None:
    with tempfile.TemporaryDirectory(prefix="fs") as folder:
        process = start(Path(folder) / "s", duration_s=2.0)
        assert process.stderr is not None
        assert "ready" in process.stderr.readline()  # it listens from here on
        with open_bus(BusConfig(connect=(f"unixsock-stream/{folder}/s",))) as bus:
            seen, beats = bus.subscribe(OBSERVATION), bus.subscribe(STATUS)
            process.communicate(timeout=60)
            last, status = seen.peek(), beats.peek()
    assert process.returncode == 0
    assert last is not None
    assert last.tick >= 25
    assert status is not None
    assert status.state == "stopping"
    wanted = {"tick", "epoch", "speed_mps", "lane", "ticks", "answered", "missed", "collisions", "rtt_p50_us",
              "rtt_p99_us", "age_p50_us", "age_p99_us", "skipped", "episodes", "failsafes"}  # fmt: skip
    assert wanted <= status.metrics.keys()
    assert status.metrics["ticks"] + status.metrics["skipped"] == 30
    assert status.metrics["missed"] >= 28


def test_the_first_world_is_announced_as_every_other() -> None:
    node = fresh()
    node.announce("at the simulator's start", 5)
    event = node.take_events()[0]
    assert (event.kind, event.epoch, event.reason, event.tick) == ("world", 7, None, 0)
