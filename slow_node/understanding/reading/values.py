"""Slots to steps: how a value is meant (to, by, at least, at most, a factor), and which numbers are no values at all."""

from __future__ import annotations

import re

from schemas.driving.measures import CAR_LENGTH_M
from schemas.wire.program import Mode, Step, Unit
from slow_node.understanding.numbers import KMH, MPH, in_digits, quantities
from slow_node.understanding.slots import Slots

AT_LEAST = re.compile(
    r"\b(?:at least|at no point (?:below|under|less|slower)|north of(?= \d)|(?:somewhere |anything |always )(?:above|over|upwards of)(?= \d)|the (?:slowest|least)\b.{0,15} is|irgendwo uber(?= \d)|quelque part au-dessus de|not (?:a|an|one|1) (?:\w+ )?(?:less|closer|fewer|slower)|keinen? (?:\w+ )?weniger|pas (?:un|une) de moins|ni uno? (?:\w+ )?menos|non uno di meno|nem uma? a menos|geen (?:\w+ )?minder|nothing less|au minimum|(?:not|never|\w*n.t|nie|nicht|jamais|pas|nunca|no|mai|non|nooit|niet)\b.{0,30} (?:nearer|closer|naher|dichter|plus pres|mas cerca|piu vicin[oa]|mais perto|dichterbij)\b(?=.{0,25}\d)|(?:no|not|never) (?:less|slower|closer|nearer) than|minimum|or more|not below|never below|mindestens|wenigstens|nicht "
    r"(?:weniger|langsamer|unter)|nie unter|unter \d+.{0,20} nicht|(?:not|\w*n.t|never)\b.{0,25} (?:under|below|less than|slower than)|au moins|pas moins|(?:al|por lo) menos|como minimo|no (?:menos|bajes) de|nunca (?:a )?menos|jamais (?:a )?moins|pas en dessous|almeno|come minimo|(?:non|mai) (?:a )?(?:meno|sotto)|pelo menos|"
    r"no minimo|nao (?:menos|abaixo|descas)|nunca (?:a menos|menos|abaixo)|minstens|ten minste|minimaal|(?:niet|nooit) (?:minder|langzamer|onder))\b"
)
AT_MOST = re.compile(
    r"\b(?:at (?:the )?(?:very )?most|at no point (?:above|over|more|faster)|the (?:fastest|most|quickest)\b.{0,15} (?:is|.s)|(?:somewhere |anything |always )(?:below|under)(?= \d)|south of(?= \d)|not (?:a|an|one|1) (?:\w+ )?(?:more|faster)|keinen? (?:\w+ )?mehr|pas (?:un|une) de plus|ni uno? (?:\w+ )?mas|non uno di piu|nem uma? a mais|geen (?:\w+ )?meer(?= |$)|(?:not|\w*n.t|never)\b.{0,25} (?:exceed|top|pass|over|above|beyond|past) (?=\d)|massimo|maximo|(?:que )?no (?:pase|sea|vaya|suba|supere)s?\b.{0,8} (?:mas|de)|cap (?:it|us|the speed|our speed|things) at|anything up to|(?:limit|restrict)(?: it| us| the speed)? to|"
    r"(?:not|\w*n.t|never|no)\b.{0,25} (?:more|faster|quicker) than|begrenz\w*|limite[zr]? (?:la vitesse )?a|ne (?:depass\w+|roul\w+) (?:pas|jamais)(?: plus)?|"
    r"sin pasar|non superare|nao (?:ultrapass\w+|pass\w+) (?:d?os|d?e)|beperk|(?:no|not|never) (?:more|faster|quicker|farther|further) than|max(?:imum)?|(?:not|never|nothing|"
    r"(?:not|never|don.?t) go) (?:above|over|beyond|past)|(?:not|never|n.t) exceed|(?:stay|keep|remain)(?: it)? (?:below|under)|no faster|tops|hochstens|maximal|nicht (?:mehr|schneller|uber)|"
    r"nie (?:uber|mehr|schneller)|au (?:maximum|plus)|pas plus|jamais plus|como (?:mucho|maximo)|a lo sumo|no (?:mas|pases) de|nunca mas|"
    r"al massimo|non (?:piu|oltre|superare)|mai (?:piu|oltre)|no maximo|nao (?:mais|passes)|nunca mais|hooguit|hoogstens|"
    r"maximaal|niet (?:meer|harder|sneller|boven)|nooit (?:meer|harder|boven))\b"
)
_FACTORS = (
    (0.5, r"half|halb\w*|halbier\w*|moitie|demi|mitad|meta|dimezza\w*|metade|helft|halveer\w*"),
    (2.0, r"twice|double|doppelt\w*|doppelte[nr]?|verdoppel\w*|deux fois|doubler?|doble|duplica\w*|dos veces|doppi[oa]|raddoppia\w*|"
     r"due volte|dobro|dobra|duas vezes|dubbel\w*|verdubbel\w*|2 times|2 mal|2 fois|2 veces|2 volte|2 vezes|2 keer"),
    (3.0, r"three times|triple|dreifach\w*|tripl\w+|3 times|3 mal|3 fois|3 veces|3 volte|3 vezes|3 keer"),
)  # fmt: skip
_FACTOR = tuple(
    (factor, re.compile(rf"(?<!and a )(?<!\d )\b(?:{words})\b(?! ?(?:a )?(?:-?sec|-?sek|-?min|-?hour|-?stunde|-?heure|-?mile|-?kilo))"))
    for factor, words in _FACTORS
)  # fmt: skip
_PERCENT = re.compile(
    r"(\d+(?:[.,]\d+)?) ?(?:%|percent|per cent|prozent|pour ?cent|por ciento|per cento|por cento|p(?:er|or|our) 100|procent)"
)
_CARS = re.compile(
    r"(\d+|an?|another|eine?|une?|una?|uma?|een)(?: more| weitere| extra)? ?-?(?:@?car|@car)? ?-?(?:lengths?|wagenlangen?|autolangen?|@car\w*langen?|"
    r"longueurs?(?: de (?:@car|vehicule))?|largos?(?: de @car)?|lunghezz[ae](?: (?:d.|di )@car)?|comprimentos?(?: de @car)?|"
    r"(?:auto|@car)lengtes?)\b"
)
_METRES = r"\d+(?:[.,]\d+)? ?(?:m|met(?:er|re|ro|ri)s?|metern?|feet|foot|yards?|(?:@?car )?-?lengths?|wagenlangen?|longueurs?)"
_MORE = r"more|further|farther|extra|additional|greater|mehr|weiter|zusatzlich|de plus|davantage|plus|mas|di piu|in piu|a mais|mais|meer"
_LESS = r"less|closer|nearer|shorter|weniger|naher|dichter|moins|plus pres|menos|mas cerca|di meno|in meno|piu vicin[oa]|mais perto|minder|dichterbij"
_BY = r"by|um|add|another|noch|ancora|weitere|encore|otros|con|met|widen|increase|reduce|drop|knock|lose"
_BY_METRES = re.compile(
    rf"\b(?:{_BY})(?: about)? {_METRES}\b|\b{_METRES}(?: of)? (?:{_MORE}|{_LESS})\b|\b(?:{_MORE}) {_METRES}\b(?! (?:to|behind|between))"
)
_SECONDS = r"(?:\d+(?:[.,]\d+)?|one|another|eine|une|una|um|uma|een) (?:s|sec(?:ond)?s?|sekunden?|secondes?|segundos?|second[oi]|seconden?)"
_BY_SECONDS = re.compile(
    rf"\b(?:{_BY}) {_SECONDS}\b|\b{_SECONDS}(?: of)? (?:{_MORE}|{_LESS})\b|\b(?:{_MORE}) {_SECONDS}\b|\banother {_SECONDS}\b"
)
_SHARES = (
    (
        1 / 3,
        re.compile(
            r"(?:\b(?:an?|one|ein|um ein|un|um|una|uma|een) |^)(?:third|drittel|tiers|tercio|tercera parte|terzo|terza parte|terco|terca parte|derde)\b(?! ?(?:@|lane|spur|baan))"
        ),
    ),
    (
        1 / 4,
        re.compile(
            r"(?:\b(?:an?|one|ein|um ein|un|um|una|uma|een) |^)(?:quarter|viertel|quart|cuarto|cuarta parte|quarto|quarta parte|kwart)\b(?! (?:of an|past|to|of a mile))"
        ),
    ),
    (
        1 / 5,
        re.compile(
            r"(?:\b(?:a|one|ein|um ein|un|um|una|uma|een) |^)(?:fifth|funftel|cinquieme|quinto|quinta parte|vijfde)\b(?! ?(?:@|lane|spur|baan))"
        ),
    ),
    (
        1 / 10,
        re.compile(
            r"\b(?:a|one|ein|um ein|un|um|een) (?:tenth|zehntel|dixieme|decimo|tiende)\b(?! ?(?:@|lane|spur|baan|of))"
        ),
    ),
)
SLOWER = re.compile(
    r"\b(?:slow\w*|down|brake|reduce|lower|less speed|off (?:our|the) speed|langsam\w*|brems\w*|runter|moins (?:vite|rapide\w*)|lentement|ralenti\w*|rédui\w*|reduis|"
    r"despacio|lento|baja\w*|reduce|frena\w*|piano|lentamente|rallenta\w*|devagar|abranda\w*|reduz\w*|langzam\w*|zachter|rem)\b"
)
FASTER = re.compile(
    r"\b(?:fast\w*|quick\w*|speed up|up the speed|accelerate|schneller|zugiger|plus (?:vite|rapide\w*)|accelere\w*|mas (?:rapido|deprisa|velocidad)|sube\w*|acelera\w*|"
    r"piu (?:veloce\w*|forte|in fretta|velocita)|in piu di velocita|accelera|mais (?:rapido|depressa|velocidade)|harder|sneller)\b"
)
_CLOSER = re.compile(
    rf"\b(?:{_LESS}|close up|close the gap|catch up|auffahren|rapproche\w*|acerca\w*|avvicina\w*|aproxima\w*)\b"
)

