"""The language model Phi (paper's Eq. 8), R_t = Phi(P_t): any OpenAI-compatible chat endpoint, inside a time budget.

A server that is overloaded, broken or gone is tried again inside the budget; one that keeps failing is left alone for
a while (`breaker`). How it wants to be asked is found out by asking (`dialect`), where its answer is by `answer`.
"""

from __future__ import annotations

import asyncio
import random
import time
from dataclasses import dataclass, replace
from typing import Any

from schemas.wire.text import plain
from slow_node.llm.answer import Answer, ModelAnswerError, read_answer, told
from slow_node.llm.breaker import Breaker
from slow_node.llm.dialect import FORMATS, TEXT, Change, Chat, Dialect, Learnt
from slow_node.llm.endpoint import is_loopback, is_passed_on
from slow_node.llm.errors import ModelError, ModelRefusedError, ModelTimeoutError, ModelUnreachableError, http_error
from slow_node.llm.transport import Response, Transport

RETRIES = 2
RETRY_PAUSE_S = 0.3
MAX_TOKENS_SHORT, MAX_TOKENS = 120, 2000
"""Of an answer, thoughts included: for the embedded model, and for an endpoint."""
PRICES_USD = {"gpt-4o-mini": (0.15e-6, 0.60e-6)}
"""A prompt's and an answer's token."""


@dataclass(frozen=True)
class Call:
    """One HTTP exchange with the server, for the record."""

    began_s: float
    """Unix time."""
    ms: float
    format: str
    """The answer format that was asked for: of `FORMATS`."""
    answer: Answer | None = None
    """What came, of use or not."""
    error: str = ""
    """Why there is none that is of use."""


class ChatModel:
    """Posts chats to `base_url`/chat/completions."""

    def __init__(
        self,
        base_url: str,
        model: str,
        key: str,
        *,
        max_tokens: int = MAX_TOKENS,
        breaker: Breaker | None = None,
        odds: bool = False,
    ) -> None:
        """odds: ask for the probabilities of the answer's tokens, which not every server has."""
        self._transport = Transport(base_url, key)
        self._key = key.strip()
        self.name, self.base_url, self.max_tokens = model, base_url, max_tokens
        self._odds = odds
        ours = is_loopback(base_url) and not is_passed_on(model)
        self.price_usd: tuple[float, float] | None = PRICES_USD.get(model, (0.0, 0.0) if ours else None)
        """What a prompt's and an answer's token cost; None: nobody told us."""
        self._learnt = Learnt()
        self._breaker = breaker or Breaker()
        self.calls = 0
        self.prompt_tokens = 0
        self.answer_tokens = 0
        self.cost_usd: float | None = None if self.price_usd is None else 0.0
        """What the calls so far cost: each as the server told, else by its count of tokens; None: nobody knows."""

    async def close(self) -> None:
        await self._transport.close()

    async def complete(
        self, chat: Chat, schema: dict[str, Any] | None, budget_s: float, calls: list[Call] | None = None
    ) -> str:
        """R_t, the model's text without its thoughts: JSON of this schema, or any text.

        Each exchange is added to `calls`. Raises `ModelError` when the budget [s] ends, at the latest.
        """
        if not self._breaker.enter():
            waits_s = self._breaker.waits_s
            raise ModelUnreachableError(
                "the model keeps failing: left alone "
                + (f"for another {waits_s:.0f} s" if waits_s else "until the call that probes it has ended")
            )
        try:
            answer = await self._retrying(chat, schema, budget_s, calls if calls is not None else [])
        except ModelAnswerError:
            self._breaker.succeeded()
            raise
        except ModelError:
            self._breaker.failed()
            raise
        except Exception as error:  # of ours or a library's: whoever asks has a stand-in for a model, not for this
            self._breaker.failed()
            raise ModelRefusedError(
                f"asking the model broke: {type(error).__name__}: {plain(str(error), 120)}"
            ) from error
        except BaseException:
            self._breaker.dropped()
            raise
        self._breaker.succeeded()
        return answer.text

    async def _retrying(self, chat: Chat, schema: dict[str, Any] | None, budget_s: float, calls: list[Call]) -> Answer:
        last: ModelError = ModelTimeoutError(f"the model did not answer within {budget_s:.1f} s")
        due = time.monotonic() + budget_s
        weaker = False
        try:
            async with asyncio.timeout(budget_s):
                for attempt in range(1 + RETRIES):
                    try:
                        return await self._negotiate(chat, schema, calls, weaker=weaker)
                    except ModelError as error:
                        if not error.again:
                            raise
                        last = error
                        # Some servers answer HTTP 500 to a schema: the next try, and only that, goes without.
                        schema_fault = isinstance(error, ModelUnreachableError) and error.status >= 500
                        weaker = schema is not None and schema_fault and not weaker
                        pause_s = max(error.retry_after_s, RETRY_PAUSE_S * (attempt + random.random()))
                        if attempt == RETRIES or time.monotonic() + pause_s >= due:
                            break
                        await asyncio.sleep(pause_s)
        except TimeoutError:
            pass
        raise last

    async def _negotiate(self, chat: Chat, schema: dict[str, Any] | None, calls: list[Call], *, weaker: bool) -> Answer:
        """Ask; on HTTP 400 or 422, again in the way that the server's sentence calls for, or else in a weaker one."""
        learnt = self._learnt
        sure, used = learnt.dialect, learnt.weaker() if weaker else learnt.dialect
        if schema is None:
            used = replace(used, format=TEXT)
        while True:
            answer = await self._exchange(
                used, used.body(self.name, chat, schema, self.max_tokens, odds=self._odds), calls
            )
            if isinstance(answer, Answer):
                learnt.took(sure, used if schema else replace(used, format=sure.format))
                return answer
            used = replace(used, **answer.fields)
            sure = replace(sure, **answer.fields) if answer.named else sure

    async def _exchange(self, used: Dialect, body: dict[str, Any], calls: list[Call]) -> Answer | Change:
        """One request, noted in `calls`: its answer, or what the server wants to be asked otherwise."""
        self.calls += 1
        began_s, began = time.time(), time.monotonic()
        answer: Answer | None = None
        error = "given up"
        try:
            response = await self._transport.post("chat/completions", body)
            sentence, code = ("", "") if response.status < 300 else told(response.content, self._key)
            change = used.changed(sentence) if response.status in (400, 422) else None
            if change is not None:
                error = f"HTTP {response.status}{f': {sentence}' if sentence else ''}"
                return change
            answer = self._read(response, sentence, code)
            error = ""
            return answer
        except ModelError as failure:
            error = str(failure)
            if isinstance(failure, ModelAnswerError):
                answer = failure.answer
            raise
        finally:
            if answer is not None:
                self._count(answer)
            calls.append(Call(began_s, 1000.0 * (time.monotonic() - began), FORMATS[used.format], answer, error))

    def _read(self, response: Response, sentence: str, code: str) -> Answer:
        if response.status < 300:
            return read_answer(response.content, self._key)
        if response.status < 400:
            sentence = f"it has moved to {plain(response.location, 160)}: set that base URL"
        raise http_error(response.status, sentence, code, response.retry_after)

    def _count(self, answer: Answer) -> None:
        self.prompt_tokens += answer.prompt_tokens
        self.answer_tokens += answer.answer_tokens
        cost = answer.cost_usd
        if cost is None and self.price_usd is not None:
            cost = self.price_usd[0] * answer.prompt_tokens + self.price_usd[1] * answer.answer_tokens
        if cost is not None:
            self.cost_usd = (self.cost_usd or 0.0) + cost
