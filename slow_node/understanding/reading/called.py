"""What is said to the car by its name in the middle of talk: "... and you, car, slow down a touch, no, not you, Mum"."""

from __future__ import annotations

import re
from collections.abc import Callable

_CAR = r"(?:car|auto|wagen|voiture|coche|macchina|carro)"
_LEAD = r"(?:^|[,.;:!?\u2013\u2014-]\s*|\b(?:uh|um|er|hey|and|und|et|y|e|en|oye|oi|ehi|h\u00e9|\u00f4|o|okay|ok)\s+)"
_NAMED = re.compile(
    rf"{_LEAD}(?:(?:hey|and|und|et|y|e|en|oye|oi|ehi|\u00f4|h\u00e9|hallo),?\s+)*(?:(?:du|you|jij|dear),?\s+|tu,?\s+(?=macchina))?{_CAR}(?:[,!:]\s*|\s+)(?P<said>(?!is\b|ist\b|est\b|es\b|\u00e8\b|was\b|has\b|hat\b).+)"
    r"|(?:^|[,.;:!?\u2013\u2014-]\s*|\s)(?:and you(?: there)?|hey,? you(?: there)?|oi,? you|you there|und du(?: da)?|du da|et toi(?: l\u00e0)?|toi l\u00e0|y t\u00fa|oye,? t\u00fa|t\u00fa ah\u00ed|e tu|ehi,? tu|e voc\u00ea(?: a\u00ed)?|"
    rf"voc\u00ea a\u00ed|en jij(?: daar)?|jij daar)\b,?\s+(?!know|said|say|see|told|were|was|hast|bist|as\b|es\b|sei\b|hai\b)(?:{_CAR}[,!:]?\s+)?(?P<told>.+)",
    re.I | re.S,
)
_AT_THE_END = re.compile(
    rf"(?:^|[,.;:!?\u2013\u2014]\s*)(?P<said>[^,.;:!?\u2013\u2014]{{6,}}),\s*{_CAR}\s*[,.;!?\u2013\u2014]\s*\S",
    re.I | re.S,
)
_PARTS = re.compile(r"\s*[,;:.!?\u2013\u2014]+\s+|\s+-+\s+|[.!?]+$")
_TURNS_AWAY = re.compile(
    r"\s+(?:okay|ok|yes|yeah|no|nope|so|right|anyway|haan|s\u00ed|que s\u00ed|que no|vale|bueno|nada|ja|nein|nee|non|oui|voil\u00e0|alors|dunque|allora|cio\u00e8|dai|t\u00e1|pois|ent\u00e3o|anda|"
    r"(?:and|but) (?:he|she|they|i)|(?:where|what) (?:was|were) (?:i|we))(?=\s|$).*$",
    re.I | re.S,
)
LONG, ENOUGH = 5, 0.3
"""Of so many words on a request without commas may run on into talk; so sure is it that it asks."""


def called(text: str, asks: Callable[[str], float]) -> tuple[str, list[str]] | None:
    """What is said to the car by name, and the rest of the text in parts; None where nobody calls it, or nothing else is said.

    asks: how sure it is that a part asks for something.
    """
    named, ended = _NAMED.search(text), _AT_THE_END.search(text)
    if ended is not None and (named is None or asks(ended["said"]) >= ENOUGH):
        said, before = ended["said"], f"{text[: ended.start()]} , {text[ended.end() - 1 :]}"
    elif named is not None:
        said, before = named["said"] or named["told"], text[: named.start()]
    else:
        return None
    parts = [part for part in _PARTS.split(said) if part and re.search(r"\w", part)]
    others = [part for part in _PARTS.split(before) if part and re.search(r"\w", part)]
    if not parts:
        return None
    first, *later = parts
    short = _TURNS_AWAY.sub("", first) if len(first.split()) > LONG else first
    if not others and not later and short == first:
        return None
    if asks(short) < max(ENOUGH, asks(first)) and asks(first) >= ENOUGH:
        short = first
    if asks(short) < ENOUGH:
        return None
    kept = [short]
    if short == first:
        while later and asks(later[0]) >= 2 * ENOUGH:
            kept.append(later.pop(0))
    else:
        later.insert(0, first[len(short) :])
    return ", ".join(kept), [*others, *later]
