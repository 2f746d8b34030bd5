"""From directive to intent, and what becomes of it: delayed, overridden, carried out, fulfilled, expired (the paper's
contribution 2).

The intent is what the policy is conditioned on (lane, speed, headway, style). It never reaches the mask.

Each part of a wish *stands* until another wish replaces it, through the whole epoch, whether or not its directive was
fulfilled. A directive's time to live bounds how long it is *pending*: how long the ego tries for what takes a while (a
lane, a car to overtake, a gap to drive to) and reports what holds it up. Which moment a directive comes at makes no
difference to what it asks for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from fast_node.wishes import Lanes, Overtaken, Rows, Standing, goes_on, returns, says_the_same, two_way
from schemas.driving.intent import (
    ANY_LANE,
    ASSERTIVE,
    CALM,
    PASS_SIGHT_S,
    SPEED_TOLERANCE_MPS,
    STYLES,
    Intent,
    intended_lane,
    unasked_lane,
)
from schemas.driving.road import LANE_LIMIT, NOBODY, VX, X, gap_between, home_lane, next_ahead
from schemas.runtime.clock import NS
from schemas.wire.bounds import TTL_MAX_S, is_from_the_future
from schemas.wire.messages import Closure, Directive, Event, EventKind, MetaAction, Observation, Reason

HEADWAY_SHARE = 0.9
"""A gap is long enough with this share of the wished headway at the ego's speed."""
GAP_SLACK_M = 4.0
"""A gap is short enough with as much over the wished headway as it may lack, and this: the room that is kept at a
standstill, and what lies between two set-points of the speed."""
FOLLOW_M = 100.0
"""A car farther ahead than this, or `PASS_SIGHT_S` of driving, is nobody to drive up to for a gap."""
OPEN_UP_MPS = 2.0
"""How much slower than the car ahead the ego is to be while the gap is too short."""
ASSERTIVE_HEADWAY_S, CALM_HEADWAY_S = 1.2, 2.0
"""Where the style is wished, but no headway."""
SLOWER_MPS, SLOWER_S = 1.0, 1.0
"""A speed is delayed once it is farther off than this while the mask allows no faster one for this long."""
NOBODY_AHEAD = "nobody ahead to keep the gap to"
"""Detail of the event of a gap that is fulfilled at once."""


@dataclass
class _Delay:
    """What the mask holds back."""

    since: int
    """The tick at which it began."""
    why: Closure
    """For which reason now."""
    reported: set[Reason] = field(default_factory=set)
    """Each reason is reported once."""
    overridden: bool = False
    """Whether it has been reported that the ego accelerates first."""


class _Gap(NamedTuple):
    """The gap to the car ahead, against the wished one."""

    off: int
    """-1: too short; 1: too long; 0: right."""
    lead_mps: float


