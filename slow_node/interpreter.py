"""What a command means, R_t = Phi(P_t) and i_t = Parse(R_t) (paper's Eqs. 6 to 9): a command and a scene in, slots out.

Two read a command. The program reader (`slow_node.understanding.reading`: rules for what is sure, over the intent
parser with its calibrated probabilities) has an answer after some 60 ms, and acts on it where it is sure enough. The
language model is asked meanwhile, with all that is known (P_t), and confirms, refines or withdraws what the reader has
done; where the reader was unsure it decides. Who is right where they differ is `slow_node.verdict`'s to say.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from msgspec import structs

from schemas.wire.messages import Verdict
from schemas.wire.program import Program
from slow_node.llm.dialect import Chat
from slow_node.llm.errors import ModelError, ModelTimeoutError
from slow_node.llm.model import ChatModel
from slow_node.memory.bank import Example, Memory
from slow_node.planning.directive import UNSAFE_WHY, ParseError, cross_check, parse_answer
from slow_node.planning.program_text import brief, program_schema, read_program
from slow_node.planning.prompt import Asked, adapted_prompt, build_prompt, program_prompt, repair_prompt
from slow_node.planning.scene import Scene, describe, in_brief
from slow_node.planning.steps import summary
from slow_node.thought import Trace
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.reader import ProgramReader, Reading
from slow_node.understanding.reading.values import steps_of, uses_miles
from slow_node.understanding.refusals import unsafe
from slow_node.understanding.slots import Slots, adapted_schema, answer_schema
from slow_node.verdict import ACTS, STANDS, Said, agrees, unsaid, weighed

FROM_MEMORY_COSINE = 0.6
FROM_MEMORY_WHY = "model unavailable: answered from memory"
FROM_PARSER_WHY = "model unavailable: answered by the intent parser"
SURE = 0.15
"""From this confidence on, the intent parser's word is taken where a small model that has learnt nothing of this is to
be asked only if the reader is unsure: it is right less often."""
REFUSE = 0.4
"""From this probability on, a command is refused, whatever else the parser or the language model make of it."""
EMBEDDED_BUDGET_S = 4.0
"""What the embedded model may take where the passenger waits for it, though the reader has an answer."""
ENDPOINT_TRUST = 0.995
"""A large model's answer leads, but for what the reader knows by the words."""

Ask = Literal["always", "unsure", "never"]
Style = Literal["full", "short", "slots", "programs"]
"""Of the prompt: for a large model, for a small one as it comes, or as the embedded model's adapter has learnt it."""


@dataclass(frozen=True)
class Context:
    """What was said before and what has become of it: the rest of P_t."""

    turns: tuple[str, ...] = ()
    """What was asked for before, in brief; the newest last."""
    wishes: str = ""
    """What stands of it."""
    delayed: str = ""
    """The manoeuvre before this command that the fast node is delaying."""
    delayed_by: str = ""
    """The rule by which it does."""
    again: str = ""
    """Why the model is asked once more about a command that is being carried out; "": it is new."""
    standing: Program | None = None
    """What is being carried out for it."""


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
    lesson: str = ""
    """What experience on a road like this one says about it."""
    provisional: bool = False
    """The reader's, to be acted on until the model has answered."""
    verdict: Verdict = ""
    """What the model's answer did to the reader's."""
    confidence: float = 0.0
    """Of the reader's reading."""
    model_confidence: float = 0.0
    """Of the model's answer, as far as it is trusted."""

    @property
    def model_decided(self) -> bool:
        """The model's answer is followed where the reader's was another, or none."""
        return self.verdict in ("refined", "withdrew", "decided")


Act = Callable[[Interpretation], None]
"""Takes the reader's word while the model is still thinking."""


@dataclass(frozen=True)
class _Read:
    """What the program reader made of a command, with its summary on this road."""

    slots: Slots
    confidence: float
    refused: float
    program: Program
    sure: bool

    @property
    def trust(self) -> float:
        """The probability that it is right."""
        return 1.0 if self.sure else self.confidence


