"""What a run comes to: counts from the simulator's heartbeats, commands and their outcomes from the replies, what
became of their directives from the events."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass

from schemas.runtime.clock import NS
from schemas.wire.messages import Command, Event, EventKind, Observation, Reply, Status

SCHEMA = "fastslow.run/3"
_COUNTED = ("ticks", "answered", "missed", "collisions", "failsafes", "episodes", "skipped", "refused", "strays")
_HAPPENS = (EventKind.DELAYED, EventKind.OVERRIDDEN, EventKind.CARRIED_OUT, EventKind.FULFILLED, EventKind.EXPIRED)
"""To a directive; each event is counted."""
KEPT = 500
"""Commands, events, modes and lane changes in the summary, the first ones: whoever floods the bus fills no memory."""


@dataclass
class Said:
    """A command and how it went on. Times in seconds since the run began; None: it never did."""

    text: str
    said_s: float | None = None
    """Unknown for plain text, which carries no stamp."""
    heard_s: float | None = None
    issued_s: float | None = None
    outcome: str = "unanswered"
    fulfilled_s: float | None = None
    why: str = ""


class Summary:
    """Collects what the bus says about a run."""

    def __init__(self, scenario: str, seed: int, start_ns: int) -> None:
        self._scenario, self._seed, self._start_ns = scenario, seed, start_ns
        self._metrics: dict[int, dict[str, float]] = {}
        """The newest metrics of each simulator process: a restarted one counts from 0 again."""
        self._said: dict[int, Said] = {}
        self._happened: Counter[str] = Counter()
        self._delayed_by: Counter[str] = Counter()
        self._events: list[dict[str, object]] = []
        self._lanes: list[dict[str, object]] = []
        self._modes: list[dict[str, object]] = []

    def begin(self, start_ns: int) -> None:
        """The run begins now: times count from here."""
        self._start_ns = start_ns
        self._lanes.clear()

    def command(self, command: Command) -> None:
        self._of(command.id, command.text).said_s = self._at(command.stamp_ns)

    def reply(self, reply: Reply) -> None:
        said = self._of(reply.command_id, reply.text)
        at = self._at(reply.stamp_ns)
        said.outcome = reply.outcome
        if reply.why:
            said.why = reply.why
        if reply.outcome in ("heard", "refused"):
            said.heard_s = at if said.heard_s is None else said.heard_s
        elif reply.outcome == "issued" and said.issued_s is None:  # a thought repeated by itself is not a new answer
            said.issued_s = at
        elif reply.outcome == "fulfilled":
            said.fulfilled_s = at

    def event(self, event: Event) -> None:
        self._happened[event.kind] += 1
        if event.kind == EventKind.DELAYED:
            self._delayed_by[event.reason or ""] += 1
        if len(self._events) < KEPT:
            self._events.append(
                {
                    "at_s": self._at(event.stamp_ns),
                    "kind": event.kind,
                    "reason": event.reason or "",
                    "vehicle": event.vehicle,
                    "duration_s": round(event.duration_s, 3),
                    "detail": event.detail,
                    "command_id": event.command_id,
                }
            )

    def observation(self, observation: Observation) -> None:
        """Keeps when the ego began to aim for another lane, and when it was there."""
        lane, there = observation.target_lane, observation.previous_lane < 0
        if len(self._lanes) < KEPT and (
            not self._lanes or (self._lanes[-1]["lane"], self._lanes[-1]["there"]) != (lane, there)
        ):
            self._lanes.append({"at_s": self._at(observation.stamp_ns), "lane": lane, "there": there})

    def status(self, status: Status) -> None:
        if status.node == "sim":
            if len(self._metrics) < KEPT or status.pid in self._metrics:
                self._metrics[status.pid] = status.metrics
            if status.mode and len(self._modes) < KEPT and (not self._modes or self._modes[-1]["mode"] != status.mode):
                since = self._at(status.mode_since_ns) if status.mode_since_ns else 0.0
                self._modes.append({"mode": status.mode, "why": status.mode_why, "since_s": since})

    def _of(self, command_id: int, text: str) -> Said:
        found = self._said.get(command_id)
        if found is None:
            found = Said(text)
            if len(self._said) < KEPT:
                self._said[command_id] = found
        return found

    def _at(self, stamp_ns: int) -> float:
        return round((stamp_ns - self._start_ns) / NS, 3)

    def result(self, restarts: dict[str, int], now_ns: int) -> dict[str, object]:
        """The summary as plain data, for JSON."""
        total = {k: int(sum(metrics.get(k, 0) for metrics in self._metrics.values())) for k in _COUNTED}
        newest = next(reversed(self._metrics.values()), {})
        return {
            "schema": SCHEMA,
            "scenario": self._scenario,
            "seed": self._seed,
            "duration_s": self._at(now_ns),
            **total,
            "restarts": sum(restarts.values()),
            "restarts_of": {name: count for name, count in restarts.items() if count},
            "latency_us": {"p50": newest.get("rtt_p50_us"), "p99": newest.get("rtt_p99_us")},
            "applied_age_us": {"p50": newest.get("age_p50_us"), "p99": newest.get("age_p99_us")},
            "commands": [asdict(said) for said in self._said.values()],
            "directives": {kind.value: self._happened[kind] for kind in _HAPPENS},
            "delayed_by": dict(self._delayed_by.most_common()),
            "modes": self._modes,
            "events": self._events,
            "lanes": self._lanes,
        }
