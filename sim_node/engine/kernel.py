"""The compiled tick: highway-env 1.12.1 bit for bit, in its order, on arrays.

One tick is what `AbstractEnv._simulate` does in one frame: the ego's action; every vehicle in turn acts (IDM, MOBIL
reading the new targets of those before it); every vehicle steps; every pair is checked for collisions. Work is left
out only where its result provably cannot matter; what is computed is computed in upstream's order of operations.

Axes: S scenes, V vehicles (upstream's list, then its objects), L lanes. SI units.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from schemas.driving import measures
from schemas.wire import messages
from sim_node import executor
from sim_node.engine import loops as numpy_loops
from sim_node.engine import tables
from sim_node.engine.loops import ARCSIN, ARCTAN, COS, SIN, TAN, addresses, dot, jit, one, power, unary
from sim_node.engine.tables import (
    AMPLITUDE,
    COUNT,
    FIRST,
    FORBIDDEN,
    HEADING,
    LENGTH,
    LIMIT,
    LINKS,
    LINKS_END,
    NEXT,
    NEXT_END,
    PHASE,
    PULSATION,
    WAY,
    WIDTH,
    X0,
    Y0,
    Roads,
)
from sim_node.scenarios import scenario

X, Y, ANGLE, SPEED, TARGET_SPEED, DELTA, TIMER, STEERING, ACCEL, PUSH_X, PUSH_Y, CAR_LENGTH, CAR_WIDTH = range(13)
"""Rows of the float state (S, 13, V). PUSH: the impact of a collision, applied at the next step."""
FLOATS = 13
KIND, LANE, TARGET_LANE, CRASHED, PUSHED, CHANGES, CHECKS, SPEED_INDEX = range(8)
"""Rows of the int state (S, 8, V). CHANGES: `enable_lane_change`; CHECKS: `check_collisions`."""
INTS = 8
ABSENT, IDM, TRAFFIC, MDP, EXECUTOR, OBSTACLE = range(6)
"""Kinds of vehicles: upstream's IDMVehicle, our TrafficVehicle, upstream's MDPVehicle, our EgoVehicle, Obstacle."""
NO_ACTION = -1
LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
"""Meta-actions of an MDP ego, as `DiscreteMetaAction.ACTIONS_ALL`; an EXECUTOR ego takes `schemas.wire.messages`'."""
ABSENT_X_M = 1e6
"""Vehicles that have left are here: nobody's neighbour."""
LEFT_ROAD_M = 20.0
"""As in `sim_node.env`: who is this near to the end of its road has left it."""

# highway-env's constants; tests/test_engine.py compares them with the installed version.
ACC_MAX = 6.0
COMFORT_ACC_MAX = 3.0
COMFORT_ACC_MIN = -5.0
DISTANCE_WANTED = 10.0
TIME_WANTED = 1.5
LANE_CHANGE_MIN_ACC_GAIN = 0.2
LANE_CHANGE_MAX_BRAKING_IMPOSED = 2.0
LANE_CHANGE_DELAY = 1.0
MAX_SPEED = 40.0
MIN_SPEED = -40.0
KP_A = 1 / 0.6
KP_HEADING = 1 / 0.2
KP_LATERAL = 1 / 0.6
TAU_PURSUIT = 0.5 * 0.2
MAX_STEERING_ANGLE = np.pi / 3
LANE_END_M = 5.0
STEERS_MPS = 0.1  # sim_node.traffic's
GAP_DIVISOR = 2 * float(np.sqrt(-COMFORT_ACC_MAX * COMFORT_ACC_MIN))
HALF_PI, QUARTER_PI, TWO_PI = np.pi / 2, np.pi / 4, 2 * np.pi
CLEAR = 1e-6
"""Distances differ by this much before a cheap test may stand for the exact one: far above any rounding, in m."""


class Calls(NamedTuple):
    """What a call into numpy takes; see `loops`. Neither these nor `Scratch` may be shared by threads."""

    loops: NDArray[np.int64]
    args: NDArray[np.int64]
    box: NDArray[np.float64]


class Scratch(NamedTuple):
    """Working memory of one scene's tick."""

    cos: NDArray[np.float64]
    sin: NDArray[np.float64]
    free: NDArray[np.float64]
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    slip_sine: NDArray[np.float64]
    angle: NDArray[np.float64]
    diagonal: NDArray[np.float64]
    some: NDArray[np.int64]
    polygons: NDArray[np.float64]
    on: NDArray[np.int64]
    """(L,) how many vehicles are on a lane; -1: not counted yet in this tick."""
    cars: NDArray[np.int64]
    places: NDArray[np.float64]