class Interpreter:
    """Refusals, program reader, retrieval, prompt, model, one repair and cross-checks, inside one time budget."""

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
        trust: float = ENDPOINT_TRUST,
        scene: bool = True,
    ) -> None:
        """trust: what the model's own probability of its answer is worth; of one that tells none, its probability.
        scene: whether the model is told of it."""
        self._shows_scene = scene
        self._memory, self._model, self._parser = memory, model, parser
        self._style, self._k, self._budget_s, self._mode, self._trust = style, k, budget_s, ask, trust
        self.model_name = model.name
        schemas = {"slots": adapted_schema, "programs": program_schema}
        self._schema = schemas[style]() if style in schemas else answer_schema(style == "short")

    @property
    def asks_again(self) -> bool:
        """Whether the model is asked once more when a directive is held up or its road turns."""
        return self._mode == "always" and self._style != "slots"

    async def close(self) -> None:
        """Hang up on the model's server, in the event loop that asked it."""
        await self._model.close()

    async def interpret(
        self,
        command: str,
        scene: Scene,
        context: Context | None = None,
        trace: Trace | None = None,
        act: Act | None = None,
    ) -> Interpretation:
        """What a command means. Never raises for a model's failure. How it came about goes into `trace`.

        act: is given the reader's word at once where it is sure enough, before the model is asked.
        """
        started, context, trace = time.monotonic(), context or Context(), trace or Trace()
        read, nearest = await asyncio.to_thread(self._parse, command, scene, trace)
        if context.standing is not None:
            read = _standing(context.standing, read, scene)
        first = self._first(command, read, nearest)
        if first is not None and not self._asks(first, read):
            return first
        acts = first is not None and (first.confidence >= ACTS or first.source == "refusals")
        if first is not None and acts and act is not None and not context.again:
            act(replace(first, provisional=True))
        waits = self._style != "full" and not acts and read is not None
        due = started + (min(self._budget_s, EMBEDDED_BUDGET_S) if waits else self._budget_s)
        try:
            said = await self._ask(command, scene, context, read, nearest, due, trace)
        except ModelError as error:
            found = self._without_model(first, nearest, str(error))
        except ParseError as error:
            why = f"the model's answer cannot be used: {error}"
            found = (
                Interpretation(None, why, nearest=nearest)
                if first is None
                else replace(first, why=first.why or why, verdict="overruled")
            )
        else:
            found = self._weighed(said, first, read, nearest, acts)
        trace.verdict = found.verdict
        return replace(found, model_asked=True, model_ms=_ms(started))

    def _first(self, command: str, read: _Read | None, nearest: tuple[Example, ...]) -> Interpretation | None:
        """The reader's word; None where there is no reader, and no rule against the command."""
        if unsafe(command):
            language = read.slots.language if read else "en"
            slots = Slots(outcome="refused", reasoning="dangerous or forbidden words", language=language)
            return Interpretation(slots, UNSAFE_WHY, source="refusals", nearest=nearest, confidence=1.0)
        if read is None:
            return None
        if read.refused >= REFUSE and read.slots.outcome != "refused":
            slots = Slots(outcome="refused", reasoning="may be dangerous", language=read.slots.language)
            return Interpretation(slots, UNSAFE_WHY, source="parser", nearest=nearest, confidence=1.0)
        return Interpretation(
            _reasoned(read), source="parser", nearest=nearest, program=read.program, confidence=read.trust
        )

    def _asks(self, first: Interpretation, read: _Read | None) -> bool:
        refused = first.slots is not None and first.slots.outcome == "refused" and first.why == UNSAFE_WHY
        if self._mode == "always":
            return not (refused and self._style == "full")
        return self._mode == "unsure" and not refused and read is not None and read.trust < SURE

    def _weighed(
        self, said: Said, first: Interpretation | None, read: _Read | None, nearest: tuple[Example, ...], acted: bool
    ) -> Interpretation:
        """The reader's word or the model's."""
        told = Interpretation(
            said.slots,
            said.why,
            source=self._model.name,
            nearest=nearest,
            program=said.program,
            verdict="decided",
            model_confidence=said.confidence,
        )
        if first is None or first.slots is None:
            return told
        told = replace(told, confidence=first.confidence)
        sure = read is not None and read.sure
        # A large model may refuse what the reader is sure of; nothing else is done against that.
        if self._style == "full" and said.slots.outcome == "refused" and first.slots.outcome == "directive":
            return replace(told, verdict="withdrew" if acted else "decided")
        verdict, why = weighed(said, first.slots, first.confidence, sure=sure, acted=acted)
        if verdict in ("confirmed", "overruled"):
            return replace(first, verdict=verdict, why=first.why or why, model_confidence=said.confidence)
        return replace(told, verdict=verdict)

    def _parse(self, command: str, scene: Scene, trace: Trace) -> tuple[_Read | None, tuple[Example, ...]]:
        began = time.monotonic()
        reading = self._parser.read(command, scene.speed_mps, scene.limit_mps) if self._parser else None
        read = None if reading is None else _on_this_road(reading, scene)
        trace.spans_ms["parser"] = _ms(began)
        began = time.monotonic()
        trace.nearest = tuple(self._memory.nearest(command, self._k))
        trace.spans_ms["memory"] = _ms(began)
        if read is not None:
            trace.reading = f"{read.slots.outcome}: {_reasoned(read).reasoning}"
        return read, trace.nearest

    async def _ask(
        self,
        command: str,
        scene: Scene,
        context: Context,
        read: _Read | None,
        nearest: tuple[Example, ...],
        due: float,
        trace: Trace,
    ) -> Said:
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
            trace.spans_ms["model"] = _ms(began)
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

    def _said_program(self, command: str, scene: Scene, read: _Read | None, answer: str, trace: Trace) -> Said:
        """The program in an answer, on this road. Raises `ParseError`."""
        try:
            program = replace_miles(read_program(answer), uses_miles(command))
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
        self, command: str, answered: Slots, read: _Read | None, nearest: tuple[Example, ...], trace: Trace
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
        self, command: str, slots: Slots, read: _Read | None, nearest: tuple[Example, ...]
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

    @staticmethod
    def _without_model(first: Interpretation | None, nearest: tuple[Example, ...], reason: str) -> Interpretation:
        if first is not None:
            return replace(first, why=first.why or f"{FROM_PARSER_WHY} ({reason})", verdict="unanswered")
        if nearest and nearest[0].cosine >= FROM_MEMORY_COSINE:
            return Interpretation(nearest[0].slots, f"{FROM_MEMORY_WHY} ({reason})", source="memory", nearest=nearest)
        return Interpretation(None, reason, model_answered=False, nearest=nearest, verdict="unanswered")


def _refuse_unsaid(program: Program, command: str, other: Program | None, trace: Trace) -> None:
    """Raises `ParseError` for a number that was neither said nor read."""
    if number := unsaid(program, command, other):
        trace.parses[-1] = f"it names {number}, which nobody said"
        raise ParseError(trace.parses[-1])


def replace_miles(program: Program, miles: bool) -> Program:
    """Whether the passenger speaks of miles is a rule's to say."""
    return structs.replace(program, miles=miles)


def _standing(program: Program, read: _Read | None, scene: Scene) -> _Read:
    """What is being carried out, in the reader's place."""
    language = read.slots.language if read else "en"
    return _Read(summary(program, scene, language), STANDS, 0.0, program, False)


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
