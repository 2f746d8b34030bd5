"""The two-way scenario for training: many scenes at once, 15 Hz, compiled with numba.

The others drive by highway-env's IDM without lane changes, exactly on their lane's centre line; the ego is moved by
the executor and highway-env's bicycle model. Everything acts on the world as it lies there, then everything steps.
`tests/test_engine.py` holds it against `sim_node.env`: equal but for rounding, until an oncoming car that brakes for
the ego comes to drive backwards; upstream's steering is unstable there, while here the car stays on its line.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from schemas import measures, messages
from schemas.messages import ROW_COLUMNS
from sim_node import executor
from sim_node.scenarios.two_way import TWO_WAY, Spawn

HZ = 15
DT_S = 1.0 / HZ
LANES: NDArray[np.float64] = np.array(
    [
        [lane.y_m, lane.start_m, lane.end_m, lane.direction, lane.width_m, lane.speed_limit_mps]
        for lane in TWO_WAY.lanes()
    ]
)
"""(2, 6): y, start, end, direction, width, speed limit of each lane; SI units."""
LANE_Y: NDArray[np.float64] = LANES[:, 0].copy()
VEHICLES = TWO_WAY.vehicles_max
OWN_LANE = TWO_WAY.ego_lane
ABSENT_X_M = 1e6
PASSED_MARGIN_M = 2.0

LENGTH_M = 5.0
WIDTH_M = 2.0
# highway-env 1.12: IDMVehicle, and the margins of AbstractLane.on_lane as Road.neighbour_vehicles calls it.
IDM_ACCEL_MPS2 = 3.0
IDM_BRAKE_MPS2 = 5.0
IDM_ACCEL_BOUND_MPS2 = 6.0
IDM_DISTANCE_M = 10.0
IDM_TIME_S = 1.5
ON_LANE_SIDE_M = 1.0
ON_LANE_END_M = 5.0
COLLISION_REACH_M = math.hypot(LENGTH_M, WIDTH_M)
LEFT_ROAD_M = 20.0
"""Other cars vanish this near to the road's ends, as in `sim_node.env`."""
NOT_ZERO = 1e-2

SPEED_FLOOR = TWO_WAY.speed_floor_mps
SPEED_CEILING = TWO_WAY.speed_ceiling_mps

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_edit_set_points: Any = numba.njit(executor.edit_set_points)
_acceleration_command: Any = numba.njit(executor.acceleration_command)
_steering_command: Any = numba.njit(executor.steering_command)
_change_finished: Any = numba.njit(executor.change_finished)


def _not_zero_py(value: float) -> float:
    if abs(value) > NOT_ZERO:
        return value
    return NOT_ZERO if value >= 0.0 else -NOT_ZERO


_not_zero: Any = numba.njit(_not_zero_py)


def _idm_py(
    scene: int,
    i: int,
    n: int,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    lane: IntArray,
    wish: FloatArray,
    delta: FloatArray,
    lanes: FloatArray,
) -> float:
    """IDMVehicle.act: the acceleration of vehicle `i` behind the nearest vehicle ahead that is on its lane."""
    k = lane[scene, i]
    lane_y, start, end, ahead, width, limit = lanes[k]
    origin = start if ahead > 0.0 else end
    s = (x[scene, i] - origin) * ahead
    front = -1
    s_front = 0.0
    for j in range(n):
        if j == i or abs(y[scene, j] - lane_y) > width / 2 + ON_LANE_SIDE_M:
            continue
        s_j = (x[scene, j] - origin) * ahead
        if not -ON_LANE_END_M <= s_j < end - start + ON_LANE_END_M:
            continue
        if s <= s_j and (front < 0 or s_j <= s_front):
            front = j
            s_front = s_j
    v = speed[scene, i]
    target = min(max(wish[scene, i], 0.0), limit)
    accel: float = IDM_ACCEL_MPS2 * (1.0 - (max(v, 0.0) / abs(_not_zero(target))) ** delta[scene, i])
    if front >= 0:
        c, d = math.cos(heading[scene, i]), math.sin(heading[scene, i])
        v_front, h_front = speed[scene, front], heading[scene, front]
        closing = (v * c - v_front * math.cos(h_front)) * c + (v * d - v_front * math.sin(h_front)) * d
        wanted = IDM_DISTANCE_M + v * IDM_TIME_S + v * closing / (2.0 * math.sqrt(IDM_ACCEL_MPS2 * IDM_BRAKE_MPS2))
        ratio = wanted / _not_zero(s_front - s)
        accel -= IDM_ACCEL_MPS2 * (ratio * ratio)
    return min(max(accel, -IDM_ACCEL_BOUND_MPS2), IDM_ACCEL_BOUND_MPS2)


_idm: Any = numba.njit(_idm_py)


def _touch_py(reach: float, offset: float, swept: float) -> bool:
    """Whether two intervals of half lengths summing to `reach` touch; `offset` is the other's centre from the first's.

    The first sweeps over `swept` more, on the side of its sign.
    """
    return -reach + min(swept, 0.0) <= offset <= reach + max(swept, 0.0)


_touch: Any = numba.njit(_touch_py)


