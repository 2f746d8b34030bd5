"""The slow node: what a passenger says, what becomes of it, and what happens when the model fails."""

from __future__ import annotations

import asyncio
import json
import socket
import sqlite3
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from schemas.runtime.bus import Subscription
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics
from schemas.wire.journal import Journal
from schemas.wire.messages import Directive, Event, EventKind, Observation, Reply
from slow_node.config import SlowConfig
from slow_node.llm.embedding import load_embedder
from slow_node.memory.bank import Memory
from slow_node.memory.preferences import Preference
from slow_node.node import build
from slow_node.understanding.refusals import unsafe
from tests import scenes
from tests.faulty_server import FaultyServer, answer
from tests.scenes import car
from tests.scripted import ScriptedModel
from tests.waiting import until

FASTER = '{"reasoning":"in a hurry","outcome":"directive","speed":"faster","overtake":true}'
SLOWER = '{"reasoning":"less","outcome":"directive","speed":"slower"}'


def observation(tick: int = 0, epoch: int = 1, lane: int = 1, x: float = 0.0, lead_x: float = 25.0) -> Observation:
    """The two-way road: the ego in its own lane 1, a lead at 3.5 m/s."""
    ego, lead = car(0, 100 + x, lane, 5), car(1, 100 + lead_x, 1, 3.5)
    return scenes.observation(ego, lead, epoch=epoch, stamp_ns=time.monotonic_ns(), tick=tick)


@pytest.fixture
def model(request: pytest.FixtureRequest) -> Iterator[ScriptedModel]:
    scripted = ScriptedModel(request.param)
    yield scripted
    scripted.close()


