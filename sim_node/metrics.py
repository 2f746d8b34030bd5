"""What is measured of an episode, defined once: for the running simulator, for evaluation and for training.

Everything is of the ego, along the road, at the tick rate; axes: S scenes, V vehicles. An episode's numbers:

* success: no collision and every condition of `Scenario.success` at the end.
* collision, ego-fault or struck: struck means that the other car came from behind while the ego kept its lane, or
  moved sideways into the ego's lane while the ego kept it; every other collision is the ego's fault.
* speed: mean over ticks, maximum, minimum [m/s]. Crashed episodes are short: speeds of several episodes are weighted
  by ticks, so that an early crash does not flatter them.
* accel: a_t = (v_t - v_{t-1}) * hz [m/s2], its standard deviation and variance over all ticks;
  jerk: (a_t - a_{t-1}) * hz, root mean square [m/s3].
* min TTC: minimum over ticks of bumper gap / closing speed to the leader in the ego's lane and, while it changes, in
  the target lane; oncoming cars count; closing above 0.1 m/s only; at most 100 s; a collision gives 0.
* headway: bumper gap / own speed to the leader in the ego's lane, mean over the ticks that have one within 100 m and
  a speed above 1 m/s [s]; nan without any.
* progress: distance driven [m]. lane changes: how often the target lane left the ego's lane.
* lane compliance: share of episodes that reached the wished lane (any lane where none is wished). It was feasible
  where that lane was reached, or where in `LANE_OPEN_S` or more in all the ego held its lane and the mask left the next
  change towards the wished one open. Without a mask every change is: then it is feasible wherever the lane exists.
* speed compliance: of the ticks in which it was feasible, the share within 0.5 m/s of the wished speed: with no slower
  car less than `BLOCKED_S` ahead, no lane change and no lane's end near, and that for long enough to get there at
  `ADAPT_MPS2`.
* time to comply: seconds until the wished lane was first reached (nan: never); in lane: share of ticks in it.
* override share: ticks in which the mask decided against the driver.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.intent import ANY_LANE, SPEED_TOLERANCE_MPS
from schemas.driving.measures import TTC_CAP_S
from schemas.driving.road import HZ, ID, LANE, LANE_END, VX, VY, X, Y, gap_between, lane_ends, lane_table
from sim_node.scenarios.scenario import Scenario

CLOSING_MIN_MPS = 0.1
HEADWAY_SIGHT_M = 100.0
SIDEWAYS_MPS = 0.3
ADAPT_MPS2, ADAPT_S = 1.0, 4.0
"""A wished speed is due after its distance at this pace, a step of 1 m/s a second, and so long to settle."""
LANE_OPEN_S = 1.0
BLOCKED_S = 5.0
ENDS_M = 300.0
"""Nearer to a lane's end than this, speed is for finding a gap."""
FIRST_LEAD = 1
"""Id of the car that `Success.pass_first_lead` is about."""
PASSED_M = 5.0
"""The first lead is passed once the centres are this far apart: the bumpers no longer overlap."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Rows = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class EpisodeResult:
    """One episode's numbers; see the module for their definitions."""

    success: bool
    collided: bool
    struck: bool
    passed: bool
    ticks: int
    avg_speed: float
    max_speed: float
    min_speed: float
    accel_sum: float
    accel_square_sum: float
    jerk_rms: float
    min_ttc_s: float
    headway_s: float
    progress_m: float
    lane_changes: int
    in_lane: float
    """Share of ticks in the wished lane."""
    speed_ticks: int
    """In which the wished speed was feasible; see the module."""
    speed_complied: int
    """Of those, within 0.5 m/s of it."""
    time_to_comply_s: float
    lane_open_s: float
    """In which the ego held its lane and could have begun to change towards the wished one."""
    override_share: float

    @property
    def lane_complied(self) -> bool:
        """It reached the wished lane."""
        return math.isfinite(self.time_to_comply_s)

    @property
    def lane_feasible(self) -> bool:
        """It could have reached the wished lane, or did."""
        return self.lane_complied or self.lane_open_s >= LANE_OPEN_S