class Coordination:
    """Follows one directive at a time through an epoch. Pure: time comes with each call."""

    # Set by the first observation of an epoch.
    _standing: Standing
    _directive: Directive | None
    _pending: bool
    _met_tick: int | None
    # Set by each observation.
    _ego_mps: float
    _raise_mps: float
    # Set by each directive that is no renewal.
    _pass: Overtaken
    _since: int
    _why: Closure | None
    _change: _Delay | None
    _speed: _Delay | None
    _hurries: bool
    _closes_up: bool
    _opens_up_mps: float

    def __init__(self, default_headway_s: float) -> None:
        self._headway_s = default_headway_s
        self._epoch: int | None = None

    def intent(
        self, observation: Observation, rows: Rows, lanes: Lanes, directive: Directive | None, now_ns: int
    ) -> tuple[Intent, list[Event]]:
        """The intent for this tick, and events about the directive that it follows.

        Without words the speed is the set-point that the epoch began with, the headway the default, the style normal,
        and the lane the policy's (`unasked_lane`).
        """
        events: list[Event] = []
        self._ego_mps = rows[0][VX]
        if observation.epoch != self._epoch:
            self._begin(observation, rows)
        home = home_lane(lanes, observation.target_lane)
        if (
            directive is not None
            and directive.epoch == self._epoch
            and (self._directive is None or directive.id > self._directive.id)
            and not is_from_the_future(directive, now_ns)
        ):
            self._adopt(directive, observation)
        current = self._directive
        if current is not None and self._pending and now_ns - current.stamp_ns > min(current.ttl_s, TTL_MAX_S) * NS:
            self._pending = False
            if self._standing.lane != observation.target_lane:
                self._standing.lane = None
            events.append(self._event(EventKind.EXPIRED, current, observation, self._why, self._since))
        pending = current if self._pending else None
        if pending is not None and pending.manoeuvre == "overtake":
            self._pass.look(rows, None if returns(pending, lanes, home) else home, observation.tick, observation.hz)
        gap = self._gap(pending, observation, rows, lanes, home)
        speed, wished_mps = self._speeds(pending, gap, observation, lanes[home][LANE_LIMIT])
        lane = self._lane(pending, gap, observation, rows, lanes, home)
        intent = Intent(lane, speed, self._headway(), style=self._style())
        if pending is not None and self._fulfilled(pending, gap, observation, rows, lanes, intent, wished_mps, home):
            self._pending, self._met_tick = False, observation.tick
            if gap is not None and self._closes_up:
                self._standing.speed_mps = max(self._standing.speed_mps, gap.lead_mps)
            alone = pending.headway_s is not None and gap is None
            detail = NOBODY_AHEAD if alone and pending.manoeuvre != "overtake" else ""
            events.append(self._event(EventKind.FULFILLED, pending, observation, self._why, self._since, detail))
        return intent, events

    def report(self, observation: Observation, intent: Intent, closed: tuple[Closure, ...], meta: int) -> list[Event]:
        """Events for an intended lane change or speed that the mask holds back, for another reason now, or lets go."""
        current = self._directive
        if current is None or not self._pending:
            self._change = self._speed = None
            return []
        there = intent.lane in (ANY_LANE, observation.target_lane)
        side = MetaAction.LEFT if intent.lane < observation.target_lane else MetaAction.RIGHT
        by = None if there else next((c for c in closed if c.action == side), None)
        delay = self._change
        if by is not None:
            delay = self._change = delay or _Delay(observation.tick, by)
            delay.why = by
            if self._speed is not None and not self._speed.reported:
                self._speed = None
            events = self._delayed(delay, current, observation)
            if by.reason == Reason.REAR_GAP and self._raise_mps > 0.0 and not delay.overridden:
                delay.overridden = True
                events.append(self._event(EventKind.OVERRIDDEN, current, observation, by, delay.since))
            return events
        if delay is not None and there:  # no longer asked for
            self._change = None
        elif delay is not None and meta == side:
            self._change = None
            return [self._event(EventKind.CARRIED_OUT, current, observation, delay.why, delay.since)]
        return self._slower(current, observation, intent, closed, there)

    def _begin(self, observation: Observation, rows: Rows) -> None:
        """A new epoch: nothing has been wished in it yet."""
        self._epoch = observation.epoch
        usual_mps = round(observation.target_speed_mps or rows[0][VX])
        self._standing = Standing(usual_mps, usual_mps)
        self._directive, self._pending, self._met_tick = None, False, None
        self._change, self._speed, self._hurries = None, None, False

    def _adopt(self, directive: Directive, observation: Observation) -> None:
        """Follow this directive now. One that renews a pending one counts from the first; one that says again what has
        been fulfilled, or was planned before that, is no new wish."""
        previous, self._directive = self._directive, directive
        again = previous is not None and previous.command_id == directive.command_id
        if (
            previous is not None
            and again
            and self._met_tick is not None
            and says_the_same(previous, directive)
            and (directive.manoeuvre != "overtake" or directive.scene_tick <= self._met_tick)
        ):
            return
        renewal = again and self._pending
        self._pending, self._met_tick = True, None
        self._standing.take(directive)
        if not renewal:
            self._since, self._why = observation.tick, None
        if renewal and directive.manoeuvre == "overtake":
            return
        self._pass = Overtaken(observation.tick)
        self._change, self._speed, self._hurries = None, None, False
        self._closes_up, self._opens_up_mps = False, math.inf

    def _style(self) -> int:
        current = self._directive
        if current is not None and (
            (current.manoeuvre == "stop" and self._standing.stopped)
            or (current.manoeuvre == "overtake" and self._pending)
        ):
            return STYLES[current.style]
        return self._standing.style

    def _headway(self) -> float:
        usual = {ASSERTIVE: ASSERTIVE_HEADWAY_S, CALM: CALM_HEADWAY_S}.get(self._style(), self._headway_s)
        return self._standing.headway_s or usual

    def _speeds(
        self, pending: Directive | None, gap: _Gap | None, observation: Observation, limit: float
    ) -> tuple[float, float]:
        """The speed to intend, and the one that is wished: they differ while a gap, or room to change, is worked for.

        While the gap is too long the ego may drive up to the limit, unless its directive names a speed; while it is too
        short it drives more slowly than the car ahead. A change that a car behind holds back makes the ego accelerate
        first to widen that gap, then change, without slowing down (the paper's t = 20 s); never one who is to stop.
        """
        wish = self._standing
        wished = 0.0 if wish.stopped else min(max(wish.speed_mps, 0.0), limit)
        self._raise_mps = 0.0 if wish.stopped else limit - wished
        if wish.stopped:
            self._hurries = False
        elif self._change is not None:
            self._hurries = self._change.why.reason == Reason.REAR_GAP
        elif observation.previous_lane < 0:
            self._hurries = False
        if self._hurries:
            return limit, wished
        if pending is None or gap is None or gap.off == 0:
            return wished, wished
        if gap.off > 0:
            self._closes_up = pending.target_speed_mps is None
            return limit if self._closes_up else wished, wished
        if not 0.5 * OPEN_UP_MPS <= gap.lead_mps - self._opens_up_mps <= 1.5 * OPEN_UP_MPS:
            self._opens_up_mps = gap.lead_mps - OPEN_UP_MPS  # held while it will do: each new intent is a new decision
        return min(wished, max(self._opens_up_mps, 0.0)), wished

    def _lane(
        self, pending: Directive | None, gap: _Gap | None, observation: Observation, rows: Rows, lanes: Lanes, home: int
    ) -> int:
        """The lane to be in now: the wished one while it makes sense, else where it must be, else the policy's.

        To overtake on a two-way road, beside the car to pass; on a one-way road the lane that is named for it from when
        the car is near until the ego has moved over, then any: there may be a slow car in it, too. A gap is driven to
        behind the car ahead: in the own lane. To stop, too.
        """
        wish = self._standing
        if wish.stopped:
            return home
        if wish.lane is not None and not goes_on(lanes, wish.lane, rows[0]):
            wish.lane = None
        lane = wish.lane
        if pending is not None and pending.manoeuvre == "overtake":
            if two_way(lanes, home):
                return home if returns(pending, lanes, home) else intended_lane(rows, home, self._pass.id)
            aim = pending.target_lane
            if observation.previous_lane < 0 and observation.target_lane == aim:
                self._pass.moved_over = True
            if (
                aim is not None
                and not self._pass.moved_over
                and self._pass.is_near(rows)
                and goes_on(lanes, aim, rows[0])
            ):
                lane = aim
        if lane is not None:
            return lane
        if gap is not None and pending is not None and pending.target_speed_mps is None:
            return home
        return unasked_lane(lanes, observation.target_lane, observation.previous_lane, rows[0][X], rows[0][VX])

    def _gap(
        self, pending: Directive | None, observation: Observation, rows: Rows, lanes: Lanes, home: int
    ) -> _Gap | None:
        """The gap that a pending directive asks for, against the one to the car ahead; None: there is no such car.

        A car too far ahead to follow, or one that drives away as fast as the ego may drive, is none.
        """
        wish, lane = self._standing, observation.target_lane
        if pending is None or pending.headway_s is None or pending.manoeuvre == "overtake" or wish.stopped:
            return None
        ego, lead = rows[0], next_ahead(rows, lane, rows[0][X])
        if lead == NOBODY or wish.headway_s is None or wish.lane not in (None, lane):
            return None
        gap, lead_mps = gap_between(ego, rows[lead]), rows[lead][VX]
        if gap < HEADWAY_SHARE * wish.headway_s * ego[VX]:
            return _Gap(-1, lead_mps)
        if gap <= (2.0 - HEADWAY_SHARE) * wish.headway_s * lead_mps + GAP_SLACK_M:
            return _Gap(0, lead_mps)
        fastest = lanes[home][LANE_LIMIT]
        if pending.target_speed_mps is not None:
            fastest = min(fastest, wish.speed_mps)
        if gap > max(FOLLOW_M, PASS_SIGHT_S * ego[VX]) or lead_mps > fastest - SPEED_TOLERANCE_MPS:
            return None
        return _Gap(1, lead_mps)

    def _fulfilled(
        self,
        pending: Directive,
        gap: _Gap | None,
        observation: Observation,
        rows: Rows,
        lanes: Lanes,
        intent: Intent,
        wished_mps: float,
        home: int,
    ) -> bool:
        """Whether all that a directive asks for is so, and no change is under way.

        An overtake: the car is passed and the ego at home; on a two-way road not before there was one. A lane: it is
        aimed for. A speed: within `SPEED_TOLERANCE_MPS`. A gap: neither too short nor too long, or nobody is ahead.
        """
        settled = observation.previous_lane < 0
        if pending.manoeuvre == "overtake":
            if self._pass.id >= 0:
                return self._pass.passed and settled and observation.target_lane == home
            if two_way(lanes, home) and not returns(pending, lanes, home):
                return False
        stopped = self._standing.stopped
        no_speed = pending.target_speed_mps is None and not stopped
        return (
            settled
            and intent.lane in (ANY_LANE, observation.target_lane)
            and (stopped or pending.target_lane in (None, observation.target_lane))
            and (no_speed or math.isclose(rows[0][VX], wished_mps, abs_tol=SPEED_TOLERANCE_MPS))
            and (gap is None or gap.off == 0)
        )

    def _slower(
        self, directive: Directive, observation: Observation, intent: Intent, closed: tuple[Closure, ...], there: bool
    ) -> list[Event]:
        """An event for a speed that the mask has kept out of reach for `SLOWER_S`: one until it is reached.

        there: in the intended lane; elsewhere the lane comes first.
        """
        if intent.speed_mps - self._ego_mps <= SLOWER_MPS:
            self._speed = None
            return []
        if self._speed is not None and self._speed.reported:
            return []
        by = next((c for c in closed if c.action == MetaAction.SPEED_UP), None)
        if by is None or not there:
            self._speed = None
            return []
        delay = self._speed = self._speed or _Delay(observation.tick, by)
        delay.why = by
        late = observation.tick - delay.since >= SLOWER_S * observation.hz
        return self._delayed(delay, directive, observation) if late else []

    def _delayed(self, delay: _Delay, directive: Directive, observation: Observation) -> list[Event]:
        """That something is delayed, once for each reason."""
        self._why = delay.why
        if delay.why.reason in delay.reported:
            return []
        delay.reported.add(delay.why.reason)
        return [self._event(EventKind.DELAYED, directive, observation, delay.why, delay.since)]

    @staticmethod
    def _event(
        kind: EventKind,
        directive: Directive,
        observation: Observation,
        closure: Closure | None,
        since: int,
        detail: str = "",
    ) -> Event:
        return Event(
            epoch=observation.epoch,
            stamp_ns=observation.stamp_ns,
            kind=kind,
            node="fast",
            tick=observation.tick,
            reason=closure.reason if closure else None,
            vehicle=closure.vehicle if closure else -1,
            since_tick=since,
            duration_s=(observation.tick - since) / observation.hz,
            directive_id=directive.id,
            command_id=directive.command_id,
            detail=detail,
        )
