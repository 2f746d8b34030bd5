"""The message bus. The only file that imports zenoh.

Every session opens explicit endpoints, with discovery off: the supervisor's session is a router on a Unix socket; our
nodes are peers that also link to each other directly over Unix sockets, so that a tick never passes through the router.
Users come through the door (`deploy.door`), which has a router of its own for them.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from schemas.runtime.bus_settings import ONE_POOL as ONE_POOL
from schemas.runtime.bus_settings import BusConfig as BusConfig
from schemas.runtime.bus_settings import zenoh_settings
from schemas.wire.codec import Fault, decode, encode
from schemas.wire.messages import Message
from schemas.wire.topics import PREFIX, Topic

M = TypeVar("M", bound=Message)
T = TypeVar("T")

ANNOUNCED = "/soon"
_IN_ZENOH = re.compile(r" at /[^ ]*\.rs:[0-9]+\.?")
"""Where in zenoh's source an error arose."""


class BusError(RuntimeError):
    """The session could not be opened; `str()` is zenoh's reason in one line."""


class Subscription(Protocol[T]):
    """A reader's end of a topic: a ring of the topic's depth in which the newest win."""

    def wait(self) -> T:
        """The next message, blocking until there is one. Signal handlers run meanwhile, and may raise.

        Raises `BusError` where the session ends meanwhile.
        """
        ...

    def poll(self, until_ns: int) -> T | None:
        """The next message if one comes before CLOCK_MONOTONIC `until_ns`, looking for it without ever sleeping.

        A core that sleeps must be woken first. Only where `realtime.may_poll`: zenoh's thread runs between two looks.
        """
        ...

    def take(self) -> list[T]:
        """All messages that have arrived since the last call, oldest first. Never waits."""
        ...

    def peek(self) -> T | None:
        """The newest message so far, again and again until a newer one arrives; None before the first. Never waits."""
        ...


class Bus(Protocol):
    """What a node needs of a message bus."""

    faults: dict[str, int]
    """Refused payloads so far, by topic name."""

    last_fault: str

    def publish(self, topic: Topic[M], message: M) -> None: ...

    def subscribe(self, topic: Topic[M]) -> Subscription[M]: ...

    def subscribe_bytes(self, topic: Topic[Any]) -> Subscription[bytes]:
        """The payloads as they came, for a topic whose payloads need not be our structs (commands)."""
        ...


class Decoding(Generic[M]):
    """Decodes what another subscription of bytes yields; counts and drops what cannot be used."""

    def __init__(
        self,
        bus: Bus,
        topic: Topic[M],
        raw: Subscription[bytes],
        rehearse: Callable[[M], None] | None = None,
        poll_ns: int = 0,
    ) -> None:
        self._bus, self._topic, self._raw, self._rehearse = bus, topic, raw, rehearse
        self._poll_ns = poll_ns
        self._newest: M | None = None
        self._payload = b""
        self.arrived_ns = 0
        """CLOCK_MONOTONIC when the payload of the message that `wait` returned was in hand, not yet decoded."""

    def _decoded(self, payload: bytes) -> M | None:
        if not payload and self._rehearse is not None:
            return None
        try:
            self._newest = decode(self._topic, payload)
        except Fault as fault:
            self._bus.faults[self._topic.name] = self._bus.faults.get(self._topic.name, 0) + 1
            self._bus.last_fault = f"{self._topic.name}: {fault}"
            return None
        return self._newest

    def poll(self, until_ns: int) -> M | None:
        while (payload := self._raw.poll(until_ns)) is not None:
            if (message := self._decoded(payload)) is not None:
                self._payload = payload
                return message
        return None

    def wait(self) -> M:
        poll_until_ns = 0
        while True:
            payload = self._raw.poll(poll_until_ns)
            if payload is None:
                payload = self._raw.wait()
            self.arrived_ns = time.monotonic_ns()
            message = self._decoded(payload)
            if message is not None:
                self._payload = payload
                return message
            if not payload and self._payload and self._rehearse is not None:
                self._rehearse(decode(self._topic, self._payload))
                poll_until_ns = time.monotonic_ns() + self._poll_ns

    def take(self) -> list[M]:
        return [m for m in map(self._decoded, self._raw.take()) if m is not None]

    def peek(self) -> M | None:
        for payload in self._raw.take():
            self._decoded(payload)
        return self._newest


