"""What of a command is said to the car, and what is talk: to somebody else, or about something else."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from slow_node.understanding.intent_parser import HEADS, IntentParser
from slow_node.understanding.reading.called import called
from slow_node.understanding.reading.lexicon import RECENT, rows, searchable
from slow_node.understanding.reading.signs import sign
from slow_node.understanding.text import fold

HEAD = Path(__file__).parents[2] / "weights" / "talk.safetensors"
"""Trained by `python -m slow_node.training.train_talk`."""

FOR_US, PERHAPS = 0.5, 0.1
"""From this probability on a sentence is for the car; the likeliest of several from this one on, where none is."""
DANGEROUS, REFUSED = 0.85, HEADS["outcome"].index("refused")
MOST_SENTENCES = 12
"""A longer text is read as a whole."""
CLEARLY, STRONG, WEAK, TALK, MANY_WORDS = 0.75, 0.4, 0.3, 0.35, 9
"""How sure it is that a part asks for something, where it does and where it does not; of so many words on a sentence may
hold talk between its commas."""
CANCELS = 0.5
"""Talk is taken for the wish to forget all more often than it is one."""
_COMMAS = re.compile(r"\s*[,:]\s+")

# What is said to somebody else about the car, and what fills a telephone call.
_TO_OTHERS = re.compile(
    r"\b(?:not you|(?:talk|speak)ing to (?:the|my) (?:@?car|driver)|(?:tell(?:ing)?|said (?:that|it) to) the @?car\b(?! to)|(?:was|is|were) (?:for|not for|n.t for) "
    r"(?:the @?car|you)\b|nicht du\b|du nicht\b|(?:rede|spreche|sprach) (?:gerade )?mit dem @?(?:car|auto|wagen)|(?:furs|fur das) @?(?:car|auto)|"
    r"pas toi\b|parl\w+ a la @?(?:car|voiture)|pour la @?(?:car|voiture)|a ti no\b|tu no\b,|habl\w+ con el @?(?:car|coche)|para el @?(?:car|coche)|"
    r"non tu\b|parl\w+ con la @?(?:car|macchina)|per la @?(?:car|macchina)|nao es tu|falar com o @?(?:car|carro)|para o @?(?:car|carro)|"
    r"jij niet|praat\w* (?:tegen|met) de @?(?:car|auto)|voor de @?(?:car|auto))"
)
_BETWEEN = re.compile(
    r"^(?:(?:uh-?huh|mhm+|aha|yes|no|yeah|right|okay|ok|sorry|well|so)[ ,.]+)*(?:(?:just )?(?:one|1|a) (?:moment|second|sec|minute)|"
    r"(?:hold|hang) on(?: (?:a|one|1) (?:moment|second|sec|minute))?|wait|what|pardon|sorry|excuse me|i.m (?:back|here|in the @?car|listening)|"
    r"uh-?huh|hello|bye|see you(?: \w+)*|moment(?: mal)?(?: kurz)?|einen moment|augenblick|bis (?:heute abend|spater|gleich|morgen|dann)|"
    r"(?:eine?|un|une|um|een) (?:instant|seconde|momento|segundo|attimo|ogenblikje|moment|momentje)|"
    r"a (?:ce soir|demain|tout a l.heure|plus tard|dopo|stasera|domani)|hasta (?:la noche|luego|manana)|ate (?:logo|amanha|ja)|"
    r"tot (?:vanavond|straks|morgen|zo))(?: please| bitte)?$"
)
_TO_AN_ADDRESS = re.compile(
    r"\b(?:take|bring|drive|get|drop|deliver)(?: (?:me|us|him|her|them))?(?: off)? (?:to|at|home to) (?:number )?\d+[a-z]?,? "
    r"(?!(?:on|in|along|for|this|the|that|km\w*|mph|kph|miles?|percent|metres?)\b)(?:[\w']+ ){1,3}(?:street|road|avenue|close|crescent|square|court|terrace|"
    r"gardens?|drive|lane|hill|st|rd|ave)\b"
    r"|\b(?:in die|in den|in der|zur|zum|nach|an den|an die) (?:[\w-]+ )?(?!land|bundes|schnell|haupt)\w{2,}-?(?:strasse|str\.?|allee|platz|gasse|weg|ufer) (?:nummer |nr\.? )?\d"
    r"|\b(?:au|a l'adresse) (?:numero )?\d+(?: bis)?,? (?:de la |du )?(?:rue|avenue|boulevard|place|chemin|impasse|quai|allee)\b"
    r"|\b(?:rue|avenue|boulevard|place|impasse) (?:[\w'-]+ ){1,4}(?:numero )\d"
    r"|\b(?:a|hasta) (?:la )?(?:calle|avenida|avda\.?|plaza|paseo) (?:(?!a\b)[\w'-]+ ){1,4},?(?:numero )?\d"
    r"|\b(?:in|a) (?:via|viale|corso|piazza|largo) (?:[\w'-]+,? ){1,3}(?:numero )?\d"
    r"|\b(?:a|na|ate a) (?:rua|avenida|praca|travessa|alameda) (?:(?!a\b)[\w'-]+,? ){1,4}(?:numero )?\d"
    r"|\bnaar (?:de |het )?(?!snel|auto)\w{2,}(?:straat|weg|laan|plein|gracht|kade|dreef|singel) (?:nummer )?\d"
)
"""A street with the number of a house."""
_SMALL_TALK = re.compile(
    r"^(?:and |so |hey |a ti |und |et |e |y )?(?:(?:do|don't|did) you (?:like|love|enjoy|fancy|remember|believe in) |(?:have|did) you (?:ever )?(?:seen?|hear|heard|read|been|eaten|watch\w*) |"
    r"magst du |hast du .{0,40}\b(?:gesehen|gehort|gelesen|gegessen)\b|(?:est-ce que )?(?:tu )?(?:aimes|t'as vu|as vu|as-tu vu|as-tu lu)\b|te gustan? |has (?:visto|oido|leido) |"
    r"ti piac(?:e|ciono) |hai (?:visto|sentito|letto) |gostas d|viste |ja viste |heb je .{0,40}\b(?:gezien|gehoord|gelezen)\b|hou je van |vind je .{0,30}\bleuk\b|"
    r"(?:what a|how|quel(?:le)?|che|que|was fur ein\w*|wat een) (?:\w+ )?(?:lovely|beautiful|nice|gorgeous|beau|belle|joli\w*|magnifique|bel(?:la|lo)?|bonit\w|lind\w|schon\w*|mooi\w*|prachtig\w*)\b)"
)
"""Questions and exclamations of people at leisure."""
_OF_DRIVING = re.compile(
    r"@(?!car)|\b(?:lane|speed|limit|gap|distance|overtak\w+|slow\w*|fast\w*|driv\w+|sign|light|spur|tempo|limit|abstand|uberhol\w*|fahr\w*|voie|vitesse|"
    r"doubl\w*|roul\w*|carril|velocidad\w*|adelant\w*|conduc\w*|corsia|velocita|sorpass\w*|guid\w*|faixa|ultrapass\w*|conduz\w*|strook|baan|"
    r"snelheid|inhal\w*|rij\w*|cartell?o|schild|panneau|senal|sinal|bord|going|braking|coming)\b"
)
"""Words that make them of the drive."""
_CALLED = re.compile(
    r",\s*(?:son|love|pet|dear|darling|mate|lad|pal|sweetheart|honey|will (?:you|ye)|would you|please|bitte|schatz|mon (?:ami|cher)|tesoro|"
    r"cari[\u00f1n]o|hijo|t[i\u00ed]o|amor|schat|joh|p\u00e1|filho)[.!?]*$",
    re.IGNORECASE,
)
"""At the end of a wish, said to the car as to a person."""
_NAME = re.compile(r",\s*[A-Z\u00c0-\u00dd]\w+[.!?]*$")


class Addressed:
    """A head on the intent parser's features. Without its weights every sentence is for the car."""

    def __init__(self, parser: IntentParser, path: Path = HEAD) -> None:
        from safetensors.numpy import load_file

        self._parser = parser
        self._weight: np.ndarray | None = None
        if path.is_file():
            tensors = load_file(path)
            self._weight, self._bias = tensors["weight"], float(tensors["bias"][0])

    def probability(self, sentence: str) -> float:
        """How likely a sentence is for the car. What is likely to be a danger is never talk."""
        if self._weight is None:
            return 1.0
        features = self._parser.features(_CALLED.sub("", sentence))
        if self._parser.heads(*features)["outcome"][REFUSED] >= DANGEROUS:
            return 1.0
        logit = float(np.concatenate(features) @ self._weight) + self._bias
        return float(1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0))))

    def kept(
        self, parts: list[str], known: Callable[[str], bool], certain: Callable[[str], bool] | None = None
    ) -> list[str]:
        """The sentences of several that are for the car, in order; none where all are talk.

        known: whether a sentence is for the car by its words alone.
        certain: whether it is so by itself, not as an answer to what was said before; None: as `known`.
        """
        said = (self._without_tales(part, certain or known) for part in parts if not at_leisure(part))
        parts = [part for part in said if part]
        if self._weight is None or not 2 <= len(parts) <= MOST_SENTENCES:
            return parts
        likely = [0.0 if _talk(part) else 1.0 if known(part) else self.probability(part) for part in parts]
        best = max(likely)
        found = [number for number, p in enumerate(likely) if p >= FOR_US]
        if len(found) > 1:
            asks = [1.0 if (certain or known)(parts[n]) else likely[n] * self._asks(parts[n]) for n in found]
            if max(asks) >= STRONG:
                found = [number for number, sure in zip(found, asks, strict=True) if sure >= WEAK]
        if found:
            return parts[found[0] : found[-1] + 1]  # what is said between two of them belongs to them
        return [] if best < PERHAPS else [parts[likely.index(best)]]

    def called(self, text: str, known: Callable[[str], bool]) -> str | None:
        """What is said to the car by name in the middle of talk; None where that is all, or a danger may stand beside it."""
        if self._weight is None:
            return None
        found = called(text, lambda part: 1.0 if known(part) else self._asks(part))
        if found is None or any(self._parser.parse(part, 25.0, 33.0).refused >= DANGEROUS for part in found[1]):
            return None
        return found[0]

    def _without_tales(self, sentence: str, known: Callable[[str], bool]) -> str:
        """A sentence without what is only told; "" where that is all."""
        if not _tells(sentence) or _SAID_TO_US.search(searchable(sentence)):
            return sentence
        parts = [part for part in _COMMAS.split(sentence) if re.search(r"\w", part) and not _tells(part)]
        asks = [self._asks(part) for part in parts]
        return ", ".join(
            part for part, sure in zip(parts, asks, strict=True) if sure >= CLEARLY or (sure >= STRONG and known(part))
        )

    def narrowed(self, text: str, known: Callable[[str], bool], harmful: bool) -> str:
        """The parts between commas that are for the car, where talk stands around them; else the whole text.

        harmful: the whole may be a danger: then talk must stand before and after them.
        """
        parts = [part for part in _COMMAS.split(text) if re.search(r"\w", part)]
        if self._weight is None or not 2 <= len(parts) <= MOST_SENTENCES or len(text.split()) < MANY_WORDS:
            return text
        likely = [0.0 if _talk(part) else 1.0 if known(part) else self.probability(part) for part in parts]
        asks = [
            0.0 if p < FOR_US or len(part.split()) < 2 else 1.0 if known(part) else p * self._asks(part)
            for part, p in zip(parts, likely, strict=True)
        ]
        found = [number for number, sure in enumerate(asks) if sure >= STRONG]
        talks = any(p < TALK and len(part.split()) > 1 for part, p in zip(parts, likely, strict=True))
        if not found or not talks or (harmful and (found[0] == 0 or found[-1] == len(parts) - 1)):
            return text
        return ", ".join(parts[found[0] : found[-1] + 1])

    def _asks(self, part: str) -> float:
        """How sure it is that a part asks for something, or is a danger."""
        parsed = self._parser.parse(part, 25.0, 33.0)
        if parsed.refused >= DANGEROUS:
            return 1.0
        if parsed.slots.outcome != "directive":
            return 0.0
        return parsed.confidence * (CANCELS if parsed.slots.cancel else 1.0)


