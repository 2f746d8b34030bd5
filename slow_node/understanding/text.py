"""The form of a text in which words are compared."""

from __future__ import annotations

import unicodedata


def fold(text: str) -> str:
    """Lower case, without accents and typographic variants: what words are compared in."""
    plain = unicodedata.normalize("NFKD", text.lower().replace("\u2019", "'").replace("\u00df", "ss"))
    return "".join(c for c in plain if not unicodedata.combining(c) or c in "\u3099\u309a")
