"""Transports that are compared: how one end of a ping-pong sends and receives over each of them."""

from __future__ import annotations

import importlib
import queue
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct

from schemas.runtime.bus import BusConfig, open_bus, open_default
from schemas.runtime.process import ConfigError
from schemas.runtime.realtime import Mode
from schemas.wire.codec import encode
from schemas.wire.messages import Observation
from schemas.wire.topics import ACTION, OBSERVATION, Topic

Transport = Literal["floor", "bus", "bus-default", "zmq", "dora", "ours"]
Link = tuple[Callable[[bytes], None], Callable[[], bytes]]
"""How an end sends a payload, and how it waits for one."""
TRANSPORTS: tuple[Transport, ...] = ("floor", "bus", "bus-default", "zmq", "dora")
"""What ours is compared with."""
PING: Topic[Any] = Topic(name="ping", type=Observation, hz=15, stale_after_s=1.0, depth=1)
PONG: Topic[Any] = Topic(name="pong", type=Observation, hz=15, stale_after_s=1.0, depth=1)


class EndConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One end of one ping-pong; its sockets are in `folder`."""

    transport: Transport
    near: bool
    folder: str
    port: int = 0
    sent_bytes: int = 0
    answered_bytes: int = 0
    realtime: Mode = "off"
    bus: BusConfig = BusConfig()
    """The simulator's link to the fast node, for the near end of `ours`."""
    observation: str = ""
    """A file with an encoded observation, which the near end of `ours` sends to the real fast node, tick by tick."""


def socket_of(folder: str, name: str) -> str:
    return f"{folder}/{name}.sock"


@contextmanager
def _unix_socket(config: EndConfig) -> Iterator[Link]:
    path = socket_of(config.folder, "floor")
    if config.near:
        raw = socket.socket(socket.AF_UNIX)
        _until(lambda: raw.connect(path), OSError)
    else:
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(path)
            listener.listen(1)
            raw = listener.accept()[0]
    size = config.answered_bytes if config.near else config.sent_bytes

    def receive() -> bytes:
        payload = raw.recv(size)
        while payload and len(payload) < size:
            payload += raw.recv(size - len(payload))
        if not payload:
            raise EOFError
        return payload

    with raw:
        yield raw.sendall, receive


@contextmanager
def _bus(config: EndConfig) -> Iterator[Link]:
    near, far = (f"unixsock-stream/{socket_of(config.folder, name)}" for name in ("bus-near", "bus-far"))
    one = BusConfig(listen=(near if config.near else far,), connect=(far,) if config.near else (), low_latency=True)
    out, into = (PING, PONG) if config.near else (PONG, PING)
    with open_bus(one) as bus:
        ring = bus.subscribe_bytes(into)
        bus.announce(out)
        if config.near and not bus.wait_for_reader(out, 10.0):
            raise ConfigError("the other end of the bus did not come up")
        yield lambda payload: bus.publish_bytes(out, payload), ring.wait


@contextmanager
def _bus_default(config: EndConfig) -> Iterator[Link]:
    arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    out, into = ("bench/ping", "bench/pong") if config.near else ("bench/pong", "bench/ping")
    answer = bytes(config.answered_bytes)
    send_of: list[Callable[[bytes], None]] = []

    def receive(payload: bytes) -> None:
        if config.near:
            arrived.put(payload)
        else:
            send_of[0](answer)

    with open_default(
        f"tcp/127.0.0.1:{config.port}", listen=not config.near, out=out, into=into, receive=receive
    ) as send:
        send_of.append(send)
        if config.near:  # nobody tells when the other end is ready: ask until it answers
            _until(lambda: (send(bytes(config.sent_bytes)), arrived.get(timeout=0.1)), queue.Empty)
            time.sleep(0.3)
            while not arrived.empty():
                arrived.get()
        yield send, arrived.get


@contextmanager
def _zmq(config: EndConfig) -> Iterator[Link]:
    zmq: Any = importlib.import_module("zmq")
    context = zmq.Context()
    pair = context.socket(zmq.PAIR)
    pair.linger = 0
    (pair.connect if config.near else pair.bind)(f"ipc://{socket_of(config.folder, 'zmq')}")
    yield pair.send, pair.recv
    context.destroy()


@contextmanager
def _dora(config: EndConfig) -> Iterator[Link]:
    import pyarrow
    from dora import Node

    node = Node()

    def receive() -> bytes:
        while True:
            event = node.next()
            if event is None or event["type"] == "STOP":
                raise EOFError
            if event["type"] == "INPUT":
                payload: bytes = event["value"].to_numpy().tobytes()
                return payload

    def send(payload: bytes) -> None:
        node.send_output("out", pyarrow.array(memoryview(payload), type=pyarrow.uint8()))

    yield send, receive


@contextmanager
def _ours(config: EndConfig) -> Iterator[Link]:
    """In the simulator's place: an observation to the real fast node, which answers with an action."""
    decoder = msgspec.msgpack.Decoder(Observation)
    seen = decoder.decode(Path(config.observation).read_bytes())
    tick = seen.tick

    with open_bus(config.bus) as bus:
        actions = bus.subscribe(ACTION)
        if not bus.wait_for_reader(OBSERVATION, 10.0):
            raise ConfigError("the fast node did not come up")

        def send(other: bytes) -> None:
            nonlocal seen, tick
            if other:
                seen = decoder.decode(other)
                return
            tick += 1
            bus.publish_bytes(
                OBSERVATION, encode(msgspec.structs.replace(seen, tick=tick, stamp_ns=time.monotonic_ns()))
            )

        def receive() -> bytes:
            while actions.wait().answers_tick != tick:
                pass
            return b""

        yield send, receive


LINKS: dict[str, Callable[[EndConfig], Any]] = {
    "floor": _unix_socket,
    "bus": _bus,
    "bus-default": _bus_default,
    "zmq": _zmq,
    "dora": _dora,
    "ours": _ours,
}


def _until(attempt: Callable[[], object], failure: type[BaseException], timeout_s: float = 10.0) -> None:
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            attempt()
            return
        except failure:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)
