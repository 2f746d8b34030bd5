"""The intent parser: slots from a sentence by classification, in ten milliseconds and with calibrated probabilities.

Linear heads on the token vectors of MiniLM (adapted by a low-rank delta, mean and maximum pooled) and on a hidden layer
over hashed character and word n-grams, which know spelling and the languages that MiniLM hardly knows. Numbers are
read by rule (`slow_node.understanding.numbers`); a head only says what a number is for.
`python -m slow_node.training.train` trains it.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slow_node.llm.embedding import Embedder, MiniLmEmbedder
from slow_node.understanding.numbers import Quantity, in_digits, quantities
from slow_node.understanding.slots import FAR_OVER_LIMIT, LaneSlot, Slots
from slow_node.understanding.text import fold

HEADS: dict[str, tuple[str, ...]] = {
    "outcome": ("directive", "refused", "out_of_scope", "unclear"),
    "speed": ("none", "faster", "slower", "keep", "stop"),
    "lane": ("none", "left", "right", "leftmost", "rightmost", "keep"),
    "gap": ("none", "closer", "farther", "keep"),
    "overtake": ("none", "true", "false"),
    "cancel": ("false", "true"),
    "number": ("none", "speed", "delta", "limit", "headway"),
    "language": ("en", "de", "fr", "es", "it", "pt", "nl", "other"),
}
"""Every head with its classes, the default first."""
BUCKETS = 1 << 15
NUMBER_SURE, NUMBER_DECIDES = 0.9, 0.1
"""How certain it must be what a number is for, and how likely that anything is wanted, for the number to decide."""
RECENT = 32
"""Texts whose features are kept: of one command several things are asked about the same part, at ten milliseconds each."""
LIKELY = 0.2
"""A directive's wish must be this likely to be acted on where every slot is more likely unasked."""


def grams(text: str) -> NDArray[np.int64]:
    """Buckets of a text's word uni-, bi- and trigrams and character 3- to 5-grams, each once; never empty."""
    words = ["^", *re.findall(r"\d+|[^\W\d_]+|[?!]", re.sub(r"\d", "0", fold(text))), "$"]
    found = {" ".join(words[i : i + n]) for n in (1, 2, 3) for i in range(len(words) - n + 1)}
    for word in words[1:-1]:
        marked = f"<{word}>"
        found |= {"#" + marked[i : i + n] for n in (2, 3, 4, 5) for i in range(len(marked) - n + 1)}
    return np.fromiter(sorted({zlib.crc32(g.encode()) % BUCKETS for g in found}), np.int64)


@dataclass(frozen=True)
class Parsed:
    """What the intent parser makes of a sentence."""

    slots: Slots
    confidence: float
    """Probability that every chosen class is right, were the heads independent."""
    refused: float
    """Probability that the command is unsafe or an attempt on the system's rules."""