class Ego(NamedTuple):
    """Vehicle 0 of every scene: its set-points, and what it may be asked for."""

    meta: NDArray[np.int64]
    """(S,) the last action."""
    speed_goal: NDArray[np.float64]
    target_speed: NDArray[np.float64]
    target_lane: NDArray[np.int64]
    """(S,) index in the scenario's lanes."""
    previous_lane: NDArray[np.int64]
    accel: NDArray[np.float64]
    """(S,) what the last tick did to the speed, m/s2."""
    crashed: NDArray[np.bool_]
    ticks: NDArray[np.int64]
    speeds: NDArray[np.float64]
    """Target speeds of an MDP ego, evenly spaced."""
    pieces: NDArray[np.float64]
    """(P, 7) as `Scenario.pieces`."""
    gates: NDArray[np.float64]
    """(L, 4) as `Scenario.gates`."""
    floor: float
    ceiling: float
    freezes: bool
    """A scene whose ego has crashed stands still."""


class View(NamedTuple):
    """What is published of every scene after a tick; nothing if `rows` has no scenes."""

    rows: NDArray[np.float32]
    """(S, V, 9) as `ROW_COLUMNS`; id -1 for what is absent or out of sight, which is then at `ABSENT_X_M`."""
    lanes: NDArray[np.float64]
    """(L, 3) start, end, y (nan: curved)."""
    lane_y: NDArray[np.float64]
    """(S, L) y of every lane beside the ego."""
    lane_of: NDArray[np.int64]
    """(N,) the scenario's lane that a lane of the network belongs to."""
    end_x: float
    """Vehicles leave the road here, and at `LEFT_ROAD_M` in the other direction."""
    sight: float


def new_calls() -> Calls:
    """Fresh `Calls` of this process."""
    return Calls(addresses(), np.zeros(16, np.int64), np.zeros(8))


def new_scratch(vehicles: int, lanes: int) -> Scratch:
    """Fresh working memory."""
    rows = np.zeros((9, vehicles))
    cos, sin, free, a, b, c, slip_sine, angle, diagonal = rows
    return Scratch(
        cos,
        sin,
        free,
        a,
        b,
        c,
        slip_sine,
        angle,
        diagonal,
        np.zeros(vehicles, np.int64),
        np.zeros((2, 5, 2)),
        np.zeros(lanes, np.int64),
        np.zeros((lanes, vehicles), np.int64),
        np.zeros((lanes, vehicles)),
    )


def _with(function: Any, **compiled: Any) -> Any:
    """A copy of a plain function that calls these compiled ones instead of the plain ones of the same names."""
    return FunctionType(function.__code__, {**function.__globals__, **compiled}, function.__name__)


_edit_set_points = jit(_with(executor.edit_set_points, lane_beside=jit(executor.lane_beside)))
_acceleration_command = jit(executor.acceleration_command)
_steering_command = jit(executor.steering_command)
_change_finished = jit(executor.change_finished)
_centre_line = jit(scenario.centre_line)


@jit
def _clip(x: float, low: float, high: float) -> float:
    return min(max(x, low), high)


@jit
def _not_zero(x: float) -> float:
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0 else -1e-2


@jit
def _wrap(x: float) -> float:
    shifted = x + np.pi
    if 0.0 <= shifted < TWO_PI:  # the modulo would return it as it is
        return shifted - np.pi
    return shifted % TWO_PI - np.pi


@jit
def _along(lane: Any, x: float) -> float:
    """Longitudinal coordinate."""
    return float((x - lane[X0]) * lane[WAY])


@jit
def _across(calls: Any, lane: Any, s: float, y: float) -> float:
    """Lateral coordinate at the longitudinal one `s`."""
    r = (y - lane[Y0]) * lane[WAY]
    if lane[AMPLITUDE] == 0.0:
        return float(r)
    return float(r - lane[AMPLITUDE] * one(calls.loops, SIN, calls.args, calls.box, lane[PULSATION] * s + lane[PHASE]))


@jit
def _heading_at(calls: Any, lane: Any, s: float) -> float:
    if lane[AMPLITUDE] == 0.0:
        return float(lane[HEADING])
    bend = one(calls.loops, COS, calls.args, calls.box, lane[PULSATION] * s + lane[PHASE])
    slope = lane[AMPLITUDE] * lane[PULSATION] * bend
    return float(lane[HEADING] + one(calls.loops, ARCTAN, calls.args, calls.box, slope))


@jit
def _closest_lane(calls: Any, roads: Any, x: float, y: float, heading: float) -> int:
    """RoadNetwork.get_closest_lane_index."""
    best, nearest = 0, np.inf
    for k in range(roads.lanes.shape[0]):
        lane = roads.lanes[k]
        s = _along(lane, x)
        beyond, before = max(s - lane[LENGTH], 0.0), max(0.0 - s, 0.0)
        if lane[AMPLITUDE] != 0.0:
            at_least = abs(y - lane[Y0]) - abs(lane[AMPLITUDE]) - CLEAR
            if max(at_least, beyond, before) > nearest:
                continue
        distance = abs(_across(calls, lane, s, y)) + beyond + before
        if distance >= nearest:  # the angle cannot make it less
            continue
        distance += abs(_wrap(heading - _heading_at(calls, lane, s)))
        if distance < nearest:
            best, nearest = k, distance
    return best


