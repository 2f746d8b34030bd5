"""What the language model is asked, and its answer: read, checked, and without a number that nobody said."""

from __future__ import annotations

import time
from typing import Literal

from msgspec import structs

from schemas.wire.program import Program
from slow_node.interpretation import Context, Read
from slow_node.llm.dialect import Chat
from slow_node.llm.errors import ModelTimeoutError
from slow_node.llm.model import ChatModel
from slow_node.memory.bank import Example
from slow_node.planning.directive import ParseError, cross_check, parse_answer
from slow_node.planning.program_text import brief, program_schema, read_program
from slow_node.planning.prompt import Asked, adapted_prompt, build_prompt, program_prompt, repair_prompt
from slow_node.planning.scene import Scene, describe, in_brief
from slow_node.planning.steps import summary
from slow_node.thought import Trace
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.values import steps_of, uses_miles
from slow_node.understanding.slots import Slots, adapted_schema, answer_schema
from slow_node.verdict import Said, agrees, unsaid

FROM_MEMORY_COSINE = 0.6

Style = Literal["full", "short", "slots", "programs"]
"""Of the prompt: for a large model, for a small one as it comes, or as the embedded model's adapter has learnt it."""


class Asking:
    """Prompt, model, one repair and cross-checks."""

    def __init__(self, model: ChatModel, style: Style, trust: float, *, scene: bool) -> None:
        """trust and scene: see `slow_node.interpreter.Interpreter`."""
        self._model, self._style, self._trust, self._shows_scene = model, style, trust, scene
        schemas = {"slots": adapted_schema, "programs": program_schema}
        self._schema = schemas[style]() if style in schemas else answer_schema(style == "short")

    async def ask(
        self,
        command: str,
        scene: Scene,
        context: Context,
        read: Read | None,
        nearest: tuple[Example, ...],
        due: float,
        trace: Trace,
    ) -> Said:
        """The model's answer. `due`: by when [s, monotonic]. Raises `ModelError`, and `ParseError` where it is none."""
        began = time.monotonic()
        model = self._model
        before = model.prompt_tokens, model.answer_tokens, model.cost_usd
        trace.model = model.name
        try:
            if self._style == "programs":
                near = nearest[0] if nearest and nearest[0].cosine >= FROM_MEMORY_COSINE else None
                trace.prompt = program_prompt(
                    Asked(
                        command,
                        in_brief(scene) if self._shows_scene else "",
                        context.turns,
                        context.wishes,
                        context.again,
                        near,
                        read.program if read else None,
                        read.trust if read else 0.0,
                    )
                )
                return self._said_program(command, scene, read, await self._answer(trace, trace.prompt, due), trace)
            if self._style == "slots":
                trace.prompt = adapted_prompt(command)
                slots = _parsed(trace, await self._answer(trace, trace.prompt, due), _numbers(command))
                return self._said_slots(command, slots, read, nearest, trace)
            hint = read.program if read is not None else None
            text = _told(describe(scene, context.delayed_by) if self._shows_scene else "not told", context)
            trace.prompt = build_prompt(
                command, text, nearest, self._schema, short=self._style == "short", turns=context.turns, hint=hint
            )
            answer = await self._answer(trace, trace.prompt, due)
            try:
                slots = _parsed(trace, answer)
            except ParseError as error:
                if due - time.monotonic() <= 0:
                    raise ModelTimeoutError("the model had no time left for a repair") from None
                slots = _parsed(trace, await self._answer(trace, repair_prompt(trace.prompt, answer, str(error)), due))
            return self._said_slots(command, slots, read, nearest, trace)
        finally:
            trace.spans_ms["model"] = 1000.0 * (time.monotonic() - began)
            trace.prompt_tokens = model.prompt_tokens - before[0]
            trace.answer_tokens = model.answer_tokens - before[1]
            trace.cost_usd = None if model.cost_usd is None else model.cost_usd - (before[2] or 0.0)

    async def _answer(self, trace: Trace, chat: Chat, due: float) -> str:
        answer = await self._model.complete(chat, self._schema, due - time.monotonic(), trace.calls)
        trace.answers.append(answer)
        return answer

    def _confidence(self, trace: Trace) -> float:
        """The model's in its answer, as far as it is to be trusted."""
        answer = trace.calls[-1].answer if trace.calls else None
        return self._trust * (1.0 if answer is None or answer.probability is None else answer.probability)

    def _said_program(self, command: str, scene: Scene, read: Read | None, answer: str, trace: Trace) -> Said:
        """The program in an answer, on this road. Raises `ParseError`."""
        try:
            # Whether the passenger speaks of miles is a rule's to say.
            program = structs.replace(read_program(answer), miles=uses_miles(command))
        except ParseError as error:
            trace.parses.append(str(error))
            raise
        trace.parses.append("")
        _refuse_unsaid(program, command, read.program if read else None, trace)
        language = read.slots.language if read else "en"
        slots = summary(program, scene, language).model_copy(update={"reasoning": f"heard: {brief(program)}"})
        same = read is not None and agrees(program, slots, read.program, read.slots)
        return Said(program, slots, self._confidence(trace), same, brief(program))

    def _said_slots(
        self, command: str, answered: Slots, read: Read | None, nearest: tuple[Example, ...], trace: Trace
    ) -> Said:
        """A model's slots after the cross-checks, as a program. Raises `ParseError`."""
        slots, why = self._checked(command, answered, read, nearest)
        if not why and slots.decision() != answered.decision():
            trace.guards.append("numbers are those that were said, and no others")
        program = Program(outcome=slots.outcome, steps=steps_of(slots))
        known = (
            None if read is None else structs.replace(read.program, steps=(*read.program.steps, *steps_of(read.slots)))
        )
        _refuse_unsaid(program, command, known, trace)
        same = read is not None and slots.decision() == read.slots.decision()
        return Said(program, slots, self._confidence(trace), same, brief(program), why)

    def _checked(
        self, command: str, slots: Slots, read: Read | None, nearest: tuple[Example, ...]
    ) -> tuple[Slots, str]:
        """The model's slots after the cross-checks, with the numbers that were said and no others."""
        if read is None:
            slots, why = cross_check(slots, nearest)
            if self._style == "slots":
                return slots, why
            said = quantities(command)
            speeds = [q.value for q in said if q.kind == "speed"]
            if not said or (slots.target_speed_mps is not None and speeds):
                slots = slots.model_copy(update={"target_speed_mps": speeds[-1] if speeds else None})
            return slots, why
        slots = slots.model_copy(update={"language": read.slots.language})
        if slots.outcome == "directive" and read.slots.outcome == "directive":
            numbers = {"target_speed_mps": read.slots.target_speed_mps, "headway_s": read.slots.headway_s}
            corrected = slots.model_copy(update=numbers)
            return (slots if corrected.is_empty() else corrected), ""
        return slots, ""


def _refuse_unsaid(program: Program, command: str, other: Program | None, trace: Trace) -> None:
    """Raises `ParseError` for a number that was neither said nor read."""
    if number := unsaid(program, command, other):
        trace.parses[-1] = f"it names {number}, which nobody said"
        raise ParseError(trace.parses[-1])


def _told(scene: str, context: Context) -> str:
    """A scene with what stands and what has happened to it."""
    parts = [scene]
    if context.delayed:
        parts.append(f"intent: {context.delayed}")
    if context.wishes:
        parts.append(f"standing wish: {context.wishes}")
    if context.again:
        parts.append(f"asked again: {context.again}")
    return "; ".join(parts)


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
