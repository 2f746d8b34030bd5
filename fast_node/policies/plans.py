"""When the lane to be entered would open: at each of some speeds, and behind each of the cars there, if all drive on as
now. What a policy chooses among that chooses a gap, instead of one action at a time.

Axes: B scenes, P plans, K moments, N cars. Metres and seconds from the ego and from now.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fast_node.policies.on_paper import SLOWEST_MPS, STANDSTILL_M, acceleration, set_point
from schemas.driving import features as f

Array = NDArray[np.float32]
Bools = NDArray[np.bool_]

OFFSETS_MPS = np.array([6.0, 3.0, 0.0, -3.0, -6.0, -9.0], np.float32)
"""Speeds to try, above that of the lane to be entered; the first two plans are the wished speed and the present one."""
PRESENT = 1
RANKS = (3, 2, 1, -1, -2, -3)
"""Cars to fall in behind: the third, second and first ahead of the ego, and those behind it."""
SPEEDS = 2 + len(OFFSETS_MPS)
PLANS = SPEEDS + len(RANKS)
STEPS = np.array([0.5] * 20 + [1.0] * 26, np.float32)
MOMENTS = np.concatenate([[0.0], np.cumsum(STEPS)[:-1]]).astype(np.float32)
NEVER_S = 42.0
ABOUT_M = 120.0
"""The speed of a lane is that of the cars in it so near to the ego."""
BRAKES_MPS2 = 2.0
GAP_S, GAP_M, GAIN_PER_S = 1.1, 3.0, 0.25
CATCH_UP_MPS, DROP_BACK_MPS = 4.0, 8.0
"""A car is fallen in behind with `GAP_S` and `GAP_M`, at most so much faster or slower than it."""
MARGIN_M, RESERVE_M = 15.0, 300.0
"""A change must begin so long before where the task ends; and so much more for each lane to be crossed after it."""
BEFORE_END_M, BEFORE_END_S = 12.0, 2.0
"""... and where one of the two lanes ends: see `mask.entering`."""
LEFT_MOST_M, SPARE_MOST_M = 300.0, 20.0
"""More road left, or more room to spare, than this is as good."""


class Plans(NamedTuple):
    """What is known of every plan."""

    there: Bools
    """(B, P) whether there is such a plan."""
    speed: Array
    """(B, P) the speed to go for now [m/s]."""
    open_s: Array
    """(B, P) when the change would be open; `NEVER_S`: not in time."""
    lost_m: Array
    """(B, P) how much farther the ego would have come by then at the wished speed; 0 if never."""
    left_m: Array
    """(B, P) how much road is left then to begin the change on, at most `LEFT_MOST_M`; 0 if never."""
    spare_m: Array
    """(B, P) how much more room there is then than the change needs, at most `SPARE_MOST_M`; 0 if never."""


def own_lane_ends(x: Array) -> Bools:
    """(B,) whether the ego's lane ends before the one to be entered, as a ramp does. x: (B, N, F)."""
    own = x[:, 0]
    return np.asarray(own[:, f.ENDS] < own[:, f.AIM_ENDS])


def to_enter(x: Array) -> NDArray[np.int64]:
    """(B,) the side of the lane to be entered, -1 left, 1 right; 0: none, or it is an oncoming one, or the ego is
    changing already, or there is time: neither its own lane nor the task ends within 2 km, the features' bound.
    x: (B, N, F)."""
    own = x[:, 0]
    free = (own[:, f.Y_WISHED] > 0) & (own[:, f.CHANGING] == 0) & (own[:, f.BORROWS] == 0)
    free &= own_lane_ends(x) | (own[:, f.GOAL_LEFT] < f.BOUND)
    return np.where(free, np.sign(own[:, f.LANE_OFF]), 0).astype(np.int64)