@jit
def _reachable(calls: Any, lane: Any, x: float, y: float) -> bool:
    """AbstractLane.is_reachable_from."""
    if lane[FORBIDDEN] != 0.0:
        return False
    s = _along(lane, x)
    return bool(0 <= s < lane[LENGTH] + LANE_END_M and abs(_across(calls, lane, s, y)) <= 2 * lane[WIDTH])


@jit
def _follow_road(calls: Any, roads: Any, target: int, x: float, y: float) -> int:
    """ControlledVehicle.follow_road without a route: the target lane."""
    lane = roads.lanes[target]
    s = _along(lane, x)
    if not s > lane[LENGTH] - LANE_END_M / 2 or roads.graph[target, NEXT] == roads.graph[target, NEXT_END]:
        return target
    lateral = 0.0
    if lane[AMPLITUDE] != 0.0:
        lateral += lane[AMPLITUDE] * one(calls.loops, SIN, calls.args, calls.box, lane[PULSATION] * s + lane[PHASE])
    px = lane[X0] + s * lane[WAY]
    py = lane[Y0] + lateral * lane[WAY]
    chosen, nearest = target, np.inf
    for e in range(roads.graph[target, NEXT], roads.graph[target, NEXT_END]):
        first, count = roads.nexts[e, 0], roads.nexts[e, 1]
        low, high = first, first + count
        if roads.graph[target, COUNT] == count:
            low = first + target - roads.graph[target, FIRST]
            high = low + 1
        of_edge, distance_of_edge = low, np.inf
        for k in range(low, high):
            other = roads.lanes[k]
            s_other = _along(other, px)
            distance = abs(_across(calls, other, s_other, py)) + max(s_other - other[LENGTH], 0.0) + max(-s_other, 0.0)
            if distance < distance_of_edge:
                of_edge, distance_of_edge = k, distance
        if distance_of_edge < nearest:
            chosen, nearest = of_edge, distance_of_edge
    return int(chosen)


@jit
def _neighbours(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, i: int, k: int) -> tuple[int, int]:
    """Road.neighbour_vehicles: (front, rear) of vehicle `i` on lane `k`, -1 for none.

    Who is on a lane, and where, is found once a tick: nobody moves while the vehicles act.
    """
    cars, places = scratch.cars, scratch.places
    if scratch.on[k] < 0:
        n = 0
        for v in range(f.shape[1]):
            if g[KIND, v] == ABSENT:
                continue
            for link in range(roads.graph[k, LINKS], roads.graph[k, LINKS_END]):
                lane = roads.lanes[int(roads.links[link, 0])]
                s = _along(lane, f[X, v])
                if -LANE_END_M <= s < lane[LENGTH] + LANE_END_M and (
                    abs(_across(calls, lane, s, f[Y, v])) <= lane[WIDTH] / 2 + 1
                ):
                    cars[k, n] = v
                    places[k, n] = s + roads.links[link, 1]
                    n += 1
                    break
        scratch.on[k] = n
    here = _along(roads.lanes[k], f[X, i])
    front, rear = -1, -1
    s_front, s_rear = np.inf, -np.inf
    for c in range(scratch.on[k]):
        s = places[k, c]
        if here <= s:
            if s <= s_front and cars[k, c] != i:
                front, s_front = cars[k, c], s
        elif s > s_rear and cars[k, c] != i:
            rear, s_rear = cars[k, c], s
    return front, rear


@jit
def _speed_ratio(roads: Any, f: Any, g: Any, e: int) -> float:
    """Speed over target speed, which the lane limits."""
    target = f[TARGET_SPEED, e]
    limit = roads.lanes[g[LANE, e], LIMIT]
    if not np.isnan(limit):
        target = _clip(target, 0.0, limit)
    return float(max(f[SPEED, e], 0.0) / abs(_not_zero(target)))


@jit
def _desired_gap(calls: Any, scratch: Any, f: Any, e: int, front: int) -> float:
    """IDMVehicle.desired_gap."""
    v, c, s = f[SPEED, e], scratch.cos[e], scratch.sin[e]
    vx = v * c - f[SPEED, front] * scratch.cos[front]
    vy = v * s - f[SPEED, front] * scratch.sin[front]
    closing = dot(calls.loops, calls.args, calls.box, vx, vy, c, s)
    return float(DISTANCE_WANTED + v * TIME_WANTED + v * closing / GAP_DIVISOR)


@jit
def _behind(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, free: float, e: int, front: int) -> float:
    """IDMVehicle.acceleration of vehicle `e` behind `front`; free: its speed ratio to the power of delta."""
    acceleration = COMFORT_ACC_MAX * (1 - free)
    if front >= 0:
        lane = roads.lanes[g[LANE, e]]
        d = _along(lane, f[X, front]) - _along(lane, f[X, e])
        ratio = _desired_gap(calls, scratch, f, e, front) / _not_zero(d)
        acceleration -= COMFORT_ACC_MAX * (ratio * ratio)
    return acceleration