_ELSEWHERE = re.compile(
    r"\b(?P<what>bus(?:linie)?|tram|strassenbahn|line|linie|ligne|linea|linha|lijn|route|gate|platform|gleis|room|zimmer|channel|kanal|"
    r"chapter|page|seite|numero|episode|track|exit|ausfahrt|sortie|salida|uscita|saida|afslag|junction|highway|interstate|"
    r"autobahn|flight|flug|radio|platz|seat|season|level|stufe|house|flat|apartment|pier|terminal|row|[amb](?=\d)) ?-?(?:number |nummer |no\.? )?\d+\b(?! ?(?:km|kmh|kph|mph|m/s|metre|meter|miles|%|sec|sek))"
    r"|\b(?:the|der|die|le|el|il|o|de) (?P<number>\d+)(?= (?:bus|tram|train|zug|buslinie)\b)"
    r"|\b\d+(?=[- ](?:kids|children|kinder|emails?|calls|floors?)\b)"
)
_ONCE = re.compile(
    r"\bonce (?=(?:we|you|it|he|she|they|i|the|that|this|there|in|past|over|on|upon|a|every|and|per)\b)", re.I
)

_ONCE_MORE = re.compile(r"\bonce (?:more|again)\b", re.I)


def unbound(command: str) -> str:
    """A command without the numbers that are of something else: a bus line, degrees, somebody's age."""
    plain = _ONCE.sub("when ", _ONCE_MORE.sub("again", command))
    digits = in_digits(plain)
    masked = _ELSEWHERE.sub(lambda m: m["what"] or (m[0][: -len(m["number"])] if m["number"] else "some"), digits)
    return plain if masked == digits else masked


