"""The language model Phi (paper's Eq. 8), R_t = Phi(P_t): any OpenAI-compatible chat endpoint, inside a time budget.

A server that is overloaded, broken or gone is tried again inside the budget; one that keeps failing is left alone for
a while (circuit breaker) and then probed with a single call.
"""

from __future__ import annotations

import asyncio
import ipaddress
import random
import time
from collections.abc import Callable
from typing import Any

import httpx

Chat = list[dict[str, str]]
"""Messages, each with a role and a content."""
RETRIES = 2
RETRY_PAUSE_S = 0.3
MAX_TOKENS_SHORT, MAX_TOKENS = 120, 400
MAX_ANSWER_CHARS = 20_000
BREAK_AFTER = 3
"""This many failed calls in a row open the breaker."""
BREAK_S, BREAK_MAX_S = 5.0, 60.0
"""How long it stays open: doubled by every probe that fails."""
SCHEMA_FAULTS = 2
"""This many times in a row a schema got HTTP 5xx and the same chat without it an answer: no schema is sent any more."""
PRICES_USD = {"gpt-4o-mini": (0.15e-6, 0.60e-6)}
"""A prompt's and an answer's token."""


class ModelError(Exception):
    """No answer; `str()` says why in one line, never with the key or the prompt in it."""

    again = False
    """Another try may help."""
    retry_after_s = 0.0
    """Not before this pause, as the server asks."""


class ModelTimeoutError(ModelError):
    """The budget ended first."""


class ModelUnreachableError(ModelError):
    """No connection, or a server that is overloaded or broken."""

    again = True

    def __init__(self, why: str, status: int = 0, retry_after_s: float = 0.0) -> None:
        super().__init__(why)
        self.status = status
        """The HTTP status; 0: none came."""
        self.retry_after_s = retry_after_s


class ModelRefusedError(ModelError):
    """The server will not do it: a wrong key, an unknown model."""


class ModelAnswerError(ModelError):
    """The server is well (HTTP 2xx), but what it answered is of no use: no chat, or a refusal of the model's."""

    def __init__(self, why: str, *, again: bool = False) -> None:
        super().__init__(why)
        self.again = again