@jit
def _mobil(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, i: int, k: int) -> bool:
    """IDMVehicle.mobil without a route. With upstream's politeness of 0 the followers' gains do not count."""
    new_front, new_rear = _neighbours(calls, roads, scratch, f, g, i, k)
    if new_rear >= 0 and g[KIND, new_rear] != OBSTACLE:
        box = calls.box
        box[0], box[1] = _speed_ratio(roads, f, g, new_rear), f[DELTA, i]
        power(calls.loops, calls.args, box, box[1:], box[2:], 1)
        braking = _behind(calls, roads, scratch, f, g, box[2], new_rear, i)
        if braking < -LANE_CHANGE_MAX_BRAKING_IMPOSED:
            return False
    old_front, _ = _neighbours(calls, roads, scratch, f, g, i, g[LANE, i])
    free = scratch.free[i]
    gain = _behind(calls, roads, scratch, f, g, free, i, new_front) - _behind(
        calls, roads, scratch, f, g, free, i, old_front
    )
    return not gain < LANE_CHANGE_MIN_ACC_GAIN


@jit
def _change_lane(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, i: int) -> None:
    """IDMVehicle.change_lane_policy."""
    k, target = g[LANE, i], g[TARGET_LANE, i]
    if k != target:
        if roads.graph[k, FIRST] == roads.graph[target, FIRST]:
            for v in range(f.shape[1]):
                if g[TARGET_LANE, v] == target and v != i and g[LANE, v] != target and IDM <= g[KIND, v] <= MDP:
                    lane = roads.lanes[k]
                    d = _along(lane, f[X, v]) - _along(lane, f[X, i])
                    if 0 < d < _desired_gap(calls, scratch, f, i, v):
                        g[TARGET_LANE, i] = k
                        break
        return
    if not f[TIMER, i] > LANE_CHANGE_DELAY:
        return
    f[TIMER, i] = 0.0
    if abs(f[SPEED, i]) < 1:
        return
    first, count = roads.graph[k, FIRST], roads.graph[k, COUNT]
    for side in (k - 1, k + 1):
        if (
            first <= side < first + count
            and _reachable(calls, roads.lanes[side], f[X, i], f[Y, i])
            and (_mobil(calls, roads, scratch, f, g, i, side))
        ):
            g[TARGET_LANE, i] = side


@jit
def _command(calls: Any, roads: Any, f: Any, g: Any, i: int, action: int, speeds: Any) -> None:
    """MDPVehicle.act with a meta-action, up to the controls."""
    if action in (FASTER, SLOWER):
        last = speeds.size - 1
        x = (f[SPEED, i] - speeds[0]) / (speeds[last] - speeds[0])
        index = int(_clip(np.rint(x * last), 0, last)) + (1 if action == FASTER else -1)
        index = min(max(index, 0), last)
        g[SPEED_INDEX, i] = index
        f[TARGET_SPEED, i] = speeds[index]
    g[TARGET_LANE, i] = _follow_road(calls, roads, g[TARGET_LANE, i], f[X, i], f[Y, i])
    if action in (LEFT, RIGHT):
        target = g[TARGET_LANE, i]
        first, count = roads.graph[target, FIRST], roads.graph[target, COUNT]
        aim = min(max(target + (1 if action == RIGHT else -1), first), first + count - 1)
        if _reachable(calls, roads.lanes[aim], f[X, i], f[Y, i]):
            g[TARGET_LANE, i] = aim


@jit
def _act(calls: Any, roads: Any, scratch: Any, f: Any, g: Any) -> None:
    """Road.act but for an EXECUTOR ego's controls."""
    n = f.shape[1]
    a, b = scratch.a, scratch.b
    for i in range(n):
        kind = g[KIND, i]
        a[i] = _speed_ratio(roads, f, g, i) if IDM <= kind <= TRAFFIC else 0.0
    power(calls.loops, calls.args, a, f[DELTA], scratch.free, n)
    scratch.on[:] = -1
    m = 0
    for i in range(n):
        kind = g[KIND, i]
        if kind == MDP:
            g[TARGET_LANE, i] = _follow_road(calls, roads, g[TARGET_LANE, i], f[X, i], f[Y, i])
            f[ACCEL, i] = KP_A * (f[TARGET_SPEED, i] - f[SPEED, i])
        elif IDM <= kind <= TRAFFIC:
            if g[CRASHED, i]:
                continue
            g[TARGET_LANE, i] = _follow_road(calls, roads, g[TARGET_LANE, i], f[X, i], f[Y, i])
            if g[CHANGES, i]:
                _change_lane(calls, roads, scratch, f, g, i)
            front, _ = _neighbours(calls, roads, scratch, f, g, i, g[LANE, i])
            accel = _behind(calls, roads, scratch, f, g, scratch.free[i], i, front)
            if g[LANE, i] != g[TARGET_LANE, i]:
                front, _ = _neighbours(calls, roads, scratch, f, g, i, g[TARGET_LANE, i])
                accel = min(accel, _behind(calls, roads, scratch, f, g, scratch.free[i], i, front))
            f[ACCEL, i] = _clip(accel, -ACC_MAX, ACC_MAX)
        else:
            continue
        # ControlledVehicle.steering_control, which nobody reads before the step: all together, below.
        lane = roads.lanes[g[TARGET_LANE, i]]
        s = _along(lane, f[X, i])
        lateral_speed = -KP_LATERAL * _across(calls, lane, s, f[Y, i])
        lane_heading = _heading_at(calls, lane, s + f[SPEED, i] * TAU_PURSUIT)
        sine = _clip(lateral_speed / _not_zero(f[SPEED, i]), -1.0, 1.0)
        if sine == 0.0 and lane_heading == f[ANGLE, i]:
            f[STEERING, i] = 0.0
        else:
            a[m], scratch.c[m], scratch.some[m] = sine, lane_heading, i
            m += 1
    unary(calls.loops, ARCSIN, calls.args, a, b, m)
    for j in range(m):
        i = scratch.some[j]
        wanted = scratch.c[j] + _clip(b[j], -QUARTER_PI, QUARTER_PI)
        rate = KP_HEADING * _wrap(wanted - f[ANGLE, i])
        a[j] = _clip(f[CAR_LENGTH, i] / 2 / _not_zero(f[SPEED, i]) * rate, -1.0, 1.0)
    unary(calls.loops, ARCSIN, calls.args, a, b, m)
    unary(calls.loops, TAN, calls.args, b, a, m)
    for j in range(m):
        a[j] = 2 * a[j]
    unary(calls.loops, ARCTAN, calls.args, a, b, m)
    for j in range(m):
        f[STEERING, scratch.some[j]] = _clip(b[j], -MAX_STEERING_ANGLE, MAX_STEERING_ANGLE)


