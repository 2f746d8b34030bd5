"""How numbers are spelled: below a thousand in English, German, French, Spanish, Italian, Portuguese and Dutch, up to 199
in Swedish, Polish and Finnish, the tens in some more languages. Everything is folded (`slow_node.understanding.text`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache

from slow_node.understanding.text import fold


def spelled(language: str) -> dict[int, tuple[str, ...]]:
    """The ways to write 1 to 199 in a language (folded), the usual one first; only some numbers for some languages."""
    if language in _TENS:
        return {10 * (i + 1): (word,) for i, word in enumerate(_TENS[language].split()) if word != "-"}
    return {n: tuple(dict.fromkeys(_spell(language, n))) for n in range(1, 200)}


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
TENS_OF = {language: tens for language, (_, tens) in _WORDS.items()}
"""Twenty to ninety, by language."""


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
def numbers() -> dict[str, int]:
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


COMMON_WORDS = ("once", "doze", "elf", "cent")
"""Numbers in one language, everyday words in another."""


@cache
def _longest() -> int:
    """The most words that a spelled-out number has."""
    return max(len(_WORD.findall(number)) for number in numbers())


_WORD = re.compile(r"[^\W_]+")


def replaced(text: str, chosen: Callable[[str, int], bool]) -> str:
    """The text with its spelled-out numbers in digits, the longest first, where they are `chosen` (by word and value).

    A regular expression of all the words would do the same, but takes a second to compile and 17 MB to keep.
    """
    words, known = list(_WORD.finditer(text)), numbers()
    parts, copied, index = [], 0, 0
    while index < len(words):
        start, step = words[index].start(), 1
        for count in range(min(_longest(), len(words) - index), 0, -1):
            end = words[index + count - 1].end()
            word = text[start:end]
            if word in known and chosen(word, known[word]):
                parts += [text[copied:start], str(known[word])]
                copied, step = end, count
                break
        index += step
    return "".join([*parts, text[copied:]])


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
