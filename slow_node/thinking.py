"""One thought, R_t = Phi(P_t) and i_t = Parse(R_t) (paper's Eqs. 6 to 9): a command and a scene in, a verdict out.

Two minds read a command: the reader (`slow_node.understanding.reader`, ten milliseconds, calibrated) and the language
model with its retrieved examples. An endpoint's answer leads, and the reader guards what is unsafe and stands in when
the
endpoint fails. The embedded model is small: there the reader leads and the model is asked where the reader is unsure.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import Literal

from slow_node.llm.model import ChatModel, ModelError, ModelTimeoutError
from slow_node.memory.bank import Example, Memory
from slow_node.planning.directive import UNSAFE_WHY, ParseError, cross_check, parse_answer
from slow_node.planning.prompt import adapted_prompt, build_prompt, repair_prompt
from slow_node.planning.scene import Scene, describe
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reader import Reader, Reading
from slow_node.understanding.refusals import unsafe
from slow_node.understanding.slots import Slots, adapted_schema, answer_schema

FROM_MEMORY_COSINE = 0.6
FROM_MEMORY_WHY = "model unavailable: answered from memory"
FROM_READER_WHY = "model unavailable: answered by the reader"
SURE = 0.15
"""From this confidence on, the reader's word is taken without asking the embedded model, which is right less often:
docs/understanding.md."""
REFUSE = 0.4
"""From this probability on, a command is refused, whatever else the reader or the language model make of it."""
EMBEDDED_BUDGET_S = 2.5
"""What the embedded model may take where the reader has an answer already."""

Ask = Literal["always", "unsure", "never"]
Style = Literal["full", "short", "adapted"]
"""Of the prompt: for a large model, for a small one, or as the embedded model's adapter has learnt it."""


@dataclass(frozen=True)
class Verdict:
    """What a thought came to: slots, or none and why."""

    slots: Slots | None
    why: str = ""
    model_answered: bool = True
    """False where no model could be reached and nothing else could help: a failure, not a refusal."""
    model_ms: float = 0.0
    source: str = ""
    """Who decided: "rules", "reader", "memory" or the language model's name."""
    nearest: tuple[Example, ...] = ()