@jit
def _directions(calls: Any, scratch: Any, f: Any) -> None:
    """Cosine and sine of every heading."""
    m = 0
    for i in range(f.shape[1]):
        if f[ANGLE, i] == 0.0:
            scratch.cos[i], scratch.sin[i] = 1.0, f[ANGLE, i]
        else:
            scratch.a[m], scratch.some[m] = f[ANGLE, i], i
            m += 1
    unary(calls.loops, COS, calls.args, scratch.a, scratch.b, m)
    unary(calls.loops, SIN, calls.args, scratch.a, scratch.c, m)
    for j in range(m):
        scratch.cos[scratch.some[j]], scratch.sin[scratch.some[j]] = scratch.b[j], scratch.c[j]


@jit
def _step(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, dt: float) -> None:
    """Vehicle.step of every vehicle."""
    a, b, c, some = scratch.a, scratch.b, scratch.c, scratch.some
    slip_sine, angle = scratch.slip_sine, scratch.angle
    m = 0
    for i in range(f.shape[1]):
        kind = g[KIND, i]
        slip_sine[i], angle[i] = 0.0, f[ANGLE, i]
        if not ABSENT < kind < OBSTACLE:
            continue
        speed = f[SPEED, i]
        if kind == TRAFFIC and not g[CRASHED, i]:
            f[ACCEL, i] = max(f[ACCEL, i], -speed / dt)
            if speed < STEERS_MPS:
                f[STEERING, i] = 0.0
        if g[CRASHED, i]:
            f[STEERING, i] = 0.0
            f[ACCEL, i] = -1.0 * speed
        if speed > MAX_SPEED:
            f[ACCEL, i] = min(f[ACCEL, i], MAX_SPEED - speed)
        elif speed < MIN_SPEED:
            f[ACCEL, i] = max(f[ACCEL, i], MIN_SPEED - speed)
        if f[STEERING, i] != 0.0:
            a[m], some[m] = f[STEERING, i], i
            m += 1
    unary(calls.loops, TAN, calls.args, a, b, m)
    for j in range(m):
        b[j] = 0.5 * b[j]
    unary(calls.loops, ARCTAN, calls.args, b, a, m)
    unary(calls.loops, SIN, calls.args, a, b, m)
    for j in range(m):
        slip_sine[some[j]] = b[j]
        angle[some[j]] = f[ANGLE, some[j]] + a[j]
    m = 0
    for i in range(f.shape[1]):
        if angle[i] == 0.0:
            scratch.cos[i], scratch.sin[i] = 1.0, angle[i]
        else:
            a[m], some[m] = angle[i], i
            m += 1
    unary(calls.loops, COS, calls.args, a, b, m)
    unary(calls.loops, SIN, calls.args, a, c, m)
    for j in range(m):
        scratch.cos[some[j]], scratch.sin[some[j]] = b[j], c[j]
    for i in range(f.shape[1]):
        if not ABSENT < g[KIND, i] < OBSTACLE:
            continue
        speed = f[SPEED, i]
        f[X, i] += speed * scratch.cos[i] * dt
        f[Y, i] += speed * scratch.sin[i] * dt
        if g[PUSHED, i]:
            f[X, i] += f[PUSH_X, i]
            f[Y, i] += f[PUSH_Y, i]
            g[CRASHED, i], g[PUSHED, i] = 1, 0
        f[ANGLE, i] += speed * slip_sine[i] / (f[CAR_LENGTH, i] / 2) * dt
        f[SPEED, i] += f[ACCEL, i] * dt
        if g[KIND, i] <= TRAFFIC:
            f[TIMER, i] += dt
        g[LANE, i] = _closest_lane(calls, roads, f[X, i], f[Y, i], f[ANGLE, i])


