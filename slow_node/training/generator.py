"""Compose training commands of the stock's phrases: dressed, compound, corrected, denied, contradicted, misheard."""

from __future__ import annotations

import random
import re
from collections import defaultdict

from slow_node.training.noise import Noise
from slow_node.training.spoken_numbers import SpokenNumbers
from slow_node.training.stock import LANGUAGES, SLOT_NAMES, Frame, Label, Sample, Stock
from slow_node.understanding.intent_parser import HEADS

_CHOICE = re.compile(r"\(([^()\[\]]*\|[^()\[\]]*)\)|\[([^()\[\]]*)\]")
_TAILGATING = re.compile(
    r"tailgat|bumper|backside|behind him|gap|metre|half a second|bother|limit|allowed|legal|"
    r"no matter"
    r"|even |whatever|don't|without|never|\bsit|intimid|over |0\."
)


class Generator:
    """Samples commands; the same seed and frames give the same commands."""

    def __init__(self, stock: Stock, seed: int) -> None:
        self._r = random.Random(seed)
        self._stock = stock
        self._by: dict[tuple[str, str], list[Frame]] = defaultdict(list)
        self._like: dict[tuple[str, frozenset[str]], list[Frame]] = defaultdict(list)
        self._plain: dict[str, list[Frame]] = defaultdict(list)
        for frame in stock.frames:
            slots = frame.slots
            self._by[frame.language, self._group(frame)].append(frame)
            if slots["outcome"] == "directive":
                self._like[frame.language, frozenset(slots)].append(frame)
                if (
                    not {"cancel", "number"} & set(slots)
                    and "keep" not in slots.values()
                    and len(frame.text) < 45
                    and slots.get("overtake") != "false"
                    and (frame.imperative or frame.language != "en")
                ):
                    self._plain[frame.language].append(frame)
        self._imperatives = [f for f in stock.frames if f.imperative]
        self._noise = Noise(self._r, stock.words)
        self._numbers = SpokenNumbers(self._r)
        self._opposed: dict[tuple[str, str], list[Frame]] = defaultdict(list)
        for frame in stock.frames:
            slots = {k: v for k, v in frame.label if k != "outcome"}
            if frame.slots["outcome"] == "directive" and len(slots) == 1 and "cancel" not in slots:
                self._opposed[frame.language, next(iter(slots))].append(frame)
        self._groups: dict[tuple[str, bool], tuple[list[list[Frame]], list[float]]] = {}

    @staticmethod
    def _group(frame: Frame) -> str:
        return " ".join(f"{k}={v}" for k, v in frame.label)

    def samples(self, size: int) -> list[Sample]:
        """Every frame once as it stands, then compositions up to `size`; no text twice."""
        seen: dict[str, Sample] = {}

        def add(sample: Sample | None) -> None:
            if sample is not None and 0 < len(sample.text) <= 250:
                seen.setdefault(sample.text.casefold(), sample)

        for frame in self._stock.frames:
            add(self._finish(self._say(frame), frame, polish=self._r.random() < 0.7))
        for _ in range(20 * size):
            if len(seen) >= size:
                break
            add(self._composed())
        return list(seen.values())

    def plain(self, frame: Frame) -> str:
        """One wording of a frame."""
        return self._say(frame)

    def _composed(self) -> Sample | None:
        kinds = {
            self._dressed: 40,
            self._compound: 24,
            self._correction: 8,
            self._taken_back: 4,
            self._replaced: 4,
            self._not_but: 3,
            self._negated: 8,
            self._mixed: 9,
            self._contradicted: 7,
            self._undecided: 2,
            self._salad: 3,
            self._mumbled: 2,
            self._gibberish: 2,
        }
        try:
            return self._r.choices(list(kinds), list(kinds.values()))[0]()
        except (IndexError, ValueError):  # a small stock, as the held-out one, lacks what this kind is made of
            return None

    def _language(self) -> str:
        return self._r.choices((*LANGUAGES, "other"), (46, 8, 8, 8, 7, 7, 7, 14))[0]

    def _frame(self, language: str, *, wish: bool = False) -> Frame:
        """A frame of any group, groups weighted by the root of their size; `wish`: a directive, and no cancelling."""
        if (language, wish) not in self._groups:
            groups = [
                (key[1], frames)
                for key, frames in self._by.items()
                if key[0] == language and (not wish or ("outcome=directive" in key[1] and "cancel" not in key[1]))
            ]
            weights = [len(g[1]) ** 0.5 * (1.0 if "outcome=directive" in g[0] else 3.0) for g in groups]
            self._groups[language, wish] = [g[1] for g in groups], weights
        return self._r.choice(self._r.choices(*self._groups[language, wish])[0])

    def _of(self, language: str, group: str) -> Frame:
        return self._r.choice(self._by[language, group])

    def _say(self, frame: Frame) -> str:
        text = frame.text
        while match := _CHOICE.search(text):
            if match[1] is not None:
                choice = self._r.choice(match[1].split("|"))
            else:
                choice = self._r.choice(match[2].split("|")) if self._r.random() < 0.5 else ""
            text = text[: match.start()] + choice + text[match.end() :]
        for mark, number in (
            ("{v}", self._numbers.speed),
            ("{d}", self._numbers.delta),
            ("{h}", self._numbers.headway),
        ):
            if mark in text:
                text = text.replace(mark, number(frame.language))
        return re.sub(r"\s+", " ", text).strip()

    def _dressed(self) -> Sample | None:
        """One phrase with a polite or rude beginning or end."""
        language = self._language()
        frame = self._frame(language)
        text = self._say(frame)
        if frame.slots["outcome"] != "unclear" or self._r.random() < 0.3:
            text = self._dress(text, language, short=len(text) < 60)
        return self._finish(text, frame)

    def _dress(self, text: str, language: str, *, short: bool) -> str:
        prefixes, suffixes = self._stock.words[language, "prefix"], self._stock.words[language, "suffix"]
        if prefixes and self._r.random() < (0.55 if short else 0.2):
            text = f"{self._r.choice(prefixes)} {text}"
        if suffixes and self._r.random() < 0.4:
            suffix = self._r.choice(suffixes)
            text = f"{text}{'' if suffix[0] in ',.!?' else ' '}{suffix}"
        return text

    def _compound(self) -> Sample | None:
        language = self._language()
        parts = [self._frame(language, wish=True) for _ in range(3 if self._r.random() < 0.15 else 2)]
        label: Label = {}
        for frame in parts:
            for slot, value in frame.slots.items():
                if slot != "outcome" and slot in label:
                    return None
                label[slot] = value
        if label.get("speed") == "stop" and len(label) > 3 - ("lane" in label):
            return None
        if (
            label.get("number")
            and {"speed", "gap"} & set(label)
            and not any("number" in f.slots and len(f.slots) > 2 for f in parts)
            and label["number"] != "headway"
        ):
            return None
        joints = self._stock.words[language, "and"] or [",", ".", " +"]
        text = self._say(parts[0])
        for frame in parts[1:]:
            text = f"{text.rstrip('.!?')}{self._r.choice(joints)} {self._say(frame)}"
        return self._finish(self._dress(text, language, short=False), parts[0], label)

    def _correction(self) -> Sample | None:
        """The last word wins: what was said before counts for nothing."""
        language = self._r.choice(("en", "en", "en", *LANGUAGES))
        first, last = self._frame(language, wish=True), self._frame(language, wish=True)
        if self._r.random() < 0.5:  # most corrections are of the same slot
            first = self._r.choice(self._like[language, frozenset(last.slots)])
        if first.label == last.label:
            return None
        joint = self._r.choice(self._stock.words[language, "correction"])
        text = f"{self._say(first).rstrip('.!?')}{joint} {self._say(last)}"
        if language == "en" and self._r.random() < 0.1:
            text = f"{text.rstrip('.!?')} instead"
        return self._finish(self._dress(text, language, short=False) if self._r.random() < 0.4 else text, last)

    def _taken_back(self) -> Sample | None:
        language = self._r.choice(("en", "en", "en", *LANGUAGES))
        frame = self._frame(language, wish=True)
        text = f"{self._say(frame).rstrip('.!?')}{self._r.choice(self._stock.words[language, 'takeback'])}"
        return self._finish(text, frame, {"outcome": "directive", "cancel": "true"})

    def _replaced(self) -> Sample | None:
        language = self._r.choice(("en", "en", "en", *LANGUAGES))
        frame = self._frame(language, wish=True)
        return self._finish(f"{self._r.choice(self._stock.words[language, 'replace'])} {self._say(frame)}", frame)

    def _not_but(self) -> Sample | None:
        language = self._r.choice(("en", "en", "en", *LANGUAGES))
        first, last = self._r.sample(self._plain[language], 2)
        if first.label == last.label:
            return None
        text = self._r.choice(self._stock.words[language, "notbut"])
        return self._finish(text.replace("{x}", self._say(first)).replace("{y}", self._say(last)), last)

    def _negated(self) -> Sample | None:
        """English imperatives, denied: no change, or none further. A danger that is denied asks for nothing."""
        frame = self._r.choice(self._imperatives)
        if frame.slots["outcome"] == "out_of_scope" or "keep" in frame.slots.values():
            return None
        text = self._say(frame)
        if frame.slots["outcome"] == "refused":
            if _TAILGATING.search(text):
                return None
            label: Label = {"outcome": "out_of_scope"}
        elif "overtake" in frame.slots:
            if frame.slots["overtake"] == "false":
                return None
            label = {"outcome": "directive", "overtake": "false"}
        else:
            slot = next(s for s in ("speed", "lane", "gap") if s in frame.slots)
            careful = frame.slots.get("speed") == "faster" and re.search("rush|hurry|floor|crazy|push", text)
            label = {"outcome": "directive", slot: "slower" if careful else "keep"}
        text = self._r.choice(self._stock.words["en", "negate"]).replace("{x}", text)
        return self._finish(self._dress(text, "en", short=False) if self._r.random() < 0.4 else text, frame, label)

    def _mixed(self) -> Sample | None:
        """A wish beside what is out of scope: the wish; beside what is refused: refused."""
        language = self._language()
        wish = self._frame(language, wish=True)
        other = self._of(language, f"outcome={'refused' if self._r.random() < 0.5 else 'out_of_scope'}")
        joints = self._stock.words[language, "and"] or [",", "."]
        if (
            other.language == "en"
            and re.match("turn|go|take|navigate|drive|never|don't|do not|no |stop|slow", other.text)
            and other.slots["outcome"] == "out_of_scope"
        ):
            return None
        parts = [self._say(wish).rstrip(".!?"), self._say(other).rstrip(".!?")]
        self._r.shuffle(parts)
        label = other.slots if other.slots["outcome"] == "refused" else wish.slots
        return self._finish(f"{parts[0]}{self._r.choice(joints)} {parts[1]}", wish, label)

    def _contradicted(self) -> Sample | None:
        """Two values of one slot that cannot be had together, asked for together: nobody can tell which."""
        language = self._r.choice(("en", "en", "en", *LANGUAGES))
        slot = self._r.choice(("speed", "speed", "lane", "gap", "overtake", "number"))
        joints, frames = "clash", self._opposed[language, slot]
        if language == "en" and self._r.random() < 0.35:
            joints = "while"
            frames = [f for f in frames if f.imperative]
        first, last = self._r.sample(frames, 2)
        if joints == "while" and first.label == last.label and first.slots.get("speed") != "slower":
            joints = "without"
        elif not _clash(first.slots[slot], last.slots[slot]):
            return None
        x, y = self._say(first).rstrip(".!?"), self._say(last).rstrip(".!?")
        if joints != "clash":
            verb, _, rest = y.partition(" ")
            y = f"{_gerund(verb)} {rest}".strip()
        text = self._r.choice(self._stock.words[language, joints])
        if joints == "clash" and slot in ("speed", "gap", "overtake") and language == "en" and self._r.random() < 0.2:
            text = "{x} and {y}"
        return self._finish(text.replace("{x}", x).replace("{y}", y), first, {"outcome": "unclear"})

    def _mumbled(self) -> Sample | None:
        """A wish whose number was not to be heard."""
        frame = self._r.choice(self._stock.words["en", "mumbled"])
        sound = self._r.choice(self._stock.words["en", "mumble"])
        return self._finish(frame.replace("{m}", sound), self._of("en", "outcome=unclear"))

    def _gibberish(self) -> Sample | None:
        """What sounds like a wish, of words that there are not."""
        text = self._r.choice(self._stock.words["en", "gibberish"])
        text = re.sub(r"\{g\}", lambda _: "".join(self._r.choice(part) for part in _SYLLABLES), text)
        return self._finish(text, self._of("en", "outcome=unclear"))

    def _undecided(self) -> Sample | None:
        """Two different values of one slot, and no decision between them."""
        first, last = self._frame("en", wish=True), self._frame("en", wish=True)
        if set(first.slots) != set(last.slots) or first.label == last.label:
            return None
        ask = self._r.choice(
            (
                "{x} or {y}, who knows",
                "either {x} or {y}",
                "{x} or {y}, I don't care",
                "maybe {x}, maybe {y}",
                "{x} and {y} at the same time",
                "{x} or {y} or whatever",
                "{x}? {y}? I can't decide",
            )
        )
        text = ask.replace("{x}", self._say(first)).replace("{y}", self._say(last))
        return self._finish(text, first, {"outcome": "unclear"})

    def _salad(self) -> Sample | None:
        """Words about driving in no order."""
        words = [w for _ in range(3) for w in self._say(self._frame("en")).split()]
        words = self._r.sample(words, min(len(words), self._r.randint(3, 6)))
        for _ in range(self._r.randint(0, 2)):
            words.insert(self._r.randrange(len(words) + 1), "".join(self._r.choices("bdfgkrtzmxsho", k=5)))
        return self._finish(" ".join(words), self._of("en", "outcome=unclear"))

    def _finish(self, text: str, frame: Frame, label: Label | None = None, *, polish: bool = False) -> Sample:
        label = dict(frame.slots if label is None else label)
        label["language"] = frame.language
        full = {name: label.get(name, HEADS[name][0]) for name in HEADS}
        if full["outcome"] != "directive":
            full |= {name: HEADS[name][0] for name in SLOT_NAMES}
        return Sample(text if polish else self._noise.heard(text, frame.language), frame.language, full)


