"""A contract per server: how it wants to be asked and where it puts the answer, as its own API has it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest

from slow_node.llm.endpoint import endpoint_url
from slow_node.llm.errors import ModelError
from slow_node.llm.model import Call, ChatModel
from tests.faulty_server import SLOWER, FaultyServer

DRAFT = '{"outcome":"directive","speed":"faster","overtake":true}'
"""What the model considers in its thoughts, and does not mean."""
SCHEMA: dict[str, Any] = {"type": "object", "properties": {"outcome": {}}, "required": ["outcome"]}
Body = dict[str, Any]
Reply = tuple[int, dict[str, str], bytes]


def replied(status: int, body: object, **headers: str) -> Reply:
    return status, headers, json.dumps(body).encode()


def chat(message: dict[str, object], finish: str = "stop", **more: object) -> Reply:
    return replied(
        200,
        {
            "id": "chatcmpl-1",
            "object": "chat.completion",
            "model": "m-2026",
            "choices": [{"index": 0, "message": {"role": "assistant", **message}, "finish_reason": finish}],
            "usage": {"prompt_tokens": 70, "completion_tokens": 30, "total_tokens": 100},
            **more,
        },
    )


def openai_reasoning(body: Body) -> Reply:
    """gpt-5 and the o series: another name for the bound, no temperature but their own."""
    if "max_tokens" in body:
        say = "Unsupported parameter: 'max_tokens' is not supported. Use 'max_completion_tokens' instead."
        return replied(400, {"error": {"message": say, "param": "max_tokens", "code": "unsupported_parameter"}})
    if body.get("temperature", 1) != 1:
        say = "Unsupported value: 'temperature' does not support 0 with this model. Only the default (1) is supported."
        return replied(400, {"error": {"message": say, "param": "temperature", "code": "unsupported_value"}})
    return chat({"content": SLOWER, "refusal": None, "annotations": []})


def azure_v1(body: Body) -> Reply:
    """Azure OpenAI's v1 API: as OpenAI's, and every answer was filtered."""
    filtered = {"hate": {"filtered": False, "severity": "safe"}}
    return chat({"content": SLOWER, "refusal": None}, prompt_filter_results=[{"content_filter_results": filtered}])


def ollama(body: Body) -> Reply:
    """Thoughts are in `reasoning`, the error of a model that is not there is one string."""
    if body["model"] != "m":
        return replied(404, {"error": f'model "{body["model"]}" not found, try pulling it first'})
    return chat({"content": SLOWER, "reasoning": f"Perhaps {DRAFT}? No."})


def vllm(_: Body) -> Reply:
    """With a reasoning parser: thoughts in `reasoning_content`, and an answer that is not there yet is null."""
    return chat({"content": f"\n\n{SLOWER}", "reasoning_content": f"Perhaps {DRAFT}? No.", "tool_calls": []})


def vllm_without_parser(_: Body) -> Reply:
    """The template has opened the thoughts already."""
    return chat({"content": f"Perhaps {DRAFT}? No.\n</think>\n\n{SLOWER}", "reasoning_content": None})


def vllm_astray(_: Body) -> Reply:
    """Thinking is switched off, and the parser takes the answer for a thought."""
    return chat({"content": None, "reasoning_content": SLOWER})


def llama_cpp(body: Body) -> Reply:
    """A schema that cannot be made into a grammar is refused; timings come with the answer."""
    if body.get("response_format", {}).get("type") == "json_schema":
        say = "JSON schema conversion failed: unrecognized schema"
        return replied(400, {"error": {"code": 400, "message": say, "type": "invalid_request_error"}})
    return chat({"content": f"<think>\nPerhaps {DRAFT}?\n</think>\n{SLOWER}"}, timings={"prompt_n": 70})


def lm_studio(body: Body) -> Reply:
    """It takes a schema or text, and no `json_object`."""
    if body.get("response_format", {}).get("type") == "json_object":
        return replied(400, {"error": "'response_format.type' must be 'json_schema' or 'text'"})
    return chat({"content": SLOWER, "reasoning_content": "", "tool_calls": []}, stats={})


def openrouter(_: Body) -> Reply:
    """White space keeps the connection while a provider is found; the cost is told."""
    status, headers, body = chat(
        {"content": SLOWER, "reasoning": "Perhaps.", "reasoning_details": [{"type": "reasoning.text"}]},
        provider="Somebody",
        usage={"prompt_tokens": 70, "completion_tokens": 30, "cost": 0.00042},
    )
    return status, headers, b"\n         \n" + body


def mistral(_: Body) -> Reply:
    """Magistral's content is a list of parts."""
    thought = {"type": "thinking", "thinking": [{"type": "text", "text": f"Perhaps {DRAFT}?"}]}
    return chat({"content": [thought, {"type": "text", "text": SLOWER}]})


