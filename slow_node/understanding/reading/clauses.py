"""Where one wish ends and the next begins, and what is waited for."""

from __future__ import annotations

import re
from dataclasses import dataclass

from schemas.wire.program import Trigger
from slow_node.understanding.number_words import replaced
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.lexicon import Found, Row, bare, rows, searchable, side_said

_SENTENCES = re.compile(r"(?<=[.!?;\u2026])\s+|\s*\n\s*|\s+[\u2013\u2014-]+\s+|(?<=[\w])\s*\u2026\s*|(?<=\w)\.\.+\s*")
_THEN = re.compile(
    r"(?:^|[ ,;]+)(?:and |und |et |y |e |en )?(?<!from )(?<!go on )(?:then|after (?:that|this)(?= ?,| ?$| (?:you|go|move|change|pull|slow|speed|"
    r"drive|take|turn|keep|overtake|pass|please|get)\b)|afterwards|dann|danach|anschliessend|puis|"
    r"ensuite|apres ca|luego|despues(?! de)|poi|dopodiche|dopo(?= \w+[ai]\b(?<!la))|depois(?! d[aeo])|em seguida|daarna|"
    r"vervolgens|(?<=, )dan|(?<=en )dan)\b(?! on\b),? ?"
    r"|,? (?:and|und|et|y|e|en) (?=\w+(?: \w+)? (?:then|danach|dann|anschliessend|puis|ensuite|luego|despues|poi|dopo|depois|daarna|"
    r"dan)\b)"
)
_FIRST = re.compile(
    r"^(?:first(?:ly)?|zuerst|erst(?:mal)?|d'abord|primero|per prima cosa|prima(?= [a-z]+[ai]\b)|primeiro|eerst),? "
)
_AND_THERE = re.compile(
    r",? (?:(?:and|und|et|y|e|en) )?(?:when|once|as soon as|wenn|sobald|quand|une fois que?|cuando|una vez|quando|appena|als|zodra) "
    r"(?:(?:you.?re|you are|we.?re|we are|that.?s|that is|it.?s|you have|you.?ve) (?:there|done|finished|over there|through|done (?:that|it))|"
    r"(?:du|wir) (?:da|dort|druben|fertig) (?:bist|sind)|das (?:erledigt|geschafft|fertig) ist|tu y es|c.est fait|tu as fini|"
    r"(?:estes|estemos) (?:ahi|alli)|(?:hayas|hayamos) terminado|(?:ci sei|hai finito|e fatto)|(?:estiveres la|acabares|estiver feito)|"
    r"(?:je|we) (?:daar|klaar) (?:bent|zijn)|dat (?:klaar|gedaan) is),? "
)
"""When the step before is done."""
_THEN_INSIDE = re.compile(
    r",? (?:and|und|et|y|e|en) (\w+(?: \w+)?) (?:then|danach|dann|anschliessend|puis|ensuite|luego|despues|poi|dopo|depois|daarna|dan) "
)
"""The verb before its "then"."""
_ACTS = (
    r"(?:\w+ing|move|slow|change|go|overtake|pass|speed|turn|drive|pull|brake|accelerate|merge|get|switch|"
    r"(?:du|wir) |d.|de |que |di |je |we )"
)
_BEFORE = re.compile(
    r"^(?P<last>.{6,}?),? (?:before|bevor|ehe|avant|antes|prima|voordat) (?:you |we |du |wir |je )?(?P<next>"
    + _ACTS
    + r".{3,})$"
)
_BEFORE_FIRST = re.compile(
    r"^(?:before|bevor|ehe|avant|antes|prima|voordat) (?:you |we |du |wir |je )?(?P<next>"
    + _ACTS
    + r"[^,]{3,}), (?P<last>.{3,})$"
)
"""One thing before the other: said in either order."""
_ONE = r"(?:a|an|one|another|eine?[nmr]?|une?|una?|uno|uma?|een)"
_HALF = re.compile(
    r"\b(?:half an?|eine[nm]? halbe[nr]?|une demi|medi[ao]|mezz[ao]|mei[ao]|een half|een halve)[ -]"
    r"(?P<unit>minut\w*|minuto|kilomet\w*|chilometro|quilometro|miles?|meile)\b"
)
_SINGLE = re.compile(rf"\b{_ONE} (?=(?:minut[eoa]?|minuut|kilomet\w+|chilometro|quilometro|miles?|meile|km)\b)")
"""Amounts in words: "half a minute", "a kilometre"."""
_EVERY_ROAD = re.compile(
    r"\b(?:when|if|once|as soon as|wenn|sobald|si|quand|des que|cuando|en cuanto|se|quando|appena|assim que|als|zodra) "
    r"(?:it(?:'s| is)? |that(?:'s| is)? |es |das |c'est |es |sea |e |for |het |dat )?(?:safe|possible|convenient|sicher|moglich|geht|"
    r"sur|possible|seguro|posible|sicuro|possibile|possivel|veilig|mogelijk|kan)(?: ist| is)?\b,? ?"
)
"""Said of every wish, and true of all: no condition."""