@jit
def _corners(scratch: Any, f: Any, i: int, out: Any) -> None:
    """RoadObject.polygon: (5, 2), closed."""
    c, s = scratch.cos[i], scratch.sin[i]
    half_l, half_w = f[CAR_LENGTH, i] / 2, f[CAR_WIDTH, i] / 2
    for p in range(4):
        px = half_l if p >= 2 else -half_l
        py = half_w if p == 1 or p == 2 else -half_w
        # BLAS may fuse the second product; times a half width of 1 it is exact either way.
        out[p, 0] = c * px + -s * py + f[X, i]
        out[p, 1] = s * px + c * py + f[Y, i]
    out[4, 0], out[4, 1] = out[0, 0], out[0, 1]


@jit
def _project(calls: Any, polygon: Any, nx: float, ny: float) -> tuple[float, float]:
    low, high = np.inf, -np.inf
    for p in range(5):
        projected = dot(calls.loops, calls.args, calls.box, polygon[p, 0], polygon[p, 1], nx, ny)
        low, high = min(low, projected), max(high, projected)
    return low, high


@jit
def _interval(min_a: float, max_a: float, min_b: float, max_b: float) -> float:
    return min_b - max_a if min_a < min_b else min_a - max_b


@jit
def _intersect(calls: Any, scratch: Any, f: Any, i: int, j: int, dt: float) -> tuple[bool, bool, float, float]:
    """utils.are_polygons_intersecting: intersecting, will intersect, translation."""
    loops, args, box = calls.loops, calls.args, calls.box
    first, second = scratch.polygons[0], scratch.polygons[1]
    _corners(scratch, f, i, first)
    _corners(scratch, f, j, second)
    mx = f[SPEED, i] * scratch.cos[i] * dt - f[SPEED, j] * scratch.cos[j] * dt
    my = f[SPEED, i] * scratch.sin[i] * dt - f[SPEED, j] * scratch.sin[j] * dt
    dx = ((first[0, 0] + first[1, 0]) + first[2, 0] + first[3, 0]) / 4 - (
        (second[0, 0] + second[1, 0]) + second[2, 0] + second[3, 0]
    ) / 4
    dy = ((first[0, 1] + first[1, 1]) + first[2, 1] + first[3, 1]) / 4 - (
        (second[0, 1] + second[1, 1]) + second[2, 1] + second[3, 1]
    ) / 4
    intersecting, will = True, True
    least, tx, ty = np.inf, 0.0, 0.0
    for which in range(2):
        polygon = scratch.polygons[which]
        for p in range(4):
            nx, ny = -polygon[p + 1, 1] + polygon[p, 1], polygon[p + 1, 0] - polygon[p, 0]
            norm = math.sqrt(dot(loops, args, box, nx, ny, nx, ny))
            nx, ny = nx / norm, ny / norm
            min_a, max_a = _project(calls, first, nx, ny)
            min_b, max_b = _project(calls, second, nx, ny)
            if _interval(min_a, max_a, min_b, max_b) > 0:
                intersecting = False
            moved = dot(loops, args, box, nx, ny, mx, my)
            if moved < 0:
                min_a += moved
            else:
                max_a += moved
            distance = _interval(min_a, max_a, min_b, max_b)
            if distance > 0:
                will = False
            if not intersecting and not will:
                return False, False, 0.0, 0.0
            if abs(distance) < least:
                least = abs(distance)
                sign = 1.0 if dot(loops, args, box, dx, dy, nx, ny) > 0 else -1.0
                tx, ty = sign * nx, sign * ny
    return intersecting, will, least * tx, least * ty


@jit
def _far_apart(scratch: Any, f: Any, i: int, j: int, dt: float) -> bool:
    """Whether an axis of vehicle `i` clearly separates the two, now and with their motion: upstream's test says no."""
    c, s = scratch.cos[i], scratch.sin[i]
    cj, sj = scratch.cos[j], scratch.sin[j]
    dx, dy = f[X, j] - f[X, i], f[Y, j] - f[Y, i]
    mx, my = (f[SPEED, i] * c - f[SPEED, j] * cj) * dt, (f[SPEED, i] * s - f[SPEED, j] * sj) * dt
    along, across = abs(c * cj + s * sj), abs(c * sj - s * cj)
    half_l, half_w = 0.5 * f[CAR_LENGTH, j], 0.5 * f[CAR_WIDTH, j]
    reach = 0.5 * f[CAR_WIDTH, i] + half_l * across + half_w * along + CLEAR
    if abs(c * dy - s * dx) > reach + abs(c * my - s * mx):
        return True
    reach = 0.5 * f[CAR_LENGTH, i] + half_l * along + half_w * across + CLEAR
    return bool(abs(c * dx + s * dy) > reach + abs(c * mx + s * my))