def uses_miles(command: str) -> bool:
    """The passenger speaks of miles."""
    return re.search(r"\b(?:mph|mi/h|miles?|meilen|millas|miglia|milhas|mijl)\b", command.lower()) is not None


def steps_of(slots: Slots, text: str = "", speed_mps: float | None = None) -> tuple[Step, ...]:
    """The steps of slots that were read from a clause, in `searchable` form; empty where they ask for nothing.

    speed_mps: the ego's, with which the slots were read.
    """
    if slots.outcome != "directive":
        return ()
    steps: list[Step] = []
    if slots.cancel:
        steps.append(Step(act="cancel"))
    gap_step, has_factor = _gap(slots, text)
    speed = _speed(slots, text, takes_factor=not has_factor, now_mps=speed_mps)
    if speed is not None:
        steps.append(speed)
    if slots.overtake and slots.lane in ("left", "right") and _PASSES_BY_A_SIDE.search(text):
        slots = slots.model_copy(update={"lane": "none"})
    if slots.lane == "keep":
        steps.append(Step(act="keep", object="lane"))
    elif slots.lane in ("left", "right"):
        steps.append(Step(act="lane", side=slots.lane, count=1))
    elif slots.lane != "none":
        steps.append(Step(act="lane", side=slots.lane))
    if gap_step is not None:
        steps.append(gap_step)
    if slots.overtake is not None:
        who = re.search(r"@(\w+)", text)
        steps.append(
            Step(
                act="overtake",
                object=who[1] if who and who[1] != "car" else "",
                polarity="do" if slots.overtake else "not",
            )
        )
    return tuple(steps)


