"""The bus, over real zenoh sessions."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from deploy.run.launch import temporary_folder
from deploy.run.processes import free_port
from schemas.runtime.bus import BusConfig, BusError, Subscription, ZenohBus, open_bus
from schemas.runtime.clock import NS
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics
from schemas.wire.messages import Command, Directive, Event, EventKind
from schemas.wire.topics import Topic
from tests.waiting import PATIENCE_S, until


@pytest.fixture
def folder() -> Iterator[Path]:
    with temporary_folder() as path:  # pytest's own are too long for a Unix socket
        yield path


def peer(folder: Path, name: str, *others: str, low_latency: bool = False) -> BusConfig:
    def socket(of: str) -> str:
        return f"unixsock-stream/{folder}/{of}.sock"

    return BusConfig(listen=(socket(name),), connect=tuple(map(socket, others)), low_latency=low_latency)


def directive(number: int) -> Directive:
    return Directive(epoch=1, stamp_ns=time.monotonic_ns(), id=number, command_id=0, scene_tick=0)


def command(number: int) -> Command:
    return Command(epoch=0, stamp_ns=time.monotonic_ns(), id=number, text=f"command {number}")


def publish_until(publish: Callable[[], None], arrived: Callable[[], object]) -> None:
    """Publish again and again until it arrives: two sessions find each other in their own time."""

    def again() -> bool:
        publish()
        return bool(arrived())

    until(again)


def passed(sender: ZenohBus, *receivers: ZenohBus) -> None:
    """Wait until all that `sender` has published so far is with the receivers: no message overtakes another."""
    mark = Event(epoch=0, stamp_ns=time.monotonic_ns(), kind=EventKind.WORLD, node="test", tick=0)

    def has_it(reader: Subscription[Event]) -> bool:
        return mark in reader.take()

    for receiver in receivers:
        publish_until(lambda: sender.publish(topics.EVENT, mark), partial(has_it, receiver.subscribe(topics.EVENT)))


def test_the_newest_wins_in_a_ring_of_one(folder: Path) -> None:
    with open_bus(peer(folder, "a")) as a, open_bus(peer(folder, "b", "a")) as b:
        reader = b.subscribe(topics.DIRECTIVE)
        publish_until(lambda: a.publish(topics.DIRECTIVE, directive(0)), reader.take)
        for number in range(1, 101):
            a.publish(topics.DIRECTIVE, directive(number))
        passed(a, b)
        assert [message.id for message in reader.take()] == [100]
        assert reader.peek() is not None
        assert reader.take() == []


def test_a_router_forwards_between_a_peer_and_a_tcp_client(folder: Path) -> None:
    port = free_port()
    router = BusConfig(mode="router", listen=(f"tcp/127.0.0.1:{port}", f"unixsock-stream/{folder}/bus.sock"))
    with (
        open_bus(router) as middle,
        open_bus(peer(folder, "node", "bus")) as node,
        open_bus(BusConfig(mode="client", connect=(f"tcp/127.0.0.1:{port}",))) as client,
    ):
        at_node, at_middle, at_client = (bus.subscribe(topics.COMMAND) for bus in (node, middle, client))
        assert client.wait_for_reader(topics.COMMAND, PATIENCE_S)
        for sender in (client, node):
            passed(sender, node, middle, client)
        publish_until(lambda: client.publish(topics.COMMAND, command(0)), at_node.take)
        passed(client, node, middle, client)
        for reader in (at_node, at_middle, at_client):
            reader.take()
        client.publish(topics.COMMAND, command(1))
        node.publish(topics.COMMAND, command(2))
        for sender in (client, node):
            passed(sender, node, middle, client)
        for reader in (at_node, at_middle, at_client):  # each once, whatever way there is
            assert sorted(message.id for message in reader.take()) == [1, 2]


def test_two_cars_on_one_router_hear_only_what_is_said_in_their_own_namespace(folder: Path) -> None:
    at = (f"unixsock-stream/{folder}/bus.sock",)
    seven, eight = (BusConfig(mode="client", connect=at, namespace=f"car-{number}") for number in (7, 8))
    with (
        open_bus(BusConfig(mode="router", listen=at)),
        open_bus(seven) as speaks,
        open_bus(seven) as same,
        open_bus(eight) as other,
        open_bus(eight) as other_speaks,
    ):
        in_seven, in_eight = (bus.subscribe(topics.COMMAND) for bus in (same, other))
        publish_until(lambda: speaks.publish(topics.COMMAND, command(1)), in_seven.peek)
        passed(speaks, same)
        passed(other_speaks, other)  # it came through the router later than the command did
        assert in_eight.take() == []


def test_a_namespace_that_is_no_key_is_an_error_in_one_line() -> None:
    with pytest.raises(BusError, match="Invalid Key Expr"), open_bus(BusConfig(namespace="car-*")):
        pass


def test_a_malformed_payload_is_counted_and_skipped(folder: Path) -> None:
    # What an outsider publishes: something else, on the key of directives.
    not_directives: Topic[Command] = Topic(name="directive", type=Command, hz=None, stale_after_s=1.0, depth=1)
    with open_bus(peer(folder, "a")) as a, open_bus(peer(folder, "b", "a")) as b:
        reader = b.subscribe(topics.DIRECTIVE)
        publish_until(lambda: a.publish(topics.DIRECTIVE, directive(1)), reader.peek)
        a.publish(not_directives, command(2))
        passed(a, b)
        newest = reader.peek()
        assert b.faults == {"directive": 1}
        assert newest is not None
        assert newest.id == 1
        assert "directive" in b.last_fault


@pytest.mark.parametrize("other", [True, False])
def test_the_largest_message_arrives_over_a_low_latency_link(folder: Path, other: bool) -> None:
    with open_bus(peer(folder, "a", low_latency=True)) as a, open_bus(peer(folder, "b", "a", low_latency=other)) as b:
        reader = b.subscribe_bytes(topics.COMMAND)
        assert a.wait_for_reader(topics.COMMAND, PATIENCE_S)
        a.publish_bytes(topics.COMMAND, b"x" * topics.MAX_MESSAGE_BYTES)
        assert len(reader.wait()) == topics.MAX_MESSAGE_BYTES


def test_an_announced_message_is_rehearsed_with_the_last_one(folder: Path) -> None:
    with open_bus(peer(folder, "a")) as a, open_bus(peer(folder, "b", "a")) as b:
        rehearsed: list[int] = []
        reader = b.subscribe_rehearsed(topics.DIRECTIVE, lambda last: rehearsed.append(last.id))
        assert a.wait_for_reader(topics.DIRECTIVE, PATIENCE_S)
        a.publish(topics.DIRECTIVE, directive(1))
        assert reader.wait().id == 1
        waiting = threading.Thread(target=reader.wait)
        waiting.start()
        publish_until(lambda: a.announce_next(topics.DIRECTIVE), lambda: rehearsed)
        a.publish(topics.DIRECTIVE, directive(2))
        waiting.join(PATIENCE_S)
        assert set(rehearsed) == {1}


def test_polling_returns_the_newest_message_or_gives_up(folder: Path) -> None:
    with open_bus(peer(folder, "a")) as a, open_bus(peer(folder, "b", "a")) as b:
        reader = b.subscribe(topics.DIRECTIVE)
        assert a.wait_for_reader(topics.DIRECTIVE, PATIENCE_S)
        for number in range(1, 101):
            a.publish(topics.DIRECTIVE, directive(number))
        passed(a, b)
        message = reader.poll(time.monotonic_ns())
        assert message is not None
        assert message.id == 100
        assert reader.poll(time.monotonic_ns() + NS // 1000) is None


def test_a_reader_sleeps_once_it_has_polled_for_long_enough(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def noted(what: str, does: Callable[..., bytes | None]) -> Callable[..., bytes | None]:
        return lambda *given: (did.append(what), does(*given))[1]  # type: ignore[func-returns-value]

    with open_bus(peer(folder, "a")) as a, open_bus(peer(folder, "b", "a")) as b:
        did: list[str] = []
        reader = b.subscribe_rehearsed(topics.DIRECTIVE, lambda _: did.append("rehearse"), poll_ns=NS // 1000)
        assert a.wait_for_reader(topics.DIRECTIVE, PATIENCE_S)
        a.publish(topics.DIRECTIVE, directive(1))
        reader.wait()
        monkeypatch.setattr(reader._raw, "poll", noted("poll", reader._raw.poll))
        monkeypatch.setattr(reader._raw, "wait", noted("sleep", reader._raw.wait))
        seen: list[int] = []
        waiting = threading.Thread(target=lambda: seen.append(reader.wait().id))
        waiting.start()
        publish_until(lambda: a.announce_next(topics.DIRECTIVE), lambda: "rehearse" in did)
        until(lambda: did[-3:] == ["rehearse", "poll", "sleep"], "it does not sleep")
        a.publish(topics.DIRECTIVE, directive(2))
        waiting.join(PATIENCE_S)
        assert seen == [2]


def test_an_announcement_is_no_message(folder: Path) -> None:
    with open_bus(peer(folder, "a")) as a, open_bus(peer(folder, "b", "a")) as b:
        rehearsing = b.subscribe_rehearsed(topics.DIRECTIVE, lambda _: None)
        other = b.subscribe_bytes(topics.DIRECTIVE)
        assert a.wait_for_reader(topics.DIRECTIVE, PATIENCE_S)
        for _ in range(10):
            a.announce_next(topics.DIRECTIVE)
        passed(a, b)
        assert (rehearsing.take(), other.take(), b.faults) == ([], [], {})


def test_an_endpoint_that_cannot_be_listened_on_is_told_without_places_in_the_source_of_zenoh() -> None:
    with pytest.raises(BusError) as told, open_bus(BusConfig(mode="router", listen=("tcp/192.0.2.1:7555",))):
        pass
    assert "192.0.2.1:7555" in str(told.value)
    assert ".rs" not in str(told.value)


def test_a_client_that_reaches_nobody_says_so_and_does_not_try_for_ever() -> None:
    with pytest.raises(BusError), open_bus(BusConfig(mode="client", connect=(f"tcp/127.0.0.1:{free_port()}",))):
        pass


def test_the_local_bus_keeps_the_same_promises() -> None:
    bus = LocalBus()
    reader = bus.subscribe(topics.DIRECTIVE)
    assert reader.peek() is None
    for number in range(3):
        bus.publish(topics.DIRECTIVE, directive(number))
    assert [message.id for message in reader.take()] == [2]
    bus.publish_bytes(topics.DIRECTIVE, b"\xc1")
    assert reader.take() == []
    assert bus.faults == {"directive": 1}
