"""What a person sees of a run: one line a second, and one line for everything that happens to a command."""

from __future__ import annotations

from collections.abc import Mapping

from schemas.runtime.clock import NS
from schemas.wire.messages import ENDS, Action, Directive, Event, EventKind, Observation, Reply, Status
from schemas.wire.text import plain

_BY_REPLY = (*ENDS, "issued", "waiting")
"""What a reply tells already, in better words than the event that goes with it."""


class Live:
    """Keeps the newest of everything and words it."""

    def __init__(self) -> None:
        self._observation: Observation | None = None
        self._action: Action | None = None
        self._directive: Directive | None = None
        self._sim: Status | None = None

    def observation(self, observation: Observation) -> None:
        self._observation = observation

    def action(self, action: Action) -> None:
        self._action = action

    def directive(self, directive: Directive) -> None:
        self._directive = directive

    def status(self, status: Status) -> None:
        if status.node == "sim":
            self._sim = status

    def reply(self, reply: Reply) -> str:
        """The line for a reply."""
        self._over(reply.outcome, reply.directive_id)
        said = f': "{plain(reply.say)}"' if reply.say else ""
        why = f" ({plain(reply.why)})" if reply.why else ""
        model = f" [language model: {reply.verdict}]" if reply.verdict else ""
        return f'  {reply.outcome:<11} "{plain(reply.text, 70)}"{said}{why}{model}'

    def event(self, event: Event) -> str | None:
        """The line for an event; None for one that a reply tells as well."""
        self._over(event.kind, event.directive_id)
        kind = event.kind.replace("_", " ")
        if event.kind in _BY_REPLY and event.command_id is not None:
            return None
        parts = [f"tick {event.tick}"]
        if event.reason:
            parts.append(event.reason)
        if event.vehicle >= 0:
            parts.append(f"vehicle {event.vehicle}")
        if event.duration_s:
            parts.append(f"for {event.duration_s:.1f} s")
        detail = f" — {plain(event.detail)}" if event.detail else ""
        return f"  {kind:<11} {', '.join(parts)}{detail}"

    def _over(self, what: str, directive_id: int | None) -> None:
        if what in ENDS and self._directive is not None and self._directive.id == directive_id:
            self._directive = None

    def line(self, now_ns: int, waiting_for: str = "") -> str:
        """The line of this second."""
        seen = self._observation
        if seen is None:
            return f"starting{f': waiting for {waiting_for}' if waiting_for else ''}"
        metrics = self._sim.metrics if self._sim is not None else {}
        acted = metrics.get("refused", 0) + metrics.get("strays", 0)
        return " | ".join(
            (
                f"tick {seen.tick:>5} {seen.scenario}",
                *([mode_of(self._sim, now_ns)] if self._sim is not None and self._sim.mode else []),
                f"{metrics.get('speed_mps', 0.0):4.1f} m/s lane {metrics.get('lane', 0):.0f}",
                self._intent(now_ns, seen.epoch),
                f"by {self._action.source if self._action else 'nobody'}",
                f"age {metrics.get('age_p50_us', 0.0) / 1e3:.1f}/{metrics.get('age_p99_us', 0.0) / 1e3:.1f} ms",
                f"missed {metrics.get('missed', 0):.0f}",
                *([f"actuator refused {acted:.0f}"] if acted else []),
            )
        )

    def _intent(self, now_ns: int, epoch: int) -> str:
        directive = self._directive
        if directive is None or directive.epoch != epoch:
            return "no directive"
        left_s = directive.ttl_s - (now_ns - directive.stamp_ns) / NS
        if left_s <= 0:
            return "no directive"
        wishes: list[str] = [directive.manoeuvre]
        if directive.target_lane is not None:
            wishes.append(f"lane {directive.target_lane}")
        if directive.target_speed_mps is not None:
            wishes.append(f"{directive.target_speed_mps:.0f} m/s")
        return f"{' '.join(wishes)}, {left_s:.0f} s left"


COLUMNS = (
    "a line a second: tick and road | how it is driven | speed and lane | what is wished for | who decided | "
    "age of what the car did, median/99 % | ticks without an answer in time"
)
"""What `Live.line` shows, for who sees it for the first time."""


def mode_of(status: Status, now_ns: int) -> str:
    """How the car is driven, why and since when: "DEGRADED for 3 s: no answer in time"."""
    since = f" for {(now_ns - status.mode_since_ns) / NS:.0f} s" if status.mode_since_ns else ""
    return f"{status.mode}{since}{f': {plain(status.mode_why, 80)}' if status.mode_why else ''}"


def happened(directives: Mapping[str, int], delayed_by: Mapping[str, int]) -> str:
    """What became of a run's directives, from the summary's counts: "2 delayed (oncoming traffic 2), ..."."""
    by = f" ({', '.join(f'{reason} {count}' for reason, count in delayed_by.items())})" if delayed_by else ""
    return ", ".join(
        f"{count} {kind.replace('_', ' ')}{by if kind == EventKind.DELAYED else ''}"
        for kind, count in directives.items()
    )
