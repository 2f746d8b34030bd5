"""Changes that are sure by their words: "an extra second of distance", "ten car lengths, nothing less", "a fifth faster"."""

from __future__ import annotations

import re

from schemas.driving.measures import CAR_LENGTH_M
from schemas.wire.program import Step
from slow_node.understanding.numbers import KMH, MPH
from slow_node.understanding.reading.values import AT_LEAST, AT_MOST, FASTER, SLOWER, share_said, uses_miles

_HALF_A_SECOND = re.compile(
    r"\b(?:half an?|half|eine halbe|une demi-?|medio|mezzo|meio|een halve)[ -]?(?=se[ck]|seg)|(?<=\bum )meio (?=seg)"
)
_EXTRA = (
    r"(?:(?:further|farther) (?:back|behind|away|off)|weiter (?:hinten|zuruck|weg)|plus (?:loin|en arriere)|mas (?:atras|lejos)|piu lontano|mais (?:atras|longe)|more|extra|further|additional|mehr|zusatzlich|weitere|de plus|en plus|supplementaires?|mas|extra|de mas|piu indietro|in piu|di piu|a mais|mais|meer|(?:further|farther) (?:back|behind|away|off)|weiter (?:hinten|zuruck|weg)|plus (?:loin|en arriere)|mas (?:atras|lejos)|"
    r"piu lontano|mais (?:atras|para tras|longe)|verder (?:naar achteren|weg|terug))"
)
_AMOUNT = (
    r"(?P<value>\d+(?:[.,]\d+)?|an?|another|one|eine?n?|une?|una?|uno|uma?|een)(?P<before> (?:full |whole |volle |ganze )?"
    + _EXTRA
    + r")? (?P<unit>(?:@?car[ -])?lengths?|@car\w*langen?|longueurs?(?: de @car)?|largos?(?: de @car)?|lunghezz[ae](?: (?:di|d.) ?@car)?|comprimentos?(?: de @car)?|(?:auto|@car)lengtes?|wagenlangen?|autolangen?|(?:s|m|sec|secs|meter|metern?|metres?|meters?|metros?|metri|metro|seconds?|sekunden?|secondes?|segundos?|secondi|secondo|seconden?))\b"
)
_MORE_ROOM = re.compile(rf"(?:(?P<first>{_EXTRA}|another|noch|ancora|otros|nog) )?{_AMOUNT}(?: (?P<after>{_EXTRA}))?")
_LESS_ROOM = re.compile(
    rf"{_AMOUNT} (?:less|fewer|closer|nearer|weniger|naher|dichter|de moins|en moins|menos|di meno|in meno|a menos|minder)"
)
_ROOM = re.compile(
    r"\b(?:gap|distance|space|room|headway|abstand|luft|platz|distance|ecart|espace|place|distancia|separacion|hueco|espacio|distanza|spazio|"
    r"distancia|espaco|afstand|ruimte|entre|between|zwischen|tussen|front|ahead|behind|vordermann|vor|devant|delante|davanti|frente|voor|guy)\b|@\w+"
)
_AROUND = re.compile(
    r"\b(?:of|the|to|from|us|me|him|her|that|this|it|one|you|in|and|give|leave|keep|let|make|i|want|need|have|would|like|maybe|um|will|do|be|is|plenty|"
    r"gib|lass|halt|halte|ich|will|mochte|zum|zu|dem|den|der|die|das|von|bitte|uns|ihm|mir|"
    r"laisse|garde|mets|et|nous|lui|la|le|l|de|du|d|avec|celui|je|veux|"
    r"deja|manten|con|el|del|al|y|nosotros|quiero|los|a|lascia|tieni|da|dal|dall|e|noi|quello|lui|un|voglio|"
    r"deixa|mantem|para|o|ao|do|dele|que|vai|fica|pelo|por|lo|carro|"
    r"geef|hou|laat|van|met|tot|en|ons|plz|graag|al|at|least|mindestens|wenigstens|au|moins|minimum|menos|almeno|minstens|pls|nothing|or|oder|ou|"
    r"ertussen|dazwischen|tussen|en medio|mezzo|meio|medio|in|sich|bis|ein|gap|gerne|gern|also|di|a|quella|celle|voiture|macchina|coche|auto)\b|[^\w@]+"
)
_BUT = re.compile(r"\b(?:limit|than|limite|tempo|until|bis|km|faster|slower|speed|lanes?)\b")


