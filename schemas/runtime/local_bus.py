"""The bus within one process: the same encoding and rings without zenoh, for lock-step drives and tests."""

from __future__ import annotations

from collections import deque
from typing import Any, TypeVar

from schemas.runtime.bus import BusError, Decoding, Subscription
from schemas.wire.codec import encode
from schemas.wire.messages import Message
from schemas.wire.topics import Topic

M = TypeVar("M", bound=Message)


class _LocalRing:
    def __init__(self, depth: int) -> None:
        self.ring: deque[bytes] = deque(maxlen=depth)
        self._newest: bytes | None = None

    def wait(self) -> bytes:
        if not self.ring:
            raise BusError("nothing was published: an in-process bus cannot wait")
        return self.ring.popleft()

    def poll(self, until_ns: int) -> bytes | None:
        return self.ring.popleft() if self.ring else None

    def take(self) -> list[bytes]:
        taken = list(self.ring)
        self.ring.clear()
        return taken

    def peek(self) -> bytes | None:
        for payload in self.take():
            self._newest = payload
        return self._newest


class LocalBus:
    """The same bus inside one process, delivering at once: for lock-step runs and tests. It really encodes messages."""

    def __init__(self) -> None:
        self._rings: dict[str, list[_LocalRing]] = {}
        self.faults: dict[str, int] = {}
        self.last_fault = ""

    def publish(self, topic: Topic[M], message: M) -> None:
        self.publish_bytes(topic, encode(message))

    def publish_bytes(self, topic: Topic[Any], payload: bytes) -> None:
        """Put a payload as it is, as any zenoh publisher could."""
        for ring in self._rings.get(topic.key, ()):
            ring.ring.append(payload)

    def subscribe(self, topic: Topic[M]) -> Subscription[M]:
        return Decoding(self, topic, self.subscribe_bytes(topic))

    def subscribe_bytes(self, topic: Topic[Any]) -> Subscription[bytes]:
        ring = _LocalRing(topic.depth)
        self._rings.setdefault(topic.key, []).append(ring)
        return ring
