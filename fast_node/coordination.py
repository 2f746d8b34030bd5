"""From directive to intent, and what becomes of it: delayed, overridden, carried out, fulfilled, expired (the paper's
contribution 2).

The intent is what the policy is conditioned on (lane, speed, headway). It never reaches the mask.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from schemas.driving.intent import ANY_LANE, SPEED_TOLERANCE_MPS, Intent, intended_lane
from schemas.driving.road import (
    LANE_LIMIT,
    LANE_WAY,
    NOBODY,
    VX,
    X,
    gap_between,
    has_passed,
    home_lane,
    is_car,
    lead_id,
    next_ahead,
)
from schemas.runtime.clock import NS
from schemas.wire.messages import Closure, Directive, Event, EventKind, MetaAction, Observation, Reason

Rows = list[list[float]]
"""(V, 9): `ROW_COLUMNS`, the ego first."""
Lanes = list[tuple[float, ...]]
"""(L, 8): `schemas.driving.road.lane_table`."""

HEADWAY_SHARE = 0.9
"""A headway is met with this share of it."""
ASSERTIVE_HEADWAY_S, CALM_HEADWAY_S = 1.0, 2.0
"""Where the directive has a style, but no headway."""
SLOWER_MPS, SLOWER_S = 1.0, 1.0
"""A speed is delayed once it is farther off than this while the mask allows no faster one for this long."""


@dataclass
class _Delay:
    """What the mask holds back."""

    since: int
    """The tick at which it began."""
    why: Closure
    """By which rule now."""
    reported: set[Reason] = field(default_factory=set)
    """Each rule is reported once."""
    overridden: bool = False
    """Whether it has been reported that the ego accelerates first."""


class Coordination:
    """Follows one directive at a time through an epoch. Pure: time comes with each call."""

    # Set by the first observation of an epoch.
    _cruise_mps: float
    _directive: Directive | None
    _done: bool
    # Set by each observation.
    _ego_mps: float
    _raise_mps: float
    # Set by each directive that is no renewal.
    _pass_id: int
    _eager: bool
    _since: int
    _why: Closure | None
    _change: _Delay | None
    _speed: _Delay | None
    _hurries: bool

    def __init__(self, default_headway_s: float) -> None:
        self._headway_s = default_headway_s
        self._epoch: int | None = None

    def intent(
        self, observation: Observation, rows: Rows, lanes: Lanes, directive: Directive | None, now_ns: int
    ) -> tuple[Intent, list[Event]]:
        """The intent for this tick, and events about the directive that it follows."""
        events: list[Event] = []
        self._ego_mps = rows[0][VX]
        if observation.epoch != self._epoch:
            self._epoch = observation.epoch
            self._cruise_mps = round(observation.target_speed_mps or rows[0][VX])
            self._directive, self._done = None, True
        home = home_lane(lanes, observation.target_lane)
        if (
            directive is not None
            and directive.epoch == self._epoch
            and (self._directive is None or directive.id > self._directive.id)
        ):
            self._adopt(directive, observation, rows, home)
        current = self._directive
        if current is not None and not self._done and now_ns - current.stamp_ns > current.ttl_s * NS:
            self._done = True
            events.append(self._event(EventKind.EXPIRED, current, observation, self._why, self._since))
        if (
            current is None
            or (self._done and current.manoeuvre != "cruise")
            or (now_ns - current.stamp_ns > current.ttl_s * NS)
        ):
            return Intent(home, self._cruise_mps, self._headway_s), events
        limit = lanes[home][LANE_LIMIT]
        overtakes = current.manoeuvre == "overtake"
        speed = current.target_speed_mps
        if speed is None:
            speed = limit if overtakes else self._cruise_mps
        if current.manoeuvre == "stop":
            speed = 0.0
        speed = min(max(speed, 0.0), limit)
        self._raise_mps = limit - speed
        if self._change is not None:
            self._hurries = self._change.why.rule == Reason.REAR_GAP
        elif observation.previous_lane < 0:
            self._hurries = False
        if self._hurries:
            speed = limit  # the paper's t = 20 s: accelerate first to widen the gap, then change, without slowing down
        headway = current.headway_s or {"assertive": ASSERTIVE_HEADWAY_S, "calm": CALM_HEADWAY_S}.get(
            current.style, self._headway_s
        )
        intent = Intent(self._lane(current, rows, lanes, home), speed, headway)
        if not self._done and self._fulfilled(current, observation, rows, lanes, intent, home):
            self._done = True
            self._cruise_mps = speed if current.manoeuvre != "stop" else 0.0
            events.append(self._event(EventKind.FULFILLED, current, observation, self._why, self._since))
        return intent, events

    def report(self, observation: Observation, intent: Intent, closed: tuple[Closure, ...], meta: int) -> list[Event]:
        """Events for an intended lane change or speed that the mask holds back, by another rule now, or lets go."""
        current = self._directive
        if current is None or self._done:
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
            if by.rule == Reason.REAR_GAP and self._raise_mps > 0.0 and not delay.overridden:
                delay.overridden = True
                events.append(self._event(EventKind.OVERRIDDEN, current, observation, by, delay.since))
            return events
        if delay is not None and there:  # no longer asked for
            self._change = None
        elif delay is not None and meta == side:
            self._change = None
            return [self._event(EventKind.CARRIED_OUT, current, observation, delay.why, delay.since)]
        return self._slower(current, observation, intent, closed, there)

    def _lane(self, directive: Directive, rows: Rows, lanes: Lanes, home: int) -> int:
        """The lane to be in for this directive now."""
        target = directive.target_lane
        if directive.manoeuvre == "stop":
            return home
        if directive.manoeuvre == "overtake" and home > 0 and lanes[home - 1][LANE_WAY] < 0:
            return home if target == home else intended_lane(rows, home, self._pass_id)
        if target is None:
            return ANY_LANE if self._eager else home  # whoever wants to get on does not mind where
        return target if 0 <= target < len(lanes) and lanes[target][LANE_WAY] > 0 else home

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
        """That something is delayed, once for each rule."""
        self._why = delay.why
        if delay.why.rule in delay.reported:
            return []
        delay.reported.add(delay.why.rule)
        return [self._event(EventKind.DELAYED, directive, observation, delay.why, delay.since)]

    def _adopt(self, directive: Directive, observation: Observation, rows: Rows, home: int) -> None:
        previous = self._directive
        renewal = previous is not None and not self._done and previous.command_id == directive.command_id
        self._directive = directive
        self._done = False
        if not renewal:
            self._since, self._why = observation.tick, None
        if renewal and directive.manoeuvre == "overtake":
            return
        self._pass_id, self._change, self._speed, self._hurries = NOBODY, None, None, False
        wanted = directive.target_speed_mps
        self._eager = directive.manoeuvre == "overtake" or (wanted is not None and wanted > self._cruise_mps)
        if directive.manoeuvre == "overtake":
            self._pass_id = lead_id(rows, home)

    def _fulfilled(
        self, directive: Directive, observation: Observation, rows: Rows, lanes: Lanes, intent: Intent, home: int
    ) -> bool:
        settled = observation.previous_lane < 0
        if directive.manoeuvre == "overtake" and self._pass_id >= 0:
            passed = all(has_passed(rows[0], row) for row in rows[1:] if is_car(row, self._pass_id))
            return passed and settled and observation.target_lane == home
        no_speed = directive.target_speed_mps is None and directive.manoeuvre != "stop"
        right_speed = no_speed or math.isclose(rows[0][VX], intent.speed_mps, abs_tol=SPEED_TOLERANCE_MPS)
        borrowed_for_nothing = directive.manoeuvre == "overtake" and lanes[max(home - 1, 0)][LANE_WAY] < 0
        return (
            settled
            and intent.lane in (ANY_LANE, observation.target_lane)
            and right_speed
            and not (borrowed_for_nothing or self._too_close(directive, observation, rows))
        )

    @staticmethod
    def _too_close(directive: Directive, observation: Observation, rows: Rows) -> bool:
        """A headway is asked for and the gap to the lead is shorter."""
        ego = rows[0]
        lead = next_ahead(rows, observation.target_lane, ego[X])
        if directive.headway_s is None or lead == NOBODY:
            return False
        return gap_between(ego, rows[lead]) < HEADWAY_SHARE * directive.headway_s * ego[VX]

    @staticmethod
    def _event(
        kind: EventKind, directive: Directive, observation: Observation, closure: Closure | None, since: int
    ) -> Event:
        return Event(
            epoch=observation.epoch,
            stamp_ns=observation.stamp_ns,
            kind=kind,
            node="fast",
            tick=observation.tick,
            rule=closure.rule if closure else None,
            vehicle=closure.vehicle if closure else -1,
            since_tick=since,
            duration_s=(observation.tick - since) / observation.hz,
            directive_id=directive.id,
            command_id=directive.command_id,
        )
