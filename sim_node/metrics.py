"""What is measured of an episode, defined once: for the running simulator, for evaluation and for training.

Everything is of the ego, along the road, at the tick rate; axes: S scenes, V vehicles. `results` has the numbers of an
episode and of many, `ride` makes one score of them. An episode's numbers:

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
* headway under 1 s: of the ticks with a leader of the ego's direction in its lane, within 100 m, those in which the
  bumper gap is less than the way of one second.
* progress: distance driven [m]. lane changes: how often the target lane left the ego's lane.
* lane flips: ticks at which the target lane is another than at the tick before. A change that is finished is one flip;
  one that is given up is two, and each time that it is taken up and given up again two more.
* changes given up: flips back to the lane that the running change began from. per minute: of driving.
* sign changes of the acceleration: it was above `SIGN_MPS2` or below minus that, and is now on the other side; what
  lies between changes nothing, so that numerical noise does not count.
* lane compliance: share of episodes that reached the wished lane (any lane where none is wished). It was feasible
  where that lane was reached, or where in `LANE_OPEN_S` or more in all the ego held its lane and the mask left the next
  change towards the wished one open. Without a mask every change is: then it is feasible wherever the lane exists.
* speed compliance: of the ticks in which it was feasible, the share within 0.5 m/s of the wished speed: with no slower
  car less than `BLOCKED_S` ahead, no lane change and no lane's end near, and that for long enough to get there at
  `ADAPT_MPS2`.
* time to comply: seconds until the wished lane was first reached (nan: never); in lane: share of ticks in it.
* fulfilled: the wish was once met. By its kind at the moment at which it was made: to overtake a car, when that car is
  behind and the ego is back in its own lane; a lane, when the ego is in it; a speed alone, when the ego is within
  0.5 m/s of it, or rid of the slower car that was its leader then: in another lane, or past it. Never complied: not
  once until the end.
* override share: ticks in which the mask decided against the driver.
* decisions: ticks in which the set-points were not merely held. With choice: two or more actions were open. Closed by
  the mask, by the wish: the action that the driver preferred was closed for that reason.

A wish may come after the start. What is said of wishes counts from the tick that follows it; `asked` are these ticks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.driving.intent import ANY_LANE, SPEED_TOLERANCE_MPS
from schemas.driving.measures import TTC_CAP_S
from schemas.driving.road import HZ, ID, LANE, LANE_END, VX, VY, X, Y, lane_ends, lane_table
from sim_node.obedience import HEADWAY_SIGHT_M, PASSED_M, Obedience, next_car
from sim_node.obedience import leader as leader
from sim_node.results import EpisodeResult
from sim_node.ride import Ride, ride_score
from sim_node.scenarios.scenario import Scenario

CLOSING_MIN_MPS = 0.1
SIDEWAYS_MPS = 0.3
ADAPT_MPS2, ADAPT_S = 1.0, 4.0
"""A wished speed is due after its distance at this pace, a step of 1 m/s a second, and so long to settle."""
CLOSE_S = 1.0
"""A leader nearer than the way of this time is followed too closely."""
SIGN_MPS2 = 0.1
BLOCKED_S = 5.0
ENDS_M = 300.0
"""Nearer to a lane's end than this, speed is for finding a gap."""
FIRST_LEAD = 1
"""Id of the car that `Success.pass_first_lead` is about."""

