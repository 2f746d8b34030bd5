"""What a server sends, and what our own machine's settings say, costs an answer at most: never the slow node."""

from __future__ import annotations

import asyncio
import gzip
import json
import tracemalloc
import zlib
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slow_node.llm.answer import MAX_ANSWER_CHARS, json_object, split_thoughts
from slow_node.llm.errors import ModelError, http_error
from slow_node.llm.model import ChatModel
from slow_node.llm.transport import MAX_BODY_BYTES
from tests.faulty_server import SLOWER, FaultyServer, answer

BOMB = gzip.compress(bytes(300_000_000), compresslevel=9)
"""Some 300 kB that inflate to 300 MB."""


def said(url: str, key: str = "") -> str:
    """What the model says, or why it does not."""

    async def run() -> str:
        model = ChatModel(url, "m", key)
        try:
            return await model.complete([{"role": "user", "content": "slower"}], None, 20.0)
        except ModelError as error:
            return str(error)
        finally:
            await model.close()

    return asyncio.run(run())


FLOODS: dict[str, tuple[object, str]] = {
    "a body without end": ("endless", "more than 1000 kB"),
    "a gzip bomb": ((200, {"Content-Encoding": "gzip"}, BOMB), "more than 1000 kB"),
    "much JSON": ((200, {}, json.dumps({"choices": ["x" * 20_000_000]}).encode()), "more than 1000 kB"),
    "an error without end": ((500, {}, b"x" * 20_000_000), "more than 1000 kB"),
    "brackets": ((200, {}, b"[" * 900_000), "no JSON"),
    "a header": ((200, {"X-Long": "x" * 1_000_000}, b"{}"), "cannot be reached"),
    "an encoding": ((200, {"Content-Encoding": "br"}, b"{}"), "not asked for"),
    "broken gzip": ((200, {"Content-Encoding": "gzip"}, b"no gzip"), "broken gzip"),
}


@pytest.mark.parametrize(("flood", "why"), FLOODS.values(), ids=FLOODS.keys())
def test_a_flood_is_an_error_and_takes_a_few_megabytes_at_most(
    flood: object, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slow_node.llm.model.RETRIES", 0)
    with FaultyServer(flood) as server:
        said(server.url)  # what is loaded by a first request is not the flood's
        tracemalloc.start()
        try:
            error = said(server.url)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert why in error
    # The server, in this process, has its own copies of what it sends; the bomb and the endless body it has not.
    assert peak < 12 * MAX_BODY_BYTES


HEADERS: dict[str, tuple[int, dict[str, str]]] = {
    **{
        f"a pause of {pause[:9]}": (429, {"Retry-After": pause}) for pause in ("nan", "-inf", "1e400", "-5", "9" * 4000)
    },
    "colours": (503, {"Retry-After": "\x1b[31m\x9b2J"}),
    "a place of its own": (307, {"Location": "\x1b]0;title\x07http://x/" + "y" * 5000}),
    "an encoding in colours": (200, {"Content-Encoding": "\x1b[31mred" * 50}),
    "a type": (200, {"Content-Type": "text/\xff; charset=none-such"}),
    "many": (200, {f"X-{k}": "x" * 50 for k in range(90)}),
}


@pytest.mark.parametrize(("status", "headers"), HEADERS.values(), ids=HEADERS.keys())
def test_whatever_stands_in_an_answer_s_headers_is_one_line_and_no_pause(
    status: int, headers: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slow_node.llm.model.RETRY_PAUSE_S", 0.0)
    with FaultyServer((status, headers, b"no JSON")) as server:
        error = said(server.url)
    assert error.isprintable()
    assert len(error) < 500


@given(st.text(max_size=30))
def test_a_pause_that_a_server_asks_for_is_a_time(header: str) -> None:
    error = http_error(429, retry_after=header)
    assert 0.0 <= error.retry_after_s <= 3600.0


@pytest.mark.parametrize("squeeze", [gzip.compress, zlib.compress])
def test_an_answer_that_a_proxy_has_compressed_is_read(squeeze: Callable[[bytes], bytes]) -> None:
    encoding = "gzip" if squeeze is gzip.compress else "deflate"
    with FaultyServer((200, {"Content-Encoding": encoding}, squeeze(answer()[2]))) as server:
        assert said(server.url) == SLOWER


SETTINGS = {
    "a socks proxy without its package": {"ALL_PROXY": "socks5://127.0.0.1:9"},
    "a NO_PROXY that is no host": {"NO_PROXY": "[::1]"},
    "a missing certificate file": {"SSL_CERT_FILE": "/no/such/file.pem"},
}


@pytest.mark.parametrize("env", SETTINGS.values(), ids=SETTINGS.keys())
def test_settings_of_the_network_that_cannot_be_used_are_an_error_that_names_them(
    env: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ALL_PROXY", "all_proxy", "NO_PROXY", "no_proxy", "SSL_CERT_FILE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    assert "check ALL_PROXY, HTTPS_PROXY, NO_PROXY and SSL_CERT_FILE" in said("https://models.invalid/v1")


def test_a_key_that_no_header_can_carry_is_an_error_that_does_not_quote_it() -> None:
    error = said("http://127.0.0.1:9/v1", "schlüssel")
    assert "no key has" in error
    assert "schl" not in error


def test_a_fault_of_ours_is_an_error_that_somebody_can_stand_in_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slow_node.llm.model.read_answer", lambda *_: [][0])
    with FaultyServer(answer()) as server:
        assert said(server.url) == "asking the model broke: IndexError: list index out of range"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no JSON object"),
        ("slower, please", "no JSON object"),
        ('{"outcome": "dir', "broken or cut off"),
        ('{"a":' * 5000, "broken or cut off"),
        ("{" * 20_000, "broken or cut off"),
        ('{"speed": "faster"} or rather {"speed": "slower"}', "several"),
        ('{"speed": "faster"} or rather {"speed": "slo', "cut off"),
    ],
)
def test_a_text_without_one_clear_object_is_refused_with_the_reason(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        json_object(text)


@pytest.mark.parametrize(
    "text",
    [
        SLOWER,
        f"Of {{left, right}} neither. {SLOWER} Hope {{this}} helps",
        f"```json\n{SLOWER}\n```",
        f"{SLOWER}\n{SLOWER}",
        f"{{}} {SLOWER}",
        SLOWER.replace("less", "less\x1b[2J"),
    ],
)
def test_the_one_object_in_a_text_is_found(text: str) -> None:
    assert json_object(text)["speed"] == "slower"


@pytest.mark.parametrize("mark", ["<think>", "[THINK]", "<|channel>thought", "</think>"])
def test_of_thoughts_that_never_close_only_the_end_is_read(mark: str) -> None:
    thoughts, text = split_thoughts(mark * (900_000 // len(mark)))
    assert len(thoughts) + len(text) <= MAX_ANSWER_CHARS