class _ZenohBytes:
    """A zenoh ring of payloads."""

    def __init__(self, subscriber: Any, closed: type[Exception]) -> None:
        """closed: what zenoh raises to a reader that waits when its session ends."""
        self._handler, self._closed = subscriber.handler, closed
        self._newest: bytes | None = None

    def wait(self) -> bytes:
        try:
            payload: bytes = self._handler.recv().payload.to_bytes()
        except self._closed as error:
            raise BusError(f"the session has ended: {_IN_ZENOH.sub('', str(error))}") from None
        return payload

    def poll(self, until_ns: int) -> bytes | None:
        while (sample := self._handler.try_recv()) is None:
            if time.monotonic_ns() >= until_ns:
                return None
            os.sched_yield()
        polled: bytes = sample.payload.to_bytes()
        return polled

    def take(self) -> list[bytes]:
        payloads: list[bytes] = []
        while (sample := self._handler.try_recv()) is not None:
            payloads.append(sample.payload.to_bytes())
        return payloads

    def peek(self) -> bytes | None:
        for payload in self.take():
            self._newest = payload
        return self._newest


@dataclass(frozen=True, slots=True)
class Arrival:
    """One payload, as it came through the router."""

    topic: str
    """Its topic's name."""
    payload: bytes
    routed_ns: int
    """When the router passed it on, in ns of its wall clock since 1970; 0 if it did not say."""


class Arrivals:
    """Everything that is published on our topics, in one ring, in the order of its arrival."""

    def __init__(self, subscriber: Any) -> None:
        self._handler = subscriber.handler

    def wait(self) -> Arrival:
        """The next one, blocking until there is one. Signal handlers run meanwhile, and may raise."""
        return self._arrival(self._handler.recv())

    def take(self) -> list[Arrival]:
        """All that have come since the last call, oldest first. Never waits."""
        taken: list[Arrival] = []
        while (sample := self._handler.try_recv()) is not None:
            taken.append(self._arrival(sample))
        return taken

    @staticmethod
    def _arrival(sample: Any) -> Arrival:
        stamp = sample.timestamp
        routed_ns: int = stamp.get_time_as_ntp64().as_nanos() if stamp is not None else 0
        return Arrival(str(sample.key_expr).rpartition("/")[2], sample.payload.to_bytes(), routed_ns)