class Breaker:
    """Closed; open after `BREAK_AFTER` failures in a row; half open, for one call, once its pause is over.

    Each call that `enter` lets through ends in `succeeded`, `failed` or `dropped`. Times in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures = 0
        self._pause_s = BREAK_S
        self._until = 0.0
        self._probing = False

    @property
    def waits_s(self) -> float:
        """How long no call is allowed; 0 when one is, or while one probes."""
        return max(0.0, self._until - self._clock())

    def enter(self) -> bool:
        """Whether a call may start now."""
        if self._probing or self.waits_s:
            return False
        self._probing = self._failures >= BREAK_AFTER
        return True

    def dropped(self) -> None:
        """The call was given up by its caller: it says nothing about the server."""
        self._probing = False

    def succeeded(self) -> None:
        self._failures, self._pause_s, self._until, self._probing = 0, BREAK_S, 0.0, False

    def failed(self) -> None:
        self._probing = False
        self._failures += 1
        if self._failures >= BREAK_AFTER:
            self._until = self._clock() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, BREAK_MAX_S)


class ChatModel:
    """Posts chats to `base_url`/chat/completions."""

    def __init__(
        self, base_url: str, model: str, key: str, *, max_tokens: int = MAX_TOKENS, breaker: Breaker | None = None
    ) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        local = is_loopback(base_url)
        # trust_env off: a proxy variable must not carry a loopback call out of the machine.
        self._client = httpx.AsyncClient(
            base_url=base_url.rstrip("/") + "/", headers=headers, timeout=None, trust_env=not local
        )
        self.name = model
        self.price_usd: tuple[float, float] | None = PRICES_USD.get(model, (0.0, 0.0) if local else None)
        """What a prompt's and an answer's token cost; None: nobody told us."""
        self._max_tokens = max_tokens
        self._format = 0
        """Which answer format the server takes; found once, by falling back on HTTP 400, 422 or 5xx."""
        self._schema_faults = 0
        self._breaker = breaker or Breaker()
        self.calls = 0
        self.prompt_tokens = 0
        self.answer_tokens = 0

    @property
    def cost_usd(self) -> float:
        """What the calls so far cost, by the server's own count of tokens; 0 where `price_usd` is unknown."""
        prompt, answer = self.price_usd or (0.0, 0.0)
        return prompt * self.prompt_tokens + answer * self.answer_tokens

    async def close(self) -> None:
        await self._client.aclose()

    async def complete(self, chat: Chat, schema: dict[str, Any] | None, budget_s: float) -> str:
        """R_t, the model's text: JSON of this schema, or any text. Raises `ModelError` when the budget [s] ends, at the
        latest."""
        if not self._breaker.enter():
            waits_s = self._breaker.waits_s
            raise ModelUnreachableError(
                "the model keeps failing: left alone "
                + (f"for another {waits_s:.0f} s" if waits_s else "until the call that probes it has ended")
            )
        try:
            answer = await self._retrying(chat, schema, budget_s)
        except ModelAnswerError:
            self._breaker.succeeded()
            raise
        except ModelError:
            self._breaker.failed()
            raise
        except BaseException:
            self._breaker.dropped()
            raise
        self._breaker.succeeded()
        return answer

    async def _retrying(self, chat: Chat, schema: dict[str, Any] | None, budget_s: float) -> str:
        last: ModelError = ModelTimeoutError(f"the model did not answer within {budget_s:.1f} s")
        due = time.monotonic() + budget_s
        weaker = False
        try:
            async with asyncio.timeout(budget_s):
                for attempt in range(1 + RETRIES):
                    try:
                        return await self._negotiate(chat, schema, weaker=weaker)
                    except ModelError as error:
                        if not error.again:
                            raise
                        last = error
                        # Some servers answer HTTP 500 to a schema: the next try, and only that, goes without.
                        schema_fault = isinstance(error, ModelUnreachableError) and error.status >= 500
                        weaker = schema is not None and self._format == 0 and schema_fault and not weaker
                        pause_s = max(error.retry_after_s, RETRY_PAUSE_S * (attempt + random.random()))
                        if attempt == RETRIES or time.monotonic() + pause_s >= due:
                            break
                        await asyncio.sleep(pause_s)
        except TimeoutError:
            pass
        raise last

    async def _negotiate(self, chat: Chat, schema: dict[str, Any] | None, *, weaker: bool) -> str:
        """Post; on HTTP 400 or 422, once more with each weaker answer format. `weaker`: leave out the strongest."""
        formats: tuple[dict[str, Any], ...] = (
            _schema_format(schema or {}),
            {"response_format": {"type": "json_object"}},
            {},
        )
        first = max(self._format, int(weaker)) if schema else len(formats) - 1
        for index in range(first, len(formats)):
            response = await self._post({"messages": chat, **formats[index]})
            if response.status_code not in (400, 422):
                if response.status_code < 300 and schema:
                    self._took(index, weaker=weaker)
                break
        if response.status_code == 429 or response.status_code >= 500:
            raise ModelUnreachableError(
                f"the model's server answered HTTP {response.status_code}",
                response.status_code,
                _retry_after_s(response),
            )
        if response.status_code >= 300:
            raise ModelRefusedError(f"the model's server said HTTP {response.status_code}; check base_url, model, key")
        return self._content(response)

    def _took(self, index: int, *, weaker: bool) -> None:
        """Remember the answer format that worked; after HTTP 5xx, which may have passed by itself, once it is sure."""
        self._schema_faults = self._schema_faults + 1 if weaker else 0
        if not weaker or self._schema_faults >= SCHEMA_FAULTS:
            self._format = index

    def _content(self, response: httpx.Response) -> str:
        try:
            body = response.json()
            message = body["choices"][0]["message"]
            content, refusal = message["content"], message.get("refusal")
        except ValueError:
            raise ModelAnswerError("the model's server sent no JSON, or a part of it", again=True) from None
        except (LookupError, TypeError, AttributeError):
            raise ModelAnswerError("the model's server did not answer in the OpenAI chat format") from None
        usage = body.get("usage")
        if isinstance(usage, dict):
            self.prompt_tokens += _count(usage.get("prompt_tokens"))
            self.answer_tokens += _count(usage.get("completion_tokens"))
        if refusal:
            raise ModelAnswerError("the model declined to answer")
        return content[:MAX_ANSWER_CHARS] if isinstance(content, str) else ""

    async def _post(self, body: dict[str, Any]) -> httpx.Response:
        self.calls += 1
        try:
            return await self._client.post(
                "chat/completions", json={"model": self.name, "temperature": 0, "max_tokens": self._max_tokens, **body}
            )
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise ModelUnreachableError(f"the model cannot be reached: {type(error).__name__}") from None


def is_loopback(base_url: str) -> bool:
    """The URL's host is this machine."""
    try:
        host = httpx.URL(base_url).host
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except (httpx.InvalidURL, ValueError):
        return False


def _schema_format(schema: dict[str, Any]) -> dict[str, Any]:
    # Strict servers want every property required. The embedded model's short schema leaves slots out, each of which
    # would take it another tenth of a second to write; its server keeps to a schema without being told to be strict.
    strict = len(schema.get("required", ())) == len(schema.get("properties", ()))
    return {
        "response_format": {
            "type": "json_schema",
            "json_schema": {"name": "answer", "strict": strict, "schema": schema},
        }
    }


def _retry_after_s(response: httpx.Response) -> float:
    """The header's delay in seconds; its date form is not worth a parser, our own pause stands in for it."""
    try:
        return min(max(float(response.headers.get("retry-after", 0.0)), 0.0), 3600.0)
    except ValueError:
        return 0.0


def _count(value: object) -> int:
    return value if isinstance(value, int) and value > 0 else 0
