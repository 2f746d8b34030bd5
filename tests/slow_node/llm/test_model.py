"""The model's client against a server that misbehaves in every way of the fault table."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest

from slow_node.llm.breaker import Breaker
from slow_node.llm.endpoint import is_loopback
from slow_node.llm.errors import ModelError
from slow_node.llm.model import Call, ChatModel
from slow_node.understanding.slots import answer_schema
from tests.faulty_server import SLOWER, FaultyServer, answer

CHAT = [{"role": "user", "content": 'Command: "go faster"'}]


def ask(
    url: str,
    *,
    budget_s: float = 20.0,
    times: int = 1,
    at_once: bool = False,
    breaker: Breaker | None = None,
    schema: dict[str, Any] | None = None,
    calls: list[Call] | None = None,
) -> tuple[list[str], ChatModel]:
    """What `times` calls gave: the answer, or the error's class and text."""
    model = ChatModel(url, "gpt-4o-mini", "a-key", breaker=breaker)

    async def one() -> str:
        try:
            return await model.complete(CHAT, schema or {"type": "object"}, budget_s, calls)
        except ModelError as error:
            return f"{type(error).__name__}: {error}"

    async def run() -> list[str]:
        outcomes = (
            await asyncio.gather(*[one() for _ in range(times)]) if at_once else [await one() for _ in range(times)]
        )
        await model.close()
        return outcomes

    return asyncio.run(run()), model