class ZenohBus:
    """A zenoh session with our topics on it. Open it with `open_bus`."""

    def __init__(self, session: Any, zenoh: Any) -> None:
        self._session, self._ring, self._drop = session, zenoh.handlers.RingChannel, zenoh.CongestionControl.DROP
        self._others, self._closed = zenoh.Locality.REMOTE, zenoh.ZError
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []
        self.faults: dict[str, int] = {}
        self.last_fault = ""

    def publish(self, topic: Topic[M], message: M) -> None:
        """Hand a message to zenoh; returns at once, whoever is or is not listening."""
        publisher = self._publishers.get(topic.key)
        if publisher is None:
            publisher = self.announce(topic)
        publisher.put(encode(message))

    def publish_bytes(self, topic: Topic[Any], payload: bytes) -> None:
        """Hand a payload to zenoh as it is."""
        (self._publishers.get(topic.key) or self.announce(topic)).put(payload)

    def announce_next(self, topic: Topic[Any]) -> None:
        """Tell the readers that rehearse for it that a message of `topic` is about to come."""
        key = topic.key + ANNOUNCED
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.declare_publisher(key, congestion_control=self._drop)
        publisher.put(b"")

    def announce(self, topic: Topic[Any]) -> Any:
        """Declare a publisher ahead of its first message, which would otherwise pay for it."""
        publisher = self._publishers[topic.key] = self._session.declare_publisher(
            topic.key, congestion_control=self._drop
        )
        return publisher

    def wait_for_reader(self, topic: Topic[Any], timeout_s: float) -> bool:
        """Wait until somebody reads a topic, so that its first message is not lost; False if nobody did in time."""
        publisher = self._publishers.get(topic.key) or self.announce(topic)
        until = time.monotonic() + timeout_s
        while not publisher.matching_status.matching:
            if time.monotonic() > until:
                return False
            time.sleep(0.01)
        return True

    def subscribe(self, topic: Topic[M]) -> Subscription[M]:
        return Decoding(self, topic, self.subscribe_bytes(topic))

    def subscribe_rehearsed(self, topic: Topic[M], rehearse: Callable[[M], None], poll_ns: int = 0) -> Decoding[M]:
        """Like `subscribe`, and `wait` also calls `rehearse` with the last message when the next one is announced.

        The announcement takes the way of the message, through the same ring, and so wakes all that it will need.
        After one, `wait` polls for `poll_ns` before it sleeps.
        """
        ring = self._ring_on(f"{topic.key}/**", topic.depth)  # a/**: a, a/b, ...
        return Decoding(self, topic, ring, rehearse, poll_ns)

    def subscribe_bytes(self, topic: Topic[Any]) -> Subscription[bytes]:
        return self._ring_on(topic.key, topic.depth)

    def subscribe_others(self, topic: Topic[Any]) -> Subscription[bytes]:
        """Like `subscribe_bytes`, without what this very session publishes."""
        ring = self._ring(topic.depth)
        subscriber = self._session.declare_subscriber(topic.key, ring, allowed_origin=self._others)
        self._subscribers.append(subscriber)
        return _ZenohBytes(subscriber, self._closed)

    def subscribe_all(self, depth: int) -> Arrivals:
        """Every topic at once, for a recorder. `depth`: how many messages wait in the ring; the newest win."""
        subscriber = self._session.declare_subscriber(f"{PREFIX}/*", self._ring(depth))
        self._subscribers.append(subscriber)
        return Arrivals(subscriber)

    def _ring_on(self, key: str, depth: int) -> _ZenohBytes:
        subscriber = self._session.declare_subscriber(key, self._ring(depth))
        self._subscribers.append(subscriber)
        return _ZenohBytes(subscriber, self._closed)


@contextmanager
def open_bus(config: BusConfig) -> Iterator[ZenohBus]:
    """A zenoh session for the time of the block, closed at its end.

    Raises `BusError` when a setting is not as zenoh wants it, an endpoint cannot be listened on, or a client reaches
    nobody.
    """
    os.environ.setdefault("ZENOH_RUNTIME", ONE_POOL)
    import zenoh  # here, so that `--help` and lock-step runs never pay for it

    zenoh.init_log_from_env_or("off")
    settings = zenoh.Config()
    try:
        for path, value in zenoh_settings(config).items():
            settings.insert_json5(path, json.dumps(value))
        session = zenoh.open(settings)
    except (zenoh.ZError, OSError, ValueError) as error:
        raise BusError(_IN_ZENOH.sub("", str(error).splitlines()[0])) from None
    try:
        yield ZenohBus(session, zenoh)
    finally:
        session.close()  # type: ignore[no-untyped-call]


@contextmanager
def open_default(
    endpoint: str, *, listen: bool, out: str, into: str, receive: Callable[[bytes], None]
) -> Iterator[Callable[[bytes], None]]:
    """Bare zenoh as it comes, which the benchmark compares with ours: yields what sends a payload to key `out`.

    Everything is default, the callback subscriber of key `into` too, but for the endpoint and discovery, which is off.
    """
    import zenoh

    settings = zenoh.Config()
    settings.insert_json5(f"{'listen' if listen else 'connect'}/endpoints", json.dumps([endpoint]))
    if not listen:
        settings.insert_json5("listen/endpoints", "[]")
    settings.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(settings) as session:
        publisher = session.declare_publisher(out)
        subscriber = session.declare_subscriber(into, lambda sample: receive(sample.payload.to_bytes()))
        yield publisher.put
        subscriber.undeclare()  # type: ignore[no-untyped-call]