_EXACTLY = re.compile(
    r",? (?:(?:no more,? (?:and )?no less|no less,? (?:and )?no more|nothing more,? nothing less)|nicht mehr,? (?:und )?nicht weniger|ni plus,? ni moins|ni mas,? ni menos|ne piu,? ne meno|nem mais,? nem menos|niet meer,? (?:en )?niet minder)\b"
)
_ON = re.compile(
    r"\b(?:on top|more|extra|up|drauf|dazu|mehr|de plus|en plus|mas|encima|di piu|in piu|a mais|em cima|erbij|bovenop|meer)\b"
)
_OFF = re.compile(
    r"\b(?:off|less|down|away|weg|weniger|runter|ab|de moins|en moins|menos|di meno|in meno|a menos|minder|eraf)\b"
)
MOST_BY = 60.0
"""A larger number is a speed."""
_SPEED_BY = re.compile(
    r"(?:(?:i.d|i would|i|we.d|just|lets?|let.s|give|take|knock|shave|drop|lose|add|put|stick|chuck|bung|whack|leg|mach|nimm|pack|tu|mets|ajoute|enleve|pon|sube|quita|baja|metti|aggiungi|togli|poe|mete|tira|doe|"
    r"haal|me|us|it|on|and|like|want|another|extra|noch|mal|encore|otros?|unos|ancora|altri|mais|uns|nog|eens|er|dann|und|et|y|e|en|take) )*(?P<v>\d+(?:[.,]\d+)?) ?(?:km/h|kmh|kph|mph|k|km|clicks|klicks|sachen|kilomet\w+|quilomet\w+|"
    r"chilometri|miles?(?: an hour)?)?(?: per hour| an hour)? (?:(?P<more>(?:more |extra )?on(?: top)?(?: of (?:what|that|this|it)\b.*)?|on the speed|onto (?:that|it|the speed)|drauf|dazu|obendrauf|schneller|plus vite|de plus au compteur|encima|mas rapido|mas deprisa|"
    r"piu veloce|in piu di velocita|mais depressa|mais rapido|em cima|erbij|bovenop|harder|sneller)|(?P<less>off(?: (?:the|our) speed| that| it| our pace)?|runter|vom tempo weg|de moins au compteur|eraf|langzamer|zachter))"
)
_TIMES = re.compile(
    r"\b(?:(?P<n>\d+(?:[.,]\d+)?|one)(?P<half> and a half| et demie?| y medi[oa]| e mezz[oa]| e mei[oa]|einhalb| en een half)? ?(?:times|mal|fois|veces|volte|vezes|keer|maal)(?: (?:so viel|as much|plus de|mas|piu|mais|zoveel))?|"
    r"(?P<more_half>anderthalb\w*|eineinhalb\w*|anderhalve? (?:keer|maal))|(?P<three>triple[zr]?|treble|tripliz?c?a\w*|verdreifach\w*|verdrievoudig|dreifach\w*|drievoudige?|el triple|il triplo|o triplo|le triple))\b(?: (?:de|del|della|da|of))?"
)
_ENOUGH = re.compile(
    r"\b(?:(?:is|are|will be|would be|should be|ist|sind|is|sont|es|son|e|sao|zijn) )?(?:enough|plenty|fine|ok(?:ay)?|sufficient|will do|would do|do|genug|genugen|genugt|reich(?:t|en)|ausreichend|suffit|suffisent|suffira|assez|"
    r"basta(?:n|no)?|suficientes?|llega|sufficienti?|chega(?:m)?|genoeg|volsta(?:at|an))\b"
)


_TO_A_NUMBER = re.compile(
    r"(?:set|resume|back (?:up |down )?(?:to|at)|pick (?:it |her |speed )?up to|return to|reprends(?: a)?|remonte a|redescends a|vuelve a|volvemos a|retoma|recupera|riprendi(?: i| a)?|torna a(?:i)?|volta a(?:os)?|"
    r"retoma(?: os)?|hervat|terug naar|weer(?: naar)?|wieder(?: auf)?|zuruck auf|on the dial|show me) (?P<v>\d+(?:[.,]\d+)?)(?: ?(?:km/h|kmh|kph|mph|k))?(?: (?:on the (?:dial|clock)|again|wieder|a nouveau|de nuevo|di nuovo|de novo|weer))?"
)
"""Behind other wishes, a number to come to."""
_PERCENT_MORE = re.compile(
    r"\d+(?:[.,]\d+)? ?(?:%|percent|per cent|prozent|pour ?cent|por ciento|per cento|por cento|procent)(?: (?:of|de|di|von|an))?(?= .*\b(?:more|extra|further|mehr|weiter|en plus|de plus|plus|mas|di piu|in piu|piu|a mais|mais|meer)\b)"
)


