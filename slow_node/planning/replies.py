"""What the car says: one sentence in the passenger's language, English where we do not know it."""

from __future__ import annotations

import tomllib
from pathlib import Path

SENTENCES: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_name("replies.toml").read_text("utf-8"))
"""By key, then by language."""


def sentence(key: str, language: str) -> str:
    """One sentence; English where the language is none of ours. Raises KeyError for an unknown key."""
    known = SENTENCES[key]
    return known.get(language, known["en"])
