"""Texts of strangers, made fit for one line of a terminal, a log or a page."""

from __future__ import annotations

import unicodedata

_TURNING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff")
"""Marks that change the direction of what follows: a line can be made to read otherwise than it is written."""


def plain(text: str, most: int | None = None) -> str:
    """The text on one line, without control characters and marks of direction; at most so many characters of it."""
    shown = "".join(
        " " if unicodedata.category(c) in ("Cc", "Zl", "Zp") else c
        for c in text
        if c not in _TURNING and unicodedata.category(c) != "Cs"
    )
    line = " ".join(shown.split())
    return line if most is None or len(line) <= most else f"{line[: most - 1]}…"