def harmony(_: Body) -> Reply:
    """gpt-oss behind a server that does not know its channels."""
    thought = f"<|channel|>analysis<|message|>Perhaps {DRAFT}?<|end|><|start|>assistant"
    return chat({"content": f"{thought}<|channel|>final <|constrain|>json<|message|>{SLOWER}<|return|>"})


def tool_call(_: Body) -> Reply:
    """A model that answers by calling a tool that nobody has offered."""
    called = {"id": "1", "type": "function", "function": {"name": "answer", "arguments": SLOWER}}
    return chat({"content": None, "tool_calls": [called]}, finish="tool_calls")


SERVERS: list[tuple[Callable[[Body], Reply], int]] = [
    (openai_reasoning, 3),
    (azure_v1, 1),
    (ollama, 1),
    (vllm, 1),
    (vllm_without_parser, 1),
    (vllm_astray, 1),
    (llama_cpp, 2),
    (lm_studio, 1),
    (openrouter, 1),
    (mistral, 1),
    (harmony, 1),
    (tool_call, 1),
]


def ask(
    server: FaultyServer,
    *,
    times: int = 1,
    model: str = "m",
    key: str = "",
    schema: dict[str, Any] | None = SCHEMA,
    path: str = "",
    calls: list[Call] | None = None,
) -> tuple[list[str], ChatModel]:
    """What the model said so many times in a row, or why it did not."""
    asked = ChatModel(server.url + path, model, key)

    async def run() -> list[str]:
        said = []
        for _ in range(times):
            try:
                said.append(await asked.complete([{"role": "user", "content": "slower"}], schema, 20.0, calls))
            except ModelError as error:
                said.append(str(error))
        await asked.close()
        return said

    return asyncio.run(run()), asked


@pytest.mark.parametrize(("script", "requests"), SERVERS, ids=lambda one: getattr(one, "__name__", None))
def test_a_server_is_asked_and_read_in_its_own_dialect_and_learnt_once(
    script: Callable[[Body], Reply], requests: int
) -> None:
    with FaultyServer(script) as server:
        said, model = ask(server, times=2)
        assert [one.strip() for one in said] == [SLOWER, SLOWER]
        assert len(server.bodies) == requests + 1
        assert (model.prompt_tokens, model.answer_tokens) == (140, 60)


@pytest.mark.parametrize("script", [vllm, vllm_without_parser, ollama, llama_cpp, mistral, harmony])
def test_thoughts_are_kept_apart_from_the_answer(script: Callable[[Body], Reply]) -> None:
    calls: list[Call] = []
    with FaultyServer(script) as server:
        ask(server, calls=calls)
    answer = calls[-1].answer
    assert answer is not None
    assert DRAFT in answer.thinking
    assert DRAFT not in answer.text


def test_the_cost_that_a_server_tells_counts() -> None:
    with FaultyServer(openrouter) as server:
        assert ask(server, times=2)[1].cost_usd == pytest.approx(0.00084)


def test_azures_key_and_version_are_where_it_looks_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slow_node.llm.transport.is_azure", lambda _: True)
    with FaultyServer(azure_v1) as server:
        ask(server, key="k-1", path="/../openai/v1?api-version=preview")
        assert server.paths[0].endswith("/openai/v1/chat/completions?api-version=preview")
        assert (server.headers[0]["api-key"], server.headers[0]["authorization"]) == ("k-1", "Bearer k-1")


def test_without_a_key_no_header_claims_one() -> None:
    with FaultyServer(ollama) as server:
        ask(server)
        assert "authorization" not in server.headers[0]


THOUGHTS_ONLY: dict[str, Reply] = {
    "cut off in a field": chat({"content": "", "reasoning_content": f"Perhaps {DRAFT}"}, finish="length"),
    "cut off in the text": chat({"content": f"<think>Perhaps {DRAFT}"}, finish="length"),
    "without an answer": chat({"content": "", "reasoning": f"Perhaps {DRAFT}? I wonder."}),
}


@pytest.mark.parametrize("reply", THOUGHTS_ONLY.values(), ids=THOUGHTS_ONLY.keys())
def test_a_draft_in_thoughts_that_come_to_no_answer_is_none(reply: Reply) -> None:
    with FaultyServer(reply) as server:
        said = ask(server)[0][0]
    assert "speed" not in said
    assert "--max-tokens" in said or "answered nothing" in said