class Thinker:
    """Rules, reader, retrieval, prompt, model, parsing with one repair and cross-checks, inside one time budget."""

    def __init__(
        self,
        memory: Memory,
        model: ChatModel,
        reader: Reader | None,
        *,
        style: Style,
        k: int,
        budget_s: float,
        ask: Ask,
    ) -> None:
        self._memory, self._model, self._reader = memory, model, reader
        self._style, self._k, self._budget_s, self._mode = style, k, budget_s, ask
        self._schema = adapted_schema() if style == "adapted" else answer_schema(style == "short")

    async def think(self, command: str, scene: Scene, intent: str = "", veto: str = "") -> Verdict:
        """The verdict on a command; `intent` adds what has become of it so far, `veto` the rule by which the fast
        system just held something up. Never raises for a model's failure."""
        started = time.monotonic()
        reading, nearest = await asyncio.to_thread(self._look, command, scene)
        if unsafe(command):
            language = reading.slots.language if reading else "en"
            slots = Slots(outcome="refused", reasoning="dangerous or forbidden words", language=language)
            return Verdict(slots, UNSAFE_WHY, source="rules", nearest=nearest)
        if reading is not None and reading.refused >= REFUSE and reading.slots.outcome != "refused":
            slots = Slots(outcome="refused", reasoning="may be dangerous", language=reading.slots.language)
            return Verdict(slots, UNSAFE_WHY, source="reader", nearest=nearest)
        if reading is not None and not self._asks(reading):
            return Verdict(_reasoned(reading), source="reader", nearest=nearest)
        text = describe(scene, veto) + (f"; intent: {intent}" if intent else "")
        budget_s = min(self._budget_s, EMBEDDED_BUDGET_S) if self._mode == "unsure" and reading else self._budget_s
        try:
            slots = await self._ask(command, text, nearest, started + budget_s)
        except ModelError as error:
            return self._without_model(reading, nearest, str(error))
        except ParseError as error:
            if reading is not None:
                return Verdict(
                    _reasoned(reading),
                    f"the model's answer cannot be used: {error}",
                    source="reader",
                    model_ms=_ms(started),
                    nearest=nearest,
                )
            return Verdict(None, f"the model's answer cannot be used: {error}", model_ms=_ms(started), nearest=nearest)
        slots, why = self._checked(command, slots, reading, nearest)
        return Verdict(slots, why, model_ms=_ms(started), source=self._model.name, nearest=nearest)

    def _look(self, command: str, scene: Scene) -> tuple[Reading | None, tuple[Example, ...]]:
        reading = self._reader.read(command, scene.speed_mps, scene.limit_mps) if self._reader else None
        return reading, tuple(self._memory.nearest(command, self._k))

    def _asks(self, reading: Reading) -> bool:
        return self._mode == "always" or (self._mode == "unsure" and reading.confidence < SURE)

    async def _ask(self, command: str, scene: str, nearest: tuple[Example, ...], due: float) -> Slots:
        if self._style == "adapted":
            answer = await self._model.complete(adapted_prompt(command), self._schema, due - time.monotonic())
            return parse_answer(answer, _numbers(command))
        chat = build_prompt(command, scene, nearest, self._schema, short=self._style == "short")
        answer = await self._model.complete(chat, self._schema, due - time.monotonic())
        try:
            return parse_answer(answer)
        except ParseError as error:
            left = due - time.monotonic()
            if left <= 0:
                raise ModelTimeoutError("the model had no time left for a repair") from None
            return parse_answer(await self._model.complete(repair_prompt(chat, answer, str(error)), self._schema, left))

    def _checked(
        self, command: str, slots: Slots, reading: Reading | None, nearest: tuple[Example, ...]
    ) -> tuple[Slots, str]:
        """The model's slots after the cross-checks, with the numbers that were said and no others."""
        if reading is None:
            slots, why = cross_check(slots, nearest)
            if self._style == "adapted":
                return slots, why
            said = quantities(command)
            speeds = [q.value for q in said if q.kind == "speed"]
            if not said or (slots.target_speed_mps is not None and speeds):
                slots = slots.model_copy(update={"target_speed_mps": speeds[-1] if speeds else None})
            return slots, why
        slots = slots.model_copy(update={"language": reading.slots.language})
        if reading.slots.outcome == "refused" and slots.outcome == "directive":
            return slots.model_copy(update={"outcome": "refused", "say": ""}), "the reader found it unsafe"
        if slots.outcome == "directive" and reading.slots.outcome == "directive":
            numbers = {"target_speed_mps": reading.slots.target_speed_mps, "headway_s": reading.slots.headway_s}
            corrected = slots.model_copy(update=numbers)
            return (slots if corrected.wishes_nothing() else corrected), ""
        return slots, ""

    @staticmethod
    def _without_model(reading: Reading | None, nearest: tuple[Example, ...], reason: str) -> Verdict:
        if reading is not None:
            return Verdict(_reasoned(reading), f"{FROM_READER_WHY} ({reason})", source="reader", nearest=nearest)
        if nearest and nearest[0].cosine >= FROM_MEMORY_COSINE:
            return Verdict(nearest[0].slots, f"{FROM_MEMORY_WHY} ({reason})", source="memory", nearest=nearest)
        return Verdict(None, reason, model_answered=False, nearest=nearest)


def _numbers(command: str) -> dict[str, float]:
    """The last speed and the last time gap that are named."""
    slots = {"speed": "target_speed_mps", "time": "headway_s"}
    return {slots[q.kind]: q.value for q in quantities(command) if q.kind in slots}


def _reasoned(reading: Reading) -> Slots:
    """The reader's slots with its reasons: what it heard and how sure it is."""
    slots = reading.slots
    heard = [f"{name} {value}" for name, value in slots.model_dump(exclude_defaults=True, exclude={"outcome"}).items()]
    said = ", ".join(heard) if heard else slots.outcome.replace("_", " ")
    return slots.model_copy(update={"reasoning": f"heard: {said} ({reading.confidence:.0%} sure)"})


def _ms(started: float) -> float:
    return 1000.0 * (time.monotonic() - started)
