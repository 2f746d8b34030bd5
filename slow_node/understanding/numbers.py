"""Numbers that a passenger says, as rules: in digits or words, with their units. Small models invent numbers.

Which words are numbers is in `number_words`, what is mended first in `number_slips`. What a number is for (a speed, a
change of it, a time gap) is not decided here: see `slow_node.understanding.intent_parser`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, NamedTuple

from slow_node.understanding.number_slips import prepared
from slow_node.understanding.number_words import COMMON_WORDS, replaced

Kind = Literal["speed", "time", "length", "bare", "other"]

KMH, MPH, KNOT = 1 / 3.6, 0.44704, 0.5144
FOOT, YARD = 0.3048, 0.9144


@dataclass(frozen=True)
class Quantity:
    """A number and what it measures: metres per second, seconds, metres, or as it was said (`bare`, `other`)."""

    value: float
    kind: Kind


def in_digits(text: str) -> str:
    """A text folded, its times of day as "clock" and its numbers from ten up in digits: what the intent parser reads."""
    return replaced(prepared(text), lambda word, n: n >= 10 and word not in COMMON_WORDS)


def quantities(text: str) -> list[Quantity]:
    """Every number in a text, in the order in which they are said."""
    folded = replaced(_HALF_SECOND.sub(_half_second, prepared(text)), lambda word, n: word != "a")
    miles = re.search(r"\b(mph|mi/h|miles?|meilen?|millas?|miglia|milhas?|mijl|milles?)\b", folded) is not None
    found = []
    for match in _PATTERN.finditer(folded):
        value = _value(match["number"])
        if match["tenth"]:
            value += _value(match["tenth"]) / 10
        if match["half"]:
            value += 0.5
        unit = next((unit for unit in UNITS if match[unit.name]), None)
        if unit is None:
            found.append(Quantity(value, "bare"))
            continue
        if match["halfafter"]:
            value += 0.5
        found.append(Quantity(value * unit.factor, unit.kind))
    return [Quantity(q.value * (MPH if miles else KMH), "speed") if _is_speed(q) else q for q in found]


def _half_second(match: re.Match[str]) -> str:
    return f"{_HALVES[match['more']] if match['more'] else 0.5} seconds"


def _is_speed(quantity: Quantity) -> bool:
    """A bare number that can be a speed is one, in km/h, or in mph where miles are spoken of."""
    return quantity.kind == "bare" and (quantity.value >= 10 or quantity.value == 0)


class Unit(NamedTuple):
    """One unit in all its spellings."""

    name: str
    kind: Kind
    factor: float
    """To metres per second, seconds or metres."""
    pattern: str
    matches: str
    """A folded text with a number of it."""
    passes: str
    """One without."""


UNITS = (
    Unit(
        "mps",
        "speed",
        1.0,
        r"m/s|mps|(?:met(?:er|re|ro|ri)s?|metern?|metr(?:y|ow|ia)|метр\w*)[ -](?:per|pro|par|por|al?|je|i|na|"
        r"в)[ -](?:a )?"
        r"(?:se[ckg]\w+|секунд\w*)|metria sekunnissa",
        "25 m/s",
        "25 metres",
    ),
    Unit(
        "kmh",
        "speed",
        KMH,
        r"km\s?/\s?[hutg]\w*|kmh|kph|kmph|km h|stundenkilometern?|sachen|klicks?|clicks?|км/ч|км|公里|千米|キロ|"
        r"킬로\w*"
        r"|(?:kilom\w+|km|k|quilom\w+|chilom\w+|килом\w+)(?:[ -](?:per|an|a|pro|par|por|in der|in het|na|orari\w*|"
        r"horari?\w*|i|a l'|all'|a la)[ -]?(?:hour|stunde|heure|hora|ora|uur|timmen?|godzine|timen?|"
        r"час))?(?![a-z])",
        "80 km/h",
        "80 kg",
    ),
    Unit(
        "mph",
        "speed",
        MPH,
        r"mph|mi/h|(?:miles?|meilen?|millas?|miglia|milhas?|mijl|milles?)(?: (?:an?|per|pro|por|all'|a l'|per) ?"
        r"(?:hour|stunde|hora|ora|uur|heure))?",
        "50 miles an hour",
        "50 smiles",
    ),
    Unit("knot", "speed", KNOT, r"knots?|knoten|noeuds?|nudos|nodi|knopen", "40 knots", "40 knocks"),
    Unit(
        "other",
        "other",
        1.0,
        r"%|percent|prozent|min(?:ute|uti|uto|uut|ut)?\w*|hours?|stunden?|heures?|horas?|ore|uur|uhr|"
        r"o'?clock|am|pm|"
        r"degrees?|grad|euros?|dollars?|lanes?|spuren?|voies?|carril\w*|cors[ie]\w*|faixas?|ban(?:en|an)?|times|"
        r"cars?|car lengths?|people|years?|jahre?|th|st|nd|rd",
        "2 lanes",
        "2 seconds",
    ),
    Unit(
        "second",
        "time",
        1.0,
        r"s|secs?|sek|se[ckg]\w*ond\w*|sec(?:n?d|on|od|no)s?|se(?:oc|o)n?ds?|"
        r"segund\w*|seg|sekun[dt]\w*|seconden?|saniye|секунд\w*|秒\w*|초",
        "3 seconds",
        "3 lanes",
    ),
    Unit("foot", "length", FOOT, r"feet|foot|ft|fuss|pieds?|pies", "50 feet", "50 feats"),
    Unit("yard", "length", YARD, r"yards?|yds?", "30 yards", "30 yaks"),
    Unit(
        "metre",
        "length",
        1.0,
        r"m|met(?:er|re|ro|ri)s?|metern|metr(?:y|ow|a|ia)?|метр\w*|米|メートル|미터",
        "40 metres",
        "40 minutes",
    ),
)
_HALVES = {
    "anderthalb": 1.5,
    "eineinhalb": 1.5,
    "anderhalve": 1.5,
    "zweieinhalb": 2.5,
    "dreieinhalb": 3.5,
    "tweeenhalve": 2.5,
    "drieenhalve": 3.5,
}
_HALF_SECOND = re.compile(
    rf"(?<!and )(?<!and a )(?<!und )(?<!en )\b(?:(?P<more>{'|'.join(_HALVES)})e?n?|half a|half|halbe\w*|halben?|"
    r"demi-?|une demi|medio|mezzo|meio|halve)"
    r"[ -]?(?:a )?(?:sec|sek|seg)\w*"
)


_PATTERN = re.compile(
    r"(?<![\d.,])(?P<number>\d+(?:[.,]\d+)?|(?<![^\W_])a(?= second))"
    r"(?:\s*(?:point|komma|virgule|coma|virgola|virgula)\s*(?P<tenth>\d))?"
    r"(?P<half> and a half| (?:und|en) (?:1|ein|een) halb?\w*| ?\u00bd| 1\u20442)?"
    rf"(?:[\s-]?(?:{'|'.join(f'(?P<{unit.name}>{unit.pattern})' for unit in UNITS)})(?![a-z])"
    r"(?P<halfafter> et demie?| y medio| e mezzo| e meio| and a half)?)?"
)


def _value(text: str) -> float:
    return 1.0 if text == "a" else float(text.replace(",", "."))
