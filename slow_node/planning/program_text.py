"""A program (`schemas.wire.program`) as the language model writes it: its schema, its text, and Parse (Eq. 9).

The same schema is sent to the model's server, trained on and validated: JSON on one line, without what is left out.
Numbers have two decimals. What a model need not say (`miles`) is left to rules.
"""

from __future__ import annotations

import json
import math
from typing import Any

import msgspec

from schemas.wire.program import Program, Step, Trigger, plain
from slow_node.llm.answer import json_object
from slow_node.planning.directive import ParseError
from slow_node.understanding.reading.lexicon import OBJECTS

ABOUT = ("limit", "middle", "speed", "lane", "gap")
"""What a step may be about besides vehicles and people."""
TOLERANCE = {"mps": 0.3, "s": 0.15, "m": 0.5, "times": 0.05}
_LEFT_OUT = ("miles",)


def program_schema() -> dict[str, Any]:
    """JSON schema of a program, as small as a grammar needs it."""
    defs = msgspec.json.schema(Program)["$defs"]
    named = {"Step": (*OBJECTS, *ABOUT), "Trigger": (*OBJECTS, "oncoming")}

    def trimmed(part: Any) -> Any:
        if isinstance(part, dict) and "$ref" in part:
            return of(part["$ref"].rpartition("/")[2])
        if isinstance(part, dict) and "anyOf" in part:
            return trimmed(part["anyOf"][0])
        if isinstance(part, dict):
            kept = {k: trimmed(v) for k, v in part.items() if k not in ("default", "title", "description")}
            return {"type": "string", **kept} if "enum" in kept else kept
        return part

    def of(name: str) -> dict[str, Any]:
        schema: dict[str, Any] = trimmed(defs[name])
        fields = {key: value for key, value in schema["properties"].items() if key not in _LEFT_OUT}
        if name in named:
            fields["object"] = {"type": "string", "enum": sorted(named[name])}
        if name == "Program":
            fields["question"] = {"type": "string", "enum": [one for one in fields["question"]["enum"] if one]}
        return {**schema, "properties": fields}

    return of("Program")


def written(program: Program) -> str:
    """A program in the model's words."""
    values = _rounded({key: value for key, value in plain(program).items() if key not in _LEFT_OUT})
    return json.dumps(values, ensure_ascii=False, separators=(",", ":"))


def read_program(text: str) -> Program:
    """The program in a model's text, which may wrap it in prose. Raises `ParseError`."""
    try:
        value = json_object(text)
        program: Program = msgspec.convert(value, Program)
    except msgspec.ValidationError as error:
        raise ParseError(str(error)) from None
    except ValueError as error:
        raise ParseError(str(error)) from None
    if program.outcome == "directive" and not program.steps:
        raise ParseError("outcome is directive, but no step says what to do")
    return program


def same(one: Program, other: Program) -> bool:
    """Whether two programs ask for the same, numbers within `TOLERANCE`."""
    if one.outcome != other.outcome or one.question != other.question or len(one.steps) != len(other.steps):
        return False
    return all(_same_step(a, b) for a, b in zip(one.steps, other.steps, strict=True))


def _same_step(one: Step, other: Step) -> bool:
    keys = ("act", "object", "side", "polarity")
    if any(getattr(one, key) != getattr(other, key) for key in keys):
        return False
    if (one.count or 1) != (other.count or 1) or one.unit != other.unit or (one.mode or "to") != (other.mode or "to"):
        return False
    if not _near(one.value, other.value, TOLERANCE.get(one.unit or "", 0.01)):
        return False
    return _same_trigger(one.when, other.when) and _same_trigger(one.until, other.until)


def _same_trigger(one: Trigger | None, other: Trigger | None) -> bool:
    if one is None or other is None:
        return one is other
    return (one.kind, one.object, one.side) == (other.kind, other.object, other.side) and _near(
        one.value, other.value, 0.5
    )


def _near(one: float | None, other: float | None, tolerance: float) -> bool:
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=0.02, abs_tol=tolerance)


def brief(program: Program) -> str:
    """A program in a few words, for turns and wishes that stand."""
    if program.outcome != "directive":
        return program.question.replace("_", " ") or program.outcome.replace("_", " ")
    return ", ".join(map(_brief_step, program.steps))


def _brief_step(step: Step) -> str:
    words: list[str] = [] if step.polarity == "do" else ["not"]
    words.append(step.act)
    words += [step.side] if step.side else []
    words += [str(step.count)] if step.count and (step.count > 1 or not step.side) else []
    words += [step.object] if step.object else []
    if step.value is not None:
        words += [step.mode or "to", number(step.value), step.unit or ""]
    for name, trigger in (("when", step.when), ("until", step.until)):
        if trigger is not None:
            value = None if trigger.value is None else number(trigger.value)
            words += [name, trigger.kind, *(one for one in (trigger.object, trigger.side, value) if one)]
    return " ".join(word for word in words if word)


def number(value: float) -> str:
    """With two decimals at most."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        short = round(value, 2)
        return int(short) if short.is_integer() else short
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, list) else value
