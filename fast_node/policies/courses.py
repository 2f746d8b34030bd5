"""The choice of a lane and a speed where no other lane than the ego's is asked for: in its own lane and in each beside
it, at each of some speeds, the ego is driven on paper for 13 s, all others driving on as now, and the course that costs
least is begun: a weighted sum of what is known of it (`COURSES`). The weights are learnt, from the ride score of whole
episodes (`fast_node.training.plan_weights`).

Axes: B scenes, L lanes (`OFFSETS`), C courses, K moments, N cars. Metres and seconds from the ego and from now.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fast_node.policies.on_paper import SLOWEST_MPS, STANDSTILL_M, acceleration, set_point, way
from fast_node.policies.policy import Policy
from fast_node.policies.weights import CHECKPOINTS, Described
from schemas.driving import features as f
from schemas.driving.features import Array
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

Bools = NDArray[np.bool_]

OFFSETS = np.array([0, -1, 1, -2, 2])
"""Lanes, from the ego's; the last two are only looked at."""
LANES = 3
LOWER_MPS = np.array([0.0, 1.0, 2.5, 5.0], np.float32)
"""Speeds to try, below the present set-point; ..."""
ABOVE_LEAD_MPS = np.array([0.0, 1.5], np.float32)
"""... above what the lane's next car comes to; and before all, the wished one."""
SPEEDS = 1 + len(LOWER_MPS) + len(ABOVE_LEAD_MPS)
WISHED, PRESENT = 0, 1
COUNT = LANES * SPEEDS
LANE = np.concatenate([np.repeat(np.arange(LANES), SPEEDS), np.arange(LANES, len(OFFSETS))])
"""Of each course, as an index of `OFFSETS`; after the courses come the lanes beyond, at the wished speed."""
AT_WISHED = np.array([0, SPEEDS, 2 * SPEEDS, COUNT, COUNT + 1])
"""In each lane the course at the wished speed."""
BESIDE = np.array([[1, 2], [3, 0], [0, 4]])
"""The lanes beside each, as indices of `OFFSETS`."""
PLAN = np.tile(np.arange(SPEEDS), LANES)
SIDE = OFFSETS[LANE[:COUNT]]

STEPS_S = np.array([0.5] * 6 + [1.0] * 10, np.float32)
MOMENTS = np.cumsum(STEPS_S) - STEPS_S
SOON, TOTAL_S = 8, STEPS_S.sum()
SOON_S = float(MOMENTS[SOON])
QUEUE = 4
"""So many cars ahead of the ego in each lane are reckoned with."""
BRAKES_MPS2 = 2.5
FAR_M, FREE_MPS = 1e4, 50.0
QUEUE_M, QUEUE_S = 6.0, 1.2
"""A car of a queue comes no nearer than this to the one ahead, unless it is nearer now."""
TTC_S = 8.0
"""A time to collision above this is as good, as in the ride score."""
CLOSING_MPS = 0.05
ENDS_M = 250.0
CROWD_M = 120.0
REACT_S = 0.5

COURSES = Described(
    names=(
        "late",
        "later",
        "beyond",
        "near",
        "nearest",
        "effort",
        "unrest",
        "close",
        "turn",
        "up",
        "wished",
        "present",
        "change",
        "left",
        "rear",
        "ends",
        "crowd",
    ),
    by_hand={
        "late": 0.4,
        "later": 0.8,
        "nearest": 0.5,
        "effort": 0.3,
        "unrest": 0.06,
        "close": 0.2,
        "turn": 0.1,
        "wished": -0.02,
        "present": -0.05,
        "change": 0.15,
        "left": -0.01,
        "rear": 0.3,
        "ends": 0.5,
    },
    shipped=CHECKPOINTS / "courses.json",
    command="make courses",
)
"""Of each course: how much less far it comes than at the wished speed, in 6.5 s / 30 m and in 13 s / 60 m; the least of
the latter in its lane and the two beside it; by how much the time to collision lies below `TTC_S`, now and at the
worst, / `TTC_S`; the mean square of the acceleration [(m/s2)2], and the mean of its changes from step to step [m/s2];
the mean shortfall from a headway of a second, / 1 s; by how much the set-point has to change, and to rise, / 5 m/s;
whether it is the wished speed, or the present set-point; whether it changes lanes, and to the left; what the car behind
has to brake with there, / 2 m/s2; how near the end of the own lane is, 0 to 1; cars ahead in the lane, / 3."""


class Courses(NamedTuple):
    """What is known of every course."""

    there: Bools
    """(B, C) whether the change that it begins with is open."""
    speed: Array
    """(B, C) the speed to go for now [m/s]."""
    known: Array
    """(B, C, D) what `COURSES` describes, in numbers of about 1."""


def to_choose(x: Array) -> Bools:
    """(B,) whether no other lane is asked for than the ego aims for, and none is an oncoming one. x: (B, N, F)."""
    own = x[:, 0]
    return np.asarray(((own[:, f.Y_WISHED] == 0) | (own[:, f.LANE_OFF] == 0)) & (own[:, f.BORROWS] == 0))


