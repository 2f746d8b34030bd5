"""The phrases written by hand (`phrases/*.txt`), of which training commands are composed.

A phrase file holds sections. `@ slot=value ...` begins phrases with that label (`imp`: bare English imperatives, which
may be negated); `@@ name` begins the language's connecting words, or (`heard`, `chat`) its misspellings. In a phrase,
`(a|b)` is a choice, `[a]` may be left out, and `{v}`, `{d}`, `{h}` stand for a speed, a difference of speeds and a time
gap.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from slow_node.understanding.intent_parser import HEADS

LIMIT_MPS = 33.0
"""Of the scene for which the phrases are labelled."""
PHRASES = Path(__file__).with_name("phrases")
LANGUAGES = ("en", "de", "fr", "es", "it", "pt", "nl")
Label = dict[str, str]
SLOT_NAMES = tuple(name for name in HEADS if name not in ("outcome", "language"))


@dataclass(frozen=True)
class Frame:
    """One hand-written line: what it says, in which language, and its label."""

    text: str
    language: str
    label: tuple[tuple[str, str], ...]
    imperative: bool = False

    @property
    def slots(self) -> Label:
        return dict(self.label)


@dataclass
class Stock:
    """All frames, and each language's connecting words."""

    frames: list[Frame] = field(default_factory=list)
    words: dict[tuple[str, str], list[str]] = field(default_factory=lambda: defaultdict(list))


@dataclass(frozen=True)
class Sample:
    """One training command with the class name of every head."""

    text: str
    language: str
    label: Label


def load_stock(folder: Path = PHRASES) -> Stock:
    """Read the phrase files. Raises ValueError naming the line with an unknown slot or value, or with brackets only."""
    stock = Stock()
    for path in sorted(folder.glob("*.txt")):
        language, words, imperative = path.stem, "", False
        label: tuple[tuple[str, str], ...] = ()
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            if line.startswith("@@ "):
                words = line[3:].strip()
            elif line.startswith("@ "):
                words, fields = "", line[2:].split()
                imperative = "imp" in fields
                label = tuple((k, v) for k, _, v in (f.partition("=") for f in fields if f != "imp"))
                if bad := [k for k, v in label if v not in HEADS.get(k, ())]:
                    raise ValueError(f"{path.name}:{number}: unknown slot or value for {', '.join(bad)}")
                if "outcome" not in dict(label):
                    label = (("outcome", "directive"), *label)
            elif words and line.strip():
                stock.words[language, words].append(line.strip("\n"))
            elif line.strip():
                if not _OPTIONAL.sub("", _OPTIONAL.sub("", line)).strip():  # they nest once
                    raise ValueError(f"{path.name}:{number}: nothing of this phrase need be said")
                stock.frames.append(Frame(line.strip(), language, label, imperative))
    return stock


_OPTIONAL = re.compile(r"\[[^\[\]]*\]")
