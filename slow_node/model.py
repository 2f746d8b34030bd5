"""The language model Phi (paper's Eq. 7), R_t = Phi(P_t): any OpenAI-compatible chat endpoint, inside a time budget.

A server that is overloaded, broken or gone is tried again inside the budget; one that keeps failing is left alone for
a while (circuit breaker) and then probed with a single call.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from typing import Any

import httpx

from slow_node.prompt import Chat

RETRIES = 2
RETRY_PAUSE_S = 0.3
MAX_TOKENS_SHORT, MAX_TOKENS = 120, 400
MAX_ANSWER_CHARS = 20_000
BREAK_AFTER = 3
"""This many failed calls in a row open the breaker."""
BREAK_S, BREAK_MAX_S = 5.0, 60.0
"""How long it stays open: doubled by every probe that fails."""
PRICES_USD = {"gpt-4o-mini": (0.15e-6, 0.60e-6)}
"""A prompt's and an answer's token; a model that is not listed counts as free."""


class ModelError(Exception):
    """No answer; `str()` says why in one line, never with the key or the prompt in it."""


class ModelTimeoutError(ModelError):
    """The budget ended first."""


class ModelUnreachableError(ModelError):
    """No connection, or a server that is overloaded or broken."""

    def __init__(self, why: str, retry_after_s: float = 0.0) -> None:
        super().__init__(why)
        self.retry_after_s = retry_after_s


class ModelRefusedError(ModelError):
    """The server answered, and will not do it: a wrong key, an unknown model, an answer that is not a chat's."""


class Breaker:
    """Closed, open after `BREAK_AFTER` failures in a row, half open once its pause is over. Times in seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures = 0
        self._pause_s = BREAK_S
        self._until = 0.0

    @property
    def waits_s(self) -> float:
        """How long no call is allowed; 0 when one is."""
        return max(0.0, self._until - self._clock())

    def succeeded(self) -> None:
        self._failures, self._pause_s, self._until = 0, BREAK_S, 0.0

    def failed(self) -> None:
        self._failures += 1
        if self._failures >= BREAK_AFTER:
            self._until = self._clock() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, BREAK_MAX_S)


class ChatModel:
    """Posts chats to `base_url`/chat/completions."""

    def __init__(self, base_url: str, model: str, key: str, *, max_tokens: int = MAX_TOKENS,
                 breaker: Breaker | None = None) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        # trust_env off: a proxy variable must not carry a loopback call out of the machine.
        self._client = httpx.AsyncClient(
            base_url=base_url.rstrip("/") + "/", headers=headers, timeout=None, trust_env="127.0.0.1" not in base_url
        )
        self.name = model
        self._max_tokens = max_tokens
        self._format = 0
        """Which answer format the server takes; found once, by falling back on HTTP 400."""
        self._breaker = breaker or Breaker()
        self.calls = 0
        self.prompt_tokens = 0
        self.answer_tokens = 0

    @property
    def cost_usd(self) -> float:
        """What the calls so far cost, by the server's own count of tokens."""
        prompt, answer = PRICES_USD.get(self.name, (0.0, 0.0))
        return prompt * self.prompt_tokens + answer * self.answer_tokens

    async def close(self) -> None:
        await self._client.aclose()

    async def complete(self, chat: Chat, schema: dict[str, Any] | None, budget_s: float) -> str:
        """R_t, the model's text: JSON of this schema, or any text. Raises `ModelError` when the budget [s] ends, at the
        latest."""
        if self._breaker.waits_s:
            raise ModelUnreachableError(
                f"the model keeps failing: left alone for another {self._breaker.waits_s:.0f} s")
        try:
            answer = await self._retrying(chat, schema, budget_s)
        except ModelError:
            self._breaker.failed()
            raise
        self._breaker.succeeded()
        return answer

    async def _retrying(self, chat: Chat, schema: dict[str, Any] | None, budget_s: float) -> str:
        last: ModelError = ModelTimeoutError(f"the model did not answer within {budget_s:.1f} s")
        due = time.monotonic() + budget_s
        try:
            async with asyncio.timeout(budget_s):
                for attempt in range(1 + RETRIES):
                    try:
                        return await self._negotiate(chat, schema)
                    except ModelUnreachableError as error:
                        last = error
                        pause_s = max(error.retry_after_s, RETRY_PAUSE_S * (attempt + random.random()))
                        if attempt == RETRIES or time.monotonic() + pause_s >= due:
                            break
                        await asyncio.sleep(pause_s)
        except TimeoutError:
            pass
        raise last

    async def _negotiate(self, chat: Chat, schema: dict[str, Any] | None) -> str:
        """Post; on HTTP 400 or 422, once more with each weaker answer format."""
        formats: tuple[dict[str, Any], ...] = (
            {
                "response_format": {
                    "type": "json_schema",
                    "json_schema": {"name": "answer", "strict": True, "schema": schema},
                }
            },
            {"response_format": {"type": "json_object"}},
            {},
        )
        for index in range(self._format if schema else len(formats) - 1, len(formats)):
            response = await self._post({"messages": chat, **formats[index]})
            if response.status_code not in (400, 422):
                if response.status_code < 300 and schema:
                    self._format = index
                break
        if response.status_code == 429 or response.status_code >= 500:
            raise ModelUnreachableError(
                f"the model's server answered HTTP {response.status_code}", _retry_after_s(response))
        if response.status_code >= 300:
            raise ModelRefusedError(f"the model's server said HTTP {response.status_code}; check base_url, model, key")
        return self._content(response)

    def _content(self, response: httpx.Response) -> str:
        try:
            body = response.json()
            message = body["choices"][0]["message"]
            content, refusal = message["content"], message.get("refusal")
        except ValueError:
            raise ModelUnreachableError("the model's server sent a broken answer") from None
        except (LookupError, TypeError, AttributeError):
            raise ModelRefusedError("the model's server did not answer in the OpenAI chat format") from None
        usage = body.get("usage")
        if isinstance(usage, dict):
            self.prompt_tokens += _count(usage.get("prompt_tokens"))
            self.answer_tokens += _count(usage.get("completion_tokens"))
        if refusal:
            raise ModelRefusedError("the model declined to answer")
        return content[:MAX_ANSWER_CHARS] if isinstance(content, str) else ""

    async def _post(self, body: dict[str, Any]) -> httpx.Response:
        self.calls += 1
        try:
            return await self._client.post(
                "chat/completions",
                json={"model": self.name, "temperature": 0, "max_tokens": self._max_tokens, **body},
            )
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise ModelUnreachableError(f"the model cannot be reached: {type(error).__name__}") from None


def _retry_after_s(response: httpx.Response) -> float:
    """The header's delay in seconds; its date form is not worth a parser, our own pause stands in for it."""
    try:
        return min(max(float(response.headers.get("retry-after", 0.0)), 0.0), 3600.0)
    except ValueError:
        return 0.0


def _count(value: object) -> int:
    return value if isinstance(value, int) and value > 0 else 0