def at_leisure(sentence: str) -> bool:
    """Whether a sentence names an address or makes conversation, and says nothing of the drive."""
    if _TO_AN_ADDRESS.search(searchable(sentence)):
        return True
    text = fold(sentence).strip(" ,.!?;:-\u2026\u00bf\u00a1")
    return _SMALL_TALK.search(text) is not None and not _OF_DRIVING.search(searchable(sentence))


@lru_cache(RECENT)
def _tells(sentence: str) -> bool:
    """Whether a sentence tells of another day, a film, a game or others."""
    text = searchable(sentence)
    found = [row for row in rows("tales", "tells") if row.search(text) is not None]
    return any(not row.fields.get("unless_sign") or sign(text) is None for row in found)


_SAID_TO_US = re.compile(
    r"^(?:and |und |et |y |e |en )?(?:drive|go|do|make|keep|take|set|be|slow|fahr|mach|halt|roule|fais|va|conduis|conduce|ve|haz|pon|guida|vai|fai|conduz|faz|rij|doe|maak|ga)\b|\b(?:please|bitte|s'il (?:te|vous) plait|por favor|per favore|per piacere|alsjeblieft|alstublieft|se faz favor|let's|lass uns|(?:we|you) (?:should|must|need to|have to)|i (?:want|need|would like)|"
    r"i'd like|can (?:you|we)|could (?:you|we)|(?:you|are you|do you|did you|why|how come|warum|pourquoi|por ?que|perche|waarom)\b)"
)
"""In a sentence that is for the car, whatever else it tells."""


def _talk(sentence: str) -> bool:
    """Whether a sentence is talk by its words alone."""
    text = fold(_NAME.sub("", sentence)).strip(" ,.!?;:-\u2026\u00bf\u00a1")
    return _TO_OTHERS.search(text) is not None or _BETWEEN.match(text) is not None
