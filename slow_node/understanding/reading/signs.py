"""What is asked for by telling how somebody fares: late, sick, too close, stuck behind, asleep, soaked in coffee."""

from __future__ import annotations

import re
from functools import lru_cache

from schemas.wire.program import Step
from slow_node.understanding.intent_parser import IntentParser, Parsed
from slow_node.understanding.reading.clauses import clauses, sentences
from slow_node.understanding.reading.lexicon import RECENT, bare, rows, searchable
from slow_node.understanding.reading.values import corrected, steps_of

HARMLESS = 0.4
"""A clause below this probability of being dangerous is none."""
LIKELY = 0.4
"""What stands beside something sure must be as likely as this."""
SURE_AS_A_WHOLE, SURE_OF_NONE = 0.75, 0.9
"""From here on the intent parser knows what is asked for; that nothing is."""
BESIDE, SIZED = 0.5, 0.3
"""From here on what stands beside a sign is a wish of its own."""
SIGN = 0.7
"""How likely it is that a sign is read as it was meant."""

SIGNS = (*rows("signs", "signs"), *rows("scenes", "signs"))
"""The first that is found counts."""
_NOT_SO = re.compile(
    r"\b(?:not|n.t|never|no longer|nicht|kein\w*|nie|ne|pas|plus|no|nunca|ya no|non|mai|nao|niet|geen|nooit|if|wenn|si|se|als) (?:\S+ ){0,2}$"
)


@lru_cache(RECENT)
def sign(text: str) -> tuple[Step, str] | None:
    """The step for the first sign in a text in `searchable` form, and what else was said; None without a sign."""
    for row in SIGNS:
        hit = row.search(text)
        if hit is None or _NOT_SO.search(text[: hit.start]):
            continue
        fields = dict(row.fields["step"])
        about = hit.said.get("who", "") if fields["act"] == "overtake" else ""
        if about not in ("", "car"):
            fields["object"] = about
        return Step(**fields), bare(f"{text[: hit.start]} {text[hit.end :]}")
    return None


def told_by_sign(text: str, whole: Parsed, parser: IntentParser, speed_mps: float, limit_mps: float) -> Step | None:
    """What a text asks for that only tells how somebody fares, where the intent parser does not know better.

    Speeds in m/s.
    """
    plain = searchable(text)
    found = sign(plain)
    if found is None:
        return None
    step, rest = found
    slots = corrected(whole.slots, plain)
    found_clauses = [clause for sentence in sentences(text) for clause in clauses(sentence)]
    if any(clause.when is not None and clause.when.kind not in ("time", "distance") for clause in found_clauses):
        return None  # it says what it waits for
    if any(clause.until is not None for clause in found_clauses) and slots.outcome == "directive":
        return None  # and this, how long
    if whole.refused >= HARMLESS and re.search(r"\d", plain):
        return None  # a number to be refused, whatever is told beside it
    numbered = any(one.value is not None for one in steps_of(slots, plain, speed_mps)) or any(
        clause.when or clause.until for clause in found_clauses
    )
    if slots.outcome == "directive" and whole.confidence >= SURE_AS_A_WHOLE and not numbered:
        return None
    if slots.outcome not in ("directive", "refused") and whole.confidence >= SURE_OF_NONE:
        return None
    if step.act == "farther" and whole.refused >= HARMLESS:
        return None  # to be too close may be what is asked for
    if len(rest.split()) > 1:
        beside = parser.parse(rest, speed_mps, limit_mps)
        wishes = {one.act for one in steps_of(beside.slots, rest, speed_mps)}
        sized = any(one.value is not None for one in steps_of(beside.slots, rest, speed_mps))
        if sized and beside.confidence >= SIZED:
            return None
        if beside.refused >= HARMLESS or (beside.confidence >= BESIDE and wishes - {step.act}):
            return None
    return step