class IntentParser:
    """Parses a sentence. `load` gives None where MiniLM or the trained weights are not there."""

    def __init__(self, embedder: MiniLmEmbedder) -> None:
        self._embedder = embedder
        self._w = embedder.delta
        self.features = lru_cache(RECENT)(self._features)
        """What the heads read of a text: the pooled token vectors, and the hidden layer over the n-grams."""
        quantities("two hundred")  # builds the tables of number words, a fifth of a second, before anybody speaks

    @classmethod
    def load(cls, embedder: Embedder) -> IntentParser | None:
        if isinstance(embedder, MiniLmEmbedder) and "dense.weight" in embedder.delta:
            return cls(embedder)
        return None

    def parse(self, command: str, speed_mps: float, limit_mps: float) -> Parsed:
        """Slots, with numbers resolved against the ego's speed and the limit, both in m/s."""
        probabilities = self.probabilities(command)
        chosen = {name: int(np.argmax(p)) for name, p in probabilities.items()}
        value = {name: HEADS[name][index] for name, index in chosen.items()}
        sure = float(probabilities["outcome"][chosen["outcome"]])
        refused = float(probabilities["outcome"][HEADS["outcome"].index("refused")])
        language = value["language"]
        said = quantities(command)
        if value["outcome"] == "unclear" and _decided_by_number(probabilities, value["number"], said):
            value["outcome"], sure = "directive", float(probabilities["outcome"][0])
        if value["outcome"] != "directive":
            return Parsed(Slots.model_validate({"outcome": value["outcome"], "language": language}), sure, refused)
        for name in HEADS:
            if name not in ("outcome", "language"):
                sure *= float(probabilities[name][chosen[name]])
        slots = Slots.model_validate(
            {
                "outcome": "directive",
                "speed": value["speed"],
                "lane": value["lane"],
                "gap": value["gap"],
                "overtake": {"none": None, "true": True, "false": False}[value["overtake"]],
                "cancel": value["cancel"] == "true",
                "language": language,
            }
        )
        slots = on_the_side_said(slots, command)
        slots = with_numbers(slots, value["number"], said, speed_mps, limit_mps)
        if slots.is_empty():
            return self._likeliest(probabilities, language, refused)
        return Parsed(slots, sure, refused)

    @staticmethod
    def _likeliest(probabilities: dict[str, NDArray[np.float32]], language: str, refused: float) -> Parsed:
        """For a directive whose every slot is more likely unasked: its likeliest wish, or that it is unclear."""
        wishes = [
            (float(p[i]), name, HEADS[name][i])
            for name, p in probabilities.items()
            if name in ("speed", "lane", "gap", "overtake", "cancel")
            for i in range(1, len(p))
        ]
        chance, name, value = max(wishes)
        unclear = float(probabilities["outcome"][HEADS["outcome"].index("unclear")])
        if chance < max(unclear, LIKELY):
            return Parsed(Slots(outcome="unclear", language=language), unclear, refused)
        wish = {name: value == "true" if name in ("overtake", "cancel") else value}
        return Parsed(Slots.model_validate({"outcome": "directive", "language": language, **wish}), chance, refused)

    def _features(self, text: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        text = in_digits(text)
        x = self._embedder.tokens(text)
        pooled = np.concatenate([x.mean(axis=0), x.max(axis=0)])
        rows = grams(text)
        hidden = self._w["sparse.weight"][rows].sum(axis=0) / np.sqrt(len(rows)) + self._w["sparse.bias"]
        return pooled, np.maximum(hidden, 0.0)

    def probabilities(self, command: str) -> dict[str, NDArray[np.float32]]:
        """Every head's distribution over its classes."""
        return self.heads(*self.features(command))

    def heads(self, pooled: NDArray[np.float32], hidden: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
        """Every head's distribution, of `features`."""
        logits = self._w["dense.weight"] @ pooled + self._w["dense.bias"]
        logits += self._w["top.weight"] @ hidden
        found, at = {}, 0
        for name, classes in HEADS.items():
            part = np.exp(logits[at : at + len(classes)] - logits[at : at + len(classes)].max())
            found[name] = part / part.sum()
            at += len(classes)
        return found


def _decided_by_number(probabilities: dict[str, NDArray[np.float32]], role: str, said: list[Quantity]) -> bool:
    """Whether what seems unclear names the one number that decides, and it is certain what that is for."""
    kinds = {"speed": ("speed",), "headway": ("time", "length")}.get(role, ())
    return (
        len(said) == 1
        and said[0].kind in kinds
        and float(probabilities["number"].max()) > NUMBER_SURE
        and float(probabilities["outcome"][HEADS["outcome"].index("directive")]) > NUMBER_DECIDES
    )


_OPPOSITE: dict[str, LaneSlot] = {"left": "right", "right": "left", "leftmost": "rightmost", "rightmost": "leftmost"}
_EAST_ASIAN = {
    "left": re.compile("\u5de6|\u3072\u3060\u308a|\uc67c\ucabd"),
    "right": re.compile("\u53f3|\u307f\u304e|\uc624\ub978\ucabd"),
}
_TURNED_ROUND = re.compile(
    "[\u4e0d\u522b\u53e6\u53cd\u4ece\u5225]|\u3058\u3083|\u306a\u3044|\u304b\u3089|"
    "\ub9d0\uace0|\uc544\ub2c8|\ubc18\ub300"
)
"""Not, other, from: words after which the side named may not be the side meant."""


def on_the_side_said(slots: Slots, command: str) -> Slots:
    """The side that a Chinese, Japanese or Korean sentence names, if it names one and denies nothing."""
    said = [side for side, pattern in _EAST_ASIAN.items() if pattern.search(command)]
    opposite = _OPPOSITE.get(slots.lane)
    if len(said) != 1 or opposite is None or slots.lane.startswith(said[0]) or _TURNED_ROUND.search(command):
        return slots
    return slots.model_copy(update={"lane": opposite})


def with_numbers(slots: Slots, role: str, said: list[Quantity], speed_mps: float, limit_mps: float) -> Slots:
    """The slots with the numbers that were said, the last word winning; a metric gap is driven at today's speed.

    `role` is what one number is for. Where one speed and one time gap in seconds are said, both are meant; beside
    metres a number without a unit may be more metres.
    """
    speeds = [q.value for q in said if q.kind == "speed"]
    times = _headways(said, speed_mps)
    target = headway = None
    if role == "limit":
        target = limit_mps
    elif role == "delta":
        delta = speeds[-1] if speeds else next((q.value / 3.6 for q in said if q.kind == "bare"), None)
        if delta is not None and slots.speed in ("faster", "slower"):
            target = max(speed_mps + (delta if slots.speed == "faster" else -delta), 0.0)
    elif role in ("speed", "headway"):
        if speeds and (role == "speed" or (len(speeds) == 1 and all(q.kind != "length" for q in said))):
            target = speeds[-1]
        if times and (role == "headway" or len(times) == 1):
            headway = min(times[-1], 60.0)
    elif (
        role == "none"
        and speeds
        and speeds[-1] > FAR_OVER_LIMIT * limit_mps
        and (slots.speed == "faster" or slots.is_empty())
    ):
        target = speeds[-1]  # what is to be refused, however unsure it is that it was asked for
    if target == 0.0:
        return slots.model_copy(update={"speed": "stop"})
    if target is not None:
        target = min(target, 1000.0)
    return slots.model_copy(update={"target_speed_mps": target, "headway_s": headway})


def _headways(said: list[Quantity], speed_mps: float) -> list[float]:
    """The time gaps that were said, in seconds; "two seconds, make that three": a number without a unit has the last.

    Not the number one, which is a pronoun more often than a number.
    """
    found: list[float] = []
    factor = 0.0
    for quantity in said:
        if quantity.kind in ("time", "length"):
            factor = 1.0 if quantity.kind == "time" else 1.0 / max(speed_mps, 1.0)
            found.append(quantity.value * factor)
        elif quantity.kind == "bare" and factor and quantity.value >= 2.0:
            found.append(quantity.value * factor)
    return found
