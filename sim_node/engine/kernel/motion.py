"""How every vehicle moves in one tick: highway-env's bicycle model."""

from __future__ import annotations

from typing import Any

from sim_node.engine.kernel.lanes import closest_lane
from sim_node.engine.kernel.layout import (
    ABSENT,
    ACCEL,
    AGE,
    ANGLE,
    CAR_LENGTH,
    CRASHED,
    HARD_FROM,
    HARD_MPS2,
    HARD_TO,
    KIND,
    LANE,
    MAX_SPEED,
    MIN_SPEED,
    OBSTACLE,
    PUSH_X,
    PUSH_Y,
    PUSHED,
    SPEED,
    STEERING,
    TIMER,
    TRAFFIC,
    X,
    Y,
)
from sim_node.engine.loops import ARCTAN, COS, SIN, TAN, unary
from sim_node.traffic import STEERS_MPS


def directions(calls: Any, scratch: Any, f: Any) -> None:
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


def step(calls: Any, roads: Any, scratch: Any, f: Any, g: Any, dt: float) -> None:
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
            if f[HARD_FROM, i] <= f[AGE, i] < f[HARD_TO, i]:
                f[ACCEL, i] = min(f[ACCEL, i], -f[HARD_MPS2, i])
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
        if g[KIND, i] == TRAFFIC:
            f[AGE, i] += dt
        g[LANE, i] = closest_lane(calls, roads, f[X, i], f[Y, i], f[ANGLE, i])
