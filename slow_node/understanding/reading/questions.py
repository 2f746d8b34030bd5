"""Questions about the ride: by how they begin (`questions.toml`), or by what is asked (`topics.toml`)."""

from __future__ import annotations

import re

from schemas.wire.program import Question
from slow_node.understanding.reading.lexicon import Row, rows

MOST_BEFORE = 4
"""So many words may stand before the word of asking: "and tell me then, ..."."""
_WISH = re.compile(
    r"\d|\b(?:(?:can|could|would|will|shall) (?:you|we) (?!tell|say)|please|bitte|go|drive|move|faster|slower|left|right|links|rechts|"
    r"gauche|droite|izquierda|derecha|sinistra|destra|esquerda|direita)\b"
)
"""What comes first is a wish of its own, and its question is not all of it."""


def question_in(clause: str, marked: bool) -> Question:
    """What a clause in `searchable` form asks about the ride; "" where it asks nothing.

    marked: a question mark ends its sentence.
    """
    for row in rows("questions", "asks"):
        hit = row.search(clause)
        if hit is not None and hit.start == 0:
            return _asked_by(row)
    for row in rows("topics", "topics"):
        hit = row.search(clause) if marked or not row.fields.get("mark") else None
        before = clause[: hit.start] if hit is not None else ""
        if hit is not None and len(before.split()) <= MOST_BEFORE and not _WISH.search(before):
            return _asked_by(row)
    return ""


def _asked_by(row: Row) -> Question:
    question: Question = row.fields["question"]
    return question