def _overlap_py(dx: float, dy: float, heading: float, sx: float, sy: float) -> bool:
    """Whether a car turned by `heading` and one along the road at (`dx`, `dy`) from it overlap (separating axes).

    As `utils.are_polygons_intersecting`: on every axis the first one also covers its relative motion (`sx`, `sy`).
    """
    c, s = math.cos(heading), math.sin(heading)
    half_l, half_w = 0.5 * LENGTH_M, 0.5 * WIDTH_M
    along = half_l + half_l * abs(c) + half_w * abs(s)
    across = half_w + half_l * abs(s) + half_w * abs(c)
    touching: bool = (
        _touch(along, dx, sx)
        and _touch(across, dy, sy)
        and _touch(along, dx * c + dy * s, sx * c + sy * s)
        and _touch(across, dy * c - dx * s, sy * c - sx * s)
    )
    return touching


_overlap: Any = numba.njit(_overlap_py)


def _write_row_py(
    scene: int,
    i: int,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    lanes: FloatArray,
    rows: NDArray[np.float32],
) -> None:
    nearest = 0
    for k in range(1, lanes.shape[0]):
        if abs(y[scene, i] - lanes[k, 0]) < abs(y[scene, i] - lanes[nearest, 0]):
            nearest = k
    rows[scene, i, 1] = x[scene, i]
    rows[scene, i, 2] = y[scene, i]
    rows[scene, i, 3] = speed[scene, i] * math.cos(heading[scene, i])
    rows[scene, i, 4] = speed[scene, i] * math.sin(heading[scene, i])
    rows[scene, i, 5] = heading[scene, i]
    rows[scene, i, 8] = nearest


_write_row: Any = numba.njit(_write_row_py)


def _kernel(sources: int) -> Any:
    """The compiled tick. numba keys its cache by this closure, so a change in `sources` compiles anew."""

    def advance(
        meta: IntArray,
        speed_goal: FloatArray,
        count: IntArray,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        speed: FloatArray,
        lane: IntArray,
        wish: FloatArray,
        delta: FloatArray,
        lanes: FloatArray,
        target_speed: FloatArray,
        target_lane: IntArray,
        previous_lane: IntArray,
        accel: FloatArray,
        crashed: BoolArray,
        doomed: BoolArray,
        tick: IntArray,
        rows: NDArray[np.float32],
    ) -> int:
        pushed = np.empty(x.shape[1])
        for scene in range(x.shape[0]):
            if crashed[scene]:
                continue
            n = count[scene]
            target_speed[scene], target_lane[scene], previous_lane[scene] = _edit_set_points(
                meta[scene],
                target_speed[scene],
                target_lane[scene],
                previous_lane[scene],
                lanes.shape[0],
                speed_goal[scene],
                SPEED_FLOOR,
                SPEED_CEILING,
            )
            y_target = lanes[target_lane[scene], 0]
            v, h = speed[scene, 0], heading[scene, 0]
            accel[scene] = _acceleration_command(v, target_speed[scene], accel[scene], meta[scene], DT_S)
            steering = _steering_command(x[scene, 0], y[scene, 0], h, v, y_target)
            for i in range(1, n):
                if rows[scene, i, 0] < 0:
                    continue
                pushed[i] = _idm(scene, i, n, x, y, heading, speed, lane, wish, delta, lanes)

            beta = math.atan(0.5 * math.tan(steering))
            x[scene, 0] += v * math.cos(h + beta) * DT_S
            y[scene, 0] += v * math.sin(h + beta) * DT_S
            heading[scene, 0] += v * math.sin(beta) / (LENGTH_M / 2) * DT_S
            speed[scene, 0] += accel[scene] * DT_S
            accel[scene] = (speed[scene, 0] - v) / DT_S
            _write_row(scene, 0, x, y, heading, speed, lanes, rows)
            crashed[scene] = doomed[scene]
            v, h = speed[scene, 0], heading[scene, 0]
            for i in range(1, n):
                if rows[scene, i, 0] < 0:
                    continue
                along = math.cos(heading[scene, i])
                x[scene, i] += speed[scene, i] * along * DT_S
                speed[scene, i] += pushed[i] * DT_S
                dx, dy = x[scene, i] - x[scene, 0], y[scene, i] - y[scene, 0]
                if math.sqrt(dx * dx + dy * dy) <= COLLISION_REACH_M + v * DT_S:
                    crashed[scene] |= _overlap(dx, dy, h, 0.0, 0.0)
                    sx, sy = (v * math.cos(h) - speed[scene, i] * along) * DT_S, v * math.sin(h) * DT_S
                    doomed[scene] |= _overlap(dx, dy, h, sx, sy)
                if not LEFT_ROAD_M < x[scene, i] < lanes[0, 2] - LEFT_ROAD_M:
                    rows[scene, i, 0] = -1
                    x[scene, i] = ABSENT_X_M
                    speed[scene, i] = 0.0
                _write_row(scene, i, x, y, heading, speed, lanes, rows)
            if previous_lane[scene] >= 0 and _change_finished(y[scene, 0], y_target):
                previous_lane[scene] = -1
            tick[scene] += 1
        return sources

    return numba.njit(cache=True)(advance)