def corrected(slots: Slots, text: str) -> Slots:
    """Slots without a change that was taken for a size: "ten metres more room" is no gap of ten metres."""
    if slots.outcome != "directive":
        return slots
    if slots.overtake is False and slots.target_speed_mps is not None and AT_MOST.search(text):
        slots = slots.model_copy(update={"overtake": None})  # "ne depasse pas les 90" is of a speed
    if (_BY_METRES.search(text) and any(q.kind == "length" for q in quantities(text))) or _CARS.search(text):
        gap = "closer" if slots.gap == "closer" or _CLOSER.search(text) else "farther"
        if _CARS.search(text) and not _changes(text):
            return slots.model_copy(update={"headway_s": None, "gap": "keep" if slots.gap == "none" else slots.gap})
        return slots.model_copy(update={"headway_s": None, "gap": gap})
    return slots


def _changes(text: str) -> bool:
    return _BY_METRES.search(text) is not None or re.search(rf"\b(?:{_MORE}|{_LESS}|another)\b", text) is not None


_OF_TIME = re.compile(
    r"\b(?:half|halbe[nr]?|demi|media|mezz|meia|quarter|quart|cuarto|quarto)(?:'? ?| of |-| d'| de )?(?:an |a |d')?(?:hour|stunde|heure|hora|ora|uur|mile|kilom\w+)\b|"
    r"\bkwartier\b|\bviertelstunde\b"
)
_HOW_FAST_OR_FAR = re.compile(
    r"fast|speed|pace|slow|quick|\bgap|distance|space|room|schnell|langsam|tempo|geschwind|abstand|vit|lent|allure|ecart|veloc|rapid|despac|distan|hueco|"
    r"piano|forte|devagar|depressa|snel|hard|langzaam|afstand|dist|halbier|dimezz|halveer|doubl|verdoppel|duplic|raddopp|verdubbel|dobl|doppi|dobr|triple|dreifach"
)
"""What a half or a double of may be meant; half a coffee is none of it."""


def _factor_said(text: str) -> float | None:
    """A multiple that is named, as a part of the whole: "half", "twice", "20 % less" (0.8)."""
    text = _OF_TIME.sub("", text)
    share = share_said(text)
    if share is not None:
        return share
    if not _HOW_FAST_OR_FAR.search(text) and len(text.split()) > 3:
        return None
    return next((factor for factor, pattern in _FACTOR if pattern.search(text)), None)


def share_said(text: str) -> float | None:
    """A part of the whole that is to be added or taken away: "20 %", "a third"."""
    text = _OF_TIME.sub("", text)
    percent = _PERCENT.search(text)
    if percent is not None:
        return float(percent[1].replace(",", ".")) / 100.0
    return next((share for share, pattern in _SHARES if pattern.search(text)), None)