@jit
def _collide(calls: Any, scratch: Any, f: Any, g: Any, dt: float) -> None:
    """RoadObject.handle_collisions of every pair."""
    n = f.shape[1]
    diagonal, x, y = scratch.diagonal, f[X], f[Y]
    widest = 0.0
    for i in range(n):
        diagonal[i] = math.sqrt(f[CAR_LENGTH, i] * f[CAR_LENGTH, i] + f[CAR_WIDTH, i] * f[CAR_WIDTH, i])
        widest = max(widest, diagonal[i])
    for i in range(n):
        if not ABSENT < g[KIND, i] < OBSTACLE:
            continue
        near = (diagonal[i] + widest) / 2 + f[SPEED, i] * dt + CLEAR
        xi, yi = x[i], y[i]
        for j in range(i + 1, n):
            dx = x[j] - xi
            if abs(dx) > near:
                continue
            dy = y[j] - yi
            if abs(dy) > near or g[KIND, j] == ABSENT or not (g[CHECKS, i] or g[CHECKS, j]):
                continue
            distance = math.sqrt(dx * dx + dy * dy)
            reach = (diagonal[i] + diagonal[j]) / 2 + f[SPEED, i] * dt
            if abs(distance - reach) < CLEAR:
                distance = math.sqrt(dot(calls.loops, calls.args, calls.box, dx, dy, dx, dy))
            if distance > reach or _far_apart(scratch, f, i, j, dt) or _far_apart(scratch, f, j, i, dt):
                continue
            intersecting, will, tx, ty = _intersect(calls, scratch, f, i, j, dt)
            if will:
                g[PUSHED, i] = 1
                if g[KIND, j] == OBSTACLE:
                    f[PUSH_X, i], f[PUSH_Y, i] = tx, ty
                else:
                    f[PUSH_X, i], f[PUSH_Y, i] = tx / 2, ty / 2
                    f[PUSH_X, j], f[PUSH_Y, j] = -tx / 2, -ty / 2
                    g[PUSHED, j] = 1
            if intersecting:
                g[CRASHED, i] = g[CRASHED, j] = 1


@jit
def _executor(ego: Ego, f: Any, scene: int, dt: float) -> None:
    """EgoVehicle.act without an action: the controls of an EXECUTOR ego."""
    y_target, lane_heading = _centre_line(ego.pieces, ego.target_lane[scene], f[X, 0])
    f[STEERING, 0] = _steering_command(f[Y, 0], f[ANGLE, 0], f[SPEED, 0], y_target, lane_heading)
    f[ACCEL, 0] = _acceleration_command(f[SPEED, 0], ego.target_speed[scene], ego.accel[scene], ego.meta[scene], dt)


@jit
def _begin(calls: Any, roads: Any, ego: Ego, f: Any, g: Any, scene: int, action: int) -> None:
    """Edit the ego's set-points by its action."""
    if g[KIND, 0] == MDP:
        _command(calls, roads, f, g, 0, action, ego.speeds)
    elif g[KIND, 0] == EXECUTOR:
        ego.meta[scene] = action
        ego.target_speed[scene], ego.target_lane[scene], ego.previous_lane[scene] = _edit_set_points(
            action,
            ego.target_speed[scene],
            ego.target_lane[scene],
            ego.previous_lane[scene],
            ego.gates,
            f[X, 0],
            ego.speed_goal[scene],
            ego.floor,
            ego.ceiling,
        )
    elif not np.isnan(ego.speed_goal[scene]):  # an IDM ego takes no actions, but knows how fast it is to be
        ego.target_speed[scene] = ego.speed_goal[scene]


@jit
def _lane_at(ego: Ego, view: View, x: float, y: float) -> int:
    """ScenarioEnv.lane_at."""
    best, nearest = 0, np.inf
    for k in range(view.lanes.shape[0]):
        if view.lanes[k, 0] <= x <= view.lanes[k, 1]:
            centre = view.lanes[k, 2]
            if np.isnan(centre):
                centre = _centre_line(ego.pieces, k, x)[0]
            if abs(centre - y) < nearest:
                best, nearest = k, abs(centre - y)
    return best


@jit
def _publish(ego: Ego, view: View, scratch: Any, f: Any, g: Any, scene: int) -> None:
    """Take vehicles that have left off the road, and write the rows."""
    rows = view.rows
    for k in range(view.lanes.shape[0]):
        y = view.lanes[k, 2]
        view.lane_y[scene, k] = _centre_line(ego.pieces, k, f[X, 0])[0] if np.isnan(y) else y
    for i in range(rows.shape[1]):
        seen = g[KIND, i] != ABSENT
        x, y = f[X, i], f[Y, i]
        if seen and i > 0 and not (x < view.end_x if scratch.cos[i] > 0 else x > LEFT_ROAD_M):
            g[KIND, i] = ABSENT
            f[X, i], f[SPEED, i] = ABSENT_X_M, 0.0
            seen = False
        if seen and i > 0:
            seen = math.hypot(x - f[X, 0], y - f[Y, 0]) <= view.sight
        if not seen:
            rows[scene, i, 0], rows[scene, i, 1] = -1, ABSENT_X_M
            rows[scene, i, 3] = rows[scene, i, 4] = 0.0
            continue
        rows[scene, i, 0], rows[scene, i, 1], rows[scene, i, 2] = i, x, y
        rows[scene, i, 3], rows[scene, i, 4] = f[SPEED, i] * scratch.cos[i], f[SPEED, i] * scratch.sin[i]
        rows[scene, i, 5], rows[scene, i, 6], rows[scene, i, 7] = f[ANGLE, i], f[CAR_LENGTH, i], f[CAR_WIDTH, i]
        rows[scene, i, 8] = _lane_at(ego, view, x, y)