def plans(x: Array, side: NDArray[np.int64]) -> Plans:
    """Of scenes x (B, N, F), each with a lane to be entered on `side` (B,)."""
    own, rows = x[:, 0], x[:, 1:]
    v = 10.0 * own[:, f.SPEED]
    wished, headway = v + 5.0 * own[:, f.V_DES], 3.0 * own[:, f.HEADWAY]
    ours = (rows[..., f.PRESENCE] > 0) & (rows[..., f.ONCOMING] == 0)
    at, mps = 50.0 * rows[..., f.DX], v[:, None] + 5.0 * rows[..., f.DVX]
    half = 5.0 * (rows[..., f.LENGTH_10] + own[:, None, f.LENGTH_10])
    there = ours & (rows[..., f.LANE_OFF] == side[:, None])
    lead_at, lead_mps, lead_half = _nearest_ahead(ours & (rows[..., f.LANE_OFF] == 0), at, mps, half)

    most = max(int(there.sum(1).max(initial=0)), 1)
    order = np.argsort(np.where(there, at, np.inf), axis=1, kind="stable")[:, :most]
    there, at, mps, half = (np.take_along_axis(a, order, 1) for a in (there, at, mps, half))
    near = there & (np.abs(at) < ABOUT_M)
    lane_mps = np.where(near.any(1), (mps * near).sum(1) / np.maximum(near.sum(1), 1), v)

    held = v + 5.0 * own[:, f.SET_POINT]
    target, car, exists, now = _targets(v, wished, held, lane_mps, there, at, mps, half)
    way, speed = _courses(v, wished, held, target, car, lead_at, lead_mps, lead_half, headway)
    spare = _spare(way, speed, there, at, mps, half, np.minimum(headway, 1.0))
    lane_left = 100.0 * np.minimum(own[:, f.AIM_ENDS], own[:, f.ENDS])[:, None, None] - BEFORE_END_M
    after = np.maximum(np.abs(own[:, f.LANE_OFF]) - 1.0, 0.0)
    task_left = (100.0 * own[:, f.GOAL_LEFT] - MARGIN_M - RESERVE_M * after)[:, None, None]
    left = np.minimum(task_left, lane_left - BEFORE_END_S * speed) - way
    fits = (spare >= 0.0) & (left >= 0.0) & (way >= 100.0 * own[:, f.OPENS, None, None]) & exists[..., None]
    first, some = fits.argmax(-1), fits.any(-1)

    def then(values: Array) -> Array:
        return np.where(some, np.take_along_axis(values, first[..., None], -1)[..., 0], 0.0)

    return Plans(
        exists,
        now,
        np.where(some, MOMENTS[first], NEVER_S),
        np.where(some, wished[:, None] * MOMENTS[first] - then(way), 0.0),
        then(np.minimum(left, LEFT_MOST_M)),
        then(spare),
    )


def _nearest_ahead(ours: Bools, at: Array, mps: Array, half: Array) -> tuple[Array, Array, Array]:
    """(B,) where the next car ahead is (inf: none), its speed, and what of the distance the two cars fill."""
    ahead = np.where(ours & (at > 0), at, np.inf)
    found = ahead.argmin(1)[:, None]
    return ahead.min(1), np.take_along_axis(mps, found, 1)[:, 0], np.take_along_axis(half, found, 1)[:, 0]


def _targets(
    v: Array, wished: Array, held: Array, lane_mps: Array, there: Bools, at: Array, mps: Array, half: Array
) -> tuple[Array, tuple[Array, Array], Bools, Array]:
    """Of every plan: (B, P) the speed to come to, (where to be now, how fast that place moves), (B, P) whether there
    is such a plan, (B, P) the speed to go for now. Cars in order along the road."""
    b = len(v)
    speeds = np.clip(lane_mps[:, None] + OFFSETS_MPS, SLOWEST_MPS, np.maximum(wished, SLOWEST_MPS)[:, None])
    speeds = np.concatenate([wished[:, None], held[:, None], speeds], 1)
    behind = (there & (at <= 0)).sum(1)
    rank = np.array(RANKS)
    index = behind[:, None] + np.where(rank > 0, rank - 1, rank)
    exists = (index >= 0) & (index < there.sum(1)[:, None])
    index = np.clip(index, 0, there.shape[1] - 1)
    car_at, car_mps, car_half = (np.take_along_axis(a, index, 1) for a in (at, mps, half))
    place = (car_at - car_half - GAP_S * car_mps - GAP_M).astype(np.float32)
    step = np.clip(GAIN_PER_S * place, -DROP_BACK_MPS, CATCH_UP_MPS)
    most = np.maximum(wished, SLOWEST_MPS)[:, None]
    return (
        np.concatenate([speeds, car_mps], 1),
        (place, car_mps),
        np.concatenate([np.ones((b, SPEEDS), np.bool_), exists], 1),
        np.concatenate([speeds, np.clip(car_mps + step, SLOWEST_MPS, most)], 1),
    )