def _bound(text: str) -> Mode:
    return "at_least" if AT_LEAST.search(text) else "at_most" if AT_MOST.search(text) else "to"


def _speed(slots: Slots, text: str, *, takes_factor: bool, now_mps: float | None = None) -> Step | None:
    if slots.speed == "stop":
        return Step(act="stop")
    if slots.speed == "keep" and slots.target_speed_mps is None:
        return Step(act="keep", object="speed")
    faster = slots.speed == "faster"
    share = share_said(text) if takes_factor else None
    by_share = None if share is None else _by_share(share, text, faster=faster)
    if by_share is not None and slots.speed in ("faster", "slower"):
        return by_share
    if slots.target_speed_mps is not None:
        value = round(slots.target_speed_mps, 3)
        if slots.speed in ("none", "faster") and _TO_THE_LIMIT.search(text) and _bound(text) == "to":
            return Step(act="drive", object="limit")
        if slots.speed in ("none", "keep"):
            of_limit = (
                "limit"
                if re.search(r"\b\w*(?:limit|limiet|limitation)\w*\b", text) and not re.search(r"\d", text)
                else ""
            )
            return Step(act="drive", object=of_limit, value=value, unit="mps", mode=_bound(text))
        if faster and AT_MOST.search(text):
            return Step(act="drive", value=value, unit="mps", mode="at_most")
        if not faster and now_mps is not None and value > now_mps - SAME_MPS and not SLOWER.search(text):
            return Step(act="drive", value=value, unit="mps", mode=_bound(text))
        change = _change(text) or _difference(slots, text, now_mps)
        if change is not None:
            return Step(act="faster" if faster else "slower", value=round(change, 3), unit="mps", mode="by")
        return Step(act="faster" if faster else "slower", value=value, unit="mps", mode="to")
    if slots.speed == "none":
        return None
    factor = _factor_said(text) if takes_factor else None
    if factor is not None:
        percent = share_said(text) is not None
        times = (1.0 + factor if faster else 1.0 - factor) if percent else factor
        if not faster and times > 1.0:
            times = 1.0 / times
        return Step(act="faster" if faster else "slower", value=round(times, 3), unit="times", mode="factor")
    if faster and _A_BIT.search(text):
        return Step(act="faster", object="bit")
    return Step(act="faster" if faster else "slower")


_TO_THE_LIMIT = re.compile(r"^(?!.*\d).*\b\w*(?:limit|limiet|limitation)\w*\b")
_PASSES_BY_A_SIDE = re.compile(
    r"\b(?:pass|overtake|uberhol\w*|vorbei|double\w*|depass\w*|adelant\w*|rebas\w*|sorpass\w*|super\w*|ultrapass\w*|inhal\w*|haal|passe)\b[^,]{0,25}(?:on (?:the|his|its)|by the|links|rechts|"
    r"par la|a|por la|pela|sulla|da|aan de|over) ?(?:left|right|gauche|droite|izquierda|derecha|sinistra|destra|esquerda|direita|linker\w*|rechter\w*)?\b|\b(?:links|rechts) (?:\w+ )?(?:uberhol|vorbei|inhal)\w*"
)
"""The side is by which he is passed, and no wish of its own."""


def _by_share(share: float, text: str, *, faster: bool) -> Step | None:
    """A part of the speed more or less; which of them the words say, if they do."""
    if bool(SLOWER.search(text)) != bool(FASTER.search(text)):
        faster = bool(FASTER.search(text))
    times = 1.0 + share if faster else 1.0 - share
    return (
        Step(act="faster" if faster else "slower", value=round(times, 3), unit="times", mode="factor")
        if times > 0
        else None
    )


def _difference(slots: Slots, text: str, now_mps: float | None) -> float | None:
    """By how much the speed is to change where the number that was said is this far from the present speed."""
    if now_mps is None or slots.target_speed_mps is None:
        return None
    change = abs(slots.target_speed_mps - now_mps)
    said = [q.value * (1.0 if q.kind == "speed" else KMH) for q in quantities(text) if q.kind in ("speed", "bare")]
    near = [value for value in said if abs(value - change) < SAME_MPS]
    meant = [value for value in said if abs(value - slots.target_speed_mps) < SAME_MPS]
    return near[-1] if near and not meant and change > SAME_MPS else None


