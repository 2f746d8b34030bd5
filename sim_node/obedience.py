"""What becomes of the wishes of many scenes: when they came, and whether they were met. `metrics` has the definitions.

Axes: S scenes, V vehicles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.intent import SPEED_TOLERANCE_MPS
from schemas.driving.road import AGAINST_MPS, ID, LANE, NOBODY, VX, X, gap_between

HEADWAY_SIGHT_M = 100.0
PASSED_M = 5.0
"""A car is passed once the centres are this far apart: the bumpers no longer overlap."""
KEPT = 0.9
"""A wished headway is kept with this share of it, as the fast node has it."""
SPEED_ALONE, A_LANE, TO_PASS = range(3)
"""Kinds of wishes."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Rows = NDArray[np.float32]


def leader(rows: Rows, lane: Ints) -> tuple[Floats, Floats]:
    """(gap [m], closing speed [m/s]) to the nearest car ahead in `lane` (S,); gap inf where there is none."""
    gap, closing, _ = next_car(rows, lane)
    return gap, closing


def next_car(rows: Rows, lane: Ints, *, ours: bool = False) -> tuple[Floats, Floats, Ints]:
    """(gap [m], closing speed [m/s], id) of the nearest car ahead in `lane` (S,); gap inf and `NOBODY` where there is
    none. ours: of the ego's direction only."""
    columns = np.moveaxis(rows, -1, 0)
    gap = np.asarray(gap_between(columns[:, :, :1], columns))
    ahead = (rows[..., ID] > 0) & (rows[..., LANE] == lane[:, None]) & (gap > 0)
    if ours:
        ahead &= rows[..., VX] >= AGAINST_MPS
    nearest = np.where(ahead, gap, np.inf).argmin(axis=1)
    each = np.arange(len(rows))
    found = ahead[each, nearest]
    closing = rows[:, 0, VX] - rows[each, nearest, VX]
    number = np.where(found, rows[each, nearest, ID], NOBODY).astype(np.int64)
    return np.where(found, gap[each, nearest], np.inf).astype(np.float64), closing.astype(np.float64), number


class Obedience:
    """Follows the wishes of S scenes tick by tick."""

    ticks: Ints
    """(S,), as all that follow."""
    wished_m: Floats
    driven_m: Floats
    asked: Ints
    """Ticks with a wish."""
    asked_at: Ints
    lead: Ints
    """The car to leave behind, or `NOBODY`."""
    kind: Ints
    speed: Floats
    """Sum over the ticks with a wish [m/s]."""
    fulfilled_s: Floats
    """Seconds from the wish to its fulfilment; nan: not yet."""
    could_headway: Ints
    in_headway: Ints

    def __init__(self, ceiling_mps: float, scenes: int, hz: int) -> None:
        self._ceiling, self._scenes, self._hz = ceiling_mps, scenes, hz
        self.restart(np.ones(scenes, np.bool_))

    def restart(self, which: Bools) -> None:
        """Forget what was recorded of these scenes."""
        counts: dict[str, Any] = dict.fromkeys(("ticks", "asked", "could_headway", "in_headway"), 0)
        sums = dict.fromkeys(("wished_m", "driven_m", "speed"), 0.0)
        fresh = {**counts, **sums, "asked_at": -1, "lead": NOBODY, "kind": -1, "fulfilled_s": np.nan}
        for name, value in fresh.items():
            array = self.__dict__.setdefault(name, np.full(self._scenes, value))
            array[which] = value

    @property
    def since_s(self) -> Floats:
        """(S,) seconds since the wish came; of no meaning before."""
        return np.asarray((self.ticks - self.asked_at) / self._hz, np.float64)

    def tick(
        self,
        rows: Rows,
        wish_lane: Ints | None,
        wish_speed: Floats | None,
        wish_headway: Floats | None,
        pass_id: Ints | None,
        settled_home: Bools,
        active: Bools,
        asked: Bools,
    ) -> None:
        """Take in the state after one tick: rows (S, V, 9), the rest (S,).

        settled_home: where the ego holds the lane in which it began; asked: where there is a wish by now.
        """
        a, ego, nobody = active, rows[:, 0], np.full(self._scenes, NOBODY)
        lane, speed, x = ego[:, LANE].astype(np.int64), ego[:, VX].astype(np.float64), ego[:, X]
        wish_lane = nobody if wish_lane is None else wish_lane
        pass_id = nobody if pass_id is None else pass_id
        wished = np.full(self._scenes, self._ceiling) if wish_speed is None else wish_speed
        self.ticks += a
        self.wished_m += np.where(a, wished, 0.0) / self._hz
        self.driven_m += np.where(a, np.minimum(speed, wished), 0.0) / self._hz
        self.asked += asked
        self.speed += np.where(asked, speed, 0.0)
        gap, closing, number = next_car(rows, lane, ours=True)
        first = asked & (self.asked_at < 0)
        if first.any():
            slower = speed - closing < wished - SPEED_TOLERANCE_MPS
            lead = np.where(pass_id >= 0, pass_id, np.where(slower, number, NOBODY))
            kind = np.where(pass_id >= 0, TO_PASS, np.where(wish_lane >= 0, A_LANE, SPEED_ALONE))
            self.asked_at = np.where(first, self.ticks - 1, self.asked_at)
            self.lead = np.where(first, lead, self.lead)
            self.kind = np.where(first, kind, self.kind)
        known = (rows[..., ID] == self.lead[:, None]) & (self.lead[:, None] >= 0)
        past = (known & (rows[..., X] < x[:, None] - PASSED_M)).any(axis=1)
        rid = (known & (rows[..., LANE] != lane[:, None])).any(axis=1) | past
        met = np.select(
            [self.kind == TO_PASS, self.kind == A_LANE],
            [past & settled_home, lane == wish_lane],
            rid | (np.abs(speed - wished) <= SPEED_TOLERANCE_MPS),
        )
        self.fulfilled_s = np.where(asked & met & np.isnan(self.fulfilled_s), self.since_s, self.fulfilled_s)
        if wish_headway is not None:
            follows = asked & (gap <= HEADWAY_SIGHT_M)
            self.could_headway += follows
            self.in_headway += follows & (gap >= KEPT * wish_headway * speed)

    def progress(self, s: int) -> float:
        """Distance driven, no faster than wished, over that at the wished speed; nan: to stand still was wished."""
        return float(self.driven_m[s] / self.wished_m[s]) if self.wished_m[s] > 0.0 else float("nan")

    def headway_kept(self, s: int) -> float:
        """Share of the ticks behind a leader at the wished headway; nan without any."""
        n = int(self.could_headway[s])
        return int(self.in_headway[s]) / n if n else float("nan")
