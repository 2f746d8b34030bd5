"""The door as a process of its own, between a router of ours and clients of every kind."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass

import msgspec
import psutil
import pytest

from deploy.run.launch import Launched, children, temporary_folder
from deploy.run.links import TCP_HOST, DoorOptions, Links
from deploy.run.processes import door_process, free_port
from schemas.runtime.bus import BusConfig, BusError, ZenohBus, open_bus
from schemas.wire import topics
from schemas.wire.messages import Action, Event, EventKind, MetaAction, Status
from schemas.wire.roles import SHOWN
from schemas.wire.topics import TOPICS
from tests.half_open import half_open
from tests.waiting import until

HIDDEN = tuple(topic for topic in TOPICS if topic not in SHOWN)


@dataclass
class Between:
    """The supervisor's router, a door, and where users come."""

    inside: ZenohBus
    port: int
    door: Launched

    def user(self) -> BusConfig:
        return BusConfig(mode="client", connect=(f"tcp/{TCP_HOST}:{self.port}",))


def start(stack: ExitStack, left_out: frozenset[str] = frozenset()) -> Between:
    folder = stack.enter_context(temporary_folder())
    port = free_port()
    links = Links(folder, DoorOptions(listen=f"tcp/{TCP_HOST}:{port}"), left_out)
    links.write_logins()
    inside = stack.enter_context(open_bus(links.supervisor()))
    beats = inside.subscribe(topics.STATUS)
    launch = stack.enter_context(children())
    door = launch("door", door_process(links).argv, folder / "door.jsonl")
    until(lambda: beats.peek() is not None, f"no door: {door.trouble()}")
    return Between(inside, port, door)


@pytest.fixture(scope="module")
def between() -> Iterator[Between]:
    with ExitStack() as stack:
        yield start(stack)


def event(tick: int) -> Event:
    return Event(epoch=1, stamp_ns=0, kind=EventKind.WORLD, node="sim", tick=tick)


def until_it_comes(publish: Callable[[], None], comes: Callable[[], object]) -> None:
    def again() -> bool:
        publish()
        time.sleep(0.005)
        return bool(comes())

    until(again)


def test_a_user_speaks_and_sees_what_happens(between: Between) -> None:
    heard = between.inside.subscribe_bytes(topics.COMMAND)
    with open_bus(between.user()) as user:
        seen, beats = user.subscribe(topics.EVENT), user.subscribe(topics.STATUS)
        until(lambda: any(beat.node == "door" for beat in beats.take()), "the door itself is not seen")
        until_it_comes(lambda: user.publish_bytes(topics.COMMAND, b"faster"), lambda: heard.peek() == b"faster")
        until_it_comes(lambda: between.inside.publish(topics.EVENT, event(7)), lambda: seen.peek() == event(7))


def test_of_all_that_a_user_puts_on_every_key_only_commands_come_in(between: Between) -> None:
    heard = {topic.name: between.inside.subscribe_bytes(topic) for topic in TOPICS if topic is not topics.STATUS}
    beats = between.inside.subscribe(topics.STATUS)
    forged = Status(epoch=0, stamp_ns=0, node="fast", pid=1, seq=0, state="ready")
    with open_bus(between.user()) as user:
        for topic in TOPICS:
            user.publish_bytes(topic, b"hello")
        user.publish(topics.STATUS, forged)
        until_it_comes(lambda: user.publish_bytes(topics.COMMAND, b"last"), lambda: heard["command"].peek() == b"last")
    assert {name for name, reader in heard.items() if reader.peek() is not None} == {"command"}
    assert {beat.node for beat in beats.take()} <= {"door"}


def test_a_user_who_asks_for_everything_is_told_only_what_users_may_see(between: Between) -> None:
    with open_bus(between.user()) as user:
        everything = user.subscribe_all(256)
        told = set[str]()

        def has_the_last() -> bool:
            told.update(arrival.topic for arrival in everything.take())
            return "event" in told

        for topic in HIDDEN:
            for _ in range(20):
                between.inside.publish_bytes(topic, b"inside")
                time.sleep(0.005)
        until_it_comes(lambda: between.inside.publish(topics.EVENT, event(1)), has_the_last)
    assert {topic.name for topic in HIDDEN} & told == set()


