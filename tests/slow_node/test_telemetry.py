"""Thoughts as spans by the GenAI conventions, in OpenTelemetry's own exporter for tests."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from typing import Any

import pytest

from slow_node.interpreter import Interpreter
from slow_node.llm.model import ChatModel
from slow_node.memory.bank import Memory
from slow_node.planning.scene import encode_scene
from slow_node.telemetry import Telemetry, telemetry_of
from slow_node.thought import Trace, thought_of
from tests.faulty_server import SLOWER, FaultyServer, answer
from tests.running import ROOT
from tests.scenes import car, lane, observation

BUSY: tuple[int, dict[str, str], bytes] = (503, {}, b'{"error":"loading model"}')


def spans(server: FaultyServer, memory: Memory, *, content: bool = False) -> list[Any]:
    """What is exported of one command, the chats first."""
    sdk = pytest.importorskip("opentelemetry.sdk.trace")
    export = pytest.importorskip("opentelemetry.sdk.trace.export")
    memory_exporter = pytest.importorskip("opentelemetry.sdk.trace.export.in_memory_span_exporter")
    kept = memory_exporter.InMemorySpanExporter()
    provider = sdk.TracerProvider()
    provider.add_span_processor(export.SimpleSpanProcessor(kept))
    model = ChatModel(server.url, "qwen3:8b", "secret-of-mine", max_tokens=500)
    interpreter = Interpreter(memory, model, None, style="full", k=4, budget_s=20.0, ask="always")
    scene = encode_scene(observation(car(0, 100, 0, 5), lanes=(lane(0),)))
    trace = Trace()

    async def run() -> None:
        found = await interpreter.interpret("a gentle pace please", scene, trace=trace)
        await interpreter.close()
        thought = thought_of(
            trace,
            epoch=1,
            stamp_ns=1,
            command_id=7,
            command="a gentle pace please",
            source=found.source,
            outcome="issued",
            slots=found.slots,
        )
        Telemetry(provider, model, content=content).thought(trace, thought)

    asyncio.run(run())
    provider.shutdown()
    return list(kept.get_finished_spans())


def test_a_command_is_a_span_and_each_answer_that_was_asked_for_one_below_it(memory: Memory) -> None:
    with FaultyServer(BUSY, answer("Gladly!"), answer()) as server:
        first, repair, whole = spans(server, memory)
        assert (first.name, repair.name, whole.name) == ("chat qwen3:8b", "chat qwen3:8b", "invoke_agent fastslow")
        assert first.parent.span_id == repair.parent.span_id == whole.context.span_id
        assert whole.start_time <= first.start_time < first.end_time <= repair.start_time < whole.end_time
        assert [event.attributes["error.message"] for event in first.events] == [
            "the model's server answered HTTP 503: loading model"
        ]


def test_a_chat_has_the_attributes_that_the_conventions_ask_for(memory: Memory) -> None:
    with FaultyServer(answer(SLOWER)) as server:
        chat, whole = spans(server, memory)
        port = server.server.server_address[1]
    assert chat.kind.name == "CLIENT"
    assert {name: value for name, value in chat.attributes.items() if not name.startswith("gen_ai.response")} == {
        "gen_ai.operation.name": "chat",
        "gen_ai.provider.name": "openai",
        "gen_ai.request.model": "qwen3:8b",
        "gen_ai.request.max_tokens": 500,
        "gen_ai.output.type": "json",
        "gen_ai.usage.input_tokens": 7,
        "gen_ai.usage.output_tokens": 3,
        "server.address": "127.0.0.1",
        "server.port": port,
    }
    assert (whole.attributes["fastslow.command_id"], whole.attributes["fastslow.outcome"]) == ("7", "issued")


def test_a_model_that_does_not_answer_is_an_error(memory: Memory) -> None:
    with FaultyServer((404, {}, b'{"error":"model not found"}')) as server:
        chat, _ = spans(server, memory)
    assert (chat.status.status_code.name, chat.attributes["error.type"]) == ("ERROR", "404")
    assert "model not found" in chat.status.description


def test_words_are_exported_only_where_they_are_asked_for(memory: Memory) -> None:
    with FaultyServer(answer(SLOWER)) as server:
        without = "".join(span.to_json() for span in spans(server, memory))
        chat, whole = spans(server, memory, content=True)
    assert "gentle pace" not in without
    assert "secret-of-mine" not in without + chat.to_json() + whole.to_json()
    assert "gentle pace" in json.loads(chat.attributes["gen_ai.input.messages"])[-1]["parts"][0]["content"]
    assert json.loads(chat.attributes["gen_ai.output.messages"])[0]["parts"][0]["content"] == SLOWER


def test_without_an_endpoint_nothing_of_opentelemetry_is_loaded() -> None:
    code = (
        "import sys; from slow_node.llm.model import ChatModel; from slow_node.telemetry import telemetry_of;"
        "telemetry_of(ChatModel('http://127.0.0.1:9/v1', 'm', ''));"
        "sys.exit(any(name.startswith('opentelemetry') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], env={"PATH": ""}, cwd=ROOT, check=False).returncode == 0


def test_an_endpoint_without_the_package_is_told_with_the_fix_and_costs_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "opentelemetry.exporter.otlp.proto.http.trace_exporter", None)
    telemetry_of(ChatModel("http://127.0.0.1:9/v1", "m", "")).close()
    assert "fastslow[otel]" in capsys.readouterr().err
