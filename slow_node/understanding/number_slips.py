"""What is mended before numbers are read: slips of the keyboard ("9O", "eigthy"), times of day, which are no numbers, and
hundreds, run-together digits and Chinese numerals, which become digits.
"""

from __future__ import annotations

import re
from functools import cache

from slow_node.understanding.number_words import TENS_OF, numbers
from slow_node.understanding.text import fold


def prepared(text: str) -> str:
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
    below = sorted((w for w, n in numbers().items() if 0 < n < 100 and w != "a"), key=len, reverse=True)
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
    return str(value + (int(numbers().get(rest, rest)) if rest else 0))


_ALIKE = re.compile(
    r"(?<![\w.,])(?=\w*[oli])(?=\w*\d)(?:\d|[li](?=[\do]{2}))(?:[\do]|[li](?=[\do]))*"
    r"(?=(?:km|kmh|kph|mph|m)?(?:/|\b))(?!')"
)


@cache
def _misspelled() -> dict[str, str]:
    """The tens of seven languages with one letter lost, or two in the wrong order, to how they are spelled."""
    right = {word for tens in TENS_OF.values() for word in tens.split()} | {"hundred", "hundert", "honderd"}
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
    for word in right | set(numbers()) | {"tenta"}:
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
    words = sorted((w for w, n in numbers().items() if 0 < n <= 24 and w != "a"), key=len, reverse=True)
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
