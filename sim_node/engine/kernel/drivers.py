"""How the other cars decide: neighbours, IDM, MOBIL, steering; and the meta-actions of upstream's own ego."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_node.engine.kernel.lanes import across, along, clip, follow_road, heading_at, not_zero, reachable, wrap
from sim_node.engine.kernel.layout import (
    ABSENT,
    ACC_MAX,
    ACCEL,
    AGE,
    ANGLE,
    CAR_LENGTH,
    CHANGES,
    CRASHED,
    DELTA,
    FASTER,
    IDM,
    IDM_ACCEL,
    IDM_DIVISOR,
    IDM_GAP,
    IDM_TIME,
    KIND,
    KP_A,
    KP_HEADING,
    KP_LATERAL,
    LANE,
    LANE_CHANGE_DELAY,
    LANE_CHANGE_MAX_BRAKING_IMPOSED,
    LANE_CHANGE_MIN_ACC_GAIN,
    LANE_END_M,
    LEFT,
    MAX_STEERING_ANGLE,
    MDP,
    OBSTACLE,
    QUARTER_PI,
    RIGHT,
    SLOWER,
    SPEED,
    SPEED_INDEX,
    STEERING,
    SWAY_M,
    SWAY_PHASE,
    SWAY_RATE,
    TARGET_LANE,
    TARGET_SPEED,
    TAU_PURSUIT,
    TIMER,
    TRAFFIC,
    X,
    Y,
)
from sim_node.engine.loops import ARCSIN, ARCTAN, SIN, TAN, dot, one, power, unary
from sim_node.engine.tables import COUNT, FIRST, LENGTH, LIMIT, LINK_LANE, LINK_OFFSET, LINKS, LINKS_END, WIDTH
from sim_node.traffic import longer_m


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
                lane = roads.lanes[int(roads.links[link, LINK_LANE])]
                s = along(lane, f[X, v])
                if -LANE_END_M <= s < lane[LENGTH] + LANE_END_M and (
                    abs(across(calls, lane, s, f[Y, v])) <= lane[WIDTH] / 2 + 1
                ):
                    cars[k, n] = v
                    places[k, n] = s + roads.links[link, LINK_OFFSET]
                    n += 1
                    break
        scratch.on[k] = n
    here = along(roads.lanes[k], f[X, i])
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


def _speed_ratio(roads: Any, f: Any, g: Any, e: int) -> float:
    """Speed over target speed, which the lane limits."""
    target = f[TARGET_SPEED, e]
    limit = roads.lanes[g[LANE, e], LIMIT]
    if not np.isnan(limit):
        target = clip(target, 0.0, limit)
    return float(max(f[SPEED, e], 0.0) / abs(not_zero(target)))


def _desired_gap(calls: Any, scratch: Any, f: Any, i: int, e: int, front: int) -> float:
    """TrafficVehicle.desired_gap of `e` to `front` in the eyes of `i`, and IDMVehicle's for cars of its length."""
    v, c, s = f[SPEED, e], scratch.cos[e], scratch.sin[e]
    vx = v * c - f[SPEED, front] * scratch.cos[front]
    vy = v * s - f[SPEED, front] * scratch.sin[front]
    closing = dot(calls.loops, calls.args, calls.box, vx, vy, c, s)
    distance = f[IDM_GAP, i] + longer_m(f[CAR_LENGTH, e], f[CAR_LENGTH, front])
    return float(distance + v * f[IDM_TIME, i] + v * closing / f[IDM_DIVISOR, i])


def _behind(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, free: float, i: int, e: int, front: int) -> float:
    """IDMVehicle.acceleration of `e` behind `front` in the eyes of `i`; free: its speed ratio to the power of delta."""
    acceleration = f[IDM_ACCEL, i] * (1 - free)
    if front >= 0:
        lane = roads.lanes[g[LANE, e]]
        d = along(lane, f[X, front]) - along(lane, f[X, e])
        ratio = _desired_gap(calls, scratch, f, i, e, front) / not_zero(d)
        acceleration -= f[IDM_ACCEL, i] * (ratio * ratio)
    return float(acceleration)


def _mobil(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, i: int, k: int) -> bool:
    """IDMVehicle.mobil without a route. With upstream's politeness of 0 the followers' gains do not count."""
    new_front, new_rear = _neighbours(calls, roads, scratch, f, g, i, k)
    if new_rear >= 0 and g[KIND, new_rear] != OBSTACLE:
        box = calls.box
        box[0], box[1] = _speed_ratio(roads, f, g, new_rear), f[DELTA, i]
        power(calls.loops, calls.args, box, box[1:], box[2:], 1)
        braking = _behind(calls, roads, scratch, f, g, box[2], i, new_rear, i)
        if braking < -LANE_CHANGE_MAX_BRAKING_IMPOSED:
            return False
    old_front, _ = _neighbours(calls, roads, scratch, f, g, i, g[LANE, i])
    free = scratch.free[i]
    gain = _behind(calls, roads, scratch, f, g, free, i, i, new_front) - _behind(
        calls, roads, scratch, f, g, free, i, i, old_front
    )
    return not gain < LANE_CHANGE_MIN_ACC_GAIN


