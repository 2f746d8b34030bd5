"""What a passenger says of himself for every drive to come: "I get carsick"; and what he takes back of it."""

from __future__ import annotations

import re
from typing import NamedTuple

from slow_node.understanding.reading.lexicon import rows
from slow_node.understanding.text import fold

_TAKEN_BACK = re.compile(
    r"\b(?:forget|do(?:es)? ?n.?t (?:remember|matter)|no longer|not any ?more|nevermore|vergiss|nicht mehr|oublie|ne .{0,20} plus|olvida|"
    r"ya no|dimentica|non .{0,20} piu|esquece|ja nao|vergeet|niet meer)\b"
)
_BESIDES = re.compile(
    r"(?:\W|\b(?:just|so|you|know|by|the|way|fyi|please|note|that|remember|forget|easily|often|sometimes|usually|always|a|"
    r"lot|very|really|quite|in|cars?|on|long|trips|drives|and|too|also|well|ok|okay|oh|hey|i|she|he|we|no|longer|any|more|"
    r"nur|damit|du|es|weisst|ubrigens|bitte|vergiss|merk|dir|dass|ich|bin|mir|immer|leicht|oft|im|auto|und|auch|sehr|"
    r"nicht|mehr|j|je|que|qu|tu|sais|pour|info|au|fait|oublie|toujours|souvent|facilement|en|voiture|plus|me|por|cierto|"
    r"olvida|siempre|facilmente|mucho|coche|ya|dimentica|che|sappi|sempre|spesso|macchina|piu|esquece|de|carro|muito|ja|"
    r"nao|vergeet|dat|ik|trouwens|altijd|vaak|niet|meer)\b)*"
)
"""Words that ask for nothing beside such a sentence."""


class Standing(NamedTuple):
    """What was said, and whether it holds or is taken back."""

    kind: str
    holds: bool


def standing(command: str) -> Standing | None:
    """What a command says for every drive; None where it says nothing of the kind."""
    found = _found(command)
    return None if found is None else found[0]


def is_only_standing(command: str) -> bool:
    """Whether it says something for every drive, and nothing for now."""
    found = _found(command)
    return found is not None and _BESIDES.fullmatch(found[1]) is not None


def _found(command: str) -> tuple[Standing, str] | None:
    """What is said, and the text around it."""
    text = fold(command)
    for row in rows("standing", "stands"):
        hit = row.search(text)
        if hit is not None:
            said = Standing(row.fields["kind"], _TAKEN_BACK.search(text) is None)
            return said, f"{text[: hit.start]} {text[hit.end :]}"
    return None