def leader(rows: Rows, lane: Ints) -> tuple[Floats, Floats]:
    """(gap [m], closing speed [m/s]) to the nearest car ahead in `lane` (S,); gap inf where there is none."""
    columns = np.moveaxis(rows, -1, 0)
    gap = np.asarray(gap_between(columns[:, :, :1], columns))
    ahead = (rows[..., ID] > 0) & (rows[..., LANE] == lane[:, None]) & (gap > 0)
    nearest = np.where(ahead, gap, np.inf).argmin(axis=1)
    each = np.arange(len(rows))
    found = ahead[each, nearest]
    closing = rows[:, 0, VX] - rows[each, nearest, VX]
    return np.where(found, gap[each, nearest], np.inf).astype(np.float64), closing.astype(np.float64)


class Recorder:
    """Follows S scenes of one scenario tick by tick."""

    ticks: Ints
    """(S,), as all that follow: sums, extremes and latches of each scene's episode so far."""
    speed: Floats
    fastest: Floats
    slowest: Floats
    accel: Floats
    accel_square: Floats
    last_accel: Floats
    jerk_square: Floats
    min_ttc: Floats
    headway: Floats
    headway_n: Ints
    start_x: Floats
    x: Floats
    changes: Ints
    changing: Bools
    in_lane: Ints
    could_lane: Ints
    in_speed: Ints
    could_speed: Ints
    free: Ints
    off: Floats
    complied: Floats
    overridden: Ints
    collided: Bools
    struck: Bools
    passed: Bools
    home: Ints

    def __init__(self, scenario: Scenario, scenes: int, hz: int = HZ) -> None:
        self.scenario, self.hz = scenario, hz
        self.scenes = scenes
        lanes = lane_table(scenario.lanes_at(0.0))
        self._ends = np.array([lanes[k][LANE_END] if lane_ends(lanes, k) else np.inf for k in range(len(lanes))])
        self.restart(np.ones(scenes, np.bool_))

    def restart(self, which: Bools) -> None:
        """Forget what was recorded of these scenes."""
        fresh: dict[str, Any] = {
            "ticks": 0,
            "speed": 0.0,
            "fastest": -np.inf,
            "slowest": np.inf,
            "accel": 0.0,
            "accel_square": 0.0,
            "last_accel": np.nan,
            "jerk_square": 0.0,
            "min_ttc": TTC_CAP_S,
            "headway": 0.0,
            "headway_n": 0,
            "start_x": np.nan,
            "x": np.nan,
            "changes": 0,
            "changing": False,
            "in_lane": 0,
            "could_lane": 0,
            "in_speed": 0,
            "could_speed": 0,
            "free": 0,
            "off": 0.0,
            "complied": np.nan,
            "overridden": 0,
            "collided": False,
            "struck": False,
            "passed": False,
            "home": -1,
        }
        for name, value in fresh.items():
            array = self.__dict__.setdefault(name, np.full(self.scenes, value))
            array[which] = value

    def tick(
        self,
        rows: Rows,
        accel: Floats,
        target_lane: Ints,
        previous_lane: Ints,
        crashed: Bools,
        active: Bools,
        wish_lane: Ints | None = None,
        wish_speed: Floats | None = None,
        overridden: Bools | None = None,
        way_open: Bools | None = None,
    ) -> None:
        """Take in the state after one tick: rows (S, V, 9), the rest (S,); scenes that are not `active` stay as is.

        way_open: where the ego could have begun a change towards the wished lane at this tick.
        """
        a = active
        ends = self._ends
        ego = rows[:, 0]
        lane = ego[:, LANE].astype(np.int64)
        speed, x = ego[:, VX].astype(np.float64), ego[:, X].astype(np.float64)
        self.start_x = np.where(a & np.isnan(self.start_x), x, self.start_x)
        self.home = np.where(a & (self.home < 0), lane, self.home)
        self.x = np.where(a, x, self.x)
        self.ticks += a
        self.speed += np.where(a, speed, 0.0)
        self.fastest = np.where(a, np.maximum(self.fastest, speed), self.fastest)
        self.slowest = np.where(a, np.minimum(self.slowest, speed), self.slowest)
        self.accel += np.where(a, accel, 0.0)
        self.accel_square += np.where(a, accel**2, 0.0)
        jerk = np.where(np.isnan(self.last_accel), 0.0, accel - self.last_accel) * self.hz
        self.jerk_square += np.where(a, jerk**2, 0.0)
        self.last_accel = np.where(a, accel, self.last_accel)
        for which in (lane, target_lane):
            gap, closing = leader(rows, which)
            with np.errstate(invalid="ignore"):
                ttc = np.where(closing > CLOSING_MIN_MPS, gap / np.maximum(closing, CLOSING_MIN_MPS), TTC_CAP_S)
            self.min_ttc = np.where(a, np.minimum(self.min_ttc, ttc), self.min_ttc)
            if which is lane:
                blocked = (gap < BLOCKED_S * speed) & (np.isfinite(gap))
                lead_mps = speed - closing
                follows = a & (gap < HEADWAY_SIGHT_M) & (speed > 1.0)
                self.headway += np.divide(gap, speed, out=np.zeros_like(gap), where=follows)
                self.headway_n += follows
        changing = previous_lane >= 0
        self.changes += a & changing & ~self.changing
        self.changing = np.where(a, changing, self.changing)
        if wish_lane is not None:
            there = (wish_lane == ANY_LANE) | (lane == wish_lane)
            self.in_lane += a & there
            self.complied = np.where(a & there & np.isnan(self.complied), self.ticks / self.hz, self.complied)
        if wish_speed is not None:
            free = (
                ~changing
                & (target_lane == lane)
                & (ends[lane] - x > ENDS_M)
                & ~(blocked & (lead_mps < wish_speed + SPEED_TOLERANCE_MPS))
            )
            off = np.abs(speed - wish_speed)
            self.free = np.where(a & free, self.free + 1, np.where(a, 0, self.free))
            self.off = np.where(a & (self.free <= 1), off, self.off)
            could = a & (self.free > (self.off / ADAPT_MPS2 + ADAPT_S) * self.hz)
            self.could_speed += could
            self.in_speed += could & (off <= SPEED_TOLERANCE_MPS)
        if way_open is not None:
            self.could_lane += a & way_open
        if overridden is not None:
            self.overridden += a & overridden
        first = rows[..., ID] == FIRST_LEAD
        behind = (first & (rows[..., X] < x[:, None] - PASSED_M)).any(axis=1)
        settled = (lane == self.home) & (target_lane == self.home) & ~changing
        self.passed |= a & behind & settled
        new = a & crashed & ~self.collided
        if new.any():
            self.collided |= new
            self.min_ttc = np.where(new, 0.0, self.min_ttc)
            self.struck |= new & _struck(rows, changing)

    def results(self, which: Bools | None = None) -> list[EpisodeResult]:
        """The episodes of these scenes (all by default) so far, one by one."""
        out = []
        goal = self.scenario.success
        for s in range(self.scenes) if which is None else np.flatnonzero(which):
            n = max(int(self.ticks[s]), 1)
            mean = float(self.speed[s]) / n
            reached = not goal.reach_lanes or self.x[s] > goal.reach_x_m
            out.append(
                EpisodeResult(
                    success=bool(
                        not self.collided[s]
                        and mean >= goal.mean_speed_mps
                        and reached
                        and (self.passed[s] or not goal.pass_first_lead)
                    ),
                    collided=bool(self.collided[s]),
                    struck=bool(self.struck[s]),
                    passed=bool(self.passed[s]),
                    ticks=n,
                    avg_speed=mean,
                    max_speed=float(self.fastest[s]),
                    min_speed=float(self.slowest[s]),
                    accel_sum=float(self.accel[s]),
                    accel_square_sum=float(self.accel_square[s]),
                    jerk_rms=float(np.sqrt(self.jerk_square[s] / n)),
                    min_ttc_s=float(self.min_ttc[s]),
                    headway_s=float(self.headway[s] / self.headway_n[s]) if self.headway_n[s] else float("nan"),
                    progress_m=float(self.x[s] - self.start_x[s]),
                    lane_changes=int(self.changes[s]),
                    in_lane=float(self.in_lane[s]) / n,
                    speed_ticks=int(self.could_speed[s]),
                    speed_complied=int(self.in_speed[s]),
                    time_to_comply_s=float(self.complied[s]),
                    lane_open_s=int(self.could_lane[s]) / self.hz,
                    override_share=float(self.overridden[s]) / n,
                )
            )
        return out


