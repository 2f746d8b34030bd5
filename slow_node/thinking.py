"""One thought, R_t = Phi(P_t) and i_t = Parse(R_t) (paper's Eqs. 5 to 8): a command and a scene in, a verdict out."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

from slow_node.directive import UNSAFE, ParseError, cross_check, parse_answer, unsafe
from slow_node.memory import Example, Memory
from slow_node.model import ChatModel, ModelError, ModelTimeoutError
from slow_node.prompt import build_prompt, repair_prompt
from slow_node.scene import Scene, describe
from slow_node.slots import Slots, answer_schema

FROM_MEMORY_COSINE = 0.6
FROM_MEMORY_WHY = "model unavailable: answered from memory"


@dataclass(frozen=True)
class Verdict:
    """What a thought came to: slots, or none and why."""

    slots: Slots | None
    why: str = ""
    model_answered: bool = True
    """False where no model could be reached and memory could not help: a failure, not a refusal."""
    model_ms: float = 0.0


class Thinker:
    """Retrieval, prompt, model, parsing with one repair, and the cross-check, inside one time budget."""

    def __init__(self, memory: Memory, model: ChatModel, *, short: bool, k: int, budget_s: float) -> None:
        self._memory, self._model = memory, model
        self._short, self._k, self._budget_s = short, k, budget_s
        self._schema = answer_schema(short)

    async def think(self, command: str, scene: Scene, intent: str = "") -> Verdict:
        """The verdict on a command; `intent` adds what has become of it so far. Never raises for a model's failure."""
        if unsafe(command):
            return Verdict(Slots(outcome="refuse", reasoning="unsafe command", say=UNSAFE.say), UNSAFE.why)
        started = time.monotonic()
        nearest = await asyncio.to_thread(self._memory.nearest, command, self._k)
        text = f"{describe(scene)}; intent: {intent}" if intent else describe(scene)
        try:
            slots = await self._ask(command, text, nearest, started + self._budget_s)
        except ModelError as error:
            return self._from_memory(command, nearest, str(error))
        except ParseError as error:
            return Verdict(None, f"the model's answer cannot be used: {error}", model_ms=_ms(started))
        slots, why = cross_check(command, slots, nearest)
        return Verdict(slots, why, model_ms=_ms(started))

    async def _ask(self, command: str, scene: str, nearest: list[Example], due: float) -> Slots:
        chat = build_prompt(command, scene, nearest, short=self._short)
        answer = await self._model.complete(chat, self._schema, due - time.monotonic())
        try:
            return parse_answer(answer)
        except ParseError as error:
            left = due - time.monotonic()
            if left <= 0:
                raise ModelTimeoutError("the model had no time left for a repair") from None
            return parse_answer(
                await self._model.complete(repair_prompt(chat, answer, str(error)), self._schema, left)
            )

    @staticmethod
    def _from_memory(command: str, nearest: list[Example], reason: str) -> Verdict:
        if nearest and nearest[0].cosine >= FROM_MEMORY_COSINE:
            slots, _ = cross_check(command, nearest[0].slots, ())
            return Verdict(slots, f"{FROM_MEMORY_WHY} ({reason})")
        return Verdict(None, reason, model_answered=False)


def _ms(started: float) -> float:
    return 1000.0 * (time.monotonic() - started)
