"""One end of a ping-pong over any transport, as a process of its own: `python -m deploy.bench.pingpong_end '{...}'`.

The near end takes orders from the benchmark over a Unix socket; the far end only answers. Orders:

* `("paced", first_due_ns, period_ns, n)`: one round per due time. A round is timed from its sending; if the answer
  before it was still outstanding when it was due, from when it was due (no coordinated omission).
* `("rounds", n)`: n rounds, each sent as soon as the one before is answered.
* `("observe", payload)`: from now on send this observation (`ours` only).

The reply is `(took_ns, late_ns, inference_ns)`: lists, the last one empty but for the floor.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Client
from typing import Any

import numpy as np

from deploy.bench.transports import LINKS, EndConfig, Link, socket_of
from fast_node.policies.attention import load_attention
from schemas.driving.features import FEATURES, N_ROWS
from schemas.runtime.process import die_with_parent, load_config
from schemas.runtime.realtime import claim

WARM_ROUNDS = 50
WARM_INFERENCES = 5


def _inference() -> Callable[[], int]:
    """What times one bare policy inference in a warm loop, in ns."""
    policy, seen = load_attention(), np.ones((N_ROWS, len(FEATURES)), np.float32)

    def warm() -> int:
        for _ in range(WARM_INFERENCES):
            policy.logits(seen)
        start = time.monotonic_ns()
        policy.logits(seen)
        return time.monotonic_ns() - start

    return warm


def near_end(config: EndConfig, link: Link, orders: Any) -> None:
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


def far_end(config: EndConfig, link: Link) -> None:
    """Answer until the other end goes."""
    send, receive = link
    pong = bytes(config.answered_bytes)
    while True:
        receive()
        send(pong)


def main() -> None:
    if "DORA_NODE_CONFIG" not in os.environ:
        die_with_parent()
    config = load_config(EndConfig, sys.argv[1:])
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
