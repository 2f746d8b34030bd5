"""What the car says: one sentence in the passenger's language, English where we do not know it."""

from __future__ import annotations

import tomllib
from pathlib import Path

from slow_node.understanding.numbers import FOOT, KMH, MPH

SENTENCES: dict[str, dict[str, str]] = {
    key: sentences
    for name in ("replies", "answers")
    for key, sentences in tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text("utf-8")).items()
}
"""By key, then by language; "{speed}" and the like stand for numbers."""


KILOMETRE, MILE = 1000.0, 1609.344


def sentence(key: str, language: str, **numbers: str) -> str:
    """One sentence; English where the language is none of ours. Raises KeyError for an unknown key or number."""
    known = SENTENCES[key]
    return known.get(language, known["en"]).format(**numbers)


def spoken_speed(mps: float, miles: bool = False) -> str:
    """A speed as the passenger speaks of it."""
    return f"{mps / MPH:.0f} mph" if miles else f"{mps / KMH:.0f} km/h"


def spoken_length(metres: float, miles: bool = False) -> str:
    """A distance as the passenger speaks of it."""
    if metres >= KILOMETRE:
        return f"{metres / MILE:.1f} mi" if miles else f"{metres / KILOMETRE:.1f} km"
    return f"{metres / FOOT:.0f} ft" if miles else f"{metres:.0f} m"
