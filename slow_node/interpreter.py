"""What a command means, R_t = Phi(P_t) and i_t = Parse(R_t) (paper's Eqs. 6 to 9): a command and a scene in, slots out.

Two read a command: the program reader (`slow_node.understanding.reading`: rules for what is sure, over the intent
parser with its calibrated probabilities) and the language model with its recalled examples. An endpoint's answer leads,
and the reader guards what is unsafe and stands in when the endpoint fails. The embedded model is small: the reader
leads, and the model is asked where the reader is unsure.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, replace
from typing import Literal

from schemas.wire.program import Program
from slow_node.llm.dialect import Chat
from slow_node.llm.errors import ModelError, ModelTimeoutError
from slow_node.llm.model import ChatModel
from slow_node.memory.bank import Example, Memory
from slow_node.planning.directive import UNSAFE_WHY, ParseError, cross_check, parse_answer
from slow_node.planning.prompt import adapted_prompt, build_prompt, repair_prompt
from slow_node.planning.scene import Scene, describe
from slow_node.planning.steps import summary
from slow_node.thought import Trace
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.reader import ProgramReader, Reading
from slow_node.understanding.reading.values import steps_of
from slow_node.understanding.refusals import unsafe
from slow_node.understanding.slots import Slots, adapted_schema, answer_schema

FROM_MEMORY_COSINE = 0.6
FROM_MEMORY_WHY = "model unavailable: answered from memory"
FROM_PARSER_WHY = "model unavailable: answered by the intent parser"
SURE = 0.15
"""From this confidence on, the intent parser's word is taken without asking the embedded model, which is right less
often: docs/understanding.md."""
REFUSE = 0.4
"""From this probability on, a command is refused, whatever else the parser or the language model make of it."""
EMBEDDED_BUDGET_S = 2.5
"""What the embedded model may take where the intent parser has an answer already."""

Ask = Literal["always", "unsure", "never"]
Style = Literal["full", "short", "adapted"]
"""Of the prompt: for a large model, for a small one, or as the embedded model's adapter has learnt it."""


@dataclass(frozen=True)
class Interpretation:
    """What a command was found to mean: slots, or none and why."""

    slots: Slots | None
    why: str = ""
    model_answered: bool = True
    """False where no model could be reached and nothing else could help: a failure, not a refusal."""
    model_ms: float = 0.0
    source: str = ""
    """Who decided: "refusals", "parser", "memory" or the language model's name."""
    nearest: tuple[Example, ...] = ()
    program: Program | None = None
    """The command as a script; None: what the slots say, at once."""
    model_asked: bool = False


@dataclass(frozen=True)
class _Read:
    """What the program reader made of a command, with its summary on this road."""

    slots: Slots
    confidence: float
    refused: float
    program: Program
    sure: bool


