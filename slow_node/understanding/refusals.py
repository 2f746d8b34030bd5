"""What must not rest on any model: commands that ask for harm or for other rules, recognised by their words.

The words are data, in `refusals.toml`. A danger that is denied ("don't hit him") is none. The expressions know the main
words of seven languages; the intent parser's own head stands beside them.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import NamedTuple

from slow_node.understanding.text import fold


class RefusedWords(NamedTuple):
    """One way to ask for what is refused."""

    name: str
    pattern: str
    """Searched in the folded text."""
    matches: str
    """A command that it must match."""
    passes: str
    """One that it must not."""


def _read(path: Path) -> dict[str, tuple[RefusedWords, ...]]:
    """The rows of a file, by group."""
    data = tomllib.loads(path.read_text("utf-8"))

    def pattern(row: dict[str, str]) -> str:
        found = row["pattern"] if "pattern" in row else fold(row["words"])
        for part, expression in data["parts"].items():
            found = found.replace(f"<{part}>", expression)
        return found

    return {
        group: tuple(RefusedWords(row["name"], pattern(row), row["matches"], row["passes"]) for row in rows)
        for group, rows in data["rules"].items()
    }


REFUSALS = _read(Path(__file__).with_name("refusals.toml"))
"""`harm`, which may be denied in the same sentence, and `tampering` with the system's rules, which may not."""
_HARM, _TAMPERING = (re.compile("|".join(r.pattern for r in REFUSALS[group])) for group in ("harm", "tampering"))

_NEGATION = re.compile(
    r"\b(?:do ?n[o']?t|dont|(?<!why )not|never|avoid|no need to|shouldn't|mustn't|must not|should not|without|"
    r"wo ?n'?t|wouldn'?t|"
    r"nicht|kein\w*|niemand\w*|niemals|nie|ne|pas|no|nunca|non|"
    r"mai|nao|niet|nooit|geen|stop|quit)\b[^.,;:!?]{0,25}$"
)
_TOLD = re.compile(r"\b(?:if\b[^.,;]*|(?:we|he|you|they)(?:'ll|'d|'re| are| will| would)|going to|gonna) ?$")
"""Said about what happens, not asked for: "you're over the limit", "if he brakes we crash into him"."""
_PLAYED = re.compile(
    r"\b(?:play|listen to|hear|song|track|album|podcast|audiobook|film|movie|titled|called|spiel|joue|reproduce|"
    r"speel)\b"
    r"(?:(?! (?:and|then|while|und|et|y|e|en) )[^.,;:!?]){0,30}$"
)
"""What follows is what something is called: "play Crash Into Me"."""
_WARNED = re.compile(
    r"(?:watch out|look out|careful|beware|there'?s|vorsicht|achtung|pass auf|da (?:ist|kommt)|attention|il y a|cuidado|ojo|hay|attent[oi]|attenzione|occhio|c'e|atencao|ha|pas op|kijk uit|let op|er komt)"
    r"[ ,:!]*(?:an? |eine? |der |une? |una |um |uma |een |de |la |voiture |macchina |auto |coche |carro |car |conducteur )*$"
)
"""A warning of somebody who does it."""
_DONT_CARE = re.compile(r"\b(?:do ?n[o']?t|dont|no) (?:care|mind|bother|worry|brake|stop|slow)\b[^.,;:!?]{0,25}$")


def unsafe(command: str) -> bool:
    """The command asks for harm, for breaking the law or for other rules, in so many words."""
    text = fold(command)
    if _TAMPERING.search(text):
        return True
    return any(not _denied(text[: match.start()]) for match in _HARM.finditer(text))


def _denied(before: str) -> bool:
    if _TOLD.search(before) or _PLAYED.search(before) or _WARNED.search(before):
        return True
    return bool(_NEGATION.search(before)) and not _DONT_CARE.search(before)