A_BIT_MPS, SAME_MPS = 10 / 3.6, 0.1
"""What a bit faster is where no number was said: 10 km/h; two speeds nearer than this are one."""
_A_BIT = re.compile(
    r"\b(?:a (?:little )?bit|a little|slightly|a tad|a touch|bit (?:faster|quicker)|etwas|ein (?:bisschen|wenig|klein wenig)|un (?:petit )?peu|"
    r"un poco|un poquito|un po.?|um (?:pouco|bocadinho)|een beetje|ietsje|iets|wat (?:sneller|harder))\b"
)
_TO_A_SPEED = re.compile(
    r"\b(?:to|at|auf|mit|bei|a|ad|aan|naar|op|up to|down to|until|bis|tot|jusqu.a|hasta|fino a|ate) (?:about |etwa )?\d"
)


def _change(text: str) -> float | None:
    """By how much [m/s] the speed is to change; None where a speed is named to change to."""
    if _TO_A_SPEED.search(text):
        return None
    said = quantities(text)
    speeds = [q.value for q in said if q.kind == "speed"]
    bare = [q.value for q in said if q.kind == "bare" and q.value >= 2.0]
    if speeds:
        change = speeds[-1]
    elif bare:
        change = bare[-1] * (MPH if uses_miles(text) else KMH)
    else:
        return None
    by = rf"\b(?:by|um|add|knock|shave|lose|drop|de|di|con|em|met) (?:about |us )?\d|\d ?\S*(?: \S+){{0,4}} (?:{_MORE}|{_LESS}|faster|slower|quicker|schneller|langsamer|vite|lent\w*|rapid\w*|veloc\w*|piano|depressa|devagar|despacio|harder|sneller|langzamer|zachter|off|up|down)\b"
    more = rf"\b(?:{_MORE}|{_LESS}|faster|slower|quicker|schneller|langsamer) (?:by )?\d"
    return change if re.search(by, text) or re.search(more, text) else None


def _gap(slots: Slots, text: str) -> tuple[Step | None, bool]:
    """The step about the gap, and whether a factor in the text belongs to it."""
    act = {"closer": "closer", "farther": "farther"}.get(slots.gap)
    cars = _CARS.search(text)
    if cars is not None:
        count = float(cars[1]) if cars[1].isdigit() else 1.0
        metres = count * CAR_LENGTH_M
        if act is None or not _changes(text):
            return Step(act="gap", value=metres, unit="m", mode=_bound(text)), False
        return _amount(act, metres, "m", "by"), False
    lengths = [q.value for q in quantities(text) if q.kind == "length"]
    if lengths and (slots.headway_s is not None or act is not None):
        metres = round(lengths[-1], 2)
        if _BY_METRES.search(text):
            return _amount(
                "closer" if slots.gap == "closer" or _CLOSER.search(text) else "farther", metres, "m", "by"
            ), False
        return Step(act="gap", value=metres, unit="m", mode=_bound(text)), False
    if slots.headway_s is not None:
        seconds = round(slots.headway_s, 3)
        if _BY_SECONDS.search(text):
            return _amount(act or ("closer" if _CLOSER.search(text) else "farther"), seconds, "s", "by"), False
        return Step(act="gap", value=seconds, unit="s", mode=_bound(text)), False
    if slots.gap == "keep":
        return Step(act="keep", object="gap"), False
    if act is None:
        return None, False
    factor = _factor_said(text)
    if factor is None or (slots.speed in ("faster", "slower") and slots.gap == "none"):
        return Step(act="closer" if act == "closer" else "farther"), False
    if share_said(text) is not None:
        factor = 1.0 + factor if act == "farther" else max(1.0 - factor, 0.0)
    return _amount(act, round(factor, 3), "times", "factor"), True


def _amount(act: str, value: float, unit: Unit, mode: Mode) -> Step:
    return Step(act="closer" if act == "closer" else "farther", value=value, unit=unit, mode=mode)
