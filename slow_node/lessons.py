"""Reflection: what an outcome teaches, for the same words on a road like that one. Pure."""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec.structs import replace

from schemas.driving.measures import INF
from schemas.wire.messages import Directive
from slow_node.dialogue import Said
from slow_node.effects import Effect, Remember
from slow_node.memory.bank import TAKEN_BACK, Example, Lesson
from slow_node.planning.scene import Scene, describe, road_and_lead
from slow_node.understanding.slots import Slots

ALIKE_COSINE = 0.75
"""So near must the words be."""
ALIKE_MPS = 6.0
"""And so near the speed."""
_SCENE = re.compile(
    r"^(?P<road>[\w-]+) road, lanes (?P<lanes>[\d-]+), we are in \d+; "
    r"(?P<speed>[\d.]+) of [\d.]+ m/s; (?P<lead>no )?car"
)


def alike(one: str, other: str) -> bool:
    """Whether two described scenes are of the same kind of road, driven alike, with a car ahead or without."""
    a, b = _SCENE.match(one), _SCENE.match(other)
    if a is None or b is None:
        return False
    same = all(a[part] == b[part] for part in ("road", "lanes", "lead"))
    return same and abs(float(a["speed"]) - float(b["speed"])) <= ALIKE_MPS


def lesson_for(slots: Slots, scene: Scene, nearest: Sequence[Example]) -> Lesson:
    """What experience says about a wish on this road: the newest lesson of those alike in words, decision and scene."""
    here = road_and_lead(describe(scene))
    for example in sorted(nearest, key=lambda one: -one.id):
        if example.shipped or example.cosine < ALIKE_COSINE or example.slots.decision() != slots.decision():
            continue
        if example.lesson and alike(road_and_lead(example.scene), here):
            return example.lesson
    return ""


def taken_back(said: Said | None) -> list[Effect]:
    """The wish before was too much: what is to be remembered of that."""
    if said is None or said.slots is None or not said.command:
        return []
    return [Remember(said.command, said.scene, said.slots, f"{TAKEN_BACK}: it was too much", 0.0, INF)]


def gentler(draft: Directive, lesson: str) -> Directive:
    """A directive after a near miss in the same place: not assertive, and calm where nobody is overtaken."""
    if lesson != "gentler" or draft.manoeuvre == "stop":
        return draft
    return replace(draft, style="normal" if draft.manoeuvre == "overtake" else "calm")
