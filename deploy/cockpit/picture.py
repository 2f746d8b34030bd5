"""What a page shows: the newest of everything as one frame, and what has been said and has happened as notes.

Pure: no clock, no bus, no sockets. A frame is for the eye, and any one may be missed; every note counts, is numbered,
and is kept in a bounded store, from which a page that comes late is served as well.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from heapq import merge
from typing import Any

import msgspec

from schemas.driving.measures import gap_m, ttc_s
from schemas.driving.road import ID, LANE, LENGTH, VX, X
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import (
    ENDS,
    POLICY_ACTIONS,
    Action,
    Closure,
    Command,
    Directive,
    Event,
    Lane,
    Message,
    MetaAction,
    Observation,
    Reply,
    Status,
)
from schemas.wire.text import plain
from schemas.wire.thought import Thought

NOTES, THOUGHTS = 400, 30
"""How many notes and how many thoughts are kept."""
SILENT_NS = 2 * NS
"""A process that has not been heard of for this long is shown as gone."""
OVER_SHOWN_NS = 4 * NS
"""A directive that has ended is shown for this long."""
SHAPE_STEP_M = 4.0
TEXT_CHARS = 600


@dataclass(frozen=True)
class Note:
    """Something that every page is told once."""

    number: int
    body: bytes
    """One JSON object."""


@dataclass
class _Plan:
    """A directive and what has become of it."""

    directive: Directive
    ended: str = ""
    """"fulfilled", "expired", ...; empty while it lives."""
    ended_ns: int = 0
    slow: bool = False
    """It has been told that the wished speed is delayed."""
    held: Closure | None = None
    """What closes the wished action now."""
    since_tick: int = -1
    detail: str = ""


@dataclass
class Picture:
    """Takes messages in, gives frames and notes out. Times are CLOCK_MONOTONIC of the car's host, as `stamp_ns` is."""

    observation: Observation | None = None
    action: Action | None = None
    answered_ms: float | None = None
    """From the newest answered observation to its action, both as stamped by their senders."""
    road_version: int = 0
    notes: deque[Note] = field(default_factory=lambda: deque(maxlen=NOTES))
    thoughts: deque[Note] = field(default_factory=lambda: deque(maxlen=THOUGHTS))
    _stamps: dict[int, int] = field(default_factory=dict)
    _plan: _Plan | None = None
    _waits: tuple[int, str] | None = None
    """The command whose step waits, and for what."""
    _nodes: dict[str, Status] = field(default_factory=dict)
    _lost: set[str] = field(default_factory=set)
    _number: int = 0
    _began_ns: int = 0

    @property
    def heartbeats(self) -> list[Status]:
        """The newest of every node, by name."""
        return [self._nodes[name] for name in sorted(self._nodes)]

    def take(self, message: Message) -> None:
        """One message of any topic."""
        match message:
            case Observation():
                self._observed(message)
            case Action():
                self.action = message
                sent_ns = self._stamps.get(message.answers_tick)
                if sent_ns is not None:
                    self.answered_ms = (message.stamp_ns - sent_ns) / 1e6
                self._hold()
            case Directive():
                last = self._plan
                self._plan = _Plan(message)
                if last is not None and not last.ended and last.directive.command_id == message.command_id:
                    self._plan = replace(last, directive=message)  # thought about again: it waits on
                self._note("directive", message, **_fields(message, "epoch", "schema", "stamp_ns"))
            case Command():
                self._note("command", message, id=message.id, text=message.text[:TEXT_CHARS], source=message.source)
            case Reply():
                self._ended(message.outcome, message.directive_id, message.stamp_ns)
                if message.waits_for:
                    self._waits = (message.command_id, message.waits_for)
                elif self._waits is not None and message.command_id == self._waits[0]:
                    self._waits = None
                self._note("reply", message, **_fields(message, "epoch", "schema", "stamp_ns"))
            case Event():
                self._happened(message)
            case Status():
                self._beat(message)
            case Thought():
                fields = msgspec.to_builtins(message)
                body = {name: fields[name] for name in fields if name not in ("type", "schema", "epoch", "stamp_ns")}
                self._keep(self.thoughts, {"kind": "thought", "t": self._seconds(message.stamp_ns), **body})

    def _observed(self, observation: Observation) -> None:
        last = self.observation
        if last is None or (last.epoch, last.scenario, len(last.lanes)) != (
            observation.epoch,
            observation.scenario,
            len(observation.lanes),
        ):
            self.road_version += 1
            self._stamps.clear()
            self._plan = self._waits = None
        self.observation = observation
        self._stamps[observation.tick] = observation.stamp_ns
        while len(self._stamps) > 8:
            del self._stamps[next(iter(self._stamps))]

    def _happened(self, event: Event) -> None:
        plan = self._plan
        if plan is not None and event.directive_id == plan.directive.id:
            plan.slow = plan.slow or event.kind == "delayed"
            plan.detail = event.detail if event.kind == "overridden" else plan.detail
            self._ended(event.kind, event.directive_id, event.stamp_ns)
        self._note("event", event, **_fields(event, "epoch", "schema", "stamp_ns"))

    def _ended(self, how: str, directive_id: int | None, stamp_ns: int) -> None:
        plan = self._plan
        if plan is not None and directive_id == plan.directive.id and how in ENDS:
            plan.ended, plan.ended_ns = how, stamp_ns

    def _hold(self) -> None:
        """What the newest action says about the wished one: held back, and since when, or free."""
        plan, seen, action = self._plan, self.observation, self.action
        if plan is None or seen is None or action is None:
            return
        lane = plan.directive.target_lane
        if lane is not None and lane != seen.target_lane:
            wanted = MetaAction.LEFT if lane < seen.target_lane else MetaAction.RIGHT
        else:
            wanted = MetaAction.SPEED_UP if plan.slow else MetaAction.CRUISE
        plan.held = next((c for c in action.closed if c.action == wanted), None)
        if wanted == MetaAction.CRUISE or seen.previous_lane >= 0:
            plan.held = None
        plan.since_tick = -1 if plan.held is None else seen.tick if plan.since_tick < 0 else plan.since_tick

    def _beat(self, status: Status) -> None:
        last = self._nodes.get(status.node)
        self._nodes[status.node] = status
        if last is None or last.pid != status.pid or status.node in self._lost:
            self._lost.discard(status.node)
            self._note("health", status, node=status.node, state="ready" if last is None else "back")

    def watch(self, now_ns: int) -> None:
        """Note the processes that have fallen silent. Call it several times a second."""
        for name, status in self._nodes.items():
            if name not in self._lost and now_ns - status.stamp_ns > SILENT_NS:
                self._lost.add(name)
                self._note("health", msgspec.structs.replace(status, stamp_ns=now_ns), node=name, state="gone")

    def since(self, number: int) -> list[Note]:
        """The notes after `number`, in order."""
        return [n for n in merge(self.notes, self.thoughts, key=lambda n: n.number) if n.number > number]

    def _note(self, kind: str, message: Message, **fields: Any) -> None:
        self._keep(self.notes, {"kind": kind, "t": self._seconds(message.stamp_ns), **fields})

    def _keep(self, store: deque[Note], body: dict[str, Any]) -> None:
        self._number += 1
        # What a note is called wins over a field of that name: an event's own kind travels as `what`.
        store.append(Note(self._number, msgspec.json.encode({"n": self._number, **body})))

    def _seconds(self, stamp_ns: int) -> float:
        """Since the first message: what a person reads."""
        self._began_ns = self._began_ns or stamp_ns
        return round((stamp_ns - self._began_ns) / NS, 2)

    def frame(self, now_ns: int) -> dict[str, Any]:
        """The newest of everything at `now_ns`: plain values, ready for JSON. Angles in rad, the rest in SI units."""
        frame: dict[str, Any] = {"t": self._seconds(now_ns), "nodes": self._health(now_ns)}
        seen = self.observation
        if seen is None:
            return frame
        rows = rows_of(seen)
        ego = rows[0]
        frame |= {
            "epoch": seen.epoch,
            "tick": seen.tick,
            "hz": seen.hz,
            "age": round((now_ns - seen.stamp_ns) / NS, 2),
            "lanes_y": [round(lane.y_m, 2) for lane in seen.lanes],
            "limits": [round(lane.speed_limit_mps, 1) for lane in seen.lanes],
            "cars": [[int(r[ID]), *(round(float(v), 3) for v in r[1:8]), int(r[LANE])] for r in rows],
            "accel": round(seen.acceleration_mps2, 2),
            "set_speed": round(seen.target_speed_mps, 2),
            "target_lane": seen.target_lane,
            "previous_lane": seen.previous_lane,
            "crashed": seen.crashed,
            **self._world(),
            **_around(rows, int(ego[LANE])),
        }
        if self.action is not None and self.action.epoch == seen.epoch:
            frame["action"] = self._action(self.action)
        plan = self._shown_plan(now_ns)
        if plan is not None:
            frame["directive"] = plan
        elif self._plan is not None:
            frame["wished"] = True  # and stands, until another wish replaces it
        if self._waits is not None:
            frame["waits_for"] = self._waits[1]
        elif plan is not None and plan["state"] in ("active", "delayed") and plan["waits_for"]:
            frame["waits_for"] = plan["waits_for"]
        return frame

    def _world(self) -> dict[str, float]:
        """Seed and density of the traffic, as the simulator's heartbeat has them."""
        sim = self._nodes.get("sim")
        return {} if sim is None else {k: sim.metrics[k] for k in ("seed", "density") if k in sim.metrics}

    def road(self) -> dict[str, Any] | None:
        """What of the road stays as it is through a world; None before the first observation."""
        seen = self.observation
        if seen is None:
            return None
        return {
            "epoch": seen.epoch,
            "scenario": seen.scenario,
            "goal_x": seen.goal_x_m if math.isfinite(seen.goal_x_m) else None,
            "sight": seen.sight_m,
            "lanes": [
                {
                    "start": lane.start_m,
                    "end": lane.end_m,
                    "way": lane.direction,
                    "width": lane.width_m,
                    "limit": round(lane.speed_limit_mps, 1),
                    "kind": lane.kind,
                    "opens": max(lane.change_from_m, lane.start_m),
                    "y": lane.y_m,
                }
                for lane in seen.lanes
            ],
            "shapes": _shapes(seen.scenario, seen.lanes),
        }

    def _action(self, action: Action) -> dict[str, Any]:
        return {
            "tick": action.answers_tick,
            "meta": action.meta_action,
            "source": action.source,
            "closed": [[c.action, str(c.reason), c.vehicle] for c in action.closed if c.action < POLICY_ACTIONS],
            "p": [round(p, 3) for p in action.probabilities],
            "why": action.why,
            "goal": action.speed_goal_mps,
            "cap": action.speed_cap_mps,
            "signal": action.turn_signal,
            "answered_ms": None if self.answered_ms is None else round(self.answered_ms, 2),
            "budget_ms": round(action.budget_ns / 1e6, 1),
        }

    def _shown_plan(self, now_ns: int) -> dict[str, Any] | None:
        plan, seen = self._plan, self.observation
        if plan is None or seen is None or plan.directive.epoch != seen.epoch:
            return None
        directive = plan.directive
        left_s = directive.ttl_s - (now_ns - directive.stamp_ns) / NS
        if left_s < -OVER_SHOWN_NS / NS or (plan.ended_ns and now_ns - plan.ended_ns > OVER_SHOWN_NS):
            return None
        held = None if plan.ended else plan.held
        return {
            "id": directive.id,
            "command_id": directive.command_id,
            "manoeuvre": directive.manoeuvre,
            "lane": directive.target_lane,
            "speed": directive.target_speed_mps,
            "headway": directive.headway_s,
            "style": directive.style,
            "ttl": directive.ttl_s,
            "left": round(max(left_s, 0.0), 1),
            "state": plan.ended or ("delayed" if held else "active"),
            "reason": str(held.reason) if held else "",
            "vehicle": held.vehicle if held else -1,
            "waited": round((seen.tick - plan.since_tick) / seen.hz, 1) if plan.since_tick >= 0 else 0.0,
            "detail": plan.detail,
            "reasoning": plain(directive.reasoning, TEXT_CHARS),
            "waits_for": directive.waits_for,
        }

    def _health(self, now_ns: int) -> list[dict[str, Any]]:
        return [
            {
                "node": plain(status.node, 40),
                "state": "gone" if now_ns - status.stamp_ns > SILENT_NS else status.state,
                "pid": status.pid,
                "age": round((now_ns - status.stamp_ns) / NS, 2),
                "metrics": {k: round(v, 3) for k, v in list(status.metrics.items())[:32] if math.isfinite(v)},
                "detail": plain(status.detail, TEXT_CHARS),
                **({"mode": status.mode, "mode_why": plain(status.mode_why, TEXT_CHARS)} if status.mode else {}),
            }
            for status in self.heartbeats
        ]