def _struck(rows: Rows, changing: Bools) -> Bools:
    """Whether the car nearest to the ego ran into it, and not the ego into that car; the ego held its lane.

    Sideways the other must move towards the ego by its own motion, and the ego not towards it: one that is back from a
    change and moves on to its lane's centre is not hit by who keeps its lane beside it. Both on a bend move alike.
    """
    ego = rows[:, :1]
    dx, dy = rows[..., X] - ego[..., X], rows[..., Y] - ego[..., Y]
    away = np.where(rows[..., ID] > 0, np.hypot(dx, 2.0 * dy), np.inf)
    other = away.argmin(axis=1)
    each = np.arange(len(rows))
    near = rows[each, other]
    touching = away[each, other] < 12.0  # else it was an obstacle
    from_behind = (dx[each, other] < -2.0) & (near[:, VX] > rows[:, 0, VX])
    side = np.sign(dy[each, other])
    theirs, ours = -side * near[:, VY], side * rows[:, 0, VY]
    sideways = (theirs > SIDEWAYS_MPS) & (theirs + ours > SIDEWAYS_MPS) & (ours <= SIDEWAYS_MPS)
    return np.asarray(touching & ~changing & (from_behind | sideways))


def summarise(episodes: Sequence[EpisodeResult]) -> dict[str, float]:
    """The table's numbers over several episodes; speeds and accelerations weighted by ticks."""
    ticks = np.array([e.ticks for e in episodes], np.float64)
    total = ticks.sum()

    def mean(name: str) -> float:
        values = np.array([getattr(e, name) for e in episodes], np.float64)
        return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")

    def weighted(name: str) -> float:
        return float((np.array([getattr(e, name) for e in episodes]) * ticks).sum() / total)

    a_mean = sum(e.accel_sum for e in episodes) / total
    accel_var = max(sum(e.accel_square_sum for e in episodes) / total - a_mean**2, 0.0)
    ttc = np.array([e.min_ttc_s for e in episodes])
    due = sum(e.speed_ticks for e in episodes)
    feasible = sum(e.lane_feasible for e in episodes)
    return {
        "episodes": len(episodes),
        "success": float(np.mean([e.success for e in episodes])),
        "ego_fault_collisions": sum(e.collided and not e.struck for e in episodes),
        "struck_collisions": sum(e.struck for e in episodes),
        "avg_speed": weighted("avg_speed"),
        "max_speed": mean("max_speed"),
        "min_speed": mean("min_speed"),
        "accel_std": float(np.sqrt(accel_var)),
        "accel_var": float(accel_var),
        "jerk_rms": weighted("jerk_rms"),
        "min_ttc_mean": float(ttc.mean()),
        "min_ttc_median": float(np.median(ttc)),
        "min_ttc_p5": float(np.percentile(ttc, 5)),
        "headway_s": mean("headway_s"),
        "progress_m": mean("progress_m"),
        "lane_changes": mean("lane_changes"),
        "lane_compliance": float(np.mean([e.lane_complied for e in episodes])),
        "lane_feasible": feasible / len(episodes),
        "lane_compliance_feasible": sum(e.lane_complied for e in episodes) / feasible if feasible else float("nan"),
        "speed_compliance": sum(e.speed_complied for e in episodes) / due if due else float("nan"),
        "speed_ticks": due,
        "time_to_comply_s": mean("time_to_comply_s"),
        "in_wished_lane": weighted("in_lane"),
        "override_share": weighted("override_share"),
    }
