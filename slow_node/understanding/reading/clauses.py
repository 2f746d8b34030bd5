"""Where one wish ends and the next begins, and what is waited for."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from schemas.wire.program import Trigger
from slow_node.understanding.number_words import replaced
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.happens import told
from slow_node.understanding.reading.lexicon import RECENT, Found, Row, bare, rows, searchable, side_said
from slow_node.understanding.reading.order import in_order
from slow_node.understanding.reading.values import AT_LEAST

_SENTENCES = re.compile(r"(?<=[.!?;\u2026])\s+|\s*\n\s*|\s+[\u2013\u2014-]+\s+|(?<=[\w])\s*\u2026\s*|(?<=\w)\.\.+\s*")
_NEXT_VERB = (
    r"(?: ?,| ?$| \d| (?:you|go|move|change|pull|slow|speed|drive|take|turn|keep|overtake|pass|please|get|tuck|come|swing|slip|return|stop|drop|head|let|ease|brake|"
    r"accelerate|hold|stay|close|leave|merge|switch|left|right|faster|slower|do|give|make|put|back|fall)\b)"
)
_THEN = re.compile(
    r"(?:^|[ ,;]+)(?:and |und |et |y |e |en )?(?<!from )(?<!go on )(?<!there )(?:then|following that|after which|[2-5](?=[:.)] )|second(?:ly)?(?=[,:] )|third(?:ly)?(?=[,:] )|zweitens|drittens|deuxiemement|(?<=, )enfin|(?:(?:only )?after|once you.ve done) (?:that|this)(?="
    + _NEXT_VERB
    + r")|afterwards|after which|and only then|thereafter|"
    r"subsequently|next(?: up)?(?=,)|(?<=, )next(?= (?!exit|lane|one|to|truck|car|@)\w+)|finally(?=,| \w+)|lastly|(?<=and )from there(?: on)?|(?<=, )from there(?: on)?|later(?: on)?(?= in (?:\w+ )?\d)|dann|danach|anschliessend|im anschluss(?: daran)?|"
    r"hinterher|hernach|nachher|zuletzt|zum schluss|schliesslich|als nachstes(?! auto)|(?<=und )von da(?: aus)?|puis|ensuite|apres (?:ca|cela|quoi)|(?<=et )apres(?! (?:le|la|les|l|ce|cette|un|une|\d)\b)|par la suite|"
    r"pour finir|finalement|enfin(?=,)|luego|despues(?! de)|a continuacion|acto seguido|por ultimo|finalmente|(?<=y )entonces|(?<=y )ya|poi|dopodiche|dopo(?= \w+[ai]\b(?<!la))|(?<=e )dopo(?! (?:il|la|lo|i|le|\d))|"
    r"in seguito|successivamente|subito dopo|infine|(?<=e )quindi|(?<=, )quindi|depois(?! d[aeo])|em seguida|a seguir(?! (?:o|a)\b)|por fim|(?<=e )ai|(?<=e )entao|(?<=e )so entao|daarna|"
    r"vervolgens|hierna|nadien|(?<= )erna|waarna|tot slot|ten slotte|tenslotte|(?<=, )dan|(?<=en )dan)\b(?! on\b)[,:.)]? ?"
    r"|,? (?:and|und|et|y|e|en) (?=\w+(?: \w+)? (?:then|danach|dann|anschliessend|puis|ensuite|luego|despues|poi|dopo|depois|daarna|"
    r"dan)\b)"
)
_FIRST = re.compile(
    r"^(?:(?:one|1|step one|step 1)(?=[:.)] )|erstens|(?:start|begin) (?:off )?(?:by|with)|commencez? par|empieza por|empiece por|inizia (?:col|con|a)|comincia (?:col|con|a)|comeca por|begin met|first(?:ly)?(?: off| of all| things first| up)?|for starters|to (?:begin|start) with|"
    r"zuerst(?: mal)?|erst(?:mal|ens| einmal)?|als erstes|zunachst(?: mal)?|(?:tout )?d'abord|pour commencer|en premier(?: lieu)?|premierement|primero(?: de todo| que nada)?|en primer lugar|antes que nada|para empezar|"
    r"per prima cosa|prima(?: di tutto)?(?=,| [a-z]+[ai]\b)|innanzitutto|anzitutto|per cominciare|primeiro(?: que tudo| de tudo)?|em primeiro lugar|antes de mais(?: nada)?|para comecar|eerst(?: even| maar)?|allereerst|om te beginnen|ten eerste)[,:.)]? "
)
_AT_FIRST = re.compile(r"(?<!go),? (?:first|zuerst|d'abord|primero|primeiro|eerst)$")
_SO_FAR = re.compile(r"(?:another|noch|nog|encore|otr[oa]s|ancora|altr[ie]|mais) \d+(?:[.,]\d+)? \w+")
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
    return list(_clauses(sentence))


@lru_cache(RECENT)
def _clauses(sentence: str) -> tuple[Clause, ...]:
    text = told(_EVERY_ROAD.sub("", in_order(searchable(sentence))))
    found: list[Clause] = []
    asks = sentence.rstrip().endswith("?")
    waiting: Trigger | None = None
    parts = _THEN.split(_FIRST.sub("", _LEAD_IN.sub("", text)))
    for number, part in enumerate(parts):
        more = number + 1 < len(parts)
        for rest, when, until in _cut(f"{part}, then" if more and _SO_FAR.fullmatch(part) else part):
            rest = _AT_FIRST.sub("", bare(rest)) if more else bare(rest)
            if waiting is not None and when is None:
                when = waiting
            if not rest:
                waiting = when
                continue
            if when is not None:
                rest = _said_of_what_is_waited_for(rest, when)
            found += _bounded(rest, when, until, number > 0, asks)
            waiting = None
    if waiting is not None:
        found.append(Clause("", waiting, None, bool(found)))
    return tuple(found)


def _bounded(rest: str, when: Trigger | None, until: Trigger | None, then: bool, asks: bool) -> list[Clause]:
    """A wish as a clause; two bounds in one breath as two."""
    bounds = _TWO_BOUNDS.match(rest)
    if bounds is None or bool(AT_LEAST.search(bounds["a"])) == bool(AT_LEAST.search(bounds["b"])):
        return [Clause(rest, when, until, then, asks)]
    return [
        Clause(bare(bounds["a"]), when, until, then, asks, beside=True),
        Clause(bare(bounds["b"]), None, None, asks=asks, beside=True),
    ]


_OVER = re.compile(
    r"(?:nip|slip|slide|squeeze|get|move|go|pull|hop|pop|duck|take|dive)(?: (?:us|in|into|over|across|it|there|for|out|that|there now))*|do it|"
    r"(?:ab |dann |geh |fahr |wechsel |zieh )?(?:da )?(?:ruber|rein|hinuber)(?: mit uns)?|vas-y|(?:tu )?te rabats|rabats-toi|tu y vas|tu passes|te cambias|te metes|ti sposti|ti infili|vai|mudas|mets-toi(?: dedans)?|metetee?|cambiate|ponte|metete|spostati|infilati|buttati|"
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


_BOUNDED = r"(?:at (?:least|most)|no (?:more|less|faster|slower)|not|do ?n.t|never|max\w*|min\w*|mindestens|hochstens|wenigstens|nicht|nie|au (?:moins|plus)|ne|pas|como|al menos|por lo menos|no|al massimo|massimo|almeno|non|pelo menos|nao|minstens|hooguit|hoogstens|niet|under|over|below|above|stay)"
_TWO_BOUNDS = re.compile(
    rf"^(?P<a>(?=.*\b{_BOUNDED}\b)[^,]*\d.*?)(?:,? (?:and|but|und|aber|et|mais|y|pero|e|ma|mas|en|maar) |, )(?P<b>(?=.*\b{_BOUNDED}\b).*\d.*)$"
)
"""A lower bound and an upper one in one breath: two wishes that hold together."""


_LEAD_IN = re.compile(r"^(?:please|bitte|ok|okay|so|now|well|hey|car|alors|bueno|allora|entao|nou)[ ,]+")


_Part = tuple[str, Trigger | None, Trigger | None]
"""A text without what is waited for; when it begins, and until when it lasts."""
_NEW_ONE = re.compile(r"(?:,|(?<= )(?:and|und|et|y|e|en|but|aber|mais|pero|ma|mas|maar)) ?$")


def _cut(text: str) -> list[_Part]:
    """The parts of a text without what is waited for: two where that stands at the beginning of a second wish."""
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
        before, after = text[: found.start], text[found.end :]
        if not ends and until is None and _NEW_ONE.search(before) and bare(_NEW_ONE.sub("", before)) and bare(after):
            return [*_cut(_NEW_ONE.sub("", before)), (bare(after), trigger, None)]
        text = f"{before} {after}".strip(" ,")
        if ends:
            until = trigger
        else:
            when = trigger
    return [(text, when, until)]


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
