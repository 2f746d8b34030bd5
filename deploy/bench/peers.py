"""One end of a ping-pong over any transport, as a process of its own: `python -m deploy.bench.peers '{...}'`.

The near end takes orders from the benchmark over a Unix socket; the far end only answers. Orders:

* `("paced", first_due_ns, period_ns, n)`: one round per due time. A round is timed from its sending; if the answer
  before it was still outstanding when it was due, from when it was due (no coordinated omission).
* `("rounds", n)`: n rounds, each sent as soon as the one before is answered.
* `("observe", payload)`: from now on send this observation (`ours` only).

The reply is `(took_ns, late_ns, inference_ns)`: lists, the last one empty but for the floor.
"""

from __future__ import annotations

import importlib
import os
import queue
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct

from schemas.runtime.bus import BusConfig, open_bus, open_default
from schemas.runtime.process import ConfigError, die_with_parent, load_config
from schemas.runtime.realtime import Mode, claim
from schemas.wire.codec import encode
from schemas.wire.messages import Observation
from schemas.wire.topics import ACTION, OBSERVATION, Topic

Transport = Literal["floor", "bus", "bus-default", "zmq", "dora", "ours"]
Link = tuple[Callable[[bytes], None], Callable[[], bytes]]
"""How an end sends a payload, and how it waits for one."""
PING: Topic[Any] = Topic(name="ping", type=Observation, publisher="bench", hz=15, stale_after_s=1.0, depth=1)
PONG: Topic[Any] = Topic(name="pong", type=Observation, publisher="bench", hz=15, stale_after_s=1.0, depth=1)
WARM_ROUNDS = 50
WARM_INFERENCES = 5


class PeerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One end of one ping-pong; its sockets are in `folder`."""

    transport: Transport
    near: bool
    folder: str
    port: int = 0
    sent_bytes: int = 0
    answered_bytes: int = 0
    realtime: Mode = "off"
    observation: str = ""
    """A file with an encoded observation, which the near end of `ours` sends to the real fast node, tick by tick."""


def socket_of(folder: str, name: str) -> str:
    return f"{folder}/{name}.sock"


@contextmanager
def _unix_socket(config: PeerConfig) -> Iterator[Link]:
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
def _bus(config: PeerConfig) -> Iterator[Link]:
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
def _bus_default(config: PeerConfig) -> Iterator[Link]:
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
def _zmq(config: PeerConfig) -> Iterator[Link]:
    zmq: Any = importlib.import_module("zmq")
    context = zmq.Context()
    pair = context.socket(zmq.PAIR)
    pair.linger = 0
    (pair.connect if config.near else pair.bind)(f"ipc://{socket_of(config.folder, 'zmq')}")
    yield pair.send, pair.recv
    context.destroy()


@contextmanager
def _dora(config: PeerConfig) -> Iterator[Link]:
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
def _ours(config: PeerConfig) -> Iterator[Link]:
    """In the simulator's place: an observation to the real fast node, which answers with an action."""
    decoder = msgspec.msgpack.Decoder(Observation)
    seen = decoder.decode(Path(config.observation).read_bytes())
    tick = seen.tick

    near, bus_path, fast = (f"unixsock-stream/{socket_of(config.folder, name)}" for name in ("sim", "bus", "fast"))
    with open_bus(BusConfig(listen=(near,), connect=(bus_path, fast), low_latency=True)) as bus:
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


LINKS: dict[str, Callable[[PeerConfig], Any]] = {
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


def _inference() -> Callable[[], int]:
    """What times one bare policy inference in a warm loop, in ns."""
    import numpy as np

    from fast_node.policies.attention import load_policy
    from schemas.driving.features import FEATURES, N_ROWS

    policy, seen = load_policy(), np.ones((N_ROWS, len(FEATURES)), np.float32)

    def warm() -> int:
        for _ in range(WARM_INFERENCES):
            policy.logits(seen)
        start = time.monotonic_ns()
        policy.logits(seen)
        return time.monotonic_ns() - start

    return warm


def near_end(config: PeerConfig, link: Link, orders: Any) -> None:
    """Carry out orders until there are no more."""
    send, receive = link
    ping = bytes(config.sent_bytes)
    infer = _inference() if config.transport == "floor" else None

    def round_trip(since_ns: int = 0) -> None:
        start = since_ns or time.monotonic_ns()
        send(ping)
        receive()
        took.append(time.monotonic_ns() - start)
        if infer is not None:
            inferred.append(infer())

    took: list[int] = []
    late: list[int] = []
    inferred: list[int] = []
    for _ in range(WARM_ROUNDS):
        round_trip()
    orders.send("ready")
    while True:
        order = orders.recv()
        if order is None:
            return
        if order[0] == "observe":
            send(order[1])
            continue
        took, late, inferred = [], [], []
        if order[0] == "rounds":
            for _ in range(order[1]):
                round_trip()
        else:
            _, first_ns, period_ns, n = order
            for k in range(n):
                due = first_ns + k * period_ns
                ahead = due - time.monotonic_ns()
                if ahead > 0:
                    time.sleep(ahead / 1e9)
                    late.append(time.monotonic_ns() - due)
                    round_trip()
                else:
                    round_trip(due)
        orders.send((took, late, inferred))


def far_end(config: PeerConfig, link: Link) -> None:
    """Answer until the other end goes."""
    send, receive = link
    pong = bytes(config.answered_bytes)
    while True:
        receive()
        send(pong)


def main() -> None:
    if "DORA_NODE_CONFIG" not in os.environ:
        die_with_parent()
    config = load_config(PeerConfig, sys.argv[1:])
    said = claim(config.realtime)
    with LINKS[config.transport](config) as link:
        if not config.near:
            far_end(config, link)
        with Client(socket_of(config.folder, "orders")) as orders:
            orders.send((config.transport, said))
            near_end(config, link, orders)


if __name__ == "__main__":
    try:
        main()
    except (EOFError, KeyboardInterrupt):
        pass
