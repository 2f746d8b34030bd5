"""Numbers that a passenger says, as rules: in digits or words, with their units. Small models invent numbers.

Words up to 199 are known in English, German, French, Spanish, Italian, Portuguese and Dutch, the tens in some more
languages. What a number is for (a speed, a change of it, a time gap) is not decided here: see `slow_node.reader`.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
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


def quantities(text: str) -> list[Quantity]:
    """Every number in a text, in the order in which they are said."""
    folded = _SINGLES.sub(_run_together, fold(text))
    folded = _HALF_SECOND.sub(_half_second, _cjk_digits(folded))
    miles = re.search(r"\b(mph|mi/h|miles?|meilen?|millas?|miglia|milhas?|mijl|milles?)\b", folded) is not None
    found = []
    for match in _pattern().finditer(folded):
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


_DIGITS = {"zero": "0", "oh": "0", "one": "1", "two": "2", "three": "3", "four": "4", "five": "5", "six": "6",
           "seven": "7", "eight": "8", "nine": "9"}
_ONE = f"(?:{'|'.join(_DIGITS)})"
_SINGLES = re.compile(rf"\b{_ONE}(?:[ -]{_ONE}){{1,2}}\b(?! ?(?:hundred|and|point|sec))")


def _run_together(match: re.Match[str]) -> str:
    """"one zero five" is 105."""
    return "".join(_DIGITS[word] for word in re.split("[ -]", match[0]))


def _half_second(match: re.Match[str]) -> str:
    return f"{_HALVES[match['more']] if match['more'] else 0.5} seconds"


def _is_speed(quantity: Quantity) -> bool:
    """A bare number that can be a speed is one, in km/h, or in mph where miles are spoken of."""
    return quantity.kind == "bare" and (quantity.value >= 10 or quantity.value == 0)


_UNITS: tuple[tuple[str, str], ...] = (
    ("mps", r"m/s|mps|(?:met(?:er|re|ro|ri)s?|metern?|метр\w*)[ -](?:per|pro|par|por|al?|je|в)[ -](?:a )?"
            r"(?:se[ckg]\w+|секунд\w*)"),
    ("kmh", r"km\s?/\s?[hutg]\w*|kmh|kph|kmph|km h|stundenkilometern?|sachen|klicks?|clicks?|км/ч|км|公里|千米|キロ|"
        r"킬로\w*"
            r"|(?:kilom\w+|km|k|quilom\w+|chilom\w+|килом\w+)(?:[ -](?:per|an|a|pro|par|por|in der|in het|na|orari\w*|"
            r"horari?\w*|i|a l'|all'|a la)[ -]?(?:hour|stunde|heure|hora|ora|uur|timmen?|godzine|timen?|"
            r"час))?(?![a-z])"),
    ("mph", r"mph|mi/h|(?:miles?|meilen?|millas?|miglia|milhas?|mijl|milles?)(?: (?:an?|per|pro|por|all'|a l'|per) ?"
            r"(?:hour|stunde|hora|ora|uur|heure))?"),
    ("knot", r"knots?|knoten|noeuds?|nudos|nodi|knopen"),
    ("other", r"%|percent|prozent|min(?:ute|uti|uto|uut|ut)?\w*|hours?|stunden?|heures?|horas?|ore|uur|uhr|"
        r"o'?clock|am|pm|"
              r"degrees?|grad|euros?|dollars?|lanes?|spuren?|voies?|carril\w*|cors[ie]\w*|faixas?|ban(?:en|an)?|times|"
              r"cars?|car lengths?|people|years?|jahre?|th|st|nd|rd"),
    ("second", r"s|secs?|sek|se[ckg]\w*ond\w*|segund\w*|seg|sekund\w*|seconden?|saniye|секунд\w*|秒\w*|초"),
    ("foot", r"feet|foot|ft|fuss|pieds?|pies"),
    ("yard", r"yards?|yds?"),
    ("metre", r"m|met(?:er|re|ro|ri)s?|metern|metr(?:y|ow|a)?|метр\w*|米|メートル|미터"),
)
_MEASURES: dict[str, tuple[Kind, float]] = {
    "mps": ("speed", 1.0), "kmh": ("speed", KMH), "mph": ("speed", MPH), "knot": ("speed", KNOT),
    "other": ("other", 1.0),
    "second": ("time", 1.0), "foot": ("length", FOOT), "yard": ("length", YARD), "metre": ("length", 1.0),
}
_HALVES = {"anderthalb": 1.5, "eineinhalb": 1.5, "anderhalve": 1.5, "zweieinhalb": 2.5, "dreieinhalb": 3.5,
           "tweeenhalve": 2.5, "drieenhalve": 3.5}
_HALF_SECOND = re.compile(
    rf"(?<!and )(?<!and a )(?<!und )(?<!en )\b(?:(?P<more>{'|'.join(_HALVES)})e?n?|half a|half|halbe\w*|halben?|"
    r"demi-?|une demi|medio|mezzo|meio|halve)"
    r"[ -]?(?:a )?(?:sec|sek|seg)\w*")

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
    "en": ("one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen "
           "eighteen nineteen", "twenty thirty forty fifty sixty seventy eighty ninety"),
    "de": ("ein zwei drei vier funf sechs sieben acht neun zehn elf zwolf dreizehn vierzehn funfzehn sechzehn siebzehn "
           "achtzehn neunzehn", "zwanzig dreissig vierzig funfzig sechzig siebzig achtzig neunzig"),
    "fr": ("un deux trois quatre cinq six sept huit neuf dix onze douze treize quatorze quinze seize dix-sept dix-huit "
           "dix-neuf", "vingt trente quarante cinquante soixante septante huitante nonante"),
    "es": ("uno dos tres cuatro cinco seis siete ocho nueve diez once doce trece catorce quince dieciseis diecisiete "
           "dieciocho diecinueve", "veinte treinta cuarenta cincuenta sesenta setenta ochenta noventa"),
    "it": ("uno due tre quattro cinque sei sette otto nove dieci undici dodici tredici quattordici quindici sedici "
           "diciassette diciotto diciannove", "venti trenta quaranta cinquanta sessanta settanta ottanta novanta"),
    "pt": ("um dois tres quatro cinco seis sete oito nove dez onze doze treze quatorze quinze dezesseis dezessete "
           "dezoito dezenove", "vinte trinta quarenta cinquenta sessenta setenta oitenta noventa"),
    "nl": ("een twee drie vier vijf zes zeven acht negen tien elf twaalf dertien veertien vijftien zestien zeventien "
           "achttien negentien", "twintig dertig veertig vijftig zestig zeventig tachtig negentig"),
}
SPELLING_LANGUAGES = tuple(_WORDS)


def _spell(language: str, n: int) -> Iterator[str]:
    """Folded spellings of 1..199."""
    if n >= 100:
        rest = list(_spell(language, n - 100)) if n > 100 else [""]
        heads = {"en": ("a hundred", "one hundred", "hundred"), "de": ("hundert", "einhundert"), "fr": ("cent",),
                 "es": ("ciento",) if n > 100 else ("cien",), "it": ("cento",),
                 "pt": ("cento",) if n > 100 else ("cem",), "nl": ("honderd",)}[language]
        joints = {"en": (" and ", " "), "de": ("", " "), "fr": (" ",), "es": (" ",), "it": ("", " "), "pt": (" e ",),
                  "nl": ("", " ")}[language] if n > 100 else ("",)
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
    words.update({"eine": 1, "einer": 1, "une": 1, "una": 1, "uma": 1, "duas": 2, "null": 0, "zero": 0, "cero": 0,
                  "nul": 0, "a": 1, "two hundred": 200, "zweihundert": 200, "deux cents": 200, "doscientos": 200,
                  "duecento": 200, "duzentos": 200, "tweehonderd": 200, "three hundred": 300, "dreihundert": 300})
    return words


@cache
def _pattern() -> re.Pattern[str]:
    words = "|".join(re.escape(w) for w in sorted(_numbers(), key=len, reverse=True) if w != "a")
    number = rf"\d+(?:[.,]\d+)?|(?<![^\W_])(?:{words}|a(?= second))(?![^\W_])"
    units = "|".join(f"(?P<{name}>{pattern})" for name, pattern in _UNITS)
    return re.compile(
        rf"(?<![\d.,])(?P<number>{number})(?:\s*(?:point|komma|virgule|coma|virgola|virgula)\s*(?P<tenth>\d|{words}))?"
        rf"(?P<half> and a half| (?:und|en) (?:ein|een) halb?\w*| ?\u00bd| 1\u20442)?"
        rf"(?:[\s-]?(?:{units})(?![a-z])(?P<halfafter> et demie?| y medio| e mezzo| e meio| and a half)?)?")


def _value(text: str) -> float:
    if text[0].isdigit():
        return float(text.replace(",", "."))
    return float(_numbers()[text])


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
    return re.sub(f"[一二三四五六七八九两十百][零\u3007一二三四五六七八九十百]*(?={counted})", digits,
    text)