class Interpreter:
    """Refusals, intent parser, retrieval, prompt, model, one repair and cross-checks, inside one time budget."""

    def __init__(
        self,
        memory: Memory,
        model: ChatModel,
        parser: ProgramReader | None,
        *,
        style: Style,
        k: int,
        budget_s: float,
        ask: Ask,
    ) -> None:
        self._memory, self._model, self._parser = memory, model, parser
        self._style, self._k, self._budget_s, self._mode = style, k, budget_s, ask
        self.model_name = model.name
        self._schema = adapted_schema() if style == "adapted" else answer_schema(style == "short")

    async def close(self) -> None:
        """Hang up on the model's server, in the event loop that asked it."""
        await self._model.close()

    async def interpret(
        self, command: str, scene: Scene, delayed: str = "", delayed_by: str = "", trace: Trace | None = None
    ) -> Interpretation:
        """What a command means. `delayed`: the manoeuvre asked for before that the fast node is delaying, `delayed_by`:
        the rule. Never raises for a model's failure. How it came about goes into `trace`."""
        started = time.monotonic()
        trace = trace or Trace()
        parsed, nearest = await asyncio.to_thread(self._parse, command, scene, trace)
        if unsafe(command):
            language = parsed.slots.language if parsed else "en"
            slots = Slots(outcome="refused", reasoning="dangerous or forbidden words", language=language)
            return Interpretation(slots, UNSAFE_WHY, source="refusals", nearest=nearest)
        if parsed is not None and parsed.refused >= REFUSE and parsed.slots.outcome != "refused":
            slots = Slots(outcome="refused", reasoning="may be dangerous", language=parsed.slots.language)
            return Interpretation(slots, UNSAFE_WHY, source="parser", nearest=nearest)
        if parsed is not None and not self._asks(parsed):
            return Interpretation(_reasoned(parsed), source="parser", nearest=nearest, program=parsed.program)
        found = await self._ask_model(command, scene, delayed, delayed_by, parsed, nearest, started, trace)
        return replace(found, model_asked=True)

    async def _ask_model(
        self,
        command: str,
        scene: Scene,
        delayed: str,
        delayed_by: str,
        parsed: _Read | None,
        nearest: tuple[Example, ...],
        started: float,
        trace: Trace,
    ) -> Interpretation:
        text = describe(scene, delayed_by) + (f"; intent: {delayed}" if delayed else "")
        budget_s = min(self._budget_s, EMBEDDED_BUDGET_S) if self._mode == "unsure" and parsed else self._budget_s
        try:
            slots = await self._ask(command, text, nearest, started + budget_s, trace)
        except ModelError as error:
            return self._without_model(parsed, nearest, str(error))
        except ParseError as error:
            if parsed is not None:
                return Interpretation(
                    _reasoned(parsed),
                    f"the model's answer cannot be used: {error}",
                    source="parser",
                    model_ms=_ms(started),
                    nearest=nearest,
                    program=parsed.program,
                )
            return Interpretation(
                None, f"the model's answer cannot be used: {error}", model_ms=_ms(started), nearest=nearest
            )
        answered = slots
        slots, why = self._checked(command, slots, parsed, nearest)
        if not why and slots.decision() != answered.decision():
            trace.guards.append("numbers are those that were said, and no others")
        if parsed is not None and (parsed.sure or slots.decision() == parsed.slots.decision()):
            # Slots cannot say what a program can: where the reader is sure of one, they only refuse it.
            refused = slots.outcome == "refused" and parsed.slots.outcome == "directive"
            if not refused:
                source = self._model.name if slots.decision() == parsed.slots.decision() else "parser"
                return Interpretation(
                    _reasoned(parsed),
                    why,
                    model_ms=_ms(started),
                    source=source,
                    nearest=nearest,
                    program=parsed.program,
                )
        program = Program(outcome=slots.outcome, steps=steps_of(slots))
        return Interpretation(
            slots, why, model_ms=_ms(started), source=self._model.name, nearest=nearest, program=program
        )

    def _parse(self, command: str, scene: Scene, trace: Trace) -> tuple[_Read | None, tuple[Example, ...]]:
        began = time.monotonic()
        reading = self._parser.read(command, scene.speed_mps, scene.limit_mps) if self._parser else None
        parsed = None if reading is None else _on_this_road(reading, scene)
        trace.spans_ms["parser"] = _ms(began)
        began = time.monotonic()
        trace.nearest = tuple(self._memory.nearest(command, self._k))
        trace.spans_ms["memory"] = _ms(began)
        if parsed is not None:
            trace.reading = f"{parsed.slots.outcome}: {_reasoned(parsed).reasoning}"
        return parsed, trace.nearest

    def _asks(self, parsed: _Read) -> bool:
        return self._mode == "always" or (self._mode == "unsure" and not parsed.sure and parsed.confidence < SURE)

    async def _ask(self, command: str, scene: str, nearest: tuple[Example, ...], due: float, trace: Trace) -> Slots:
        began = time.monotonic()
        model = self._model
        before = model.prompt_tokens, model.answer_tokens, model.cost_usd
        trace.model = model.name
        try:
            if self._style == "adapted":
                trace.prompt = adapted_prompt(command)
                return _parsed(trace, await self._answer(trace, trace.prompt, due), _numbers(command))
            trace.prompt = build_prompt(command, scene, nearest, self._schema, short=self._style == "short")
            answer = await self._answer(trace, trace.prompt, due)
            try:
                return _parsed(trace, answer)
            except ParseError as error:
                if due - time.monotonic() <= 0:
                    raise ModelTimeoutError("the model had no time left for a repair") from None
                return _parsed(trace, await self._answer(trace, repair_prompt(trace.prompt, answer, str(error)), due))
        finally:
            trace.spans_ms["model"] = _ms(began)
            trace.prompt_tokens = model.prompt_tokens - before[0]
            trace.answer_tokens = model.answer_tokens - before[1]
            trace.cost_usd = None if model.cost_usd is None else model.cost_usd - (before[2] or 0.0)

    async def _answer(self, trace: Trace, chat: Chat, due: float) -> str:
        answer = await self._model.complete(chat, self._schema, due - time.monotonic(), trace.calls)
        trace.answers.append(answer)
        return answer

    def _checked(
        self, command: str, slots: Slots, parsed: _Read | None, nearest: tuple[Example, ...]
    ) -> tuple[Slots, str]:
        """The model's slots after the cross-checks, with the numbers that were said and no others."""
        if parsed is None:
            slots, why = cross_check(slots, nearest)
            if self._style == "adapted":
                return slots, why
            said = quantities(command)
            speeds = [q.value for q in said if q.kind == "speed"]
            if not said or (slots.target_speed_mps is not None and speeds):
                slots = slots.model_copy(update={"target_speed_mps": speeds[-1] if speeds else None})
            return slots, why
        slots = slots.model_copy(update={"language": parsed.slots.language})
        if parsed.slots.outcome == "refused" and slots.outcome == "directive":
            return slots.model_copy(update={"outcome": "refused", "say": ""}), "the intent parser found it unsafe"
        if slots.outcome == "directive" and parsed.slots.outcome == "directive":
            numbers = {"target_speed_mps": parsed.slots.target_speed_mps, "headway_s": parsed.slots.headway_s}
            corrected = slots.model_copy(update=numbers)
            return (slots if corrected.is_empty() else corrected), ""
        return slots, ""

    @staticmethod
    def _without_model(parsed: _Read | None, nearest: tuple[Example, ...], reason: str) -> Interpretation:
        if parsed is not None:
            return Interpretation(
                _reasoned(parsed),
                f"{FROM_PARSER_WHY} ({reason})",
                source="parser",
                nearest=nearest,
                program=parsed.program,
            )
        if nearest and nearest[0].cosine >= FROM_MEMORY_COSINE:
            return Interpretation(nearest[0].slots, f"{FROM_MEMORY_WHY} ({reason})", source="memory", nearest=nearest)
        return Interpretation(None, reason, model_answered=False, nearest=nearest)


