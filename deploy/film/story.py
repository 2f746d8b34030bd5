"""What a film tells beside the road: what was said last, what it means now, and what has become of it."""

from __future__ import annotations

from deploy.film.writer import Picture
from schemas.runtime.clock import NS
from schemas.wire.messages import ENDS, Action, Command, Directive, Event, EventKind, Message, Observation, Reply
from sim_node.drawing import picture

NOTE_S = 4.0
"""How long it is shown what has happened."""


class Story:
    """Hears the messages of a drive in their order, and draws its ticks. All stamps are of one clock."""

    def __init__(self) -> None:
        self._said = self._note = ""
        self._noted_ns = 0
        self._directive: Directive | None = None

    def hear(self, message: Message) -> None:
        """Take in what was sent: from the next picture on it is shown."""
        match message:
            case Command():
                self._said = message.text
            case Directive():
                self._directive = message
            case Event():
                self._over(message.kind, message.directive_id)
                self._tell(worded(message), message.stamp_ns)
            case Reply():
                self._over(message.outcome, message.directive_id)
                self._tell(message.say, message.stamp_ns)

    def draw(self, observation: Observation, action: Action | None) -> Picture:
        """One tick; `action`: what answered it, None where nothing did."""
        now_ns, directive = observation.stamp_ns, self._directive
        if directive is not None and (
            directive.epoch != observation.epoch or now_ns - directive.stamp_ns > directive.ttl_s * NS
        ):
            directive = None
        note = self._note if now_ns - self._noted_ns < NOTE_S * NS else ""
        if observation.crashed:
            note = "collision"
        return picture(observation, action, directive, self._said, note)

    def _tell(self, note: str, now_ns: int) -> None:
        if note:
            self._note, self._noted_ns = note, now_ns

    def _over(self, how: str, directive_id: int | None) -> None:
        if how in ENDS and self._directive is not None and self._directive.id == directive_id:
            self._directive = None


def worded(event: Event) -> str:
    """An event in a few words."""
    if event.kind in (EventKind.WORLD, EventKind.FAULT, EventKind.ACTUATOR):
        return event.detail
    if event.kind in (EventKind.WAITING, EventKind.DUE) and event.detail:
        return f"{event.kind}: {event.detail}"
    why = f": {event.reason}" if event.reason and event.kind in ("delayed", "overridden") else ""
    car = f" (car {event.vehicle})" if why and event.vehicle >= 0 else ""
    return f"{str(event.kind).replace('_', ' ')}{why}{car}"
