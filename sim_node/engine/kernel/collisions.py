"""Which pairs of vehicles collide, and where the impact pushes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim_node.engine.kernel.layout import (
    ABSENT,
    CAR_LENGTH,
    CAR_WIDTH,
    CHECKS,
    CLEAR,
    CRASHED,
    KIND,
    OBSTACLE,
    PUSH_X,
    PUSH_Y,
    PUSHED,
    SPEED,
    X,
    Y,
)
from sim_node.engine.loops import dot


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


def _project(calls: Any, polygon: Any, nx: float, ny: float) -> tuple[float, float]:
    low, high = np.inf, -np.inf
    for p in range(5):
        projected = dot(calls.loops, calls.args, calls.box, polygon[p, 0], polygon[p, 1], nx, ny)
        low, high = min(low, projected), max(high, projected)
    return low, high


def _interval(min_a: float, max_a: float, min_b: float, max_b: float) -> float:
    return min_b - max_a if min_a < min_b else min_a - max_b


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


def collide(calls: Any, scratch: Any, f: Any, g: Any, dt: float) -> None:
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