@pytest.fixture(scope="session")
def bank(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = str(tmp_path_factory.mktemp("memory") / "bank.sqlite")
    Memory(load_embedder(), path).close()
    return path


Step = Callable[[LocalBus], None]


def play(
    url: str,
    bank: str,
    *steps: Step,
    budget_s: float = 4.0,
    embedded: bool = False,
    parser: bool = False,
    asked: Callable[[], object] = lambda: False,
    thoughts_path: str = "",
    wishes_path: str = "",
) -> tuple[list[Reply], list[Directive]]:
    """Run the node on an in-process bus; what it published.

    Each step waits until the node has done all that the last one gave it to do, or until the model is `asked`.
    """
    bus = LocalBus()
    replies, directives = bus.subscribe(topics.REPLY), bus.subscribe(topics.DIRECTIVE)
    seen: list[Directive] = []
    heard: list[Reply] = []
    node, memory = build(
        bus,
        SlowConfig(
            base_url=url,
            memory_path=bank,
            budget_s=budget_s,
            embedded=embedded,
            parser=parser,
            api_key_env="FASTSLOW_NO_KEY",
            thoughts_path=thoughts_path,
            wishes_path=wishes_path,
        ),
    )

    rounds, poll = 0, node.poll

    def counted(now_ns: int) -> None:
        nonlocal rounds
        poll(now_ns)
        rounds += 1

    node.poll = counted  # type: ignore[method-assign]

    async def run() -> None:
        stop = asyncio.Event()
        task = asyncio.create_task(node.run(stop.is_set))
        for step in steps:
            before, last = rounds, step is steps[-1]
            step(bus)
            while rounds < before + 2 or ((node._interpretation or node._chores) and (last or not asked())):
                await asyncio.sleep(0.01)
            heard.extend(replies.take())
            seen.extend(directives.take())
        stop.set()
        await task

    try:
        asyncio.run(run())
    finally:
        memory.close()
    return [*heard, *replies.take()], [*seen, *directives.take()]


def look(tick: int = 0, epoch: int = 1, lane: int = 1, x: float = 0.0) -> Step:
    return lambda bus: bus.publish(topics.OBSERVATION, observation(tick, epoch, lane, x))


def say(text: str | bytes) -> Step:
    payload = text if isinstance(text, bytes) else text.encode()
    return lambda bus: bus.publish_bytes(topics.COMMAND, payload)


def look_and_say(text: str) -> Step:
    def step(bus: LocalBus) -> None:
        look()(bus)
        say(text)(bus)

    return step


def obeys(_: str) -> str:
    return FASTER


def garbage(_: str) -> str:
    return "I would love to help!"


SECOND_ASKED = threading.Event()


def slow_first(prompt: str) -> str:
    if "first" in prompt:
        SECOND_ASKED.wait(20.0)
        return FASTER
    SECOND_ASKED.set()
    return SLOWER


@pytest.mark.parametrize("model", [obeys], indirect=True)
def test_a_command_is_heard_at_once_and_issued_after(model: ScriptedModel, bank: str) -> None:
    replies, directives = play(model.url, bank, look(), say("Hurry, I'm late"))
    assert [r.outcome for r in replies] == ["heard", "issued"]
    assert (directives[0].manoeuvre, directives[0].target_lane, directives[0].target_speed_mps) == ("overtake", 0, 8.0)
    assert replies[1].directive_id == directives[0].id
    assert replies[1].say


@pytest.mark.parametrize("model", [obeys], indirect=True)
@pytest.mark.parametrize("payload", [b"", b"x" * 10_000, b"\x00\xff\xfe\x81", b"\x81\xa1a\x01"])
def test_a_bad_payload_is_refused_with_a_reason(model: ScriptedModel, bank: str, payload: bytes) -> None:
    replies, directives = play(model.url, bank, look(), say(payload))
    assert [r.outcome for r in replies] == ["refused"]
    assert replies[0].why
    assert not directives


@pytest.mark.parametrize("model", [garbage], indirect=True)
def test_garbage_is_repaired_once_then_refused(model: ScriptedModel, bank: str) -> None:
    replies, directives = play(model.url, bank, look(), say("Hurry, I'm late"))
    assert [r.outcome for r in replies] == ["heard", "refused"]
    assert len(model.prompts) == 2
    assert "no JSON object" in model.prompts[1]
    assert not directives


@pytest.mark.parametrize("model", [slow_first], indirect=True)
def test_the_newest_command_wins(model: ScriptedModel, bank: str) -> None:
    replies, directives = play(
        model.url, bank, look(), say("first things first"), say("a little slower"), asked=lambda: model.prompts
    )
    assert [r.outcome for r in replies] == ["heard", "heard", "superseded", "issued"]
    assert replies[2].text == "first things first"
    assert [d.manoeuvre for d in directives] == ["cruise"]


@pytest.mark.parametrize("model", [obeys], indirect=True)
def test_ramming_is_refused_even_if_the_model_obeys(model: ScriptedModel, bank: str) -> None:
    replies, directives = play(model.url, bank, look(), say("ram the car ahead"))
    assert [r.outcome for r in replies] == ["heard", "refused"]
    assert not directives
    assert not unsafe("please don't hit the car ahead")


@pytest.mark.parametrize("model", [obeys], indirect=True)
def test_overtaking_returns_and_ends_on_our_own_side(model: ScriptedModel, bank: str) -> None:
    ids: list[int] = []
    readers: list[Subscription[Directive]] = []

    def fulfilled(tick: int) -> Step:
        def step(bus: LocalBus) -> None:
            bus.publish(
                topics.EVENT,
                Event(
                    epoch=1,
                    stamp_ns=time.monotonic_ns(),
                    kind=EventKind.FULFILLED,
                    node="fast",
                    tick=tick,
                    directive_id=ids[-1],
                ),
            )

        return step

    def note(bus: LocalBus) -> None:
        readers.append(bus.subscribe(topics.DIRECTIVE))

    def read(_: LocalBus) -> None:
        newest = readers[0].peek()
        assert newest is not None
        ids.append(newest.id)

    replies, directives = play(
        model.url,
        bank,
        note,
        look(),
        say("I'm in a hurry"),
        look(1, lane=0, x=10),
        read,
        fulfilled(1),
        look(2, lane=0, x=40),
        look(3, lane=1, x=45),
        read,
        fulfilled(3),
    )
    assert [d.target_lane for d in directives] == [0, 1]
    assert [r.outcome for r in replies] == ["heard", "issued", "issued", "fulfilled"]


@pytest.mark.parametrize("model", [obeys], indirect=True)
def test_an_active_wish_survives_a_reset_of_the_world(model: ScriptedModel, bank: str) -> None:
    _, directives = play(model.url, bank, look(), say("I'm in a hurry"), look(0, epoch=2))
    assert [d.epoch for d in directives] == [1, 2]


def test_without_a_model_memory_answers_or_a_reason_is_given(bank: str) -> None:
    nobody = "http://127.0.0.1:9/v1"
    replies, directives = play(nobody, bank, look_and_say("please slow down"))
    assert replies[-1].outcome == "issued"
    assert replies[-1].why.startswith("model unavailable: answered from memory")
    assert directives[0].manoeuvre == "cruise"
    replies, directives = play(nobody, bank, look_and_say("quantum marmalade trombone"))
    assert replies[-1].outcome == "failed"
    assert "reached" in replies[-1].why
    assert not directives


def test_a_superseded_interpretation_hangs_up(bank: str) -> None:
    with FaultyServer("hang", answer()) as server:
        replies, _ = play(
            server.url, bank, look(), say("first things first"), say("a little slower"), asked=lambda: server.bodies
        )
        assert [r.outcome for r in replies] == ["heard", "heard", "superseded", "issued"]
        assert server.hung_up.wait(10)


def test_every_thought_is_kept_that_of_a_command_which_was_replaced_too(bank: str, tmp_path: Path) -> None:
    file = tmp_path / "thoughts.jsonl"
    with FaultyServer("hang", answer()) as server:
        play(
            server.url,
            bank,
            look(),
            say("first things first"),
            say("a little slower"),
            asked=lambda: server.bodies,
            thoughts_path=str(file),
        )
    thoughts = [json.loads(line) for line in file.read_text("utf-8").splitlines()]
    assert [(one["command"], one["outcome"]) for one in thoughts] == [
        ("first things first", "superseded"),
        ("a little slower", "issued"),
    ]
    assert [one["tries"][0]["failed"] for one in thoughts] == ["given up", ""]
    assert len({one["command_id"] for one in thoughts}) == 2


UNUSABLE = {
    "truncated": '{"outcome": "directive", "spe',
    "none": "",
    "wrong schema": '{"outcome": "directive", "velocity": 3}',
}


@pytest.mark.parametrize("content", UNUSABLE.values(), ids=UNUSABLE.keys())
def test_an_unusable_answer_is_repaired_with_the_error_named(content: str, bank: str) -> None:
    with FaultyServer(answer(content), answer()) as server:
        replies, directives = play(server.url, bank, look(), say("a little slower"))
        assert [r.outcome for r in replies] == ["heard", "issued"]
        assert "cannot be used" in json.dumps(server.bodies[1])
        assert [d.manoeuvre for d in directives] == ["cruise"]


@pytest.mark.parametrize("model", [obeys], indirect=True)
def test_the_smallest_time_to_collision_until_the_outcome_is_remembered(model: ScriptedModel, tmp_path: Path) -> None:
    """At 1.5 m/s of closing speed, bumpers 5 m and then 20 m apart."""
    ids: list[int] = []
    readers: list[Subscription[Directive]] = []

    def note(bus: LocalBus) -> None:
        readers.append(bus.subscribe(topics.DIRECTIVE))

    def read(_: LocalBus) -> None:
        ids.extend(directive.id for directive in readers[0].take())

    def fulfil(bus: LocalBus) -> None:
        bus.publish(
            topics.EVENT,
            Event(
                epoch=1,
                stamp_ns=time.monotonic_ns(),
                kind=EventKind.FULFILLED,
                node="fast",
                tick=3,
                directive_id=ids[-1],
            ),
        )

    path = str(tmp_path / "bank.sqlite")
    play(model.url, path, note, look(), say("hurry up, chauffeur"), look(1, x=15), look(2), read, fulfil)
    memory = Memory(load_embedder(), path)
    learnt = memory.examples()[-1]
    memory.close()
    assert (learnt.command, learnt.outcome) == ("hurry up, chauffeur", "fulfilled")
    assert learnt.min_ttc_s == pytest.approx(5.0 / 1.5, rel=1e-3)


def answers(url: str) -> bool:
    try:
        urllib.request.urlopen(url, timeout=1).close()
    except OSError:
        return False
    return True


def test_the_embedded_model_understands_a_hurry(bank: str) -> None:
    pytest.importorskip("xllamacpp")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "slow_node.llm.embedded", json.dumps({"port": port, "polite": False})],
        stderr=subprocess.DEVNULL,
    )
    try:
        until(lambda: answers(f"http://127.0.0.1:{port}/health"), "the model did not come up")
        replies, directives = play(
            f"http://127.0.0.1:{port}/v1",
            bank,
            look_and_say("I'm in a hurry to get to work, I want to drive faster"),
            budget_s=35.0,
            embedded=True,
        )
    finally:
        server.terminate()
        assert server.wait(30) == 0
    assert replies[-1].outcome == "issued", replies[-1].why
    assert "from memory" not in replies[-1].why
    assert directives[0].manoeuvre == "overtake"