def courses(x: Array) -> Courses:
    """Of scenes x (B, N, F)."""
    own, rows = x[:, 0], x[:, 1:]
    v = 10.0 * own[:, f.SPEED, None]
    wished = np.maximum(v + 5.0 * own[:, f.V_DES, None], SLOWEST_MPS)
    held, headway = v + 5.0 * own[:, f.SET_POINT, None], 3.0 * own[:, f.HEADWAY, None]
    ours = (rows[..., f.PRESENCE] > 0) & (rows[..., f.ONCOMING] == 0)
    at, mps = 50.0 * rows[..., f.DX], v + 5.0 * rows[..., f.DVX]
    half = 5.0 * (rows[..., f.LENGTH_10] + own[:, None, f.LENGTH_10])
    here = ours[:, None] & (rows[:, None, :, f.LANE_OFF] == OFFSETS[:, None])
    ahead = here & (at > 0)[:, None]
    lead_at, lead_mps, lead_half = _next_ahead(ahead, at, mps, half)
    goal = _goals(wished, held, lead_at, lead_mps)
    stays = np.ones(len(x), np.bool_)
    free = own[:, f.CHANGING] == 0
    is_open = np.stack([stays, free & (own[:, f.LEFT_OPEN] > 0), free & (own[:, f.RIGHT_OPEN] > 0)], 1)
    driven = _drive(v, held, goal, lead_at[:, LANE], lead_mps[:, LANE], lead_half[:, LANE], headway)
    lost = wished * TOTAL_S - driven.way
    goal = goal[:, :COUNT]
    turn = goal - held
    known = np.empty((*goal.shape, len(COURSES.names)), np.float32)
    for k, column in enumerate(
        (
            (wished * SOON_S - driven.way_soon[:, :COUNT]) / 30.0,
            lost[:, :COUNT] / 60.0,
            _beyond(lost, here.any(-1))[:, LANE[:COUNT]] / 60.0,
            *(part[:, :COUNT] for part in driven[2:]),
            np.abs(turn) / 5.0,
            np.maximum(turn, 0.0) / 5.0,
            PLAN == WISHED,
            PLAN == PRESENT,
            SIDE != 0,
            SIDE < 0,
            _braking_behind(here[:, :LANES] & ~ahead[:, :LANES], at, mps, half, v)[:, LANE[:COUNT]] / 2.0,
            np.clip(1.0 - 100.0 * own[:, f.ROAD_LEFT, None] / ENDS_M, 0.0, 1.0) * (SIDE == 0),
            (ahead[:, :LANES] & (at < CROWD_M)[:, None]).sum(-1)[:, LANE[:COUNT]] / 3.0,
        )
    ):
        known[..., k] = column
    return Courses(is_open[:, LANE[:COUNT]], goal, known)


def _goals(wished: Array, held: Array, lead_at: Array, lead_mps: Array) -> Array:
    """(B, C + beyond) the speed that every course goes for [m/s]."""
    at_last = np.where(lead_at[..., -1] < FAR_M, lead_mps[..., -1], np.inf)[:, :LANES, None]
    b = len(wished)
    lower = np.broadcast_to((held - LOWER_MPS)[:, None], (b, LANES, len(LOWER_MPS)))
    tried = np.concatenate([np.broadcast_to(wished[:, None], (b, LANES, 1)), lower, at_last + ABOVE_LEAD_MPS], 2)
    clipped = np.clip(tried.reshape(b, COUNT), SLOWEST_MPS, wished)
    return np.concatenate([clipped, np.repeat(wished, len(OFFSETS) - LANES, 1)], 1)


def _next_ahead(ahead: Bools, at: Array, mps: Array, half: Array) -> tuple[Array, Array, Array]:
    """(B, L, K) where the next car ahead will be (`FAR_M`: none), how fast, and (B, L) what of the distance the two
    cars fill. Every car drives on as now, but comes no nearer to the one ahead of it than it is or than a queue is."""
    order = np.argsort(np.where(ahead, at[:, None], np.inf), axis=-1, kind="stable")[..., :QUEUE]
    there = np.take_along_axis(ahead, order, -1)
    at, mps, half = (np.take_along_axis(np.broadcast_to(a[:, None], ahead.shape), order, -1) for a in (at, mps, half))
    path = np.full((*order.shape[:2], len(MOMENTS)), FAR_M, np.float32)
    for m in reversed(range(order.shape[-1])):
        alone = at[..., m, None] + mps[..., m, None] * MOMENTS
        if m + 1 < order.shape[-1]:
            room = np.where(there[..., m + 1], at[..., m + 1] - at[..., m], FAR_M)
            alone = np.minimum(alone, path - np.minimum(room, QUEUE_M + QUEUE_S * mps[..., m])[..., None])
        path = np.where(there[..., m, None], alone, path)
    speed = np.empty_like(path)
    speed[..., :-1] = np.diff(path, axis=-1) / STEPS_S[:-1]
    speed[..., -1] = speed[..., -2]
    some = there[..., :1]
    return path, np.where(some, speed, FREE_MPS), np.where(some[..., 0], half[..., 0], 0.0)


