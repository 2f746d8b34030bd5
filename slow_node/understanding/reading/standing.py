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


class Standing(NamedTuple):
    """What was said, and whether it holds or is taken back."""

    kind: str
    holds: bool


def standing(command: str) -> Standing | None:
    """What a command says for every drive; None where it says nothing of the kind."""
    text = fold(command)
    for row in rows("standing", "stands"):
        hit = row.search(text)
        if hit is not None:
            return Standing(row.fields["kind"], _TAKEN_BACK.search(text) is None)
    return None
