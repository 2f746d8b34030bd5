"""The language model Phi (paper's Eq. 7), R_t = Phi(P_t): any OpenAI-compatible chat endpoint, inside a time budget."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx

from slow_node.prompt import Chat

RETRIES = 2
RETRY_PAUSE_S = 0.3
MAX_TOKENS_SHORT, MAX_TOKENS = 120, 400
MAX_ANSWER_CHARS = 20_000


class ModelError(Exception):
    """No answer; `str()` says why in one line, never with the key or the prompt in it."""


class ModelTimeoutError(ModelError):
    """The budget ended first."""


class ModelUnreachableError(ModelError):
    """No connection, or a server that is overloaded or broken."""


class ModelRefusedError(ModelError):
    """The server answered, and will not do it: a wrong key, an unknown model, an answer that is not a chat's."""


class ChatModel:
    """Posts chats to `base_url`/chat/completions."""

    def __init__(self, base_url: str, model: str, key: str, *, short: bool) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        # trust_env off: a proxy variable must not carry a loopback call out of the machine.
        self._client = httpx.AsyncClient(
            base_url=base_url.rstrip("/") + "/", headers=headers, timeout=None, trust_env="127.0.0.1" not in base_url
        )
        self._model = model
        self._max_tokens = MAX_TOKENS_SHORT if short else MAX_TOKENS
        self._format = 0
        """Which answer format the server takes; found once, by falling back on HTTP 400."""
        self.calls = 0

    async def close(self) -> None:
        await self._client.aclose()

    async def complete(self, chat: Chat, schema: dict[str, Any], budget_s: float) -> str:
        """R_t, the model's text. Raises `ModelError` at the latest when the budget ends."""
        last: ModelError = ModelTimeoutError(f"the model did not answer within {budget_s:.1f} s")
        try:
            async with asyncio.timeout(budget_s):
                for attempt in range(1 + RETRIES):
                    if attempt:
                        await asyncio.sleep(RETRY_PAUSE_S * attempt)
                    try:
                        return await self._negotiate(chat, schema)
                    except ModelUnreachableError as error:
                        last = error
        except TimeoutError:
            pass
        raise last

    async def _negotiate(self, chat: Chat, schema: dict[str, Any]) -> str:
        """Post; on HTTP 400, once more with each weaker answer format."""
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
        for index in range(self._format, len(formats)):
            response = await self._post({"messages": chat, **formats[index]})
            if response.status_code != 400:
                self._format = index
                break
        if response.status_code == 429 or response.status_code >= 500:
            raise ModelUnreachableError(f"the model's server answered HTTP {response.status_code}")
        if response.status_code >= 300:
            raise ModelRefusedError(f"the model's server said HTTP {response.status_code}; check base_url, model, key")
        try:
            content = response.json()["choices"][0]["message"]["content"]
        except (ValueError, LookupError, TypeError):
            raise ModelRefusedError("the model's server did not answer in the OpenAI chat format") from None
        return content[:MAX_ANSWER_CHARS] if isinstance(content, str) else ""

    async def _post(self, body: dict[str, Any]) -> httpx.Response:
        self.calls += 1
        try:
            return await self._client.post(
                "chat/completions",
                json={"model": self._model, "temperature": 0, "max_tokens": self._max_tokens, **body},
            )
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise ModelUnreachableError(f"the model cannot be reached: {type(error).__name__}") from None
