"""The steps of a command side by side: nothing twice, and of whom each is."""

from __future__ import annotations

import re

import msgspec

from schemas.wire.program import Step, Trigger


def not_said_before(mine: tuple[Step, ...], steps: list[Step], begins: Trigger | None) -> tuple[Step, ...]:
    """What is no repetition: "ambulance behind us, let it pass" yields once, "careful, slowly" slows down once."""
    left: list[Step] = []
    for step in mine:
        before = left[-1] if left else steps[-1] if steps else None
        held = before is not None and before.act == step.act and before.polarity == step.polarity
        if begins is None and before is not None and step == msgspec.structs.replace(before, when=None, until=None):
            continue
        if held and (step.act == "cancel" or (step.act == "overtake" and step.polarity == "not" and begins is None)):
            continue
        if begins is None and step.act == "yield" and before is not None and before.act == "yield":
            if not before.object and step.object:
                steps[-1] = msgspec.structs.replace(before, object=step.object)
            continue
        slowed = any(one.act == "slower" for one in (*steps, *left))
        if begins is None and step.act == "slower" and step.mode in (None, "factor") and slowed:
            continue
        left.append(step)
    return tuple(left)


def lets(step: Step) -> bool:
    return step.act == "yield" and step.polarity == "do"


def named(steps: list[Step], text: str) -> list[Step]:
    """The steps, those that let somebody go with whom another part of the command names."""
    said = [who for who in re.findall(r"@(\w+)", text) if who not in ("car", "driver")]
    riding = [who for who in said if who not in ("pedestrian", "child")]
    if not said:
        return steps
    who = (riding or said)[0]
    return [msgspec.structs.replace(s, object=who) if s.act == "yield" and not s.object else s for s in steps]


def before_us(steps: list[Step]) -> list[Step]:
    """The steps; for somebody who goes first before something else of ours, no other lane is taken."""
    if any(step.when is not None for step in steps[1:]):
        return [msgspec.structs.replace(s, side=None) if s.act == "yield" else s for s in steps]
    return steps