COUNTS = (*("led", "close", "flips", "given_up", "sign", "signs"), *("decisions", "choices", "by_mask", "by_wish"))
"""What begins at 0."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Rows = NDArray[np.float32]


class Settled(NamedTuple):
    """How an action of a tick came about, (S,) each; see the module for what counts."""

    decided: Bools
    choice: Bools
    by_mask: Bools
    by_wish: Bools


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
    lane: Ints
    led: Ints
    close: Ints
    flips: Ints
    given_up: Ints
    aimed: Ints
    held: Ints
    sign: Ints
    signs: Ints
    decisions: Ints
    choices: Ints
    by_mask: Ints
    by_wish: Ints

    def __init__(self, scenario: Scenario, scenes: int, hz: int = HZ) -> None:
        self.scenario, self.hz = scenario, hz
        self.scenes = scenes
        self.obedience = Obedience(scenario.ego.speed_ceiling_mps, scenes, hz)
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
            "lane": -1,
            "aimed": -1,
            "held": -1,
            **dict.fromkeys(COUNTS, 0),
        }
        for name, value in fresh.items():
            array = self.__dict__.setdefault(name, np.full(self.scenes, value))
            array[which] = value
        self.obedience.restart(which)

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
        *,
        wish_headway: Floats | None = None,
        pass_id: Ints | None = None,
        asked: Bools | None = None,
        settled: Settled | None = None,
    ) -> None:
        """Take in the state after one tick: rows (S, V, 9), the rest (S,); scenes that are not `active` stay as is.

        way_open: where the ego could have begun a change towards the wished lane at this tick; pass_id: the car to
        overtake, or `NOBODY`; asked: where there is a wish by now, everywhere by default.
        """
        a = active
        asked = a if asked is None else a & asked
        ends = self._ends
        ego = rows[:, 0]
        lane = ego[:, LANE].astype(np.int64)
        speed, x = ego[:, VX].astype(np.float64), ego[:, X].astype(np.float64)
        self.start_x = np.where(a & np.isnan(self.start_x), x, self.start_x)
        self.home = np.where(a & (self.home < 0), lane, self.home)
        self.x, self.lane = np.where(a, x, self.x), np.where(a, lane, self.lane)
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
                led = (gap < BLOCKED_S * speed) & (np.isfinite(gap))
                lead_mps = speed - closing
                follows = a & (gap < HEADWAY_SIGHT_M) & (speed > 1.0)
                self.headway += np.divide(gap, speed, out=np.zeros_like(gap), where=follows)
                self.headway_n += follows
        changing = previous_lane >= 0
        self.changes += a & changing & ~self.changing
        self.changing = np.where(a, changing, self.changing)
        self._watch(rows, accel, target_lane, previous_lane, a)
        straight = ~changing & (target_lane == lane) & (ends[lane] - x > ENDS_M)
        settled_home = (lane == self.home) & (target_lane == self.home) & ~changing
        self.obedience.tick(rows, wish_lane, wish_speed, wish_headway, pass_id, settled_home, a, asked)
        if settled is not None:
            for total, now in zip((self.decisions, self.choices, self.by_mask, self.by_wish), settled, strict=True):
                total += a & settled.decided & now
        if wish_lane is not None:
            there = (wish_lane == ANY_LANE) | (lane == wish_lane)
            self.in_lane += asked & there
            self.complied = np.where(asked & there & np.isnan(self.complied), self.obedience.since_s, self.complied)
        if wish_speed is not None:
            self._obey(wish_speed, speed, straight & ~(led & (lead_mps < wish_speed + SPEED_TOLERANCE_MPS)), a, asked)
        if way_open is not None:
            self.could_lane += asked & way_open
        if overridden is not None:
            self.overridden += a & overridden
        first = rows[..., ID] == FIRST_LEAD
        behind = (first & (rows[..., X] < x[:, None] - PASSED_M)).any(axis=1)
        self.passed |= a & behind & settled_home
        new = a & crashed & ~self.collided
        if new.any():
            self.collided |= new
            self.min_ttc = np.where(new, 0.0, self.min_ttc)
            self.struck |= new & _struck(rows, changing)

    def _obey(self, wish_mps: Floats, speed: Floats, free: Bools, a: Bools, asked: Bools) -> None:
        """Count the ticks at which the wished speed could be driven, and those at which it is. free: nothing is in the
        way of it."""
        off = np.abs(speed - wish_mps)
        self.free = np.where(a & free, self.free + 1, np.where(a, 0, self.free))
        self.off = np.where(a & (self.free <= 1), off, self.off)
        could = asked & (self.free > (self.off / ADAPT_MPS2 + ADAPT_S) * self.hz)
        self.could_speed += could
        self.in_speed += could & (off <= SPEED_TOLERANCE_MPS)

    def _watch(self, rows: Rows, accel: Floats, target_lane: Ints, previous_lane: Ints, a: Bools) -> None:
        """Count flips of the target lane, signs of the acceleration, and following too closely."""
        self.aimed = np.where(a & (self.aimed < 0), self.home, self.aimed)
        self.held = np.where(a & (self.held < 0), self.home, self.held)
        flip = a & (target_lane != self.aimed)
        self.flips += flip
        self.given_up += flip & (target_lane == self.held)
        self.aimed = np.where(a, target_lane, self.aimed)
        self.held = np.where(a & (previous_lane < 0), target_lane, self.held)
        sign = (accel > SIGN_MPS2).astype(np.int64) - (accel < -SIGN_MPS2)
        self.signs += a & (sign * self.sign < 0)
        self.sign = np.where(a & (sign != 0), sign, self.sign)
        gap, _, _ = next_car(rows, rows[:, 0, LANE].astype(np.int64), ours=True)
        led = a & (gap <= HEADWAY_SIGHT_M)
        self.led += led
        self.close += led & (gap < CLOSE_S * rows[:, 0, VX])

    def results(self, which: Bools | None = None) -> list[EpisodeResult]:
        """The episodes of these scenes (all by default) so far, one by one."""
        return [self._result(int(s)) for s in (range(self.scenes) if which is None else np.flatnonzero(which))]

    def _result(self, s: int) -> EpisodeResult:
        goal, n, hz = self.scenario.success, max(int(self.ticks[s]), 1), self.hz
        obedience, minutes = self.obedience, n / hz / 60.0
        asked = int(obedience.asked[s])
        mean = float(self.speed[s]) / n
        reached = not goal.reach_lanes or (self.x[s] > goal.reach_x_m and int(self.lane[s]) in goal.reach_lanes)
        passed, collided, struck = bool(self.passed[s]), bool(self.collided[s]), bool(self.struck[s])
        success = bool(
            not collided and mean >= goal.mean_speed_mps and reached and (passed or not goal.pass_first_lead)
        )
        jerk_rms = float(np.sqrt(self.jerk_square[s] / n))
        speed_ticks = int(self.could_speed[s])
        ride = Ride(
            own_fault=collided and not struck,
            success=success,
            min_ttc_s=float(self.min_ttc[s]),
            close_share=float(self.close[s]) / n,
            jerk_rms=jerk_rms,
            accel_rms=float(np.sqrt(self.accel_square[s] / n)),
            accel_sign_changes_per_min=float(self.signs[s]) / minutes,
            changes_given_up_per_min=float(self.given_up[s]) / minutes,
            progress=obedience.progress(s),
            asked=asked > 0,
            fulfilled_s=float(obedience.fulfilled_s[s]),
            speed_kept=float(self.in_speed[s]) / speed_ticks if speed_ticks else float("nan"),
            headway_kept=obedience.headway_kept(s),
        )
        return EpisodeResult(
            success=success,
            collided=collided,
            struck=struck,
            passed=passed,
            ticks=n,
            seconds=n / hz,
            avg_speed=mean,
            max_speed=float(self.fastest[s]),
            min_speed=float(self.slowest[s]),
            accel_sum=float(self.accel[s]),
            accel_square_sum=float(self.accel_square[s]),
            jerk_rms=jerk_rms,
            min_ttc_s=float(self.min_ttc[s]),
            headway_s=float(self.headway[s] / self.headway_n[s]) if self.headway_n[s] else float("nan"),
            progress_m=float(self.x[s] - self.start_x[s]),
            lane_changes=int(self.changes[s]),
            in_lane=float(self.in_lane[s]) / max(asked, 1),
            speed_ticks=speed_ticks,
            speed_complied=int(self.in_speed[s]),
            time_to_comply_s=float(self.complied[s]),
            lane_open_s=int(self.could_lane[s]) / hz,
            override_share=float(self.overridden[s]) / n,
            lane_flips=int(self.flips[s]),
            changes_given_up=int(self.given_up[s]),
            accel_sign_changes=int(self.signs[s]),
            led_ticks=int(self.led[s]),
            close_ticks=int(self.close[s]),
            asked_ticks=asked,
            asked_speed=float(obedience.speed[s]) / asked if asked else float("nan"),
            fulfilled_s=float(obedience.fulfilled_s[s]),
            decisions=int(self.decisions[s]),
            decisions_with_choice=int(self.choices[s]),
            decisions_closed_by_mask=int(self.by_mask[s]),
            decisions_closed_by_wish=int(self.by_wish[s]),
            ride_score=ride_score(ride),
        )


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
