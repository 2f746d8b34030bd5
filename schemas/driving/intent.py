"""The wish: what a directive comes down to for the policy, the same in training, evaluation and driving."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

ANY_LANE = -1
PASS_SIGHT_M = 60.0
"""A lead farther ahead than this many metres (or `PASS_SIGHT_S` of driving) is not overtaken yet."""
PASS_SIGHT_S = 5.0
SPEED_TOLERANCE_MPS = 0.5
"""A wished speed is met within this."""
BEHIND_M = 4.0
"""Room between the passed car and the ego when it returns."""


@dataclass(frozen=True)
class Wish:
    """What the policy is asked for: lane index (`ANY_LANE`: no matter), speed [m/s], headway [s]."""

    lane: int
    speed_mps: float
    headway_s: float


def lead_of(rows: Any, lane: int) -> int:
    """Id of the nearest car ahead of the ego in `lane` that drives our way; -1 where there is none. rows: (V, 9)."""
    ahead = [r for r in rows[1:] if r[0] > 0 and int(r[8]) == lane and r[3] > -0.1 and r[1] > rows[0][1]]
    return int(min(ahead, key=lambda r: float(r[1]))[0]) if ahead else -1


def wished_lane(rows: Any, home: int, pass_id: int) -> int:
    """The lane to be in while overtaking the car `pass_id` from lane `home`: beside it until it is passed, then home.

    rows: (V, 9) sequence as `ROW_COLUMNS`. Compiles with numba unchanged.
    """
    if pass_id < 0:
        return home
    for i in range(1, len(rows)):
        row = rows[i]
        if int(row[0]) == pass_id:
            ahead = row[1] + 0.5 * (row[6] + rows[0][6]) + BEHIND_M - rows[0][1]
            if 0.0 < ahead < max(PASS_SIGHT_M, PASS_SIGHT_S * rows[0][3]):
                return home - 1
    return home
