"""Where a picture comes from: the bus of a running car, or a recording of one."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from typing import Any, Literal, Protocol

from schemas.runtime.bus import Bus
from schemas.wire import topics
from schemas.wire.codec import Fault, decode_command
from schemas.wire.messages import Command, Message


class Refused(Exception):  # noqa: N818 - a word to the passenger, not a mistake of ours
    """What a page asked for cannot be done; `str()` says why in one sentence."""


class Source(Protocol):
    """What the pump asks, some dozens of times a second. Nothing in here waits."""

    generation: int
    """Grows whenever what was shown so far is void: after a jump within a recording."""

    def take(self) -> list[Message]:
        """What has come since the last call, oldest first."""
        ...

    def now_ns(self) -> int:
        """The car's clock, as its messages are stamped by."""
        ...

    def say(self, text: str) -> None:
        """Tell the car. Raises `Refused`."""
        ...

    def control(self, do: str, value: Any) -> None:
        """Pause, resume, step, restart, seek or change the speed. Raises `Refused`."""
        ...

    def state(self) -> dict[str, Any]:
        """What a page must know of the source: its kind, what it can do, where it is."""
        ...


class BusSource:
    """The running car."""

    kind: Literal["live"] = "live"

    def __init__(self, bus: Bus, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._bus, self._clock_ns = bus, clock_ns
        self.generation = 0
        self._commands = bus.subscribe_bytes(topics.COMMAND)
        self._others = tuple(bus.subscribe(topic) for topic in topics.TOPICS if topic is not topics.COMMAND)
        self._said: set[int] = set()

    def take(self) -> list[Message]:
        now_ns = self._clock_ns()
        messages: list[Message] = []
        for number, payload in enumerate(self._commands.take()):
            try:
                messages.append(decode_command(payload, fallback_id=now_ns // 1000 + number, epoch=0, now_ns=now_ns))
            except Fault:  # the slow node answers it; here it is nothing to show
                continue
        for ring in self._others:
            messages += ring.take()
        return messages

    def now_ns(self) -> int:
        return self._clock_ns()

    def say(self, text: str) -> None:
        command = Command(
            epoch=0, stamp_ns=self._clock_ns(), id=secrets.randbits(48), text=text.strip(), source="cockpit"
        )
        try:
            self._bus.publish(topics.COMMAND, command)
        except (Fault, UnicodeEncodeError) as error:
            raise Refused(f"This cannot be said: {error}.") from None

    def control(self, do: str, value: Any) -> None:
        raise Refused("The running simulator takes no such order.")

    def state(self) -> dict[str, Any]:
        return {"kind": self.kind, "can": ["say"], "paused": False}
