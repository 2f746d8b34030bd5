"""Times and lengths in digits, and how long they hold: "for half a mile", "two minutes of quiet driving"."""

from __future__ import annotations

import re

_ONE = r"(?:a|an|one|another|eine?[nmr]?|une?|una?|uno|uma?|een)"
_HALF = re.compile(
    r"\b(?:half an?|eine[nmr]? halbe[nr]?|une? demi|medi[ao]|mezz[ao]|mei[ao]|een half|een halve)[ -]"
    r"(?P<unit>min(?:ut|uut)\w*|minuto|kilomet\w*|chilometro|quilometro|miles?|meile)\b"
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
_PARTS = re.compile(
    r"\b(?:an? |1 |the next )?(?P<three>3 )?(?P<part>half|quarter|viertel|quart|cuarto|quarto|kwart)s?(?: of| de| d'| di| van)?(?: an?| un| ein)?[ -](?P<unit>miles?|kilomet\w+|chilomet\w+|quilomet\w+)\b"
)
_AND_HALF = re.compile(
    rf"\b(?:(?P<n>{_ONE}|\d+) )?(?P<unit>minut\w*|kilom\w+|km|quilom\w+|chilom\w+|miles?|meilen?) (?:et demie?|y medi[ao]|e mezz[ao]|e mei[ao]|and a half)\b"
    r"|\b(?P<m>anderthalb|eineinhalb|anderhalve|zweieinhalb|tweeenhalve|(?:\d+|one) and a half) (?P<unit2>\w+)"
)
_HALVES = {"anderthalb": 1.5, "eineinhalb": 1.5, "anderhalve": 1.5, "zweieinhalb": 2.5, "tweeenhalve": 2.5}
_COUPLE = re.compile(
    r"\b(?:a )?couple(?: of)? (?=minutes|seconds|secs|kilomet|miles|km)|\b(?:ein )?paar (?=minuten|sekunden|kilometer)"
)
_NEXT_ONE = re.compile(r"\b(next|nachste|prochaine|proximo|prossimo|volgende) (?=minut)")
_MORE_OF_IT = re.compile(r"\bfor (\d+|1) more (?=minut|second|kilomet|mile|km|metre|meter)")
_SINGLE = re.compile(rf"\b{_ONE} (?=(?:minut[eoa]?|minuut|kilomet\w+|chilometro|quilometro|miles?|meile|km)\b)")

_TIME = r"\d+(?:[.,]\d+)? ?-?(?:s|secs?|seconds?|sekunden?|secondes?|segundos?|secondi|secondo|seconden?|min(?:ute|uten|utes|utos|uti|uto|uut|uten)?s?)\b"
_LENGTH = (
    r"\d+(?:[.,]\d+)? ?(?:m|met(?:er|re|ro|ri)s?|metern?|km|kilomet\w+|quilomet\w+|chilomet\w+|meilen?|yards?|miles?)\b"
)
_ABOUT = (
    r"(?:about|around|roughly|some|say|maybe|perhaps|like|or so|etwa|ungefahr|rund|sagen wir|so|environ|disons|genre|a peu pres|unos|unas|"
    r"digamos|como|aproximadamente|circa|diciamo|tipo|cerca de|uns|umas|ongeveer|zeg|zo'n|zowat)"
)
_A_WHILE = re.compile(
    r"\b(?:for )?(?:a (?:little |short )?(?:while|bit|spell|moment)|the time being|(?:fur )?(?:eine?) (?:weile|moment|zeit lang|zeitlang)|(?:pendant )?un (?:petit )?"
    r"(?:moment|bout de temps)|(?:durante )?un (?:rato|ratito|tiempo)|(?:per )?un (?:po'?|momento|attimo)|(?:por|durante) um (?:bocado|tempo|pouco)|"
    rf"(?:voor )?een (?:tijdje|poosje|eindje)),? (?:{_ABOUT} )?(?P<span>{_TIME}|{_LENGTH})"
)
_SPAN_OF = re.compile(
    rf"^(?P<span>{_TIME})(?: long)?(?: of| de| d'| di| von| van)? (?P<what>(?!.*\b(?:gap|distance|room|space|behind|between|more|less|ahead|abstand|luft|mehr|weniger|distancia|"
    r"ecart|espace|plus|moins|distanza|spazio|di piu|espaco|mais|menos|mas|afstand|ruimte|meer|minder|then|later|from|before|vor|avant|nach|ago|is|are|will|ist|sind|reich\w*|suffi\w*|basta\w*|es|e|sont|genoeg|enough|plenty)\b)\w+.*)$"
)
_OUT_OF = re.compile(
    r"\b(?:until|till|til|bis|jusqu.a ce que|jusqu.au bout|hasta que|hasta|finche|fino a|ate|tot)\b[^,]{3,45}, (?:that'?s |which is |das sind |c'est |son |sono |sao |dat is )?"
    rf"(?:{_ABOUT} )?(?P<span>{_LENGTH}|{_TIME})"
)
_WAIT = (
    r"(?:wait|hang on|hold on|hold off|give it|stay put|sit tight|hold it|leave it|pause|chill|rest|count(?: to)?|stay(?: there| here| put)?|warte?|bleib(?: da| dort| so)?|attends|"
    r"patiente|reste(?: la)?|espera|aguarda|quedate(?: ahi| asi)?|aspetta|resta(?: li)?|fica(?: ai| la)?|wacht|blijf(?: daar| zo)?)"
)
_FOR = r"(?: there| here)?(?: for| pendant| durante| per| por| nog| noch| mal| even| encore)?"
_WAIT_BEFORE = re.compile(
    rf"^{_WAIT}{_FOR} (?:{_ABOUT} )?(?P<span>{_TIME}) (?:before|bevor|ehe|avant (?:de|que)|antes de(?: que)?|prima di|prima che|antes que|voordat|voor)"
    r"(?: you| we| du| wir| tu| je)? (?P<next>.{3,})$"
)
_WAIT_BETWEEN = re.compile(
    rf",? ?(?:(?:and|und|et|y|e|en) )?(?<=[ ,]){_WAIT}{_FOR} (?:{_ABOUT} )?(?P<span>{_TIME}),? (?:(?:and|then|und|dann|et|puis|y|luego|e|poi|depois|en|dan) )*(?=\w)"
)
_BESIDE = re.compile(
    rf"(?:^|, )(?:just |only |nur |solo )?(?:{_ABOUT} )?(?P<span>{_TIME}|{_LENGTH})(?: or so)?(?=,|$)(?:, (?=\w))?"
)
_HOLDS = re.compile(
    r"\b(?:no|not|n.t|keep|hold|stay|remain|smooth\w*|quiet\w*|gentl\w*|calm\w*|nicht|kein\w*|bleib\w*|halt\w*|ruhig\w*|sanft\w*|pas|reste\w*|garde\w*|tiens|doucement|"
    r"sin|manten\w*|quedate|suave\w*|non|niente|resta|tieni|mantieni|nao|sem|fica|mantem|niet|geen|blijf|hou|houd|rustig)\b"
)
"""What is to last, rather than to be done in so long."""


def spans_in_digits(text: str) -> str:
    """A text in `searchable` form whose times and lengths are digits with a unit, said as one says how long."""
    text = _HALF.sub(lambda m: "30 seconds" if m["unit"].startswith("minu") else f"0.5 {m['unit']}", text)
    for amount, pattern in _PART_OF_AN_HOUR:
        text = pattern.sub(amount, text)
    text = _AND_HALF.sub(_and_half, _PARTS.sub(_part, _COUPLE.sub("2 ", text)))
    text = _NEXT_ONE.sub(r"\1 1 ", _MORE_OF_IT.sub(r"for another \1 ", text))
    return _SINGLE.sub("1 ", text)


def lasting(text: str) -> str:
    """A text with spans in digits in which what only stands beside a wish says how long or when: "two minutes, no
    lane changes" is for two minutes."""
    if not re.search(r"\d ?-?[a-z]", text):
        return text
    text = _OUT_OF.sub(r"for \g<span>", _A_WHILE.sub(r"for \g<span>", text))
    found = _WAIT_BEFORE.match(text)
    if found is not None:
        return f"in {found['span']}, {found['next']}"
    text = _WAIT_BETWEEN.sub(r", then in \g<span> ", text)
    found = _SPAN_OF.match(text)
    if found is not None:
        return f"{found['what']} for {found['span']}"
    found = _BESIDE.search(text)
    if found is not None and _HOLDS.search(f"{text[: found.start()]} {text[found.end() :]}"):
        rest = ", ".join(part for part in (text[: found.start()].strip(" ,"), text[found.end() :].strip(" ,")) if part)
        return f"{rest} for {found['span']}"
    return text


def _and_half(found: re.Match[str]) -> str:
    if found["m"] is not None:
        said = found["m"].split()[0]
        value = _HALVES.get(said) or (float(said) if said.isdigit() else 1.0) + 0.5
        return f"{value} {found['unit2']}"
    return f"{(float(found['n']) if (found['n'] or '').isdigit() else 1.0) + 0.5} {found['unit']}"


_PARTS_OF = (
    (("half", "halb", "demi", "medi", "mezz", "mei", "halve"), 0.5),
    (("quarter", "viertel", "quart", "cuarto", "kwart"), 0.25),
)


def _part(found: re.Match[str]) -> str:
    said = found["part"]
    value = 0.75 if found["three"] else next(size for begins, size in _PARTS_OF if said.startswith(begins))
    return f"{value} {found['unit']}"