def _sources_digest() -> int:
    """A number for the text of the modules that the kernel compiles in; numba itself watches only this file."""
    digest = hashlib.sha256()
    for module in (executor, measures, messages):
        digest.update(Path(str(module.__file__)).read_bytes())
    digest.update(repr(TWO_WAY).encode())
    return int.from_bytes(digest.digest()[:7], "little")


_advance: Callable[..., int] = _kernel(_sources_digest())


class BatchedTwoWay:
    """`scenes` independent two-way scenes. A crashed scene stands still, its tick too, until it is reset.

    Scene k draws its episodes from the k-th child of `SeedSequence(seed)`, whatever the other scenes do.
    Vehicle 0 is the ego, 1 the first lead; the order is the spawn's and stays. The float64 state behind `rows` is
    `x`, `y`, `heading`, `speed` (S, V); the first `count[k]` vehicles of scene k exist.
    """

    def __init__(self, scenes: int, seed: int) -> None:
        shape = (scenes, VEHICLES)
        self.scenes = scenes
        self.rows: NDArray[np.float32] = np.zeros((*shape, len(ROW_COLUMNS)), np.float32)
        self.x, self.y, self.heading, self.speed = (np.zeros(shape) for _ in range(4))
        self.wish, self.delta = np.zeros(shape), np.ones(shape)
        self.lane: IntArray = np.zeros(shape, np.int64)
        self.count: IntArray = np.zeros(scenes, np.int64)
        self.target_speed: FloatArray = np.zeros(scenes)
        self.target_lane: IntArray = np.full(scenes, OWN_LANE, np.int64)
        self.previous_lane: IntArray = np.full(scenes, -1, np.int64)
        self.accel: FloatArray = np.zeros(scenes)
        self.crashed: BoolArray = np.zeros(scenes, np.bool_)
        self.doomed: BoolArray = np.zeros(scenes, np.bool_)
        """The ego's next tick is a crash: upstream also collides where constant velocity would overlap a tick later."""
        self.ticks: IntArray = np.zeros(scenes, np.int64)
        self._rngs = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(scenes)]
        self.reset(np.ones(scenes, np.bool_))

    def reset(self, mask: BoolArray) -> None:
        """Start a new episode in every scene where `mask` is set."""
        for scene in np.flatnonzero(mask):
            self.load(int(scene), TWO_WAY.spawn(self._rngs[scene]))

    def load(self, scene: int, spawn: Spawn) -> None:
        """Put these vehicles into one scene, at tick 0."""
        n = len(spawn.x)
        self.count[scene] = n
        self.x[scene, :n], self.x[scene, n:] = spawn.x, ABSENT_X_M
        self.lane[scene, :n], self.lane[scene, n:] = spawn.lane, OWN_LANE
        self.y[scene] = LANE_Y[self.lane[scene]]
        self.heading[scene, :n], self.heading[scene, n:] = np.where(spawn.direction > 0, 0.0, np.pi), 0.0
        self.speed[scene, :n], self.speed[scene, n:] = spawn.speed, 0.0
        self.wish[scene, :n], self.wish[scene, n:] = spawn.target_speed, 0.0
        self.delta[scene, :n], self.delta[scene, n:] = spawn.delta, 1.0
        self.target_speed[scene] = spawn.target_speed[0]
        self.target_lane[scene] = spawn.lane[0]
        self.previous_lane[scene] = -1
        self.accel[scene] = 0.0
        self.crashed[scene] = False
        self.doomed[scene] = False
        self.ticks[scene] = 0
        rows = self.rows[scene]
        rows[:, 0] = np.where(np.arange(VEHICLES) < n, np.arange(VEHICLES), -1)
        rows[:, 1], rows[:, 2], rows[:, 5] = self.x[scene], self.y[scene], self.heading[scene]
        rows[:, 3] = self.speed[scene] * np.cos(self.heading[scene])
        rows[:, 4] = self.speed[scene] * np.sin(self.heading[scene])
        rows[:, 6], rows[:, 7], rows[:, 8] = LENGTH_M, WIDTH_M, self.lane[scene]

    def tick(self, meta: IntArray, speed_goal: FloatArray) -> None:
        """Advance every scene by 1/15 s: one meta-action per scene, and its speed goal in m/s (nan: none)."""
        _advance(
            meta,
            speed_goal,
            self.count,
            self.x,
            self.y,
            self.heading,
            self.speed,
            self.lane,
            self.wish,
            self.delta,
            LANES,
            self.target_speed,
            self.target_lane,
            self.previous_lane,
            self.accel,
            self.crashed,
            self.doomed,
            self.ticks,
            self.rows,
        )

    def passed(self) -> BoolArray:
        """Where the first lead is passed: the ego's rear 2 m ahead of its front, and the ego back in its lane."""
        ahead = self.x[:, 0] - self.x[:, 1] - LENGTH_M > PASSED_MARGIN_M
        done: BoolArray = ahead & (self.rows[:, 0, 8] == OWN_LANE) & (self.previous_lane == -1)
        return done
