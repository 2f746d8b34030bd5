"""Where one wish ends and the next begins, and what is waited for."""

from __future__ import annotations

import re
from dataclasses import dataclass

from schemas.wire.program import Trigger
from slow_node.understanding.number_words import replaced
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.happens import told
from slow_node.understanding.reading.lexicon import Found, Row, bare, rows, searchable, side_said
from slow_node.understanding.reading.values import AT_LEAST

_SENTENCES = re.compile(r"(?<=[.!?;\u2026])\s+|\s*\n\s*|\s+[\u2013\u2014-]+\s+|(?<=[\w])\s*\u2026\s*|(?<=\w)\.\.+\s*")
_THEN = re.compile(
    r"(?:^|[ ,;]+)(?:and |und |et |y |e |en )?(?<!from )(?<!go on )(?:then|after (?:that|this)(?= ?,| ?$| (?:you|go|move|change|pull|slow|speed|"
    r"drive|take|turn|keep|overtake|pass|please|get|tuck|come|swing|slip|return|stop|drop|head|let|ease|brake|accelerate|hold|stay|close|leave|merge|switch)\b)|afterwards|dann|danach|anschliessend|puis|"
    r"ensuite|apres ca|luego|despues(?! de)|poi|dopodiche|dopo(?= \w+[ai]\b(?<!la))|depois(?! d[aeo])|em seguida|daarna|"
    r"vervolgens|(?<=, )dan|(?<=en )dan)\b(?! on\b),? ?"
    r"|,? (?:and|und|et|y|e|en) (?=\w+(?: \w+)? (?:then|danach|dann|anschliessend|puis|ensuite|luego|despues|poi|dopo|depois|daarna|"
    r"dan)\b)"
)
_FIRST = re.compile(
    r"^(?:(?:start|begin) (?:off )?by|commencez? par|empieza por|empiece por|inizia (?:col|con)|comincia (?:col|con)|comeca por|begin met|first(?:ly)?|zuerst|erst(?:mal)?|d'abord|primero|per prima cosa|prima(?= [a-z]+[ai]\b)|primeiro|eerst),? "
)
_AT_FIRST = re.compile(r"(?<!go),? (?:first|zuerst|d'abord|primero|primeiro|eerst)$")
_AND_THERE = re.compile(
    r",? (?:(?:and|und|et|y|e|en),? )?(?:when|once|as soon as|wenn|sobald|quand|une fois que?|cuando|una vez|quando|appena|als|zodra) "
    r"(?:(?:you.?re|you are|we.?re|we are|that.?s|that is|it.?s|you have|you.?ve) (?:there|done|finished|over there|through|done (?:that|it))|"
    r"(?:du|wir) (?:da|dort|druben|fertig) (?:bist|sind)|das (?:erledigt|geschafft|fertig) ist|tu y es|c.est fait|tu as fini|"
    r"(?:estes|estemos) (?:ahi|alli)|(?:hayas|hayamos) terminado|(?:ci sei|hai finito|e fatto)|(?:estiveres la|acabares|estiver feito)|"
    r"(?:je|we) (?:daar|klaar) (?:bent|zijn)|dat (?:klaar|gedaan) is),? "
    r"|,? (?:(?:and|und|et|y|e|en),? )?(?:(?:once|when) done|une fois (?:fait|la)|cela fait|una vez hecho|hecho esto|una volta fatto|fatto questo|"
    r"feito isso|uma vez feito)\b,? "
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
_BUT_FIRST = re.compile(
    r"^(?P<last>.{4,}?)[,;]? (?:but|and|aber|mais|pero|ma|mas|maar) (?:before that|before you do(?: that)?|first|zuerst|vorher|davor|d'abord|avant ca|primero|antes de eso|"
    r"prima di questo|primeiro|antes disso|eerst|daarvoor),? (?P<next>.{4,})$"
)
_BEFORE_FIRST = re.compile(
    r"^(?:before|bevor|ehe|avant|antes|prima|voordat) (?:you |we |du |wir |je )?(?P<next>"
    + _ACTS
    + r"[^,]{3,}), (?P<last>.{3,})$"
)
"""One thing before the other: said in either order."""
# Amounts in words: "half a minute", "a kilometre".
_ONE = r"(?:a|an|one|another|eine?[nmr]?|une?|una?|uno|uma?|een)"
_HALF = re.compile(
    r"\b(?:half an?|eine[nmr]? halbe[nr]?|une? demi|medi[ao]|mezz[ao]|mei[ao]|een half|een halve)[ -]"
    r"(?P<unit>minut\w*|minuto|kilomet\w*|chilometro|quilometro|miles?|meile)\b"
)
_PART_OF_AN_HOUR = (
    (
        "30 minutes",
        re.compile(
            r"\b(?:half an hour|(?:eine[rn]? )?halben? stunde|une demi-? ?heure|media hora|mezz'? ?ora|meia hora|(?:een )?half uur)\b"
        ),
    ),
    (
        "15 minutes",
        re.compile(
            r"\b(?:(?:a |1 )?quarter of an hour|(?:eine[rn]? )?viertelstunde|un quart d'heure|un cuarto de hora|un quarto d'ora|um quarto de hora|(?:een )?kwartier)\b"
        ),
    ),
)
_QUARTER = re.compile(r"\b(?:a |1 )?quarter of a (?P<unit>mile|kilomet\w+)\b")
_AND_HALF = re.compile(
    rf"\b(?:(?P<n>{_ONE}|\d+) )?(?P<unit>minut\w*|kilom\w+|km|quilom\w+|chilom\w+|miles?|meilen?) (?:et demie?|y medi[ao]|e mezz[ao]|e mei[ao]|and a half)\b"
    r"|\b(?P<m>anderthalb|eineinhalb|anderhalve|zweieinhalb|tweeenhalve|(?:\d+|one) and a half) (?P<unit2>\w+)"
)
_HALVES = {"anderthalb": 1.5, "eineinhalb": 1.5, "anderhalve": 1.5, "zweieinhalb": 2.5, "tweeenhalve": 2.5}
_COUPLE = re.compile(
    r"\b(?:a )?couple(?: of)? (?=minutes|seconds|secs|kilomet|miles|km)|\b(?:ein )?paar (?=minuten|sekunden|kilometer)"
)
_LET_FIRST = re.compile(r"^lass(?:e|t)? (?:erst(?:mal)?|zuerst) ")
_SO_FAR = re.compile(r"(?:another|noch|nog|encore|otr[oa]s|ancora|altr[ie]|mais) \d+(?:[.,]\d+)? \w+")
_NEXT_ONE = re.compile(r"\b(next|nachste|prochaine|proximo|prossimo|volgende) (?=minut)")
_MORE_OF_IT = re.compile(r"\bfor (\d+|1) more (?=minut|second|kilomet|mile|km|metre|meter)")
_OFF_BEFORE = re.compile(
    r"^(?P<holds>.*\b(?:do ?n.?t|not|never|no|nobody|stay|keep|remain|nicht|niemand\w*|bleib\w*|ne|pas|personne|reste\w*|nadie|non|nessuno|"
    r"nao|ninguem|niet|niemand)\b.*) (?:before (?:the|our|my) (?:next )?(?:exit|junction|turn-?off)|before we (?:come|get|turn) off|"
    r"vor (?:der|unserer) (?:nachsten )?(?:ausfahrt|abfahrt)|avant (?:la|notre) (?:prochaine )?sortie|antes de (?:la|nuestra) salida|"
    r"prima dell.uscita|antes da (?:nossa )?saida|voor (?:de|onze) (?:afslag|afrit))(?: (?:of |off )?(?:the |this )?(?:motorway|highway|freeway))?"
)
"""Not before the exit is: until then not."""
_SINGLE = re.compile(rf"\b{_ONE} (?=(?:minut[eoa]?|minuut|kilomet\w+|chilometro|quilometro|miles?|meile|km)\b)")
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
    beside: bool = False
    """One of two bounds that hold together."""


def sentences(command: str) -> list[str]:
    """The sentences of a command as they were said."""
    return [part.strip() for part in _SENTENCES.split(command) if re.search(r"\w", part)]


def clauses(sentence: str) -> list[Clause]:
    """The clauses of one sentence, in order."""
    text = told(_EVERY_ROAD.sub("", _in_order(searchable(sentence))))
    found: list[Clause] = []
    asks = sentence.rstrip().endswith("?")
    waiting: Trigger | None = None
    parts = _THEN.split(_FIRST.sub("", _LEAD_IN.sub("", text)))
    for number, part in enumerate(parts):
        rest, when, until = _cut(f"{part}, then" if number + 1 < len(parts) and _SO_FAR.fullmatch(part) else part)
        rest = _AT_FIRST.sub("", bare(rest)) if number + 1 < len(parts) else bare(rest)
        if waiting is not None and when is None:
            when = waiting
        if not rest:
            waiting = when
            continue
        if when is not None:
            rest = _said_of_what_is_waited_for(rest, when)
        bounds = _TWO_BOUNDS.match(rest)
        if bounds is not None and bool(AT_LEAST.search(bounds["a"])) != bool(AT_LEAST.search(bounds["b"])):
            found.append(Clause(bare(bounds["a"]), when, until, number > 0, asks, beside=True))
            found.append(Clause(bare(bounds["b"]), None, None, asks=asks, beside=True))
        else:
            found.append(Clause(rest, when, until, number > 0, asks))
        waiting = None
    if waiting is not None:
        found.append(Clause("", waiting, None, bool(found)))
    return found


_OVER = re.compile(
    r"(?:nip|slip|slide|squeeze|get|move|go|pull|hop|pop|duck|take|dive)(?: (?:us|in|into|over|across|it|there|for|out|that|there now))*|do it|"
    r"(?:ab |dann |geh |fahr |wechsel |zieh )?(?:da )?(?:ruber|rein|hinuber)(?: mit uns)?|vas-y|mets-toi(?: dedans)?|metetee?|cambiate|ponte|metete|spostati|infilati|buttati|"
    r"muda|mete-te|schuif(?: maar)? op|ga(?: maar| er)?|voeg in|decale-toi|glisse-toi|rientra|rabats-toi|scher ein|passa para la|passa pra la|mete-te la|entra"
)
_STAYS = re.compile(
    r"(?:hold|leave|keep|stay|maintain)(?: (?:it|that|there|at that|like that|steady|here|so))+|halt(?:e)? (?:das|es|die geschwindigkeit)|bleib(?: da)?bei|bleib so|"
    r"reste(?:s)? (?:la|comme ca)|tiens-la|garde-la|quedate ahi|mantenla|dejal[oa] ahi|resta li|mantienila|fica ai|mantem|hou (?:dat|het)(?: vast| zo)?|blijf daar"
)


def _said_of_what_is_waited_for(rest: str, when: Trigger) -> str:
    """ "Into it" is into the lane that is waited for; "hold it there" is of the speed that is waited for."""
    if when.kind == "free" and when.side is not None and _OVER.fullmatch(rest):
        return f"move over to the {when.side}"
    if when.kind == "speed" and _STAYS.fullmatch(rest):
        return "keep this speed"
    return rest


def _in_order(text: str) -> str:
    """A text with amounts in digits, and what comes first said first."""
    text = _HALF.sub(lambda m: "30 seconds" if m["unit"].startswith("minu") else f"0.5 {m['unit']}", text)
    text = _LET_FIRST.sub("lass ", text).replace("tu laisses ", "laisse ")
    for amount, pattern in _PART_OF_AN_HOUR:
        text = pattern.sub(amount, text)
    text = _AND_HALF.sub(_and_half, _QUARTER.sub(r"0.25 \g<unit>", _COUPLE.sub("2 ", text)))
    text = _NEXT_ONE.sub(r"\1 1 ", _MORE_OF_IT.sub(r"for another \1 ", text))
    text = _BETWEEN.sub(r"at least \1 and at most \2", _OFF_BEFORE.sub(r"\g<holds> until the exit", text))
    text = _SINGLE.sub("1 ", text).replace("des qu'il", "des que il")
    text = _THEN_INSIDE.sub(r", then \1 ", _AND_THERE.sub(", then ", text))
    for pattern in (_BUT_FIRST, _BEFORE_FIRST, _BEFORE):
        found = pattern.match(text.rstrip(".!?"))
        if found is not None:
            first, second = ("next", "last") if pattern is _BUT_FIRST else ("last", "next")
            return f"{found[first]}, then {found[second]}"
    return text


def _and_half(found: re.Match[str]) -> str:
    if found["m"] is not None:
        said = found["m"].split()[0]
        value = _HALVES.get(said) or (float(said) if said.isdigit() else 1.0) + 0.5
        return f"{value} {found['unit2']}"
    return f"{(float(found['n']) if (found['n'] or '').isdigit() else 1.0) + 0.5} {found['unit']}"


_BETWEEN = re.compile(
    r"\b(?:somewhere |irgendwo )?(?:between|zwischen|entre|tra|fra|tussen)(?: de)? ([2-9]\d|1\d\d)(?: ?km/h)? (?:and|und|et|y|e|en) ([2-9]\d|1\d\d)\b"
    r"(?! ?(?:m|s|met\w+|se[ck]\w*)\b)"
)
_BOUNDED = r"(?:at (?:least|most)|no (?:more|less|faster|slower)|not|do ?n.t|never|max\w*|min\w*|mindestens|hochstens|wenigstens|nicht|nie|au (?:moins|plus)|ne|pas|como|al menos|por lo menos|no|al massimo|massimo|almeno|non|pelo menos|nao|minstens|hooguit|hoogstens|niet|under|over|below|above|stay)"
_TWO_BOUNDS = re.compile(
    rf"^(?P<a>(?=.*\b{_BOUNDED}\b)[^,]*\d.*?)(?:,? (?:and|but|und|aber|et|mais|y|pero|e|ma|mas|en|maar) |, )(?P<b>(?=.*\b{_BOUNDED}\b).*\d.*)$"
)
"""A lower bound and an upper one in one breath: two wishes that hold together."""


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


_METRES = ((("k", "q", "c"), 1000.0), (("mil", "meil", "migl", "mij"), 1609.3), (("y",), 0.9144), (("feet",), 0.3048))
"""How long a unit is, by how it begins; others are metres."""


def _trigger(row: Row, found: Found) -> Trigger | None:
    said, kind = found.said, row.fields["kind"]
    side = side_said(said)
    value: float | None = None
    if kind == "time":
        value = float(said["t"].replace(",", ".")) * (60.0 if said["tu"].startswith("min") else 1.0)
    elif kind == "distance":
        metres = next((metres for begins, metres in _METRES if said["du"].startswith(begins)), 1.0)
        value = float(said["d"].replace(",", ".")) * metres
    elif kind == "speed":
        speeds = [q.value for q in quantities(replaced(said["v"], lambda _, n: True)) if q.kind == "speed"]
        if not speeds:
            return None
        value = speeds[-1]
    who = row.fields.get("object", said.get("who", ""))
    if value is not None and value > 10_000:
        return None
    return Trigger(kind=kind, object=who, side="left" if side == "left" else "right" if side else None, value=value)
