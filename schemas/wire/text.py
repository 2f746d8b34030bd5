"""Texts of strangers, made fit for one line of a terminal, a log or a page."""

from __future__ import annotations

import json
import re
import unicodedata

_TURNING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff")
"""Marks that change the direction of what follows: a line can be made to read otherwise than it is written."""


_UNSHOWN = re.compile(f"[\x7f-\x9f\ud800-\udfff{''.join(sorted(_TURNING))}]")


def json_line(value: object) -> str:
    """JSON on one line, in the letters that were written; what a terminal would take for an order is escaped."""
    line = json.dumps(value, ensure_ascii=False)
    return _UNSHOWN.sub(lambda unshown: f"\\u{ord(unshown.group()):04x}", line)


def printable(text: str) -> str:
    """The text with a blank for every control character, and without marks of direction; its own blanks stay."""
    return "".join(
        " " if unicodedata.category(c) in ("Cc", "Zl", "Zp") else c
        for c in text
        if c not in _TURNING and unicodedata.category(c) != "Cs"
    )


def plain(text: str, most: int | None = None) -> str:
    """The same with single blanks; at most so many characters of it."""
    line = " ".join(printable(text).split())
    return line if most is None or len(line) <= most else f"{line[: most - 1]}…"
