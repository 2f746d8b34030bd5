"""Numbers that a passenger says, as rules: in digits or words, with their units. Small models invent numbers.

Words below a thousand are known in English, German, French, Spanish, Italian, Portuguese and Dutch, up to 199 in
Swedish, Polish and Finnish, the tens in some more languages. Slips of the keyboard ("9O", "eigthy") are mended, and a
time of day is no number. What a number is for (a speed, a change of it, a time gap) is not decided here: see
`slow_node.understanding.intent_parser`.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Literal

Kind = Literal["speed", "time", "length", "bare", "other"]

KMH, MPH, KNOT = 1 / 3.6, 0.44704, 0.5144
FOOT, YARD = 0.3048, 0.9144


@dataclass(frozen=True)
class Quantity:
    """A number and what it measures: metres per second, seconds, metres, or as it was said (`bare`, `other`)."""

    value: float
    kind: Kind


def fold(text: str) -> str:
    """Lower case, without accents and typographic variants: what words are compared in."""
    plain = unicodedata.normalize("NFKD", text.lower().replace("\u2019", "'").replace("\u00df", "ss"))
    return "".join(c for c in plain if not unicodedata.combining(c) or c in "\u3099\u309a")


def spelled(language: str) -> dict[int, tuple[str, ...]]:
    """The ways to write 1 to 199 in a language (folded), the usual one first; only some numbers for some languages."""
    if language in _TENS:
        return {10 * (i + 1): (word,) for i, word in enumerate(_TENS[language].split()) if word != "-"}
    return {n: tuple(dict.fromkeys(_spell(language, n))) for n in range(1, 200)}


def in_digits(text: str) -> str:
    """A text folded, its times of day as "clock" and its numbers from ten up in digits: what the intent parser reads."""
    return _replaced(_prepared(text), lambda word, n: n >= 10 and word not in _COMMON_WORDS)


def quantities(text: str) -> list[Quantity]:
    """Every number in a text, in the order in which they are said."""
    folded = _replaced(_HALF_SECOND.sub(_half_second, _prepared(text)), lambda word, n: word != "a")
    miles = re.search(r"\b(mph|mi/h|miles?|meilen?|millas?|miglia|milhas?|mijl|milles?)\b", folded) is not None
    found = []
    for match in _PATTERN.finditer(folded):
        value = _value(match["number"])
        if match["tenth"]:
            value += _value(match["tenth"]) / 10
        if match["half"]:
            value += 0.5
        unit = next((name for name, _ in _UNITS if match[name]), None)
        if unit is None:
            found.append(Quantity(value, "bare"))
            continue
        if match["halfafter"]:
            value += 0.5
        kind, factor = _MEASURES[unit]
        found.append(Quantity(value * factor, kind))
    return [Quantity(q.value * (MPH if miles else KMH), "speed") if _is_speed(q) else q for q in found]


def _prepared(text: str) -> str:
    """Folded and mended; no times of day; hundreds, run-together digits and Chinese numerals in digits."""
    folded = _without_clock(_mended(fold(text)))
    if _HUNDREDS_HINT.search(folded):
        folded = _hundreds_pattern().sub(_hundreds, folded)
    return _cjk_digits(_SINGLES.sub(_run_together, folded))


_DIGITS = {
    "zero": "0",
    "oh": "0",
    "one": "1",
    "two": "2",
    "three": "3",
    "four": "4",
    "five": "5",
    "six": "6",
    "seven": "7",
    "eight": "8",
    "nine": "9",
}
_ONE = f"(?:{'|'.join(_DIGITS)})"
_SINGLES = re.compile(rf"\b{_ONE}(?:[ -]{_ONE}){{1,2}}\b(?! ?(?:hundred|and|point|sec))")


def _run_together(match: re.Match[str]) -> str:
    """ "one zero five" is 105."""
    return "".join(_DIGITS[word] for word in re.split("[ -]", match[0]))


def _half_second(match: re.Match[str]) -> str:
    return f"{_HALVES[match['more']] if match['more'] else 0.5} seconds"


def _is_speed(quantity: Quantity) -> bool:
    """A bare number that can be a speed is one, in km/h, or in mph where miles are spoken of."""
    return quantity.kind == "bare" and (quantity.value >= 10 or quantity.value == 0)


_UNITS: tuple[tuple[str, str], ...] = (
    (
        "mps",
        r"m/s|mps|(?:met(?:er|re|ro|ri)s?|metern?|metr(?:y|ow|ia)|метр\w*)[ -](?:per|pro|par|por|al?|je|i|na|"
        r"в)[ -](?:a )?"
        r"(?:se[ckg]\w+|секунд\w*)|metria sekunnissa",
    ),
    (
        "kmh",
        r"km\s?/\s?[hutg]\w*|kmh|kph|kmph|km h|stundenkilometern?|sachen|klicks?|clicks?|км/ч|км|公里|千米|キロ|"
        r"킬로\w*"
        r"|(?:kilom\w+|km|k|quilom\w+|chilom\w+|килом\w+)(?:[ -](?:per|an|a|pro|par|por|in der|in het|na|orari\w*|"
        r"horari?\w*|i|a l'|all'|a la)[ -]?(?:hour|stunde|heure|hora|ora|uur|timmen?|godzine|timen?|"
        r"час))?(?![a-z])",
    ),
    (
        "mph",
        r"mph|mi/h|(?:miles?|meilen?|millas?|miglia|milhas?|mijl|milles?)(?: (?:an?|per|pro|por|all'|a l'|per) ?"
        r"(?:hour|stunde|hora|ora|uur|heure))?",
    ),
    ("knot", r"knots?|knoten|noeuds?|nudos|nodi|knopen"),
    (
        "other",
        r"%|percent|prozent|min(?:ute|uti|uto|uut|ut)?\w*|hours?|stunden?|heures?|horas?|ore|uur|uhr|"
        r"o'?clock|am|pm|"
        r"degrees?|grad|euros?|dollars?|lanes?|spuren?|voies?|carril\w*|cors[ie]\w*|faixas?|ban(?:en|an)?|times|"
        r"cars?|car lengths?|people|years?|jahre?|th|st|nd|rd",
    ),
    (
        "second",
        r"s|secs?|sek|se[ckg]\w*ond\w*|sec(?:n?d|on|od|no)s?|se(?:oc|o)n?ds?|"
        r"segund\w*|seg|sekun[dt]\w*|seconden?|saniye|секунд\w*|秒\w*|초",
    ),
    ("foot", r"feet|foot|ft|fuss|pieds?|pies"),
    ("yard", r"yards?|yds?"),
    ("metre", r"m|met(?:er|re|ro|ri)s?|metern|metr(?:y|ow|a|ia)?|метр\w*|米|メートル|미터"),
)
_MEASURES: dict[str, tuple[Kind, float]] = {
    "mps": ("speed", 1.0),
    "kmh": ("speed", KMH),
    "mph": ("speed", MPH),
    "knot": ("speed", KNOT),
    "other": ("other", 1.0),
    "second": ("time", 1.0),
    "foot": ("length", FOOT),
    "yard": ("length", YARD),
    "metre": ("length", 1.0),
}
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

_TENS = {
    "sv": "- tjugo trettio fyrtio femtio sextio sjuttio attio nittio hundra hundratio hundratjugo hundratrettio",
    "da": "- tyve tredive fyrre halvtreds tres halvfjerds firs halvfems hundrede hundredeti hundredetyve -",
    "no": "- tjue tretti forti femti seksti sytti atti nitti hundre hundreti hundretjue hundretretti",
    "pl": "- dwadziescia trzydziesci czterdziesci piecdziesiat szescdziesiat siedemdziesiat osiemdziesiat "
    "dziewiecdziesiat sto - - -",
    "ru": "десять двадцать тридцать сорок пятьдесят шестьдесят семьдесят восемьдесят девяносто сто - - -",
    "tr": "- yirmi otuz k\u0131rk elli altm\u0131s yetmis seksen doksan yuz - - -",
}
_WORDS = {
    "en": (
        "one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen "
        "eighteen nineteen",
        "twenty thirty forty fifty sixty seventy eighty ninety",
    ),
    "de": (
        "ein zwei drei vier funf sechs sieben acht neun zehn elf zwolf dreizehn vierzehn funfzehn sechzehn siebzehn "
        "achtzehn neunzehn",
        "zwanzig dreissig vierzig funfzig sechzig siebzig achtzig neunzig",
    ),
    "fr": (
        "un deux trois quatre cinq six sept huit neuf dix onze douze treize quatorze quinze seize dix-sept dix-huit "
        "dix-neuf",
        "vingt trente quarante cinquante soixante septante huitante nonante",
    ),
    "es": (
        "uno dos tres cuatro cinco seis siete ocho nueve diez once doce trece catorce quince dieciseis diecisiete "
        "dieciocho diecinueve",
        "veinte treinta cuarenta cincuenta sesenta setenta ochenta noventa",
    ),
    "it": (
        "uno due tre quattro cinque sei sette otto nove dieci undici dodici tredici quattordici quindici sedici "
        "diciassette diciotto diciannove",
        "venti trenta quaranta cinquanta sessanta settanta ottanta novanta",
    ),
    "pt": (
        "um dois tres quatro cinco seis sete oito nove dez onze doze treze quatorze quinze dezesseis dezessete "
        "dezoito dezenove",
        "vinte trinta quarenta cinquenta sessenta setenta oitenta noventa",
    ),
    "nl": (
        "een twee drie vier vijf zes zeven acht negen tien elf twaalf dertien veertien vijftien zestien zeventien "
        "achttien negentien",
        "twintig dertig veertig vijftig zestig zeventig tachtig negentig",
    ),
}
SPELLING_LANGUAGES = tuple(_WORDS)


def _spell(language: str, n: int) -> Iterator[str]:
    """Folded spellings of 1..199."""
    if n >= 100:
        rest = list(_spell(language, n - 100)) if n > 100 else [""]
        heads = {
            "en": ("a hundred", "one hundred", "hundred"),
            "de": ("hundert", "einhundert"),
            "fr": ("cent",),
            "es": ("ciento",) if n > 100 else ("cien",),
            "it": ("cento",),
            "pt": ("cento",) if n > 100 else ("cem",),
            "nl": ("honderd",),
        }[language]
        joints = (
            {
                "en": (" and ", " "),
                "de": ("", " "),
                "fr": (" ",),
                "es": (" ",),
                "it": ("", " "),
                "pt": (" e ",),
                "nl": ("", " "),
            }[language]
            if n > 100
            else ("",)
        )
        for head in heads:
            for joint in joints:
                for tail in rest:
                    yield f"{head}{joint}{tail}"
        if language == "en" and n >= 110:
            for tail in rest:
                yield f"one {tail}"
                yield f"one-{tail}"
        return
    low, tens = (part.split() for part in _WORDS[language])
    if language == "fr" and n in range(70, 100) and n != 80:
        base, rest_n = ("soixante", n - 60) if n < 80 else ("quatre-vingt", n - 80)
        joint = " et " if n == 71 else "-"
        yield f"{base}{joint}{low[rest_n - 1]}"
        yield f"{base} {low[rest_n - 1]}"
    if language == "fr" and n == 80:
        yield "quatre-vingts"
        yield "quatre-vingt"
        yield "quatre vingt"
        yield "quatre vingts"
    if n < 20:
        yield low[n - 1]
        if language == "pt" and n in (14, 16, 17, 19):
            yield {14: "catorze", 16: "dezasseis", 17: "dezassete", 19: "dezanove"}[n]
        if language == "de":
            yield low[n - 1].replace("funf", "fuenf").replace("zwolf", "zwoelf")
        return
    ten, one = tens[n // 10 - 2], n % 10
    if not one:
        yield ten
        if language == "de":
            yield ten.replace("funf", "fuenf")
        return
    unit = low[one - 1]
    if language in ("de", "nl"):
        yield f"{unit}{'und' if language == 'de' else 'en'}{ten}"
        yield f"{unit.replace('funf', 'fuenf')}{'und' if language == 'de' else 'en'}{ten.replace('funf', 'fuenf')}"
    elif language == "es" and n < 30:
        yield f"veinti{unit}"
    elif language == "it":
        yield f"{ten[:-1] if one in (1, 8) else ten}{unit}"
    else:
        for joint in {"en": ("-", " "), "fr": ("-", " ", " et ", "-et-"), "es": (" y ",), "pt": (" e ",)}[language]:
            yield f"{ten}{joint}{unit}"


@cache
def _numbers() -> dict[str, int]:
    words: dict[str, int] = {}
    for language in (*_WORDS, *_TENS):
        for n, spellings in spelled(language).items():
            for spelling in spellings:
                words.setdefault(fold(spelling), n)
    for n, spelling in (*_swedish(), *_polish(), *_finnish()):
        words.setdefault(spelling, n)
    words.update(
        {
            "eine": 1,
            "einer": 1,
            "une": 1,
            "una": 1,
            "uma": 1,
            "duas": 2,
            "null": 0,
            "zero": 0,
            "cero": 0,
            "nul": 0,
            "a": 1,
            "two hundred": 200,
            "zweihundert": 200,
            "deux cents": 200,
            "doscientos": 200,
            "duecento": 200,
            "duzentos": 200,
            "tweehonderd": 200,
            "three hundred": 300,
            "dreihundert": 300,
        }
    )
    return words


_COMMON_WORDS = ("once", "doze", "elf", "cent")
"""Numbers in one language, everyday words in another."""


@cache
def _longest() -> int:
    """The most words that a spelled-out number has."""
    return max(len(_WORD.findall(number)) for number in _numbers())


_WORD = re.compile(r"[^\W_]+")


def _replaced(text: str, chosen: Callable[[str, int], bool]) -> str:
    """The text with its spelled-out numbers in digits, the longest first, where they are `chosen` (by word and value).

    A regular expression of all the words would do the same, but takes a second to compile and 17 MB to keep.
    """
    words, numbers = list(_WORD.finditer(text)), _numbers()
    parts, copied, index = [], 0, 0
    while index < len(words):
        start, step = words[index].start(), 1
        for count in range(min(_longest(), len(words) - index), 0, -1):
            end = words[index + count - 1].end()
            word = text[start:end]
            if word in numbers and chosen(word, numbers[word]):
                parts += [text[copied:start], str(numbers[word])]
                copied, step = end, count
                break
        index += step
    return "".join([*parts, text[copied:]])


_PATTERN = re.compile(
    r"(?<![\d.,])(?P<number>\d+(?:[.,]\d+)?|(?<![^\W_])a(?= second))"
    r"(?:\s*(?:point|komma|virgule|coma|virgola|virgula)\s*(?P<tenth>\d))?"
    r"(?P<half> and a half| (?:und|en) (?:1|ein|een) halb?\w*| ?\u00bd| 1\u20442)?"
    rf"(?:[\s-]?(?:{'|'.join(f'(?P<{name}>{pattern})' for name, pattern in _UNITS)})(?![a-z])"
    r"(?P<halfafter> et demie?| y medio| e mezzo| e meio| and a half)?)?"
)


def _value(text: str) -> float:
    return 1.0 if text == "a" else float(text.replace(",", "."))


_SWEDISH = "ett tva tre fyra fem sex sju atta nio - elva tolv tretton fjorton femton sexton sjutton arton nitton"
_POLISH_TENS = (
    "dwudziestu trzydziestu czterdziestu piecdziesieciu szescdziesieciu siedemdziesieciu osiemdziesieciu "
    "dziewiecdziesieciu"
)
_FINNISH = (
    ("yksi kaksi kolme nelja viisi kuusi seitseman kahdeksan yhdeksan", "kymmenen", "kymmenta", "sata"),
    ("yhta kahta kolmea neljaa viitta kuutta seitsemaa kahdeksaa yhdeksaa", "kymmenta", "kymmenta", "sataa"),
    (
        "yhteen kahteen kolmeen neljaan viiteen kuuteen seitsemaan kahdeksaan yhdeksaan",
        "kymmeneen",
        "kymmeneen",
        "sataan",
    ),
    ("yhden kahden kolmen neljan viiden kuuden seitseman kahdeksan yhdeksan", "kymmenen", "kymmenen", "sadan"),
)
"""As they are, as an amount (partitive), as an aim (illative), genitive: 1 to 9, 10, the end of 20 to 90, 100."""


def _swedish() -> Iterator[tuple[int, str]]:
    """1..199 but for the words that mean something else in other languages ("en", "tio")."""
    low = _SWEDISH.split()
    tens = _TENS["sv"].split()[1:9]
    below = [(n, w) for n, w in enumerate(low, 1) if w != "-"]
    below += [(20 + 10 * i, ten) for i, ten in enumerate(tens)]
    below += [
        (20 + 10 * i + j, f"{ten}{joint}{low[j - 1]}")
        for i, ten in enumerate(tens)
        for j in range(1, 10)
        for joint in ("", " ")
    ]
    yield from below[1:]
    for head in ("hundra", "etthundra", "ett hundra"):
        yield 100, head
        yield from ((100 + n, f"{head}{joint}{word}") for n, word in (*below, (10, "tio")) for joint in ("", " "))


def _polish() -> Iterator[tuple[int, str]]:
    """1..199, as they are and as they follow "do" (the genitive)."""
    plain = (
        "jeden dwa trzy cztery piec szesc siedem osiem dziewiec dziesiec jedenascie dwanascie trzynascie "
        "czternascie pietnascie szesnascie siedemnascie osiemnascie dziewietnascie",
        _TENS["pl"].split()[1:9],
    )
    genitive = (
        "jednego dwoch trzech czterech pieciu szesciu siedmiu osmiu dziewieciu dziesieciu jedenastu dwunastu "
        "trzynastu czternastu pietnastu szesnastu siedemnastu osiemnastu dziewietnastu",
        _POLISH_TENS.split(),
    )
    for (low_text, tens), head in ((plain, "sto"), (genitive, "stu")):
        low = low_text.split()
        below = list(enumerate(low, 1)) + [(20 + 10 * i, ten) for i, ten in enumerate(tens)]
        below += [(20 + 10 * i + j, f"{ten} {low[j - 1]}") for i, ten in enumerate(tens) for j in range(1, 10)]
        yield from below
        yield 100, head
        yield from ((100 + n, f"{head} {word}") for n, word in below)
    yield 2, "dwie"


def _finnish() -> Iterator[tuple[int, str]]:
    """1..199 in four cases and in everyday speech ("kymppi")."""
    for ones, ten, many, hundred in _FINNISH:
        low = ones.split()
        below = [*enumerate(low, 1), (10, ten), *((10 + n, f"{word}toista") for n, word in enumerate(low, 1))]
        for n, word in list(enumerate(low, 1))[1:]:
            for end in (many, "kymppia", "kymppi", "kymppiin"):
                below.append((10 * n, f"{word}{end}"))
                below += [
                    (10 * n + m, f"{word}{end}{joint}{unit}") for m, unit in enumerate(low, 1) for joint in ("", " ")
                ]
        yield from below
        yield 100, hundred
        yield from ((100 + n, f"{hundred}{word}") for n, word in below)


_MANY = {
    "hundred": "two three four five six seven eight nine",
    "hundert": "zwei drei vier funf sechs sieben acht neun",
    "cents?": "deux trois quatre cinq six sept huit neuf",
    "cento": "due tre quattro cinque sei sette otto nove",
    "honderd": "twee drie vier vijf zes zeven acht negen",
    "sataa": "kaksi kolme nelja viisi kuusi seitseman kahdeksan yhdeksan",
    "hundra": "tva tre fyra fem sex sju atta nio",
}
_MANY_IRREGULAR = {
    "doscient[oa]s": 200,
    "trescient[oa]s": 300,
    "cuatrocient[oa]s": 400,
    "quinient[oa]s": 500,
    "duzent[oa]s": 200,
    "trezent[oa]s": 300,
    "quatrocent[oa]s": 400,
    "quinhent[oa]s": 500,
    "dwiescie": 200,
    "trzysta": 300,
    "czterysta": 400,
    "piecset": 500,
    "dwustu": 200,
    "trzystu": 300,
}


_HUNDREDS_HINT = re.compile("hund|cent|cien|honderd|sataa|ientos|ientas|entos|entas|dwie|trzy|czterysta|piecset|dwustu")


@cache
def _hundreds_pattern() -> re.Pattern[str]:
    """Hundreds with what follows them: "two hundred and ten", "zweihundertzehn", "1 hundred and 10"."""
    heads = [rf"(?:{'|'.join(words.split())})[ -]?{hundred}" for hundred, words in _MANY.items()]
    below = sorted((w for w, n in _numbers().items() if 0 < n < 100 and w != "a"), key=len, reverse=True)
    head, rest = "|".join((*heads, *_MANY_IRREGULAR, "[1-9] ?hundred")), "|".join(map(re.escape, below))
    return re.compile(
        rf"(?<![^\W_])(?P<head>{head})"
        rf"(?:(?: and | y | e | och |[ -]|)(?P<rest>\d{{1,2}}|{rest}))?(?![^\W_])"
    )


def _hundreds(match: re.Match[str]) -> str:
    head, rest = match["head"], match["rest"]
    value = next((n for pattern, n in _MANY_IRREGULAR.items() if re.fullmatch(pattern, head)), 0)
    if head[0].isdigit():
        value = 100 * int(head[0])
    for hundred, words in _MANY.items():
        if value == 0 and (found := re.fullmatch(rf"({'|'.join(words.split())})[ -]?{hundred}", head)):
            value = 100 * (words.split().index(found[1]) + 2)
    return str(value + (int(_numbers().get(rest, rest)) if rest else 0))


_ALIKE = re.compile(
    r"(?<![\w.,])(?=\w*[oli])(?=\w*\d)(?:\d|[li](?=[\do]{2}))(?:[\do]|[li](?=[\do]))*"
    r"(?=(?:km|kmh|kph|mph|m)?(?:/|\b))(?!')"
)


@cache
def _misspelled() -> dict[str, str]:
    """The tens of seven languages with one letter lost, or two in the wrong order, to how they are spelled."""
    right = {w for _, tens in _WORDS.values() for w in tens.split()} | {"hundred", "hundert", "honderd"}
    wrong = {
        "fourty": "forty",
        "fourthy": "forty",
        "fivty": "fifty",
        "fity": "fifty",
        "sixy": "sixty",
        "huntert": "hundert",
        "sisty": "sixty",
        "forteen": "fourteen",
        "hundread": "hundred",
        "hunderd": "hundred",
        "hundret": "hundred",
    }
    for word in sorted(w for w in right if len(w) >= 6):
        for i in range(1, len(word) - 1):
            wrong.setdefault(word[:i] + word[i + 1 :], word)
            if i < len(word) - 2:
                wrong.setdefault(word[:i] + word[i + 1] + word[i] + word[i + 2 :], word)
    for word in right | set(_numbers()) | {"tenta"}:
        wrong.pop(word, None)
    return wrong


_ONES_AS_TYPED = {
    "wun": "one",
    "oen": "one",
    "tow": "two",
    "tree": "three",
    "free": "three",
    "thre": "three",
    "trhee": "three",
    "theree": "three",
    "foru": "four",
    "fuor": "four",
    "fower": "four",
    "fiv": "five",
    "fve": "five",
    "fiev": "five",
    "siks": "six",
    "sixx": "six",
    "sxi": "six",
    "sevn": "seven",
    "sevin": "seven",
    "seveen": "seven",
    "eigt": "eight",
    "eigth": "eight",
    "eihgt": "eight",
    "nien": "nine",
    "nin": "nine",
    "nyne": "nine",
}
_ONES_SLIPPED = re.compile(
    r"\b(?P<tens>(?:twenty|thirty|forty|fifty|sixty|seventy|eighty|ninety)[ -])?"
    rf"(?P<one>{'|'.join(sorted(_ONES_AS_TYPED, key=len, reverse=True))})"
    r"\b(?(tens)|(?=[ -](?:sec|scon|seoc)))"
)
"""After a ten ("ninety fiv"), or before seconds."""


def _mended(text: str) -> str:
    """Look-alike letters as digits, slips in number words mended, words and digits apart."""
    text = re.sub(r"(?<=!)[1!]+(?!\w)", "", text)  # "now!!1"
    text = _ALIKE.sub(lambda m: m[0].translate(str.maketrans("oli", "011")), text.replace("\u00ad", ""))
    text = re.sub(r"(?<=\d)(?=hundred\b)|(?<=\band)(?=\d)", " ", text)
    text = re.sub(r"[a-z]{4,}", lambda m: _misspelled().get(m[0], m[0]), text)
    text = _ONES_SLIPPED.sub(lambda m: f"{m['tens'] or ''}{_ONES_AS_TYPED[m['one']]}", text)
    text = re.sub(r"\bquatre[ -]vingts?(?=[ -])", "quatre-vingt", text)
    return re.sub(r"\bdix (?=(?:sept|huit|neuf)\b)", "dix-", text)


@cache
def _clock_pattern() -> re.Pattern[str]:
    words = sorted((w for w, n in _numbers().items() if 0 < n <= 24 and w != "a"), key=len, reverse=True)
    minutes = (
        r"(?:5|10|15|20|25|five|ten|twenty(?:[ -]five)?|funf|zehn|zwanzig|vijf|tien|fem|tio|quarter|kwart|"
        r"viertel)"
    )
    digits = r"(?:[01]?\d|2[0-4])"
    hour = rf"(?:{digits}(?![\d.,:]\d|\d)|(?:{'|'.join(words)})(?![^\W_]))"
    no_unit = r"(?! ?(?:km|k\b|mph|m\b|m/|s\b|se[ckg]|miles|kilo|%|knot|met[er]|faster|slower|more|less))"
    events = (
        r"(?:start|begin|open|clos|shut|leav|depart|goes|due|board|land|end|finish|meeting|appointment|exam|"
        r"flight|train|there|home|work)[a-z]*"
    )
    return re.compile(
        "|".join(
            (
                rf"(?<![\d.,]){digits} ?(?:[:h]|uhr) ?[0-5]\d\b(?: ?(?:[ap]\.?m\b|uhr|h\b))?",
                rf"(?<![\d.,]){digits}[.][0-5]\d ?(?:[ap]\.?m\b|uhr\b|h\b|uur\b)",
                rf"\b(?:klo|kl\.?|klockan|kello|o godzinie) ?{digits}(?:[.:][0-5]\d)?\b",
                rf"\b(?:klo|klockan|kello) {hour}",
                rf"(?<![\d.,]){digits}h\b",
                rf"(?<!\d){digits} ?[\u70b9\u6642\u65f6\uc2dc]",
                rf"\b{hour} (?:uhr|heures|horas|uur|o'? ?clock)\b(?: (?:et|y|e) (?:demie?|media|meia|quart|cuarto)|"
                rf" (?:moins|menos) (?:le quart|cuarto|{minutes})| (?:trente|dix|vingt|quinze|dreissig|\d\d)\b{no_unit})?",
                rf"\b(?:half past|half|halb|halv|puoli|wpol do|kvart (?:i|over)) {hour}{no_unit}"
                r"(?! (?:a |as |second|sec|of|the))",
                rf"(?<!from )(?<!von )\b{minutes} (?:to|past|vor|nach|voor|over) {hour}{no_unit}",
                rf"\b(?:las|alle|sono le|sao|as(?= [^ ]+ (?:horas|e meia))) {hour}{no_unit}"
                rf"(?: (?:y|e) (?:media|mezza|meia|cuarto|un quarto|{hour})| (?:menos|meno) (?:cuarto|un quarto|{hour}))?",
                rf"\b{events}(?: (?!drive|go|speed|at\b)[a-z']+){{0,2}} (?:at|by|before|until|till) {hour}{no_unit}",
            )
        )
    )


def _without_clock(text: str) -> str:
    """Times of day are no speeds: "half past six", "18:30", "um acht Uhr", "the train leaves at ten"."""
    return _clock_pattern().sub(" clock ", text)


_CJK = {c: i for i, c in enumerate("零一二三四五六七八九")} | {"两": 2, "\u3007": 0}


def _cjk_digits(text: str) -> str:
    """Chinese and Japanese numerals below 1000 as digits."""

    def digits(match: re.Match[str]) -> str:
        total, current = 0, 0
        for c in match[0]:
            if c in "十百":
                total += (current or 1) * (10 if c == "十" else 100)
                current = 0
            else:
                current = _CJK[c]
        value = total + current
        if match[0][-1] not in "十百" and "百" in match[0] and "十" not in match[0] and "零" not in match[0]:
            value += 9 * current  # 一百二: the last digit counts tens
        return str(value)

    counted = "公里|千米|米|秒|キロ|メートル|で|$|[^\u4e00-\u9fff]"
    return re.sub(f"[一二三四五六七八九两十百][零\u3007一二三四五六七八九十百]*(?={counted})", digits, text)
