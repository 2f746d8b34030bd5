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
from dataclasses import replace
from typing import Literal

from schemas.wire.program import Program
from slow_node.asking import FROM_MEMORY_COSINE, Asking, Style
from slow_node.interpretation import Context, Interpretation, Read
from slow_node.llm.errors import ModelError
from slow_node.llm.model import ChatModel
from slow_node.memory.bank import Example, Memory
from slow_node.planning.directive import UNSAFE_WHY, ParseError
from slow_node.planning.scene import Scene
from slow_node.planning.steps import summary
from slow_node.thought import Trace
from slow_node.understanding.reading.reader import ProgramReader, Reading
from slow_node.understanding.refusals import unsafe
from slow_node.understanding.slots import Slots
from slow_node.verdict import ACTS, STANDS, Said, weighed

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
Act = Callable[[Interpretation], None]
"""Takes the reader's word while the model is still thinking."""


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
        self._memory, self._model, self._parser = memory, model, parser
        self._style, self._k, self._budget_s, self._mode = style, k, budget_s, ask
        self._asking = Asking(model, style, trust, scene=scene)
        self.model_name = model.name

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
            said = await self._asking.ask(command, scene, context, read, nearest, due, trace)
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

    def _first(self, command: str, read: Read | None, nearest: tuple[Example, ...]) -> Interpretation | None:
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

    def _asks(self, first: Interpretation, read: Read | None) -> bool:
        refused = first.slots is not None and first.slots.outcome == "refused" and first.why == UNSAFE_WHY
        if self._mode == "always":
            return not (refused and self._style == "full")
        return self._mode == "unsure" and not refused and read is not None and read.trust < SURE

    def _weighed(
        self, said: Said, first: Interpretation | None, read: Read | None, nearest: tuple[Example, ...], acted: bool
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

    def _parse(self, command: str, scene: Scene, trace: Trace) -> tuple[Read | None, tuple[Example, ...]]:
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

    @staticmethod
    def _without_model(first: Interpretation | None, nearest: tuple[Example, ...], reason: str) -> Interpretation:
        if first is not None:
            return replace(first, why=first.why or f"{FROM_PARSER_WHY} ({reason})", verdict="unanswered")
        if nearest and nearest[0].cosine >= FROM_MEMORY_COSINE:
            return Interpretation(nearest[0].slots, f"{FROM_MEMORY_WHY} ({reason})", source="memory", nearest=nearest)
        return Interpretation(None, reason, model_answered=False, nearest=nearest, verdict="unanswered")


def _standing(program: Program, read: Read | None, scene: Scene) -> Read:
    """What is being carried out, in the reader's place."""
    language = read.slots.language if read else "en"
    return Read(summary(program, scene, language), STANDS, 0.0, program, False)


def _on_this_road(reading: Reading, scene: Scene) -> Read:
    slots = reading.slots or summary(reading.program, scene, reading.language)
    return Read(slots, reading.confidence, reading.refused, reading.program, reading.sure)


def worded(name: str, value: object) -> str:
    """A slot for people: "speed faster", "overtake", "no overtake", "target speed mps 22.2"."""
    if isinstance(value, bool):
        return name if value else f"no {name}"
    return f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"


def _reasoned(parsed: Read) -> Slots:
    """The intent parser's slots with its reasons: what it heard and how sure it is."""
    slots = parsed.slots
    named = slots.model_dump(exclude_defaults=True, exclude={"outcome"})
    heard = [worded(name.replace("_", " "), value) for name, value in named.items()]
    said = ", ".join(heard) if heard else slots.outcome.replace("_", " ")
    return slots.model_copy(update={"reasoning": f"heard: {said} ({parsed.confidence:.0%} sure)"})


def _ms(started: float) -> float:
    return 1000.0 * (time.monotonic() - started)
