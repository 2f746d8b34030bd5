"""The slow node: what a passenger says, what becomes of it, and what happens when the model fails."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the node's own __main__ does, before NumPy loads

import numpy as np
import pytest

from schemas import topics
from schemas.bus import LocalBus, Subscription
from schemas.messages import Directive, Event, Lane, Observation, Reply
from slow_node.config import SlowConfig
from slow_node.directive import ParseError, Plan, parse_answer, plan_of, unsafe
from slow_node.embedding import HashedEmbedder, load_embedder
from slow_node.memory import Memory
from slow_node.node import build
from slow_node.scene import encode_scene
from slow_node.slots import Slots

FASTER = '{"reasoning":"in a hurry","outcome":"directive","speed":"faster","overtake":true}'
SLOWER = '{"reasoning":"less","outcome":"directive","speed":"slower"}'


def observation(tick: int = 0, epoch: int = 1, lane: int = 1, x: float = 0.0, lead_x: float = 25.0) -> Observation:
    """The two-way road: the ego in its own lane 1, a lead at 3.5 m/s."""
    lanes = (
        Lane(y_m=-4, start_m=-100, end_m=1000, direction=-1, kind="oncoming", speed_limit_mps=10),
        Lane(y_m=0, start_m=-100, end_m=1000, speed_limit_mps=10),
    )
    rows = [(0, x, 4 * lane - 4, 5, 0, 0, 5, 2, lane), (1, lead_x, 0, 3.5, 0, 0, 5, 2, 1)]
    return Observation(epoch=epoch, stamp_ns=time.monotonic_ns(), tick=tick, scenario="two-way", lanes=lanes,
                       rows=np.array(rows, np.float32).tobytes(), target_lane=lane)


class ScriptedModel:
    """An OpenAI-compatible server on loopback that answers with what `script` makes of the newest user turn."""

    def __init__(self, script: Callable[[str], str]) -> None:
        self.prompts: list[str] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                prompt = body["messages"][-1]["content"]
                outer.prompts.append(prompt)
                reply = json.dumps({"choices": [{"message": {"content": script(prompt)}}]}).encode()
                try:
                    self.send_response(200)
                    self.send_header("Content-Length", str(len(reply)))
                    self.end_headers()
                    self.wfile.write(reply)
                except OSError:
                    pass  # the caller has hung up: superseded

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()


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


def play(url: str, bank: str, *steps: Step, wait_s: float = 0.6, budget_s: float = 4.0) -> tuple[
        list[Reply], list[Directive]]:
    """Run the node on an in-process bus, one step every `wait_s`; what it published."""
    bus = LocalBus()
    replies, directives = bus.subscribe(topics.REPLY), bus.subscribe(topics.DIRECTIVE)
    seen: list[Directive] = []
    node, memory = build(bus, SlowConfig(base_url=url, memory_path=bank, budget_s=budget_s))

    async def run() -> None:
        stop = asyncio.Event()
        task = asyncio.create_task(node.run(stop.is_set))
        for step in steps:
            step(bus)
            await asyncio.sleep(wait_s)
            seen.extend(directives.take())
        stop.set()
        await task

    try:
        asyncio.run(run())
    finally:
        memory.close()
    return replies.take(), seen


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


def slow_first(prompt: str) -> str:
    if "first" in prompt:
        time.sleep(1.0)
        return FASTER
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
    replies, directives = play(model.url, bank, look(), say(payload), wait_s=0.15)
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
    replies, directives = play(model.url, bank, look(), say("first things first"), say("a little slower"))
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
            bus.publish(topics.EVENT, Event(epoch=1, stamp_ns=time.monotonic_ns(), kind="fulfilled", node="fast",
                                            tick=tick, directive_id=ids[-1]))
        return step

    def note(bus: LocalBus) -> None:
        readers.append(bus.subscribe(topics.DIRECTIVE))

    def read(_: LocalBus) -> None:
        newest = readers[0].peek()
        assert newest is not None
        ids.append(newest.id)

    replies, directives = play(
        model.url, bank, note, look(), say("I'm in a hurry"), look(1, lane=0, x=10), read, fulfilled(1),
        look(2, lane=0, x=40), look(3, lane=1, x=45), read, fulfilled(3), wait_s=0.4)
    assert [d.target_lane for d in directives] == [0, 1]
    assert [r.outcome for r in replies] == ["heard", "issued", "issued", "fulfilled"]


@pytest.mark.parametrize("model", [obeys], indirect=True)
def test_an_active_wish_survives_a_reset_of_the_world(model: ScriptedModel, bank: str) -> None:
    _, directives = play(model.url, bank, look(), say("I'm in a hurry"), look(0, epoch=2))
    assert [d.epoch for d in directives] == [1, 2]


def test_without_a_model_memory_answers_or_a_reason_is_given(bank: str) -> None:
    nobody = "http://127.0.0.1:9/v1"
    replies, directives = play(nobody, bank, look(), say("please slow down"), wait_s=2.0)
    assert replies[-1].outcome == "issued"
    assert replies[-1].why.startswith("model unavailable: answered from memory")
    assert directives[0].manoeuvre == "cruise"
    replies, directives = play(nobody, bank, look(), say("quantum marmalade trombone"), wait_s=2.0)
    assert replies[-1].outcome == "failed"
    assert "reached" in replies[-1].why
    assert not directives


def test_a_paraphrase_finds_its_example(bank: str) -> None:
    memory = Memory(load_embedder(), bank)
    assert memory.nearest("I need to catch my flight", 1)[0].slots.overtake
    memory.close()
    assert np.isclose(np.linalg.norm(HashedEmbedder().embed("anything")), 1.0)


def test_gates() -> None:
    scene = encode_scene(observation())
    faster = plan_of(Slots(outcome="directive", target_speed_mps=60.0), scene)
    assert isinstance(faster, Plan)
    assert faster.target_speed_mps == 10.0
    assert not isinstance(plan_of(Slots(outcome="directive", lane="right"), scene), Plan)
    with pytest.raises(ParseError, match="speed"):
        parse_answer('{"outcome":"directive","speed":"ludicrous"}')


def test_the_embedded_model_understands_a_hurry(bank: str) -> None:
    pytest.importorskip("xllamacpp")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = subprocess.Popen([sys.executable, "-m", "slow_node.embedded", json.dumps({"port": port})],
                              stderr=subprocess.DEVNULL)
    try:
        for _ in range(100):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=1).close()
                break
            except OSError:
                time.sleep(0.2)
        replies, directives = play(
            f"http://127.0.0.1:{port}/v1", bank, look_and_say("I'm in a hurry to get to work, I want to drive faster"),
            wait_s=12.0, budget_s=9.0)
    finally:
        server.terminate()
        assert server.wait(10) == 0
    assert replies[-1].outcome == "issued", replies[-1].why
    assert "from memory" not in replies[-1].why
    assert directives[0].manoeuvre == "overtake"
