"""The expressions of `*.toml`, and the form of a text in which they are searched."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from slow_node.understanding.number_slips import prepared
from slow_node.understanding.number_words import COMMON_WORDS, replaced

LANGUAGES = ("en", "de", "fr", "es", "it", "pt", "nl", "any")
_WHO = {
    "ambulance": r"ambulan\w+|krankenwagen|rettungswagen|notarzt|fire engine|fire truck|feuerwehr\w*|pompiers|bomber\w+|"
    r"vigili del fuoco|brandweer\w*|emergency vehicle",
    "police": r"(?:police|patrol)(?: (?:car|van|vehicle))?|squad car|cops?|polizei\w*|streifenwagen|gendarmes?|policia|polizia|carabinieri|politie\w*",
    "truck": r"(?:big )?(?:(?:pick-?up |dump )?trucks?|lorr(?:y|ies)|hgvs?|lkws?|laster|lastwagen|camion(?:es|s)?|camiao|caminh(?:ao|oes)|"
    r"vrachtwagens?|vrachtauto|tankers?|juggernaut|semi)",
    "van": r"vans?(?! (?:de|het|die|dit|links|rechts|mij|ons|een|deze|hier|rijstrook|baan)\b)|transporter|lieferwagen|camionnettes?|fourgon|furgoneta|furgone|carrinha|bestelbus(?:je)?|busje",
    "bus": r"(?:\w{3,8})?bus(?:es|se)?|autobus|onibus|autocarro|coach|reisebus|school bus|pullman|corriera|autocar|omnibus|minibus|micro(?=bus)|bussen",
    "motorcycle": r"scooters?|mopeds?|vespa|motorini?o?|motorroller|ciclomotor|brommer|motor(?:bikes?|cycles?|cyclist|rad|radfahrer)|(?<=die )motor|motos?|motas?|motards?|biker|motociclista|motorrijder",
    "cyclist": r"cyclists?|bicycles?|(?:push)?bikes?|rad(?:ler|fahrer(?:in)?)|fahrrad(?:fahrer)?|cyclistes?|velos?|ciclistas?|"
    r"bicicletas?|bicicletta|fietsers?|fiets",
    "pedestrian": r"pedestrians?|people|fussganger\w*|pietons?|peaton(?:es)?|pedon[ei]|peao|peoes|pedestres?|voetgangers?|"
    r"(?:old|elderly) (?:lady|man|woman|gentleman|couple)|pensioners?|woman|man with a pram|rentner(?:in)?|vecchiett[oaie]|vieille dame|vieux monsieur|mamie|viejecit[oa]s?|ancian[oa]s?|abuelit[oa]s?|anzian[oaie]|velhinh[oa]s?|idos[oa]s?|oudere(?:n)?|omaatje",
    "child": r"child(?:ren)?|kids?|schoolchildren|(?:schul)?kinder|schulkind|(?<=das )kind|(?<=ein )kind|enfants?|ninos?|nina|bambin[oaie]|bimb[oaie]|"
    r"criancas?|kinderen|(?<=een )kind",
    "deer": r"deer|rehe?|hirsche?|chevreuils?|biche|ciervos?|corzos?|caprioli?o?|cerv[oi]|veados?|hert(?:en)?|reeen|moose|elk",
    "animal": r"dogs?|cats?|ducks?|geese|horses?(?! ?-?(?:box|trailer|float|power))|cows?|sheep|ewes?|lambs?|fox(?:es)?|badgers?|hedgehogs?|(?:wild )?boars?|"
    r"hunde?|wildschweine?|pferde?|kuhe|kuh|schafe?|fuchs|igel|chiens?|sangliers?|vaches?|chevaux|cheval|moutons?|renard|herisson|"
    r"perros?|jabali(?:es)?|vacas?|caballos?|ovejas?|zorro|cani|cane|cinghial[ei]|mucc[ah]e?|cavall[oi]|pecor[ae]|"
    r"cao|caes|javalis?|cavalos?|ovelhas?|raposa|honden|hond|wilde zwijnen|koeien|paarden|paard|schapen",
    "caravan": r"caravans?|wohnwagen|wohnmobil|caravane|caravana|roulotte|camper|autocaravana",
    "tractor": r"tractors?|traktor|trecker|trekker|tracteurs?|trattore|trator(?:es)?",
    "car": r"cars?|vehicles?|taxi|auto|wagen|voiture|coche|macchina|carro|suv|limo|saloon|hatchback|estate|kombi|bmw|"
    r"audi|mercedes|volkswagen|golf|tesla|toyota|porsche|nissan|ford|fiat|renault|peugeot|citroen|opel|seat(?= (?:ibiza|leon))|skoda|volvo|honda|mazda|kia|hyundai|jaguar|mustang|corsa|clio|fiesta|prius|cabrio|convertible|limousine|berline|berlina|(?<=that )one|(?<=this )one|(?<=the )one|guy|driver",
}
OBJECTS = tuple(_WHO)
"""Whom a step or a trigger may be about."""
ON_FOOT = ("pedestrian", "child", "cyclist", "animal", "deer")
VULNERABLE = ("cyclist", "pedestrian", "child", "motorcycle", "animal", "deer")
_OBJECTS = re.compile("|".join(rf"(?P<{name}>(?<!\w)(?:{words})(?!\w))" for name, words in _WHO.items()))
_SMALL_WORDS = ("a", "sei", "se", "une", "una", "uma", "eine", "einer", "set", *COMMON_WORDS)
"""Numbers in one language, everyday words in another; besides what is one in any of them."""

_COURTESY = (
    r"please|pls|bitte(?: mal)?|s'il (?:te|vous) plait|por favor|per (?:favore|piacere)|(?:als?je|alstu)blieft|"
    r"se faz favor|could you|can you|would you|will you|would you mind|i (?:want|need|would like) you to|"
    r"i'?d like you to|you (?:should|can|could) |hey|hi|ok|okay|oh|ah|um|uh|er|well|so|now|right|listen|look(?! out)|"
    r"hey @?car|@?car|@?driver|computer|yes|yeah|and|but|just|then|"
    r"kannst du|konntest du|konnen sie|kannst du mal|mal|doch|jetzt|also|und|ja|"
    r"peux-tu|pourrais-tu|pouvez-vous|tu peux|tu pourrais|est-ce que tu (?:peux|pourrais)|alors|et|maintenant|"
    r"puedes|podrias|y|ahora|bueno|vale|puoi|potresti|e|allora|ora|adesso|dai|"
    r"podes|pode|poderias|podias|agora|entao|kun je|kan je|zou je|wil je|en|nu|dus|"
    r"tell me|sag mal|sag mir|dis-moi|dime|dimmi|diz-me|zeg|"
    r"honey|darling|dear|love|mate|thanks|thank you|danke|merci|gracias|grazie|obrigad[oa]|bedankt"
)
_AFTER = (
    r"please|pls|bitte|s'il (?:te|vous) plait|por favor|per (?:favore|piacere)|(?:als?je|alstu)blieft|se faz favor|"
    r"will you|would you|can you|could you|ok|okay|now|@?car|driver|honey|darling|dear|love|mate|man|then|"
    r"thanks|thank you|danke|merci|gracias|grazie|obrigad[oa]|bedankt|jetzt|maintenant|ahora|adesso|ora|agora|nu|"
    r"but only|only|and only|aber nur|nur|erst|mais seulement|seulement|pero solo|solo|ma solo|mas so|apenas|maar alleen|alleen|"
    r"ja|nochmal bitte|if you (?:can|could|would|like|please)|wenn du kannst|when you can"
)
_LEADING = re.compile(rf"^(?:(?:{_COURTESY})(?!\w)[ ,]*)+")
_TRAILING = re.compile(rf"(?:[ ,]+(?:{_AFTER}))+$")
_MARKS = re.compile(r"[\"\u201c\u201d\u00ab\u00bb()\[\]\u00bf\u00a1*_]")


class Found(NamedTuple):
    """A match of one row."""

    start: int
    end: int
    said: Mapping[str, str]
    """What the named groups of its expression have matched."""


class Row(NamedTuple):
    """One row of a file."""

    fields: Mapping[str, Any]
    patterns: tuple[re.Pattern[str], ...]

    def search(self, text: str) -> Found | None:
        """The longest of its matches in a text in `searchable` form."""
        whole = self.fields.get("whole", False)
        found = [m for p in self.patterns if (m := p.fullmatch(text) if whole else p.search(text))]
        return _found(max(found, key=lambda match: match.end() - match.start())) if found else None

    def match(self, text: str) -> Found | None:
        """Of the whole text, in the first language in which it does."""
        return next((_found(m) for p in self.patterns if (m := p.fullmatch(text))), None)


def _found(match: re.Match[str]) -> Found:
    said = {name.rsplit("_", 1)[0]: part for name, part in match.groupdict().items() if part}
    return Found(match.start(), match.end(), said)


@cache
def _tables(name: str) -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text("utf-8"))


@cache
def rows(name: str, group: str) -> tuple[Row, ...]:
    """The rows of a group of `name`.toml."""
    data = _tables(name)
    parts = _tables("phrases")["parts"] | data.get("parts", {})
    parts |= {"SIDE": f"(?:{parts['LEFT']}|{parts['RIGHT']})", "WHO": r"(?:@(?P<who>\w+))"}
    return tuple(
        Row(row, tuple(_compiled(row[language], parts) for language in LANGUAGES if language in row))
        for row in data[group]
    )


def _compiled(expression: str, parts: Mapping[str, str]) -> re.Pattern[str]:
    for _ in range(3):  # a part may have parts
        for name, part in parts.items():
            expression = expression.replace(f"<{name}>", part)
    numbered = iter(range(1000))
    return re.compile(re.sub(r"\(\?P<(\w+)>", lambda m: f"(?P<{m[1]}_{next(numbered)}>", expression))


RECENT = 256
"""So many texts are remembered in the form in which they were read: one is looked at from several sides."""


@lru_cache(RECENT)
def searchable(text: str) -> str:
    """Folded, numbers from two up in digits, vehicles and people as "@truck", "@cyclist", ..."""
    plain = _MARKS.sub(" ", prepared(text))
    plain = replaced(plain, lambda word, n: n >= 2 and word not in _SMALL_WORDS)
    plain = _OBJECTS.sub(lambda match: f"@{match.lastgroup}", plain)
    return " ".join(plain.split())


def bare(clause: str) -> str:
    """Without words of courtesy and punctuation around it."""
    plain = clause.strip(" ,.!?;:-\u2026")
    plain = _LEADING.sub("", plain)
    return _TRAILING.sub("", plain).strip(" ,.!?;:-\u2026")


def side_said(said: Mapping[str, str]) -> str | None:
    """ "left" or "right", if one was said."""
    return "left" if "left" in said else "right" if "right" in said else None