def _multiple(found: re.Match[str]) -> float:
    if found["more_half"] is not None:
        return 1.5
    if found["three"] is not None:
        return 3.0
    return (float(found["n"].replace(",", ".")) if found["n"] != "one" else 1.0) + (0.5 if found["half"] else 0.0)


def amount(text: str) -> Step | None:
    """The change of speed or of the gap that a clause asks for, in `searchable` form; None where its words do not tell."""
    text = re.sub(r"^(?=(?:terco|quarto|quinto) mais )", "um ", text)
    text = _EXACTLY.sub("", text)
    share = share_said(text)
    if share is not None and len(text.split()) <= 10 and "limit" not in text and not _ROOM.search(text):
        faster, slower = FASTER.search(text), SLOWER.search(text)
        if bool(faster) == bool(slower):
            faster, slower = _ON.search(text), _OFF.search(text)
        if bool(faster) == bool(slower):
            return None
        times = 1.0 + share if faster else 1.0 - share
        if times <= 0.0:
            return None
        return Step(act="faster" if faster else "slower", value=round(times, 3), unit="times", mode="factor")
    by = _SPEED_BY.fullmatch(text)
    if by is not None and float(by["v"]) < MOST_BY:
        adds = by["more"] is not None
        change = float(by["v"]) * (MPH if uses_miles(text) else KMH)
        return Step(act="faster" if adds else "slower", value=round(change, 3), unit="mps", mode="by")
    plain = _HALF_A_SECOND.sub("0.5 ", text)
    to = _TO_A_NUMBER.fullmatch(plain)
    if to is not None and 20.0 <= float(to["v"]) < 200.0:
        value = float(to["v"]) * (MPH if uses_miles(text) else KMH)
        return Step(act="drive", value=round(value, 3), unit="mps", mode="to")
    percent = _PERCENT_MORE.search(plain)
    if percent is not None and _ROOM.search(plain) and _only(_ON.sub(lambda word: " " * len(word[0]), plain), percent):
        share = share_said(plain) or 0.0
        return Step(act="farther", value=round(1.0 + share, 3), unit="times", mode="factor")
    multiple = _TIMES.search(plain)
    if multiple is not None and _ROOM.search(plain) and _only(plain, multiple):
        return Step(act="farther", value=_multiple(multiple), unit="times", mode="factor")
    if _BUT.search(plain):
        return None
    less = _LESS_ROOM.search(plain)
    if less is not None and _only(plain, less):
        return _step(less, "closer", "by")
    more = _MORE_ROOM.search(plain)
    if more is None:
        return None
    enough = _ENOUGH.sub(" ", plain)
    cars = more["unit"].startswith(("@", "car", "wagen", "auto", "length", "longueur"))
    exact = (
        AT_LEAST.search(plain) is None
        and more["value"] != "another"
        and not (more["first"] or more["before"] or more["after"])
    )
    if exact and (cars or enough != plain) and _only(enough, _MORE_ROOM.search(enough)):
        return _step(more, "gap", "at_most" if AT_MOST.search(plain) else "to")
    if exact and AT_MOST.search(plain) and _ROOM.search(plain):
        bound = AT_MOST.sub(" ", plain)
        if _only(bound, _MORE_ROOM.search(bound)):
            return _step(more, "gap", "at_most")
    if (more["first"] or more["before"] or more["after"]) and _only(plain, more) and AT_LEAST.search(plain) is None:
        return _step(more, "farther", "by")
    if AT_LEAST.search(plain) and not re.search(r"\bslow|langsam|fast|schnell|faster\b", plain):
        cars, bound = more["unit"].startswith(("@", "car", "wagen", "auto", "length")), AT_LEAST.sub(" ", plain)
        if (cars or _ROOM.search(plain)) and _only(bound, _MORE_ROOM.search(bound)):
            return _step(more, "gap", "at_least")
    return None


def _only(text: str, found: re.Match[str] | None) -> bool:
    """Whether nothing else is said but of room."""
    if found is None:
        return False
    rest = f"{text[: found.start()]} {text[found.end() :]}"
    return not _AROUND.sub(" ", _ROOM.sub(" ", rest)).split()


def _step(said: re.Match[str], act: str, mode: str) -> Step:
    value = float(said["value"].replace(",", ".")) if said["value"][0].isdigit() else 1.0
    unit = "s" if said["unit"].startswith("s") else "m"
    if any(word in said["unit"] for word in ("leng", "lang", "longueur", "largo", "lunghezz", "comprimento")):
        value *= CAR_LENGTH_M
    return Step(act=act, value=value, unit=unit, mode=mode)  # type: ignore[arg-type]