def _courses(
    v: Array,
    wished: Array,
    held: Array,
    target: Array,
    car: tuple[Array, Array],
    lead_at: Array,
    lead_mps: Array,
    lead_half: Array,
    headway: Array,
) -> tuple[Array, Array]:
    """(B, P, K) where the ego would be, and how fast.

    held: (B,) the set-point; target: (B, P) the speeds of the plans that have one; car: (B, ranks) where each of the
    others wants to be now, and how fast that place moves.
    """
    place, car_mps = car
    led = np.isfinite(lead_at)
    stop = np.where(led, np.where(led, lead_at, 0.0) - lead_half - STANDSTILL_M - headway * lead_mps, 1e6)
    stops = stop[:, None, None] + lead_mps[:, None, None] * MOMENTS
    places = place[..., None] + car_mps[..., None] * MOMENTS
    most, lead = np.maximum(wished, SLOWEST_MPS)[:, None], lead_mps[:, None]
    speed = np.repeat(v[:, None], target.shape[1], 1)
    way, point, goal = np.zeros_like(speed), np.repeat(held[:, None], target.shape[1], 1), target.copy()
    ways, speeds = np.empty((*way.shape, len(MOMENTS)), way.dtype), np.empty((*way.shape, len(MOMENTS)), way.dtype)
    for k, dt in enumerate(STEPS):
        ways[..., k], speeds[..., k] = way, speed
        off = np.minimum(np.maximum(GAIN_PER_S * (places[..., k] - way[:, SPEEDS:]), -DROP_BACK_MPS), CATCH_UP_MPS)
        goal[:, SPEEDS:] = np.minimum(np.maximum(car_mps + off, SLOWEST_MPS), most)
        point = set_point(point, goal, speed, dt)
        accel = acceleration(point, speed, lead, stops[..., k] - way, BRAKES_MPS2)
        speed = np.maximum(speed + accel * dt, 0.0)
        way = way + speed * dt
    return ways, speeds


def _spare(way: Array, speed: Array, there: Bools, at: Array, mps: Array, half: Array, gap_s: Array) -> Array:
    """(B, P, K) how much more room there is between the cars of the lane than `mask.entering` and
    `choice.worth_entering` ask for with preset "sim" at 5 m/s and more, at most `SPARE_MOST_M`; negative: too little. A
    car that passes the ego at more than twice its speed counts as gone once it is ahead; the mask waits until it is
    1.5 m ahead."""
    safe = speed * (2.0 / 15.0) + (speed + 2.0 / 15.0) ** 2 / 14.0 + 1.51
    worth = (gap_s[:, None, None] + 1.0) * speed
    brakes = 0.1 * speed * speed
    spare = np.full(way.shape, SPARE_MOST_M, way.dtype)
    for n in range(there.shape[1]):
        here = there[:, n]
        if not here.any():
            continue
        v = mps[:, n, None, None]
        apart = (at[:, n, None, None] + v * MOMENTS) - way
        front = np.maximum(safe - v * v / 18.0, worth - v)
        spared = 1.2566 * (5.0 + 1.5 * v + v * (v - speed) / 7.746)
        rear = np.maximum(np.maximum(spared, 3.5), 0.8 * v + 0.16 + (v + 0.4) ** 2 / 12.0 - brakes)
        room = np.abs(apart) - np.where(apart > 0.0, front, rear) - half[:, n, None, None]
        np.minimum(spare, np.where(here[:, None, None], room, SPARE_MOST_M), out=spare)
    return spare
