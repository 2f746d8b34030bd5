"""What the slow node took into account, told on the bus, so that a recording can be checked."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from schemas.runtime.process import log
from schemas.wire.codec import Fault
from schemas.wire.journal import Found, Input, Journal
from schemas.wire.messages import Command, Event
from slow_node.interpretation import Interpretation
from slow_node.understanding.slots import Slots

SCENES = 15
"""So many ticks go into one message, about a second's; what else is taken into account goes out at once."""


class Diary:
    """Keeps the inputs in their order, and sends them."""

    def __init__(self, send: Callable[[Journal], None]) -> None:
        self._send, self._seq = send, 0
        self._waiting: list[Input] = []

    def scene(self, epoch: int, tick: int, now_ns: int) -> None:
        """An observation was looked at."""
        self._waiting.append(Input(now_ns=now_ns, epoch=epoch, tick=tick))
        if len(self._waiting) >= SCENES:
            self.flush(now_ns)

    def event(self, event: Event, now_ns: int) -> None:
        self._say(Input(now_ns=now_ns, event=event))

    def command(self, command: Command, now_ns: int) -> None:
        self._say(Input(now_ns=now_ns, command=command))

    def refused(self, why: str, identity: int, now_ns: int) -> None:
        """A payload was no command."""
        self._say(Input(now_ns=now_ns, refused=why, id=identity))

    def interpretation(self, identity: int, found: Interpretation, now_ns: int) -> None:
        self._say(Input(now_ns=now_ns, found=as_found(found), id=identity))

    def manner(self, kinds: frozenset[str], now_ns: int) -> None:
        """What is preferred on every drive. Goes out with the first scenes: before, nobody listens yet."""
        self._waiting.append(Input(now_ns=now_ns, manner=tuple(sorted(kinds))))

    def flush(self, now_ns: int) -> None:
        """Send what waits."""
        if self._waiting:
            inputs, self._waiting = tuple(self._waiting), []
            self._publish(inputs, now_ns)

    def _say(self, one: Input) -> None:
        self.flush(one.now_ns)
        self._publish((one,), one.now_ns)

    def _publish(self, inputs: tuple[Input, ...], now_ns: int) -> None:
        """One that is too long is left out; the gap in `seq` tells."""
        message = Journal(epoch=max(one.epoch for one in inputs), stamp_ns=now_ns, seq=self._seq, inputs=inputs)
        self._seq += 1
        try:
            self._send(message)
        except Fault as fault:
            log("slow", "journal", str(fault))


def as_found(found: Interpretation) -> Found:
    """What counts of an interpretation for what is done about it."""
    slots = found.slots
    text = json.dumps({**slots.model_dump(), "language": slots.language}) if slots is not None else ""
    return Found(
        slots=text,
        why=found.why,
        model_answered=found.model_answered,
        program=found.program,
        provisional=found.provisional,
        verdict=found.verdict,
        lesson=found.lesson,
    )


def interpretation_of(found: Found) -> Interpretation:
    """The same for `Deliberation.on_interpretation`."""
    fields: dict[str, Any] = json.loads(found.slots) if found.slots else {}
    slots = Slots(**fields) if fields else None
    return Interpretation(
        slots,
        found.why,
        found.model_answered,
        program=found.program,
        provisional=found.provisional,
        verdict=found.verdict,
        lesson=found.lesson,
    )