@dataclass(frozen=True)
class Clause:
    """A part of a command with one wish, or with none."""

    text: str
    """In `searchable` form, what is waited for cut out."""
    when: Trigger | None = None
    until: Trigger | None = None
    then: bool = False
    """It follows what was said before."""
    asks: bool = False
    """A question mark ends its sentence."""


def sentences(command: str) -> list[str]:
    """The sentences of a command as they were said."""
    return [part.strip() for part in _SENTENCES.split(command) if re.search(r"\w", part)]


def clauses(sentence: str) -> list[Clause]:
    """The clauses of one sentence, in order."""
    text = _EVERY_ROAD.sub("", _in_order(searchable(sentence)))
    found: list[Clause] = []
    asks = sentence.rstrip().endswith("?")
    waiting: Trigger | None = None
    for number, part in enumerate(_THEN.split(_FIRST.sub("", _LEAD_IN.sub("", text)))):
        rest, when, until = _cut(part)
        rest = bare(rest)
        if waiting is not None and when is None:
            when = waiting
        if not rest:
            waiting = when
            continue
        found.append(Clause(rest, when, until, number > 0 and bool(found), asks))
        waiting = None
    if waiting is not None:
        found.append(Clause("", waiting, None, bool(found)))
    return found


def _in_order(text: str) -> str:
    """A text with amounts in digits, and what comes first said first."""
    text = _HALF.sub(lambda m: "30 seconds" if m["unit"].startswith("minu") else f"0.5 {m['unit']}", text)
    text = _SINGLE.sub("1 ", text).replace("des qu'il", "des que il")
    text = _THEN_INSIDE.sub(r", then \1 ", _AND_THERE.sub(", then ", text))
    for pattern in (_BEFORE_FIRST, _BEFORE):
        found = pattern.match(text.rstrip(".!?"))
        if found is not None:
            return f"{found['last']}, then {found['next']}"
    return text


_LEAD_IN = re.compile(r"^(?:please|bitte|ok|okay|so|now|well|hey|car|alors|bueno|allora|entao|nou)[ ,]+")


def _cut(text: str) -> tuple[str, Trigger | None, Trigger | None]:
    """A text without what is waited for; when it begins, and until when it lasts."""
    when: Trigger | None = None
    until: Trigger | None = None
    for row in rows("triggers", "waits"):
        ends = row.fields.get("until", False)
        if (ends and until) or (not ends and when):
            continue
        found = row.search(text)
        trigger = None if found is None else _trigger(row, found)
        if found is None or trigger is None:
            continue
        text = f"{text[: found.start]} {text[found.end :]}".strip(" ,")
        if ends:
            until = trigger
        else:
            when = trigger
    return text, when, until


def _trigger(row: Row, found: Found) -> Trigger | None:
    said, kind = found.said, row.fields["kind"]
    side = side_said(said)
    value: float | None = None
    if kind == "time":
        value = float(said["t"].replace(",", ".")) * (60.0 if said["tu"].startswith("min") else 1.0)
    elif kind == "distance":
        unit = said["du"]
        metres = (
            1000.0
            if unit[0] in "kqc"
            else 1609.3
            if unit.startswith(("mile", "meile"))
            else 0.9144
            if unit[0] == "y"
            else 1.0
        )
        value = float(said["d"].replace(",", ".")) * (0.3048 if unit == "feet" else metres)
    elif kind == "speed":
        speeds = [q.value for q in quantities(replaced(said["v"], lambda _, n: True)) if q.kind == "speed"]
        if not speeds:
            return None
        value = speeds[-1]
    who = row.fields.get("object", said.get("who", ""))
    if value is not None and value > 10_000:
        return None
    return Trigger(kind=kind, object=who, side="left" if side == "left" else "right" if side else None, value=value)
