"""Labelled commands wrapped in unrelated talk: the label stays, for nothing else is asked for.

The talk (`chatter.toml`) is cut in two halves. Rules and weights may be made with the first; figures are those of the
second.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

Half = Literal["develop", "measure"]
Way = Literal["before", "after", "around", "call"]
WAYS: Final[tuple[Way, ...]] = ("before", "after", "around", "call")


@cache
def talk(half: Half) -> dict[str, dict[str, tuple[str, ...]]]:
    """The sentences and calls of one half, by language."""
    data = tomllib.loads(Path(__file__).with_name("chatter.toml").read_text("utf-8"))
    cut = slice(None, None)
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    for language, lists in data.items():
        found[language] = {}
        for name, lines in lists.items():
            middle = len(lines) // 2
            cut = slice(middle) if half == "develop" else slice(middle, None)
            found[language][name] = tuple(lines[cut])
    return found


def wrapped(
    rows: Sequence[Mapping[str, Any]], half: Half, way: Way, language_of: Callable[[str], str]
) -> list[dict[str, Any]]:
    """The rows of a labelled set with talk in their language before, after or around the command, or in a call.

    Deterministic: the same talk goes with the same command. A language without talk of its own has the English.
    """
    known = talk(half)
    found = []
    for number, row in enumerate(rows):
        command = row["text"].strip()
        said = known.get(language_of(command), known["en"])
        sentences, calls = said["sentences"], said["calls"]
        first, second = sentences[(5 * number) % len(sentences)], sentences[(5 * number + 2) % len(sentences)]
        ended = command if command[-1] in ".!?…" else command + "."
        text = {
            "before": f"{first} {command}",
            "after": f"{ended} {first}",
            "around": f"{first} {ended} {second}",
            "call": calls[number % len(calls)].replace("{}", ended),
        }[way]
        found.append({**row, "text": text})
    return found