def test_a_node_that_starts_again_tells_the_passenger_what_became_of_the_wish_before(bank: str, tmp_path: Path) -> None:
    file = tmp_path / "wishes.json"
    play(
        "http://127.0.0.1:9/v1",
        bank,
        look(),
        say("in ten seconds go left"),
        parser=True,
        embedded=True,
        wishes_path=str(file),
    )
    assert b"in ten seconds go left" in file.read_bytes()
    replies, _ = play("http://127.0.0.1:9/v1", bank, look(), look(1), parser=True, embedded=True, wishes_path=str(file))
    assert [(reply.outcome, reply.why) for reply in replies] == [("failed", "the slow node was restarted")]
    assert "in ten seconds go left" in replies[0].say
    assert file.read_bytes() == b"[]"


CARSICK = "my daughter gets car sick, just so you know"


def test_a_bank_that_somebody_else_holds_keeps_nobody_waiting_and_gets_the_preference_afterwards(
    tmp_path: Path,
) -> None:
    path = str(tmp_path / "bank.sqlite")
    Memory(load_embedder(), path).close()
    holder = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    readers: list[Subscription[Reply]] = []
    heard: list[str] = []

    def lock(bus: LocalBus) -> None:
        holder.execute("BEGIN IMMEDIATE")
        readers.append(bus.subscribe(topics.REPLY))

    def answered() -> bool:
        heard.extend(reply.outcome for reply in readers[0].take())
        return "fulfilled" in heard

    def release(_: LocalBus) -> None:
        assert answered()
        holder.rollback()
        holder.close()

    nobody = "http://127.0.0.1:9/v1"
    _, directives = play(nobody, path, lock, look(), say(CARSICK), release, parser=True, asked=answered)
    assert [d.style for d in directives] == ["calm"]
    memory = Memory(load_embedder(), path)
    assert memory.preferences() == (Preference("gentle", CARSICK),)
    memory.close()


def test_the_journal_begins_with_the_passengers_manner_for_who_listens_only_once_the_node_is_there(
    tmp_path: Path,
) -> None:
    path = str(tmp_path / "bank.sqlite")
    memory = Memory(load_embedder(), path)
    memory.prefer(Preference("gentle", CARSICK))
    memory.close()
    readers: list[Subscription[Journal]] = []

    def listen(bus: LocalBus) -> None:
        readers.append(bus.subscribe(topics.JOURNAL))

    play("http://127.0.0.1:9/v1", path, listen, look())
    first = readers[0].take()[0]
    assert (first.seq, [one.manner for one in first.inputs]) == (0, [("gentle",), None])