def _fields(message: Message, *but: str) -> dict[str, Any]:
    """A message's fields as plain values; its own `kind` is called `what`."""
    values = {
        name: plain(str(value), TEXT_CHARS) if isinstance(value, str) else value
        for name in message.__struct_fields__
        if name not in but and (value := getattr(message, name)) is not None
    }
    if "kind" in values:
        values["what"] = values.pop("kind")
    return values


def _around(rows: Any, lane: int) -> dict[str, Any]:
    """The nearest car ahead and behind in the ego's lane, and the nearest that comes towards it: gap, time to collision
    (for one that comes: until they meet) and headway, each rounded; None where there is none."""
    ego = rows[0]
    near: dict[str, tuple[float, Any]] = {}
    for row in rows[1:]:
        ahead = row[X] >= ego[X]
        if row[VX] < -0.1:
            place = "oncoming" if ahead else ""
        else:
            place = ("ahead" if ahead else "behind") if int(row[LANE]) == lane else ""
        distance = abs(float(row[X] - ego[X]))
        if place and (place not in near or distance < near[place][0]):
            near[place] = distance, row
    found: dict[str, Any] = dict.fromkeys(("ahead", "behind", "oncoming"))
    for place, (_, row) in near.items():
        rear, front = (row, ego) if place == "behind" else (ego, row)
        gap = gap_m(float(rear[X]), float(front[X]), float(rear[LENGTH]), float(front[LENGTH]))
        ttc = ttc_s(gap, float(rear[VX] - front[VX]))
        follower = max(float(rear[VX]), 0.1)
        found[place] = {
            "id": int(row[ID]),
            "gap": round(gap, 1),
            "ttc": round(ttc, 1) if ttc < 100.0 else None,
            "headway": round(max(gap, 0.0) / follower, 2) if place != "oncoming" else None,
            "speed": round(float(row[VX]), 1),
        }
    return found


def _shapes(scenario: str, seen: Sequence[Lane]) -> list[list[list[float]] | None]:
    """Per lane its centre line [[x, y], ...] where it bends, by the simulator's own geometry; None where it is straight
    or the road is not one of ours."""
    from sim_node.scenarios import SCENARIOS  # here: half of a page's road needs nothing of it
    from sim_node.scenarios.scenario import centre_line

    known, lanes = SCENARIOS.get(scenario), len(seen)
    if known is None or len(known.lanes) != lanes:
        return [None] * lanes
    pieces = known.narrower(seen[0].width_m).pieces().tolist()
    shapes: list[list[list[float]] | None] = []
    for lane in range(lanes):
        mine = [p for p in pieces if p[0] == lane]
        if all(p[4] == 0.0 for p in mine) and len({p[3] for p in mine}) == 1:
            shapes.append(None)
            continue
        start, end = min(p[1] for p in mine), max(p[2] for p in mine)
        steps = max(int((end - start) / SHAPE_STEP_M), 1)
        xs = [start + (end - start) * k / steps for k in range(steps + 1)]
        shapes.append([[round(x, 1), round(centre_line(pieces, lane, x)[0], 2)] for x in xs])
    return shapes
