"""The participants beside ours: a round that is late, a participant that dies or hangs."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from deploy.bench import pingpong_end
from deploy.bench.pingpongs import PingPongs
from deploy.bench.transports import EndConfig
from schemas.runtime.clock import ManualClock


class Orders:
    """The benchmark's end of the orders, without a socket."""

    def __init__(self, *orders: object) -> None:
        self._orders: list[object] = [*orders, None]
        self.replies: list[Any] = []

    def recv(self) -> object:
        return self._orders.pop(0)

    def send(self, reply: object) -> None:
        self.replies.append(reply)


def test_a_round_behind_a_late_one_counts_from_when_it_was_due(monkeypatch: pytest.MonkeyPatch) -> None:
    slow_at = 51  # the rounds before it are for warming up

    def receive() -> bytes:
        nonlocal slow_at
        slow_at -= 1
        if slow_at == 0:
            manual.advance(0.05)
        return b""

    manual = ManualClock()
    monkeypatch.setattr(pingpong_end, "time", SimpleNamespace(monotonic_ns=manual.now_ns, sleep=manual.advance))
    orders = Orders(("paced", manual.now_ns() + 50_000_000, 10_000_000, 3))
    pingpong_end.near_end(EndConfig(transport="bus", near=True, folder=""), (lambda _: None, receive), orders)
    assert orders.replies[1][0] == [50_000_000, 40_000_000, 30_000_000]


@contextmanager
def two_peers(folder: Path, other: str) -> Iterator[PingPongs]:
    with PingPongs(folder, ("floor", other), 512, 128, "off") as peers:  # type: ignore[arg-type]
        yield peers


@pytest.mark.parametrize(
    ("peer", "part"), [("zmq", "far end"), ("bus", "far end"), ("bus", "near end"), ("dora", "dataflow")]
)
def test_a_peer_that_dies_is_dropped_and_says_which_part_it_was(tmp_path: Path, peer: str, part: str) -> None:
    pytest.importorskip({"bus": "zenoh"}.get(peer, peer))
    with two_peers(tmp_path, peer) as peers:
        os.kill(peers.parts(peer)[part], signal.SIGKILL)
        peers.order(peer, "rounds", 10)
        assert peers.reply(peer) is None
        assert f"its {part} was killed by signal 9" in peers.lost[peer]


def test_a_peer_goes_on_when_another_has_died(tmp_path: Path) -> None:
    with two_peers(tmp_path, "bus") as peers:
        os.kill(peers.parts("bus")["far end"], signal.SIGKILL)
        peers.order("bus", "rounds", 10)
        peers.reply("bus")
        peers.order("floor", "rounds", 10)
        reply = peers.reply("floor")
        assert reply is not None
        assert len(reply[0]) == 10


def test_a_peer_that_hangs_is_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with PingPongs(tmp_path, ("floor",), 512, 128, "off") as peers:
        monkeypatch.setattr(peers, "_patience_s", 1.0)  # of a peer that is up
        os.kill(peers.parts("floor")["far end"], signal.SIGSTOP)
        peers.order("floor", "rounds", 10)
        assert peers.reply("floor") is None
        assert "did not answer for 1 s" in peers.lost["floor"]