def _on_this_road(reading: Reading, scene: Scene) -> _Read:
    slots = reading.slots or summary(reading.program, scene, reading.language)
    return _Read(slots, reading.confidence, reading.refused, reading.program, reading.sure)


def _parsed(trace: Trace, answer: str, numbers: dict[str, float] | None = None) -> Slots:
    """The slots in an answer, noted in the trace. Raises `ParseError`."""
    try:
        slots = parse_answer(answer, numbers)
    except ParseError as error:
        trace.parses.append(str(error))
        raise
    trace.parses.append("")
    return slots


def _numbers(command: str) -> dict[str, float]:
    """The last speed and the last time gap that are named."""
    slots = {"speed": "target_speed_mps", "time": "headway_s"}
    return {slots[q.kind]: q.value for q in quantities(command) if q.kind in slots}


def worded(name: str, value: object) -> str:
    """A slot for people: "speed faster", "overtake", "no overtake", "target speed mps 22.2"."""
    if isinstance(value, bool):
        return name if value else f"no {name}"
    return f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"


def _reasoned(parsed: _Read) -> Slots:
    """The intent parser's slots with its reasons: what it heard and how sure it is."""
    slots = parsed.slots
    named = slots.model_dump(exclude_defaults=True, exclude={"outcome"})
    heard = [worded(name.replace("_", " "), value) for name, value in named.items()]
    said = ", ".join(heard) if heard else slots.outcome.replace("_", " ")
    return slots.model_copy(update={"reasoning": f"heard: {said} ({parsed.confidence:.0%} sure)"})


def _ms(started: float) -> float:
    return 1000.0 * (time.monotonic() - started)
