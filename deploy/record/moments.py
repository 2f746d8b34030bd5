"""A recording tick by tick: what was seen, what answered it, and what else was sent until the next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from deploy.record.reader import Recording
from schemas.runtime.clock import NS
from schemas.runtime.process import ConfigError
from schemas.wire.messages import Action, Message, Observation

_TOPICS = ("observation", "action", "command", "directive", "reply", "event")


@dataclass
class Moment:
    """One recorded tick."""

    at_s: float
    """Seconds since the first of them, as `fastslow replay` counts."""
    observation: Observation
    action: Action | None = None
    """What answered it; None where nothing did."""
    heard: list[Message] = field(default_factory=list)
    """Commands, directives, replies and events that came before the next tick; at the first, those before it, too."""


def moments(recording: Recording) -> Iterator[Moment]:
    """Every recorded tick, in order."""
    moment: Moment | None = None
    answers: dict[tuple[int, int], Action] = {}  # one may be recorded before what it answers
    heard: list[Message] = []
    began_ns = 0
    for at_ns, _, message in recording.messages(_TOPICS):
        if isinstance(message, Action):
            answers[message.epoch, message.answers_tick] = message
        elif not isinstance(message, Observation):
            heard.append(message)
        else:
            if moment is None:
                began_ns = at_ns
            else:
                yield _answered(moment, answers)
                heard = []
            moment = Moment((at_ns - began_ns) / NS, message, None, heard)
    if moment is not None:
        yield _answered(moment, answers)


def _answered(moment: Moment, answers: dict[tuple[int, int], Action]) -> Moment:
    place = moment.observation.epoch, moment.observation.tick
    moment.action = answers.pop(place, None)
    for old in [key for key in answers if key < place]:
        del answers[old]
    return moment


def length_s(recording: Recording) -> float:
    """Seconds from the first recorded tick to the last's chunk. Raises `ConfigError` for a recording without a tick."""
    span_ns = recording.span_ns("observation")
    if span_ns is None:
        raise ConfigError(f"{recording.path} holds no drive: not one observation is recorded in it")
    return (span_ns[1] - span_ns[0]) / NS
