"""The rules of an episode, for the live simulator, the environment, training and evaluation alike: what is done instead
of a closed action, when an episode is over, and what a decision has earned.

Axis: S scenes; a single world is one scene.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.driving.measures import TTC_CAP_S, ttc_s
from schemas.driving.reward import OURS, Weights, reward, shortfall
from schemas.driving.road import HZ, LANE, VX, X, gap_between, next_ahead, next_facing
from schemas.wire.messages import MetaAction

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

MILDEST = (MetaAction.CRUISE, MetaAction.SLOW_DOWN, MetaAction.SPEED_UP, MetaAction.RIGHT, MetaAction.LEFT)
"""What is done instead of a closed action: the first of these that is open, else EMERGENCY_BRAKE."""
_LEFT, _CRUISE = int(MetaAction.LEFT), int(MetaAction.CRUISE)
REDIRECT_PER_S = 0.03
"""How often the passenger of a training episode asks for something else."""


def held(action: int) -> int:
    """What follows `action` until the next decision: a speed goes on to rise or fall, a lane change has begun once.
    Compiles with numba unchanged."""
    return action if action < _LEFT else _CRUISE


def replaced(action: Ints, is_open: Bools) -> Ints:
    """(S,) the actions themselves where they are open, else the mildest open one. is_open: (S, 5 or more)."""
    out = np.full(len(action), int(MetaAction.EMERGENCY_BRAKE))
    for a in reversed(MILDEST):
        out = np.where(is_open[:, a], int(a), out)
    return np.where(is_open[np.arange(len(action)), action], action, out)


class Ending(IntEnum):
    """Why an episode is over; the first reason counts, in this order."""

    NONE = 0
    COLLISION = 1
    GOAL = 2
    """The place that the scenario wants reached is reached, in a lane that counts."""
    ROAD_END = 3
    TIME = 4


class Goal(NamedTuple):
    """Where an episode ends, apart from collisions."""

    reach_x_m: float
    """Beyond this in one of `reach_lanes`, ..."""
    reach_lanes: tuple[int, ...]
    """... none of which there may be, ..."""
    end_x_m: float
    """... and beyond this anywhere."""


def ending(crashed: Bools, ego: Any, goal: Goal) -> Ints:
    """(S,) `Ending` of the present states, time apart. crashed: (S,); ego: (S, 9) rows of the ego."""
    x = ego[:, X]
    reached = (x > goal.reach_x_m) & np.isin(ego[:, LANE], goal.reach_lanes)
    return np.select(
        (crashed, reached, x > goal.end_x_m), (int(Ending.COLLISION), int(Ending.GOAL), int(Ending.ROAD_END)), 0
    )


def flags(over: Ints, timed_out: Bools) -> tuple[Bools, Bools]:
    """(S,) terminated and (S,) truncated of `ending`.

    Only a collision terminates: after it nothing more can be earned. Goal, road's end and time cut an episode off that
    could go on, so that what would come after is worth what the value says; otherwise reaching the goal would cost.
    """
    terminated = over == Ending.COLLISION
    return terminated, ~terminated & ((over != Ending.NONE) | timed_out)


def closeness(rows: Any, target_lane: int, headway_s: float) -> tuple[float, float]:
    """How close the ego is: (time to collision [s], at most `TTC_CAP_S`; `shortfall` of the gap to its leader).

    The time to collision is with the next car ahead of either direction, in the ego's lane and in the one that it
    aims for; the leader is the next of our direction there. rows: (V, 9). Compiles with numba unchanged.
    """
    ego = rows[0]
    ttc, short = TTC_CAP_S, 0.0
    lead = next_ahead(rows, target_lane, ego[X])
    if lead >= 0:
        short = shortfall(gap_between(ego, rows[lead]), ego[VX], headway_s)
    for lane in (int(ego[LANE]), target_lane):
        for other in (next_ahead(rows, lane, ego[X]), next_facing(rows, lane, ego[X])):
            if other >= 0:
                gap = gap_between(ego, rows[other])
                if gap > 0.0:
                    ttc = min(ttc, ttc_s(gap, ego[VX] - rows[other][VX]))
    return ttc, short


class Decision:
    """One decision in S scenes: what is done and met at each of its ticks, and what it has earned in the end.

    In a scene whose episode ends on the way, the ticks after that count no more.
    """

    def __init__(self, action: Ints, x_m: Any, accel: Floats) -> None:
        """action: (S,) what was decided, before the mask replaced anything; x_m, accel: (S,) where the egos are, and
        what the last tick did to their speeds."""
        s = len(action)
        self._acted, self._changes = action != MetaAction.CRUISE, action >= MetaAction.LEFT
        self._accel, self._jolt = np.array(accel), np.zeros(s)
        self._start_x = np.array(x_m, np.float64)
        self._x = self._start_x
        self._ticks = np.zeros(s, np.int64)
        self._effort, self._short, self._ttc = np.zeros(s), np.zeros(s), np.full(s, TTC_CAP_S)
        self._braked, self._there = np.zeros(s, np.bool_), np.zeros(s, np.bool_)
        self.over = np.zeros(s, np.int64)
        """(S,) `Ending`, time apart."""

    def tick(self, meta: Ints, ego: Any, accel: Floats, ttc: Floats, short: Floats, there: Bools, over: Ints) -> None:
        """After a tick: what was done, (S, 9) rows of the egos, what the tick did to their speeds, `closeness`, whether
        they aim for the lane that is wished (or none is), and `ending`."""
        on = self.over == Ending.NONE
        self._ticks += on
        self._x = np.where(on, ego[:, X], self._x)
        self._braked |= on & (meta == MetaAction.EMERGENCY_BRAKE)
        self._effort += np.where(on, accel**2, 0.0)
        self._jolt += np.where(on, (accel - self._accel) ** 2, 0.0)
        self._accel = np.array(accel)
        self._ttc = np.where(on, np.minimum(self._ttc, ttc), self._ttc)
        self._short += np.where(on, short, 0.0)
        self._there = np.where(on, there, self._there)
        self.over = np.where(on, over, self.over)

    def earned(
        self, v_des: Floats, speed_range: float, hz: int = HZ, *, to_reach: bool = False, weights: Weights = OURS
    ) -> NDArray[np.float32]:
        """(S,) the reward. v_des: (S,) wished speeds [m/s]; speed_range: see `reward`; to_reach: there is a place
        to be reached before the road's end."""
        seconds = self._ticks / hz
        return reward(
            (self._x - self._start_x) / seconds,
            v_des,
            speed_range,
            self._effort / self._ticks,
            self._jolt * (hz * hz) / self._ticks,
            self._acted,
            self._changes,
            self._there,
            self._ttc,
            self._short / self._ticks,
            self._braked,
            self.over == Ending.COLLISION,
            seconds,
            (self.over == Ending.ROAD_END) & to_reach,
            weights,
        )
