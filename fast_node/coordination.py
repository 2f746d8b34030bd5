"""From directive to wish, and what becomes of it: delayed, overridden, fulfilled, expired (the paper's contribution 2).

The wish is what the policy is conditioned on (lane, speed, headway). It never reaches the mask.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from fast_node.mask import REAR_GAP, RULES
from schemas.driving.intent import ANY_LANE, SPEED_TOLERANCE_MPS, Wish, lead_of, wished_lane
from schemas.driving.measures import gap_m
from schemas.runtime.clock import NS
from schemas.wire.messages import Closure, Directive, Event, EventKind, MetaAction, Observation

HEADWAY_SHARE = 0.9
"""A wished headway is met with this share of it."""
ASSERTIVE_HEADWAY_S, CALM_HEADWAY_S = 1.0, 2.0
"""Where the passenger wishes a style, but no headway."""
ACCELERATES, CARRIED_OUT = "accelerates first", "and now carried out"
"""Details of `overridden`: the limit replaces the wished speed; the change that was held back begins."""
SLOWER_MPS, SLOWER_S = 1.0, 1.0
"""A wished speed is delayed once it is farther off than this while the mask allows no faster one for this long."""


@dataclass
class _Hold:
    """What the mask holds back."""

    since: int
    """The tick at which it began."""
    why: Closure
    """By which rule now."""
    told: set[str] = field(default_factory=set)
    """The rules that have been reported: each once."""
    raised: bool = False
    """Whether it has been reported that the ego accelerates first."""


class Coordination:
    """Follows one directive at a time through an epoch. Pure: time comes with each call."""

    def __init__(self, default_headway_s: float) -> None:
        self._headway_s = default_headway_s
        self._epoch = -1
        self._cruise_mps = 0.0
        self._directive: Directive | None = None
        self._done = True
        self._pass_id = -1
        self._eager = False
        self._since = -1
        self._why: Closure | None = None
        self._change: _Hold | None = None
        self._speed: _Hold | None = None
        self._hurries = False
        self._ego_mps = self._raise_mps = 0.0

    def wish(
        self, observation: Observation, rows: list[list[float]], directive: Directive | None, now_ns: int
    ) -> tuple[Wish, list[Event]]:
        """The wish for this tick, and events about the directive that it follows."""
        events: list[Event] = []
        self._ego_mps = rows[0][3]
        if observation.epoch != self._epoch:
            self._epoch = observation.epoch
            self._cruise_mps = round(observation.target_speed_mps or rows[0][3])
            self._directive, self._done = None, True
        if (
            directive is not None
            and directive.epoch == self._epoch
            and (self._directive is None or directive.id > self._directive.id)
        ):
            self._adopt(directive, observation, rows)
        current = self._directive
        home = self._home(observation)
        if current is not None and not self._done and now_ns - current.stamp_ns > current.ttl_s * NS:
            self._done = True
            events.append(self._event("expired", current, observation, self._why, self._since))
        if (
            current is None
            or (self._done and current.manoeuvre != "cruise")
            or (now_ns - current.stamp_ns > current.ttl_s * NS)
        ):
            return Wish(home, self._cruise_mps, self._headway_s), events
        limit = observation.lanes[home].speed_limit_mps
        overtakes = current.manoeuvre == "overtake"
        speed = current.target_speed_mps
        if speed is None:
            speed = limit if overtakes else self._cruise_mps
        lane = home
        if current.manoeuvre == "stop":
            speed = 0.0
        elif overtakes and home > 0 and observation.lanes[home - 1].direction < 0:
            asked = home - 1 if current.target_lane is None else current.target_lane
            lane = wished_lane(rows, home, self._pass_id) if asked != home else home
        elif (
            current.target_lane is not None
            and 0 <= current.target_lane < len(observation.lanes)
            and (observation.lanes[current.target_lane].direction > 0)
        ):
            lane = current.target_lane
        elif current.target_lane is None and self._eager:
            lane = ANY_LANE  # whoever wants to get on does not mind where
        speed = min(max(speed, 0.0), limit)
        self._raise_mps = limit - speed
        if self._change is not None:
            self._hurries = self._change.why.rule == RULES[REAR_GAP]
        elif observation.previous_lane < 0:
            self._hurries = False
        if self._hurries:
            speed = limit  # the paper's t = 20 s: accelerate first to widen the gap, then change, without slowing down
        headway = current.headway_s or {"assertive": ASSERTIVE_HEADWAY_S, "calm": CALM_HEADWAY_S}.get(
            current.style, self._headway_s
        )
        wish = Wish(lane, speed, headway)
        if not self._done and self._fulfilled(current, observation, rows, wish, home):
            self._done = True
            self._cruise_mps = speed if current.manoeuvre != "stop" else 0.0
            events.append(self._event("fulfilled", current, observation, self._why, self._since))
        return wish, events

    def verdict(self, observation: Observation, wish: Wish, closed: tuple[Closure, ...], meta: int) -> list[Event]:
        """Events for a wished lane change or speed that the mask holds back, by another rule now, or lets go."""
        current = self._directive
        if current is None or self._done:
            self._change = self._speed = None
            return []
        there = wish.lane in (ANY_LANE, observation.target_lane)
        side = MetaAction.LEFT if wish.lane < observation.target_lane else MetaAction.RIGHT
        by = None if there else next((c for c in closed if c.action == side), None)
        held = self._change
        if by is not None:
            held = self._change = held or _Hold(observation.tick, by)
            held.why = by
            if self._speed is not None and not self._speed.told:
                self._speed = None
            events = self._delayed(held, current, observation)
            if by.rule == RULES[REAR_GAP] and self._raise_mps > 0.0 and not held.raised:
                held.raised = True
                events.append(self._event("overridden", current, observation, by, held.since, ACCELERATES))
            return events
        if held is not None and there:  # no longer asked for
            self._change = None
        elif held is not None and meta == side:
            self._change = None
            return [self._event("overridden", current, observation, held.why, held.since, CARRIED_OUT)]
        return self._slower(current, observation, wish, closed, there)

    def _slower(
        self, directive: Directive, observation: Observation, wish: Wish, closed: tuple[Closure, ...], there: bool
    ) -> list[Event]:
        """An event for a wished speed that the mask has kept out of reach for `SLOWER_S`: one until it is reached.

        there: in the wished lane; elsewhere the lane comes first.
        """
        if wish.speed_mps - self._ego_mps <= SLOWER_MPS:
            self._speed = None
            return []
        if self._speed is not None and self._speed.told:
            return []
        by = next((c for c in closed if c.action == MetaAction.SPEED_UP), None)
        if by is None or not there:
            self._speed = None
            return []
        held = self._speed = self._speed or _Hold(observation.tick, by)
        held.why = by
        late = observation.tick - held.since >= SLOWER_S * observation.hz
        return self._delayed(held, directive, observation) if late else []

    def _delayed(self, held: _Hold, directive: Directive, observation: Observation) -> list[Event]:
        """That `held` is held back, once for each rule."""
        self._why = held.why
        if held.why.rule in held.told:
            return []
        held.told.add(held.why.rule)
        return [self._event("delayed", directive, observation, held.why, held.since)]

    def _adopt(self, directive: Directive, observation: Observation, rows: list[list[float]]) -> None:
        previous = self._directive
        renewal = previous is not None and not self._done and previous.command_id == directive.command_id
        self._directive = directive
        self._done = False
        if not renewal:
            self._since, self._why = observation.tick, None
        if renewal and directive.manoeuvre == "overtake":
            return
        self._pass_id, self._change, self._speed, self._hurries = -1, None, None, False
        wanted = directive.target_speed_mps
        self._eager = directive.manoeuvre == "overtake" or (wanted is not None and wanted > self._cruise_mps)
        if directive.manoeuvre == "overtake":
            self._pass_id = lead_of(rows, self._home(observation))

    @staticmethod
    def _home(observation: Observation) -> int:
        """The lane to go on in: the one aimed for; beside a borrowed oncoming lane the first of our direction, and
        from a lane that ends the nearest to the left that goes on."""
        lanes, lane = observation.lanes, observation.target_lane
        while lanes[lane].direction < 0 and lane + 1 < len(lanes):
            lane += 1
        furthest = max(b.end_m for b in lanes)
        while lane > 0 and lanes[lane].end_m < furthest and lanes[lane - 1].direction > 0:
            lane -= 1
        return lane

    def _fulfilled(
        self, directive: Directive, observation: Observation, rows: list[list[float]], wish: Wish, home: int
    ) -> bool:
        settled = observation.previous_lane < 0
        if directive.manoeuvre == "overtake" and self._pass_id >= 0:
            passed = wished_lane(rows, home, self._pass_id) == home and not any(
                int(r[0]) == self._pass_id and r[1] > rows[0][1] for r in rows[1:]
            )
            return passed and settled and observation.target_lane == home
        no_speed = directive.target_speed_mps is None and directive.manoeuvre != "stop"
        right_speed = no_speed or math.isclose(rows[0][3], wish.speed_mps, abs_tol=SPEED_TOLERANCE_MPS)
        borrowed_for_nothing = directive.manoeuvre == "overtake" and observation.lanes[max(home - 1, 0)].direction < 0
        return (
            settled
            and wish.lane in (ANY_LANE, observation.target_lane)
            and right_speed
            and not (borrowed_for_nothing or self._too_close(directive, observation, rows))
        )

    @staticmethod
    def _too_close(directive: Directive, observation: Observation, rows: list[list[float]]) -> bool:
        """A headway is wished and the gap to the leader is shorter."""
        if directive.headway_s is None:
            return False
        lead = lead_of(rows, observation.target_lane)
        return any(
            int(r[0]) == lead
            and gap_m(rows[0][1], r[1], rows[0][6], r[6]) < HEADWAY_SHARE * directive.headway_s * rows[0][3]
            for r in rows[1:]
        )

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
            rule=closure.rule if closure else "",
            vehicle=closure.vehicle if closure else -1,
            since_tick=since,
            duration_s=(observation.tick - since) / observation.hz,
            directive_id=directive.id,
            command_id=directive.command_id,
            detail=detail,
        )