@pytest.fixture(autouse=True)
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses [s] before each retry, noted and not waited for."""
    noted: list[float] = []
    sleep = asyncio.sleep

    async def note(delay: float) -> None:
        noted.append(delay)
        await sleep(0)

    monkeypatch.setattr("slow_node.llm.model.asyncio.sleep", note)
    return noted


Answer = tuple[int, dict[str, str], bytes]
BUSY: Answer = (429, {}, b"")
BROKEN: Answer = (500, {}, b"")
WRONG_KEY: Answer = (401, {}, b"")
BAD_REQUEST: Answer = (400, {}, b'{"error": "response_format is not supported"}')
HTML: Answer = (200, {"Content-Type": "text/html"}, b"<!doctype html><title>Log in</title>")
TRUNCATED: Answer = (200, {}, b'{"choices": [{"mess')
PASSING: dict[str, object] = {
    "429": BUSY,
    "500": BROKEN,
    "503": (503, {}, b""),
    "disconnect": "disconnect",
    "truncated": TRUNCATED,
}
passing = pytest.mark.parametrize("fault", PASSING.values(), ids=PASSING.keys())


@passing
def test_a_passing_fault_is_retried_within_the_budget(fault: object) -> None:
    with FaultyServer(fault, answer()) as server:
        assert (ask(server.url)[0], len(server.bodies)) == ([SLOWER], 2)


@passing
def test_a_lasting_fault_is_retried_twice_and_never_a_third_time(fault: object) -> None:
    with FaultyServer(fault) as server:
        ask(server.url)
        assert len(server.bodies) == 3


@pytest.mark.parametrize("status", [401, 403, 404])
def test_a_request_that_the_server_will_not_serve_is_not_retried(status: int) -> None:
    with FaultyServer((status, {}, b"")) as server:
        ask(server.url)
        assert len(server.bodies) == 1


def test_the_pauses_between_tries_vary(pauses: list[float]) -> None:
    with FaultyServer(BUSY) as server:
        ask(server.url, times=3)
    assert len(set(pauses)) == len(pauses) == 6


def test_the_pause_that_a_server_asks_for_is_kept(pauses: list[float]) -> None:
    with FaultyServer((429, {"Retry-After": "7"}, b""), answer()) as server:
        ask(server.url)
    assert pauses == [7.0]


def test_a_server_that_asks_for_a_pause_beyond_the_budget_is_not_asked_again() -> None:
    with FaultyServer((429, {"Retry-After": "60"}, b""), answer()) as server:
        outcomes, _ = ask(server.url)
        assert "429" in outcomes[0]
        assert len(server.bodies) == 1


@pytest.mark.parametrize("fault", ["hang", "drip"])
def test_a_server_that_takes_for_ever_costs_the_budget_and_its_connection_is_closed(fault: str) -> None:
    with FaultyServer(fault) as server:
        outcomes, _ = ask(server.url, budget_s=0.3)
        assert outcomes == ["ModelTimeoutError: the model did not answer within 0.3 s"]
        assert server.hung_up.wait(10)


def test_two_calls_share_one_connection() -> None:
    with FaultyServer(answer()) as server:
        ask(server.url, times=2)
        assert (len(server.bodies), server.connections) == (2, 1)


def test_answer_formats_fall_back_once_from_schema_to_object_to_plain_text() -> None:
    with FaultyServer(BAD_REQUEST, BAD_REQUEST, answer()) as server:
        ask(server.url, times=2)
        assert server.formats == ["json_schema", "json_object", None, None]


def no_schemas(body: dict[str, Any]) -> object:
    """A server that breaks over a schema."""
    return BROKEN if body.get("response_format", {}).get("type") == "json_schema" else answer()


def test_a_server_that_breaks_over_schemas_is_asked_without_from_the_third_call_on() -> None:
    with FaultyServer(no_schemas) as server:
        outcomes, _ = ask(server.url, times=3)
        assert outcomes == [SLOWER] * 3
        assert server.formats == ["json_schema", "json_object", "json_schema", "json_object", "json_object"]


def test_a_fault_that_passed_by_itself_does_not_cost_the_schema() -> None:
    with FaultyServer(BROKEN, answer()) as server:
        ask(server.url, times=3)
        assert server.formats == ["json_schema", "json_object", "json_schema", "json_schema"]


@pytest.mark.parametrize("short", [False, True])
def test_only_a_schema_whose_slots_are_all_required_is_posted_as_strict(short: bool) -> None:
    with FaultyServer(answer()) as server:
        ask(server.url, schema=answer_schema(short))
        assert server.bodies[0]["response_format"]["json_schema"]["strict"] is not short


USELESS: dict[str, tuple[object, str]] = {
    "refusal": (answer("", refusal="I cannot help with that"), "declined to answer"),
    "HTML": (HTML, "no JSON"),
    "another format": ((200, {}, b'{"text": "faster"}'), "OpenAI chat format"),
}
useless = pytest.mark.parametrize(("reply", "why"), USELESS.values(), ids=USELESS.keys())


@useless
def test_an_answer_of_no_use_is_an_error_that_says_why(reply: object, why: str) -> None:
    with FaultyServer(reply) as server:
        outcome = ask(server.url)[0][0]
        assert outcome.startswith("ModelAnswerError")
        assert why in outcome


@useless
def test_answers_of_no_use_do_not_open_the_breaker(reply: object, why: str) -> None:
    with FaultyServer(reply) as server:
        assert why in ask(server.url, times=5)[0][4]


def test_a_wrong_key_is_never_quoted() -> None:
    with FaultyServer(WRONG_KEY) as server:
        outcomes, _ = ask(server.url)
        assert "401" in outcomes[0]
        assert "a-key" not in outcomes[0]


def test_tokens_and_their_price_are_counted() -> None:
    with FaultyServer(answer()) as server:
        _, model = ask(server.url, times=2)
        assert (model.prompt_tokens, model.answer_tokens) == (14, 6)
        assert model.cost_usd == pytest.approx(14 * 0.15e-6 + 6 * 0.60e-6)


def test_an_answer_of_no_use_costs_its_tokens_and_keeps_its_thoughts() -> None:
    calls: list[Call] = []
    with FaultyServer(answer("<think>draft")) as server:
        _, model = ask(server.url, calls=calls)
    assert [call.answer.thinking for call in calls if call.answer] == ["draft"] * 3
    assert (model.prompt_tokens, model.answer_tokens) == (21, 9)
    assert model.cost_usd == pytest.approx(21 * 0.15e-6 + 9 * 0.60e-6)


def test_the_price_of_a_model_nobody_listed_is_unknown_unless_it_runs_here() -> None:
    assert ChatModel("https://models.example/v1", "some-model", "").price_usd is None
    assert ChatModel("http://127.0.0.1:9/v1", "some-model", "").price_usd == (0.0, 0.0)


@pytest.mark.parametrize(
    ("url", "loopback"),
    [
        ("http://127.0.0.1:8000/v1", True),
        ("http://localhost:11434/v1", True),
        ("http://[::1]:8000/v1", True),
        ("http://127.0.0.2/v1", True),
        ("https://api.openai.com/v1", False),
        ("https://models.example/127.0.0.1", False),
        ("http://192.168.0.7/v1", False),
        ("http://localhost.example/v1", False),
    ],
)
def test_only_a_host_that_is_this_machine_is_loopback(url: str, loopback: bool) -> None:
    assert is_loopback(url) is loopback


def test_a_call_to_localhost_passes_by_the_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NO_PROXY", "no_proxy", "http_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    with FaultyServer(answer()) as server:
        assert ask(server.url.replace("127.0.0.1", "localhost"))[0] == [SLOWER]


class Watch:
    """A clock for the breaker, put forward by hand. Seconds."""

    def __init__(self) -> None:
        self.now = 0.0
        self.breaker = Breaker(lambda: self.now)


def test_the_breaker_opens_after_three_failures_and_closes_after_a_good_probe() -> None:
    watch = Watch()
    with FaultyServer(*[WRONG_KEY] * 4, answer()) as server:
        outcomes, _ = ask(server.url, times=4, breaker=watch.breaker)
        assert "left alone" in outcomes[3]
        assert len(server.bodies) == 3
        watch.now = 6.0
        assert "401" in ask(server.url, times=2, breaker=watch.breaker)[0][0]  # fails: open again, twice as long
        assert len(server.bodies) == 4
        watch.now = 17.0
        assert ask(server.url, times=2, breaker=watch.breaker)[0] == [SLOWER, SLOWER]


def test_a_half_open_breaker_lets_a_single_probe_through() -> None:
    watch = Watch()
    with FaultyServer(*[WRONG_KEY] * 3, answer()) as server:
        ask(server.url, times=3, breaker=watch.breaker)
        watch.now = 6.0
        ask(server.url, times=3, at_once=True, breaker=watch.breaker)
        assert len(server.bodies) == 4


def test_a_probe_given_up_by_its_caller_lets_the_next_one_through() -> None:
    watch = Watch()
    for _ in range(3):
        watch.breaker.enter()
        watch.breaker.failed()
    watch.now = 6.0
    assert watch.breaker.enter()
    watch.breaker.dropped()
    assert watch.breaker.enter()


def test_refused_connections_open_the_breaker() -> None:
    with socket.socket() as held:  # bound and not listening: nobody else gets the port
        held.bind(("127.0.0.1", 0))
        outcomes, _ = ask(f"http://127.0.0.1:{held.getsockname()[1]}/v1", times=4)
    assert "cannot be reached" in outcomes[2]
    assert "left alone" in outcomes[3]


def cancelled(server: FaultyServer, breaker: Breaker) -> None:
    """A call that is given up once the server has it."""

    async def run() -> None:
        model = ChatModel(server.url, "gpt-4o-mini", "", breaker=breaker)
        call = asyncio.create_task(model.complete(CHAT, None, 20.0))
        before = len(server.bodies)
        while len(server.bodies) == before and not call.done():
            await asyncio.wait([call], timeout=0.01)
        call.cancel()
        await asyncio.wait([call])
        await model.close()

    asyncio.run(run())


def test_a_call_that_is_given_up_closes_its_connection() -> None:
    with FaultyServer("hang") as server:
        cancelled(server, Breaker())
        assert server.hung_up.wait(10)


def test_calls_that_are_given_up_do_not_open_the_breaker() -> None:
    breaker = Breaker()
    with FaultyServer("hang") as server:
        for _ in range(4):
            cancelled(server, breaker)
    assert breaker.enter()