def _change_lane(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, i: int) -> None:
    """IDMVehicle.change_lane_policy."""
    k, target = g[LANE, i], g[TARGET_LANE, i]
    if k != target:
        if roads.graph[k, FIRST] == roads.graph[target, FIRST]:
            for v in range(f.shape[1]):
                if g[TARGET_LANE, v] == target and v != i and g[LANE, v] != target and IDM <= g[KIND, v] <= MDP:
                    lane = roads.lanes[k]
                    d = along(lane, f[X, v]) - along(lane, f[X, i])
                    if 0 < d < _desired_gap(calls, scratch, f, i, i, v):
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
            and reachable(calls, roads.lanes[side], f[X, i], f[Y, i])
            and (_mobil(calls, roads, scratch, f, g, i, side))
        ):
            g[TARGET_LANE, i] = side


def command(calls: Any, roads: Any, f: Any, g: Any, i: int, action: int, speeds: Any) -> None:
    """MDPVehicle.act with a meta-action, up to the controls."""
    if action in (FASTER, SLOWER):
        last = speeds.size - 1
        x = (f[SPEED, i] - speeds[0]) / (speeds[last] - speeds[0])
        index = int(clip(np.rint(x * last), 0, last)) + (1 if action == FASTER else -1)
        index = min(max(index, 0), last)
        g[SPEED_INDEX, i] = index
        f[TARGET_SPEED, i] = speeds[index]
    g[TARGET_LANE, i] = follow_road(calls, roads, g[TARGET_LANE, i], f[X, i], f[Y, i])
    if action in (LEFT, RIGHT):
        target = g[TARGET_LANE, i]
        first, count = roads.graph[target, FIRST], roads.graph[target, COUNT]
        aim = min(max(target + (1 if action == RIGHT else -1), first), first + count - 1)
        if reachable(calls, roads.lanes[aim], f[X, i], f[Y, i]):
            g[TARGET_LANE, i] = aim


def act(calls: Any, roads: Any, scratch: Any, f: Any, g: Any) -> None:
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
            g[TARGET_LANE, i] = follow_road(calls, roads, g[TARGET_LANE, i], f[X, i], f[Y, i])
            f[ACCEL, i] = KP_A * (f[TARGET_SPEED, i] - f[SPEED, i])
        elif IDM <= kind <= TRAFFIC:
            if g[CRASHED, i]:
                continue
            g[TARGET_LANE, i] = follow_road(calls, roads, g[TARGET_LANE, i], f[X, i], f[Y, i])
            if g[CHANGES, i]:
                _change_lane(calls, roads, scratch, f, g, i)
            front, _ = _neighbours(calls, roads, scratch, f, g, i, g[LANE, i])
            accel = _behind(calls, roads, scratch, f, g, scratch.free[i], i, i, front)
            if g[LANE, i] != g[TARGET_LANE, i]:
                front, _ = _neighbours(calls, roads, scratch, f, g, i, g[TARGET_LANE, i])
                accel = min(accel, _behind(calls, roads, scratch, f, g, scratch.free[i], i, i, front))
            f[ACCEL, i] = clip(accel, -ACC_MAX, ACC_MAX)
        else:
            continue
        # ControlledVehicle.steering_control, which nobody reads before the step: all together, below.
        lane = roads.lanes[g[TARGET_LANE, i]]
        s = along(lane, f[X, i])
        y = f[Y, i]
        if f[SWAY_M, i] != 0.0:
            angle = f[SWAY_RATE, i] * f[AGE, i] + f[SWAY_PHASE, i]
            y -= f[SWAY_M, i] * one(calls.loops, SIN, calls.args, calls.box, angle)
        lateral_speed = -KP_LATERAL * across(calls, lane, s, y)
        lane_heading = heading_at(calls, lane, s + f[SPEED, i] * TAU_PURSUIT)
        sine = clip(lateral_speed / not_zero(f[SPEED, i]), -1.0, 1.0)
        if sine == 0.0 and lane_heading == f[ANGLE, i]:
            f[STEERING, i] = 0.0
        else:
            a[m], scratch.c[m], scratch.some[m] = sine, lane_heading, i
            m += 1
    unary(calls.loops, ARCSIN, calls.args, a, b, m)
    for j in range(m):
        i = scratch.some[j]
        wanted = scratch.c[j] + clip(b[j], -QUARTER_PI, QUARTER_PI)
        rate = KP_HEADING * wrap(wanted - f[ANGLE, i])
        a[j] = clip(f[CAR_LENGTH, i] / 2 / not_zero(f[SPEED, i]) * rate, -1.0, 1.0)
    unary(calls.loops, ARCSIN, calls.args, a, b, m)
    unary(calls.loops, TAN, calls.args, b, a, m)
    for j in range(m):
        a[j] = 2 * a[j]
    unary(calls.loops, ARCTAN, calls.args, a, b, m)
    for j in range(m):
        f[STEERING, scratch.some[j]] = clip(b[j], -MAX_STEERING_ANGLE, MAX_STEERING_ANGLE)
