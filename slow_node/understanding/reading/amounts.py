"""Changes that are sure by their words: "an extra second of distance", "ten car lengths, nothing less", "a fifth faster"."""

from __future__ import annotations

import re

from schemas.driving.measures import CAR_LENGTH_M
from schemas.wire.program import Step
from slow_node.understanding.reading.values import AT_LEAST, FASTER, SLOWER, share_said

_HALF_A_SECOND = re.compile(
    r"\b(?:half an?|half|eine halbe|une demi-?|medio|mezzo|meio|een halve)[ -]?(?=se[ck]|seg)|(?<=\bum )meio (?=seg)"
)
_EXTRA = r"(?:more|extra|further|additional|mehr|zusatzlich|weitere|de plus|en plus|supplementaires?|mas|extra|de mas|in piu|di piu|a mais|mais|meer)"
_AMOUNT = (
    r"(?P<value>\d+(?:[.,]\d+)?|an?|another|one|eine?n?|une?|una?|uno|uma?|een)(?P<before> (?:full |whole |volle |ganze )?"
    + _EXTRA
    + r")? (?P<unit>(?:@?car[ -])?lengths?|wagenlangen?|autolangen?|(?:s|m|sec|secs|meter|metern?|metres?|meters?|metros?|metri|metro|seconds?|sekunden?|secondes?|segundos?|secondi|secondo|seconden?))\b"
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
    r"sich|bis|ein|gap|gerne|gern|also|di|a|quella|celle|voiture|macchina|coche|auto)\b|[^\w@]+"
)
_BUT = re.compile(r"\b(?:limit|than|limite|tempo|until|bis|km|faster|slower|speed|lanes?)\b")


def amount(text: str) -> Step | None:
    """The change of speed or of the gap that a clause asks for, in `searchable` form; None where its words do not tell."""
    text = re.sub(r"^(?=(?:terco|quarto|quinto) mais )", "um ", text)
    share = share_said(text)
    if share is not None and len(text.split()) <= 10 and "limit" not in text and not _ROOM.search(text):
        faster, slower = FASTER.search(text), SLOWER.search(text)
        if bool(faster) == bool(slower):
            return None
        times = 1.0 + share if faster else 1.0 - share
        if times <= 0.0:
            return None
        return Step(act="faster" if faster else "slower", value=round(times, 3), unit="times", mode="factor")
    plain = _HALF_A_SECOND.sub("0.5 ", text)
    if _BUT.search(plain):
        return None
    less = _LESS_ROOM.search(plain)
    if less is not None and _only(plain, less):
        return _step(less, "closer", "by")
    more = _MORE_ROOM.search(plain)
    if more is None:
        return None
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
    if "leng" in said["unit"] or "lang" in said["unit"]:
        value *= CAR_LENGTH_M
    return Step(act=act, value=value, unit=unit, mode=mode)  # type: ignore[arg-type]
