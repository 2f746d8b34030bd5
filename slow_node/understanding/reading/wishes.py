"""Several wishes in one breath, in the order in which they are said: "half the speed, the right lane and more room"."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

from schemas.wire.program import Step
from slow_node.understanding.intent_parser import IntentParser
from slow_node.understanding.reading.clauses import Clause
from slow_node.understanding.reading.lexicon import bare
from slow_node.understanding.reading.values import corrected, steps_of

_JOINTS = re.compile(
    r",? (?:and|und|et|y|e|en|plus|&|aber|but|mais|pero|ma|mas|maar)(?: (?:also|auch|aussi|tambien|anche|tambem|ook))? |, "
)
_STATES = re.compile(
    r"^(?:somebody|someone|nobody|he|she|they|it|there|i.m|i am|we.re|we are|we.ve|the @|that @|this @|my|our|that.s|this is|jemand|niemand|er|sie|es|wir sind|ich bin|mein\w*|unser\w*|il|elle|c.est|on est|je suis|mon|ma|notre|"
    r"alguien|nadie|esta|es|estamos|estoy|mi|nuestr[oa]|qualcuno|nessuno|e |siamo|sono|mio|mia|nostr[oa]|alguem|ninguem|estou|meu|minha|noss[oa]|iemand|niemand|hij|zij|het|we zijn|ik ben|mijn|onze)\b"
)
"""What tells something, and asks for nothing."""
_MENDS = re.compile(
    r"(?<=\w), (?:hm+|er|um|uh|oh|ach|sorry|wait|no+|nope|nah|nein|non|nee|nao|pardon|scratch|i mean|on second|actually|doch|lieber|anzi|scusa|perdon|alias|afinal|toch|of nee)\b"
)
"""A change of mind."""
MOST_WISHES = 4
CLEAR, HARMLESS, DOUBTFUL = 0.4, 0.4, 0.6
"""Each part is as likely as this, and less likely a danger than that; below the last, the whole is not trusted to have
as many wishes as it should."""
WORD, WARNED = 0.6, 0.8
"""So clear is a part of two words; by so much it is slowed down for a warning."""
_SLOT = {"drive": "speed", "faster": "speed", "slower": "speed", "stop": "speed", "gap": "gap", "closer": "gap", "farther": "gap"}  # fmt: skip


def parted(
    clause: Clause, certain: Callable[[Clause], Step | None], parser: IntentParser, speed_mps: float, limit_mps: float
) -> list[Clause]:
    """A clause's wishes, one by one; the clause alone where its parts are not all clear wishes, each about something else.

    certain: the wish that is sure in a clause by its words. Speeds in m/s.
    """
    parts = [part for part in map(bare, _JOINTS.split(clause.text)) if part]
    if not 2 <= len(parts) <= MOST_WISHES or clause.beside or _MENDS.search(clause.text):
        return [clause]
    whole = parser.parse(clause.text, speed_mps, limit_mps)
    said = steps_of(whole.slots, clause.text, speed_mps)
    if len(said) < 2 and whole.confidence >= DOUBTFUL and whole.slots.outcome == "directive":
        return [clause]
    slots: list[str] = []
    for part in parts:
        step = certain(Clause(part))
        if step is None and _STATES.match(part):
            return [clause]
        if step is None:
            found = parser.parse(part, speed_mps, limit_mps)
            steps = steps_of(corrected(found.slots, part), part, speed_mps)
            clear = CLEAR if len(part.split()) > 2 else WORD
            if found.confidence < clear or found.refused >= HARMLESS or len(steps) != 1:
                return [clause]
            step = steps[0]
        if step.act == "slower" and step.value == WARNED:
            return [clause]  # the rest says of what
        if slots and slots[-1] == "yield" and step.act in ("farther", "slower"):
            return [clause]  # how room is made
        slots.append(about(step))
    if len(set(slots)) < len(slots):
        return [clause]
    return [replace(clause, text=parts[0]), *(Clause(part, asks=clause.asks) for part in parts[1:])]


def about(step: Step) -> str:
    """What a step is about: two wishes about one thing are one, or a correction."""
    return step.object if step.act == "keep" else _SLOT.get(step.act, step.act)