class _Driven(NamedTuple):
    """(B, courses) each, of the course as a whole; see `COURSES`."""

    way_soon: Array
    way: Array
    near: Array
    nearest: Array
    effort: Array
    unrest: Array
    close: Array


def _drive(
    v: Array, held: Array, goal: Array, lead_at: Array, lead_mps: Array, lead_half: Array, headway: Array
) -> _Driven:
    """Every course to its end, as `on_paper` moves the ego."""
    speed, point, way = np.repeat(v, goal.shape[1], 1), np.repeat(held, goal.shape[1], 1), np.zeros_like(goal)
    lead, rear = (np.ascontiguousarray(np.moveaxis(a, -1, 0)) for a in (lead_mps, lead_at - lead_half[..., None]))
    kept, ways, speeds, accels = headway * lead, np.empty_like(rear), np.empty_like(rear), np.empty_like(rear)
    for k, dt in enumerate(STEPS_S.tolist()):
        ways[k], speeds[k] = way, speed
        point = set_point(point, goal, speed, dt)
        accels[k] = accel = acceleration(point, speed, lead[k], rear[k] - way - STANDSTILL_M - kept[k], BRAKES_MPS2)
        speed = np.maximum(speed + accel * dt, 0.0)
        way = way + speed * dt
    gaps = rear - ways
    near = 1.0 - np.minimum(np.maximum(gaps, 0.0) / (TTC_S * np.maximum(speeds - lead, CLOSING_MPS)), 1.0)
    short = np.maximum(1.0 - gaps / np.maximum(speeds, 1.0), 0.0)
    steps_s = STEPS_S[:, None, None]
    return _Driven(
        ways[SOON],
        way,
        near[0],
        near.max(0),
        (steps_s * accels * accels).sum(0) / TOTAL_S,
        np.abs(np.diff(accels, axis=0, prepend=np.float32(0.0))).sum(0) / np.float32(len(STEPS_S)),
        (steps_s * short).sum(0) / TOTAL_S,
    )


def _beyond(lost: Array, seen: Bools) -> Array:
    """(B, LANES) the least that is lost at the wished speed in each lane or one beside it in which a car is."""
    here = lost[:, AT_WISHED]
    beside = np.where(seen, here, np.inf)[:, BESIDE]
    least: Array = np.minimum(here[:, :LANES], beside.min(-1))
    return least


def _braking_behind(behind: Bools, at: Array, mps: Array, half: Array, v: Array) -> Array:
    """(B, LANES) what the cars behind have to brake with for the ego [m/s2], half a second from now; 0 in its own
    lane."""
    room = np.maximum(-at - half - REACT_S * mps, 1.0)
    faster = np.maximum(mps - v, 0.0)
    need = np.where(behind, (faster * faster / (2.0 * room))[:, None], 0.0).max(-1, initial=0.0)
    need[:, 0] = 0.0
    return np.asarray(need)


SHARP = 10.0
"""What a cost of 1 counts in a logit: a course that costs 0.1 more is e times less likely."""
WORST = -50.0
"""The logit of an action with which no course begins."""


class CoursePolicy:
    """A base policy, and a choice of lane and speed where no other lane is asked for."""

    def __init__(self, base: Policy, weights: Array | None = None) -> None:
        """weights: (D,) of `COURSES`; None: by hand."""
        self._base = base
        self._weights = COURSES.in_order(COURSES.by_hand) if weights is None else weights

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`: an action's is what the best course costs that begins with it."""
        flat = x.reshape(-1, *x.shape[-2:])
        chosen = to_choose(flat)
        if not chosen.any():
            return self._base.logits(x)
        out = np.empty((len(flat), POLICY_ACTIONS), np.float32)
        if not chosen.all():
            out[~chosen] = self._base.logits(flat[~chosen])
        seen = flat[chosen]
        known = courses(seen)
        cost = np.where(known.there, known.known @ self._weights, np.inf)
        begins = _first_actions(seen, known.speed)
        best = np.stack([np.where(begins == a, cost, np.inf).min(1) for a in range(POLICY_ACTIONS)], 1)
        out[chosen] = np.maximum(-SHARP * best, WORST)
        return out.reshape(*x.shape[:-2], POLICY_ACTIONS)


def _first_actions(x: Array, goal: Array) -> NDArray[np.int64]:
    """(B, C) the action that each course begins with: the change of lanes, else a step towards its speed (B, C)."""
    v = 10.0 * x[:, 0, f.SPEED, None]
    turn = way(goal, v + 5.0 * x[:, 0, f.SET_POINT, None], v + 5.0 * x[:, 0, f.V_DES, None])
    speed = np.where(turn < 0, MetaAction.SLOW_DOWN, np.where(turn > 0, MetaAction.SPEED_UP, MetaAction.CRUISE))
    return np.where(SIDE < 0, MetaAction.LEFT, np.where(SIDE > 0, MetaAction.RIGHT, speed))