SENTENCES: dict[str, tuple[Reply, str]] = {
    "Ollama": (ollama({"model": "qwen"}), "try pulling it first"),
    "OpenAI": (
        replied(429, {"error": {"message": "You exceeded your current quota", "code": "insufficient_quota"}}),
        "You exceeded your current quota",
    ),
    "FastAPI": (replied(422, {"detail": [{"loc": ["body"], "msg": "field required"}]}), "field required"),
    "OpenRouter, within HTTP 200": (
        replied(200, {"error": {"code": 402, "message": "Insufficient credits", "metadata": {"raw": "add more"}}}),
        "Insufficient credits: add more",
    ),
    "a proxy's page": ((403, {}, b"<html><title>Sign in\nfirst</title>"), "Sign in first"),
    "terminal codes": (replied(404, {"error": "no\x1b]0;owned\x07 \u202emodel\u009b2J"}), "no ]0;owned model 2J"),
}


@pytest.mark.parametrize(("reply", "sentence"), SENTENCES.values(), ids=SENTENCES.keys())
def test_the_servers_own_sentence_is_in_the_error_and_fit_to_be_shown(reply: Reply, sentence: str) -> None:
    with FaultyServer(reply) as server:
        said = ask(server, schema=None)[0][0]
    assert sentence in said
    assert said.isprintable()


def test_a_quota_that_is_used_up_is_not_asked_again() -> None:
    with FaultyServer(SENTENCES["OpenAI"][0]) as server:
        ask(server)
        assert len(server.bodies) == 1


QUOTED = "Incorrect API key provided: secret-of-mine (sk-proj-abcd****wxyz)"


@pytest.mark.parametrize(
    "reply",
    [
        replied(401, {"error": {"message": QUOTED}}),
        replied(200, {"error": {"message": QUOTED, "code": 401}}),
        chat({"content": "", "refusal": QUOTED}),
    ],
)
def test_a_key_that_a_server_quotes_is_not_passed_on(reply: Reply) -> None:
    with FaultyServer(reply) as server:
        error = ask(server, key="secret-of-mine")[0][0]
    assert "Incorrect API key provided" in error
    assert "secret-of-mine" not in error
    assert "abcd" not in error


def test_a_single_refusal_without_words_does_not_weaken_the_answer_format() -> None:
    with FaultyServer((400, {}, b""), chat({"content": SLOWER})) as server:
        ask(server, times=3)
        assert server.formats == ["json_schema", "json_object", "json_schema", "json_schema"]


def test_a_server_that_moved_says_where_to() -> None:
    with FaultyServer((301, {"Location": "https://models.example/v1"}, b"")) as server:
        assert "https://models.example/v1" in ask(server)[0][0]


@pytest.mark.parametrize(
    ("written", "url"),
    [
        ("http://127.0.0.1:8000/v1", "http://127.0.0.1:8000/v1"),
        ("http://127.0.0.1:8000", "http://127.0.0.1:8000/v1"),
        ("localhost:11434", "http://localhost:11434/v1"),
        ("192.168.0.7:1234/v1/", "http://192.168.0.7:1234/v1"),
        ("api.openai.com", "https://api.openai.com/v1"),
        ("https://openrouter.ai", "https://openrouter.ai/api/v1"),
        ("https://mine.openai.azure.com/", "https://mine.openai.azure.com/openai/v1"),
        (
            "https://mine.openai.azure.com/openai/deployments/gpt?api-version=2025-04-01",
            "https://mine.openai.azure.com/openai/deployments/gpt?api-version=2025-04-01",
        ),
        ("https://models.example/v1/chat/completions", "https://models.example/v1"),
        ("http://[::1]:8000", "http://[::1]:8000/v1"),
    ],
)
def test_a_base_url_is_completed_as_it_was_meant(written: str, url: str) -> None:
    assert endpoint_url(written) == url


@pytest.mark.parametrize(
    ("written", "fix"),
    [
        ("http://127.0.0.1:port/v1", "port 'port'"),
        ("http://127.0.0.1:99999/v1", "port '99999'"),
        ("ftp://127.0.0.1", "look like"),
        ("", "look like"),
        ("http://", "look like"),
        ("http://[::1", "look like"),
        ("https://me:secret@models.example/v1", "OPENAI_API_KEY"),
        ("https://models.example/v1?key=secret", "OPENAI_API_KEY"),
    ],
)
def test_a_base_url_that_is_none_is_refused_with_its_fix_and_without_its_secret(written: str, fix: str) -> None:
    with pytest.raises(ValueError, match=fix) as refused:
        endpoint_url(written)
    assert "secret" not in str(refused.value)