def test_where_our_fast_node_is_left_out_another_may_drive_through_the_door_and_not_steer_the_rest() -> None:
    with ExitStack() as stack:
        between = start(stack, frozenset({"fast"}))
        heard = {t.name: between.inside.subscribe_bytes(t) for t in (topics.ACTION, topics.DIRECTIVE, topics.CONTROL)}
        beats, events = between.inside.subscribe(topics.STATUS), between.inside.subscribe(topics.EVENT)
        user = stack.enter_context(open_bus(between.user()))
        action = Action(epoch=1, stamp_ns=0, answers_tick=1, meta_action=int(MetaAction.CRUISE), source="policy")
        for topic in (topics.DIRECTIVE, topics.CONTROL):
            user.publish_bytes(topic, b"hello")
        until_it_comes(lambda: user.publish(topics.ACTION, action), lambda: heard["action"].peek())
        assert {name for name, reader in heard.items() if reader.peek() is not None} == {"action"}

        said, happened = set[str](), set[str]()

        def speak() -> None:
            for name in ("sim", "supervisor", "fast"):
                user.publish(topics.STATUS, Status(epoch=0, stamp_ns=0, node=name, pid=1, seq=0, state="ready"))
                user.publish(topics.EVENT, msgspec.structs.replace(event(1), node=name))

        def both() -> bool:
            said.update(beat.node for beat in beats.take())
            happened.update(one.node for one in events.take())
            return "fast" in said and "fast" in happened

        until_it_comes(speak, both)

        def counts_both_ways() -> bool:
            door = next((beat.metrics for beat in beats.take() if beat.node == "door"), {})
            carried_in, carried_out = (
                {door.get(f"{way}_{name}") for name in ("event", "status")} for way in ("in", "out")
            )
            return all(carried_in) and carried_out == {0.0}

        until(counts_both_ways, "the door counts one way into the other")
        ever_said, ever_happened = set(said), set(happened)
        for _ in range(20):  # whatever was put before fast's comes before it
            said.clear()
            happened.clear()
            until_it_comes(speak, both)
            ever_said |= said
            ever_happened |= happened
        assert (ever_said, ever_happened) == ({"door", "fast"}, {"fast"})


@pytest.mark.parametrize(
    ("left_out", "more"), [("fast", set()), ("sim", {"control"}), ("slow", {"command"})], ids=["fast", "sim", "slow"]
)
def test_where_a_node_is_left_out_users_are_told_what_it_subscribes_to_and_nothing_else(
    left_out: str, more: set[str]
) -> None:
    with ExitStack() as stack:
        between = start(stack, frozenset({left_out}))
        user = stack.enter_context(open_bus(between.user()))
        everything = user.subscribe_all(512)
        told, wanted = set[str](), {topic.name for topic in SHOWN} | more

        def all_told() -> bool:
            for topic in TOPICS:
                between.inside.publish_bytes(topic, b"inside")
            told.update(arrival.topic for arrival in everything.take())
            return told >= wanted

        for _ in range(20):
            told.clear()
            until(all_told, "something is not told that should be")
            assert told == wanted


def honest(between: Between, words: bytes) -> None:
    """Somebody who means well is heard."""
    heard = between.inside.subscribe_bytes(topics.COMMAND)

    def is_heard() -> bool:
        with suppress(BusError), open_bus(between.user()) as user:
            until_it_comes(lambda: user.publish_bytes(topics.COMMAND, words), lambda: words in heard.take())
            return True
        return False

    until(is_heard, "nobody is let in any more")


@pytest.mark.parametrize("size", [4_000, 100_000, 1_000_000, 10_000_000])
def test_a_message_that_is_too_long_does_not_come_in_and_costs_little_memory(between: Between, size: int) -> None:
    heard, before = between.inside.subscribe_bytes(topics.COMMAND), psutil.Process(between.door.pid).memory_info().rss
    with open_bus(between.user()) as user:
        for _ in range(3):
            user.publish_bytes(topics.COMMAND, b"x" * size)
            time.sleep(0.05)
        honest(between, b"after %d" % size)
    assert max(map(len, heard.take())) < 100
    assert psutil.Process(between.door.pid).memory_info().rss - before < 20_000_000


def test_one_who_floods_silences_nobody_else(between: Between) -> None:
    heard, came, ended = between.inside.subscribe_bytes(topics.COMMAND), set[bytes](), threading.Event()

    def flood() -> None:
        with open_bus(between.user()) as user:
            while not ended.wait(0.005):
                for _ in range(20):
                    user.publish_bytes(topics.COMMAND, b"me")

    def arrived(words: bytes) -> bool:
        came.update(heard.take())
        return words in came

    flooder = threading.Thread(target=flood)
    flooder.start()
    try:
        until(lambda: b"me" in heard.take())
        for number in range(15):
            words = b"honest %d" % number
            with open_bus(between.user()) as user:
                assert user.wait_for_reader(topics.COMMAND, 30.0)
                user.publish_bytes(topics.COMMAND, words)
                until(lambda: arrived(words), "an honest word is lost")  # noqa: B023
    finally:
        ended.set()
        flooder.join()


def test_thousands_of_half_open_connections_keep_the_door_alive_and_it_serves_on(between: Between) -> None:
    with half_open(between.port):
        assert not between.door.trouble()
    honest(between, b"after the storm")
