"""Who is right where the quick reader and the language model differ.

One rule: of two answers that differ the likelier one counts, each by its own calibrated probability. What stands above
it: a refusal of the reader's stands, whatever a model says; what the reader knows by the words is certain; an answer
with a number that nobody said is none. What was not followed is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from schemas.driving.measures import CAR_LENGTH_M
from schemas.wire.messages import Verdict
from schemas.wire.program import Program
from slow_node.planning.program_text import number, same
from slow_node.understanding.numbers import KMH, MPH, quantities
from slow_node.understanding.slots import Slots

ACTS = 0.5
"""From this probability of being right on, the reader's word is acted on before the model has answered."""
STANDS = 0.9
"""So likely is what is being carried out, where the model is asked once more: only a surer answer changes it."""
_MEANINGS = (1.0, KMH, MPH, CAR_LENGTH_M, 60.0, 1000.0, 1609.3)
"""What a number without a unit may have to be multiplied by to be one in SI units."""


@dataclass(frozen=True)
class Said:
    """A language model's answer, read and checked."""

    program: Program
    slots: Slots
    confidence: float
    """The probability that it is right."""
    agrees: bool
    """It asks for what the reader's asks for."""
    told: str
    """In brief."""
    why: str = ""
    """Why it is not what the model wrote, where it is not."""


def weighed(said: Said, first: Slots, confidence: float, *, sure: bool, acted: bool) -> tuple[Verdict, str]:
    """What comes of the model's answer beside the reader's, and why where it is not followed.

    confidence: of the reader. sure: it knows by the words. acted: the car does already what it says.
    """
    if said.agrees:
        return "confirmed", ""
    if first.outcome == "refused" and said.slots.outcome != "refused":
        return "overruled", f"the language model said {said.told!r}: a refusal stands"
    if sure or said.confidence <= confidence:
        return "overruled", f"the language model said {said.told!r} ({said.confidence:.0%} sure): the reader is surer"
    if not acted:
        return "decided", ""
    return ("refined" if said.slots.outcome == "directive" or said.program.question else "withdrew"), ""


def agrees(program: Program, slots: Slots, other: Program, other_slots: Slots) -> bool:
    """Two programs ask for the same, in the same words or at once in others."""
    if same(program, other):
        return True
    at_once = not any(step.when or step.until for one in (program, other) for step in one.steps)
    plain = program.question == other.question and len(program.steps) == len(other.steps)
    return at_once and plain and slots.decision() == other_slots.decision()


def unsaid(program: Program, command: str, other: Program | None) -> str:
    """A number of a program that was neither said nor read; "" where there is none."""
    known = [q.value * by for q in quantities(command) for by in (_MEANINGS if q.kind in ("bare", "other") else (1.0,))]
    known += [value for value, _ in _values(other)] if other is not None else []
    for value, unit in _values(program):
        if unit != "times" and not any(math.isclose(value, one, rel_tol=0.02, abs_tol=0.05) for one in known):
            return f"{number(value)} {unit}".strip()
    return ""


def _values(program: Program) -> list[tuple[float, str]]:
    found = [(step.value, step.unit or "") for step in program.steps]
    found += [(at.value, "") for step in program.steps for at in (step.when, step.until) if at is not None]
    return [(value, unit) for value, unit in found if value is not None]
