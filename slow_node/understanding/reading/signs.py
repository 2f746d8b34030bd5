"""What is asked for by telling how somebody fares: late, sick, too close, stuck behind, asleep, soaked in coffee."""

from __future__ import annotations

import re

from schemas.wire.program import Step
from slow_node.understanding.reading.lexicon import bare, rows

_NOT_SO = re.compile(
    r"\b(?:not|n.t|never|no longer|nicht|kein\w*|nie|ne|pas|plus|no|nunca|ya no|non|mai|nao|niet|geen|nooit|if|wenn|si|se|als) (?:\S+ ){0,2}$"
)


def sign(text: str) -> tuple[Step, str] | None:
    """The step for the first sign in a text in `searchable` form, and what else was said; None without a sign."""
    for row in rows("signs", "signs"):
        hit = row.search(text)
        if hit is None or _NOT_SO.search(text[: hit.start]):
            continue
        about = hit.said.get("who", "") if row.fields["step"]["act"] == "overtake" else ""
        return Step(**row.fields["step"], object="" if about == "car" else about), bare(
            f"{text[: hit.start]} {text[hit.end :]}"
        )
    return None