def _clash(one: str, other: str) -> bool:
    """Whether no car can do both. Of two numbers, words have to say so, and those of `clash` do."""
    if one == other:
        return one in ("speed", "headway")  # kinds of numbers: two of them
    return not {"delta", "limit"} & {one, other} and {one, other} not in (
        {"slower", "stop"},
        {"left", "leftmost"},
        {"right", "rightmost"},
        {"speed", "headway"},
    )


def _gerund(verb: str) -> str:
    """ "pass" to "passing", "close" to "closing", "stop" to "stopping"."""
    if verb.endswith("e") and not verb.endswith(("ee", "oe", "be")):
        return f"{verb[:-1]}ing"
    if re.fullmatch(r"(?:\w*[^aeiou])?[aeiou][bdgmnpt]", verb) and not re.fullmatch(r"open|\w+en", verb):
        return f"{verb}{verb[-1]}ing"
    return f"{verb}ing"


_SYLLABLES = (
    ("b", "d", "fl", "g", "gr", "kl", "m", "pl", "sn", "squ", "thr", "w", "z"),
    ("a", "i", "o", "oo", "u"),
    ("b", "dd", "ff", "mb", "nk", "pp", "rg", "zz"),
    ("le", "et", "ity", "o", "", "er", "ing"),
)
