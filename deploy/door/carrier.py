"""What carries messages through the door, one topic in one direction, and no faster than the car can take them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from typing import Any

from schemas.runtime.bus import BusError, Subscription
from schemas.wire.codec import Fault, decode
from schemas.wire.messages import Event, Status
from schemas.wire.text import plain
from schemas.wire.topics import COMMAND, Topic

EVENTS_HZ = 20.0
"""Of a topic without a rate. One that has one may have twice as much."""


class Pace:
    """Lets through `hz` a second, and `burst` at once after a silence."""

    def __init__(self, hz: float, burst: int) -> None:
        self._period_s, self._burst = 1.0 / hz, burst
        self._full_s = 0.0
        """When it is (or was) full again, of the caller's clock."""

    def delay_s(self, now_s: float) -> float:
        """Take a place, and say how long to wait for it."""
        self._full_s = max(self._full_s, now_s) + self._period_s
        return max(0.0, self._full_s - now_s - self._burst * self._period_s)


def pace_of(topic: Topic[Any]) -> Pace:
    return Pace(2.0 * topic.hz if topic.hz else EVENTS_HZ, topic.depth)


def why_not(topic: Topic[Any], payload: bytes, stand_ins: Collection[str] = ()) -> str:
    """Why a payload from outside may not pass; "" where it may. A command need not be one of our messages.

    stand_ins: the only nodes in whose name an event or a status may come: another's would keep a node that hangs
    "alive", or be taken for the supervisor's own voice.
    """
    if len(payload) > topic.max_bytes:
        return f"{len(payload)} bytes exceed {topic.max_bytes}"
    if topic is COMMAND:
        return ""
    try:
        message = decode(topic, payload)
    except Fault as fault:
        return str(fault)
    if isinstance(message, (Event, Status)) and message.node not in stand_ins:
        return f"nobody outside stands in for {plain(message.node, 40)!r}"
    return ""


class Carrier(threading.Thread):
    """Carries what `source` yields to `put`, until the session ends. While it waits, the ring keeps the newest.

    Its name is its direction and its topic, as in `in_event` and `out_event`: some topics pass both ways.
    """

    def __init__(
        self,
        topic: Topic[Any],
        source: Subscription[bytes],
        put: Callable[[Topic[Any], bytes], None],
        refuse: Callable[[Topic[Any], str], None] | None = None,
        stand_ins: Collection[str] = (),
    ) -> None:
        """refuse: told why a payload does not pass; None: all pass, at any pace (what our own processes say).
        stand_ins: see `why_not`.
        """
        super().__init__(name=f"{'out' if refuse is None else 'in'}_{topic.name}", daemon=True)
        self._topic, self._source, self._put, self._refuse = topic, source, put, refuse
        self._stand_ins, self._pace = stand_ins, pace_of(topic)
        self.carried = 0

    def run(self) -> None:
        while True:
            try:
                payload = self._source.wait()
            except BusError:
                return
            if self._refuse is not None:
                if why := why_not(self._topic, payload, self._stand_ins):
                    self._refuse(self._topic, why)
                    continue
                time.sleep(self._pace.delay_s(time.monotonic()))
            self._put(self._topic, payload)
            self.carried += 1