@jit
def _finish(ego: Ego, view: View, f: Any, g: Any, scene: int, before: float, dt: float) -> None:
    """What is known of the ego after a tick."""
    ego.accel[scene] = (f[SPEED, 0] - before) / dt
    ego.crashed[scene] = g[CRASHED, 0] != 0
    ego.ticks[scene] += 1
    if g[KIND, 0] == EXECUTOR:
        if ego.previous_lane[scene] >= 0 and _change_finished(
            f[Y, 0], _centre_line(ego.pieces, ego.target_lane[scene], f[X, 0])[0]
        ):
            ego.previous_lane[scene] = -1
    elif g[KIND, 0] != MDP and view.rows.shape[0] > 0:
        ego.target_lane[scene] = view.lane_of[g[TARGET_LANE, 0]]
        lane = view.lane_of[g[LANE, 0]]
        ego.previous_lane[scene] = lane if lane != ego.target_lane[scene] else -1


def _kernel(sources: int) -> Any:
    """The compiled entries. numba keys its cache by this closure, so a change in `sources` compiles anew."""

    def advance(
        ticks: int,
        dt: float,
        roads: Roads,
        calls: Calls,
        scratch: Scratch,
        f: Any,
        g: Any,
        ego: Ego,
        view: View,
        action: Any,
    ) -> int:
        for scene in range(f.shape[0]):
            f_s, g_s = f[scene], g[scene]
            _directions(calls, scratch, f_s)
            for tick in range(ticks):
                if ego.freezes and g_s[CRASHED, 0]:
                    break
                if tick == 0 and action[scene] != NO_ACTION:
                    _begin(calls, roads, ego, f_s, g_s, scene, action[scene])
                if g_s[KIND, 0] != MDP:
                    f_s[TARGET_SPEED, 0] = ego.target_speed[scene]
                before = f_s[SPEED, 0]
                if g_s[KIND, 0] == EXECUTOR:
                    _executor(ego, f_s, scene, dt)
                _act(calls, roads, scratch, f_s, g_s)
                _step(calls, roads, scratch, f_s, g_s, dt)
                _directions(calls, scratch, f_s)
                _collide(calls, scratch, f_s, g_s, dt)
                _finish(ego, view, f_s, g_s, scene, before, dt)
                if view.rows.shape[0] > 0:
                    _publish(ego, view, scratch, f_s, g_s, scene)
        return sources

    def settle(
        roads: Roads,
        calls: Calls,
        scratch: Scratch,
        f: Any,
        g: Any,
        ego: Ego,
        view: View,
        scene: int,
        lane: Any,
        way: Any,
    ) -> int:
        f_s, g_s = f[scene], g[scene]
        for i in range(f_s.shape[1]):
            if g_s[KIND, i] != ABSENT:
                f_s[Y, i], heading = _centre_line(ego.pieces, lane[i], f_s[X, i])
                if g_s[KIND, i] == OBSTACLE:
                    heading = 0.0
                f_s[ANGLE, i] = heading if way[i] > 0 else heading + np.pi
                g_s[LANE, i] = _closest_lane(calls, roads, f_s[X, i], f_s[Y, i], f_s[ANGLE, i])
        _directions(calls, scratch, f_s)
        _publish(ego, view, scratch, f_s, g_s, scene)
        return sources

    return tuple(numba.njit(cache=True, error_model="numpy", _nrt=False)(entry) for entry in (advance, settle))


def sources_digest() -> int:
    """A number for the text of everything that is compiled in; numba itself watches only this file."""
    digest = hashlib.sha256(np.__version__.encode())
    for module in (executor, scenario, tables, numpy_loops, measures, messages):
        digest.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(digest.digest()[:7], "little")


_entries = _kernel(sources_digest())

advance: Callable[..., int] = _entries[0]
"""Advance every scene by `ticks` ticks of `dt` s, in place.

(ticks, dt, roads, calls, scratch, f (S, FLOATS, V), g (S, INTS, V), ego, view, action (S,)): the actions are carried
out at the first tick; `NO_ACTION` leaves the set-points alone.
"""
settle: Callable[..., int] = _entries[1]
"""Put the vehicles of one scene, of which x is known, on their lanes' centre lines, and publish them.

(roads, calls, scratch, f, g, ego, view, scene, lane (V,) of the scenario, way (V,) +1 or -1).
"""
