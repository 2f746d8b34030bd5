"""What becomes of a sentence on its way to the car: slips of the finger and of the ear, hesitations, broken audio."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping


class Noise:
    """Damages sentences; the same random state and words give the same damage.

    words: by language and section, of a phrase file: `filler`, and the misspellings `heard` (English) and `chat`.
    """

    def __init__(self, r: random.Random, words: Mapping[tuple[str, str], list[str]]) -> None:
        self._r = r
        self._fillers = {language: lines for (language, section), lines in words.items() if section == "filler"}
        self._heard = _misspellings(words.get(("en", "heard"), []))
        self._chat = {
            language: _misspellings(lines) for (language, section), lines in words.items() if section == "chat"
        }

    def heard(self, text: str, language: str) -> str:
        """A sentence as it arrives: about half of them unharmed, in some spelling of upper and lower case."""
        return self._noisy(self._cased(text), language)

    def _cased(self, text: str) -> str:
        roll = self._r.random()
        if roll < 0.45:
            text = text[:1].upper() + text[1:]
            return text if text[-1] in ".!?" else text + self._r.choice((".", ".", ".", "!", "?", "", ""))
        if roll < 0.48:
            return text.upper()
        if roll < 0.75:
            return text.lower()
        return text

    def _noisy(self, text: str, language: str) -> str:
        """Slips of the finger and of the ear, hesitations, missing accents, chat shorthand, lost vowels and spaces."""
        roll = self._r.random()
        if language == "other":
            return self._slip(text) if roll > 0.85 and text.isascii() else text
        if roll < 0.54:
            return text
        words = text.split(" ")
        if roll < 0.59 and language in self._fillers:
            words.insert(self._r.randrange(len(words) + 1), self._r.choice(self._fillers[language]))
            return " ".join(words)
        if roll < 0.61:  # a stutter
            at = self._r.randrange(len(words))
            return " ".join([*words[: at + 1], *words[at:]])
        if roll < 0.68:
            text = text.translate(_NO_ACCENTS)
            return re.sub(r"[^\w\s']", "", text).lower()
        if language == "en" and roll < 0.76:
            return " ".join(self._r.choice((w, *self._heard.get(w.lower(), (self._as_heard(w),)))) for w in words)
        if roll < 0.84:
            return self._as_texted(words, language)
        if roll < 0.88:
            return self._crackling(words) if self._r.random() < 0.4 else self._stumbling(words, language)
        if roll < 0.92:  # hardly a word as it should be
            return " ".join(
                self._r.choice((w, self._slip(w), self._slip(self._as_heard(w)), self._as_heard(w)))
                if len(w) > 2
                else w
                for w in words
            )
        for _ in range(1 + len(text) // 30):
            text = self._slip(text)
        return text

    def _as_texted(self, words: list[str], language: str) -> str:
        """A message typed in haste: shorthand, lost vowels, letters out of order, words run together."""
        chat = self._chat.get(language, {})
        typed = []
        for word in words:
            roll, bare = self._r.random(), word.lower().strip(".,!?")
            if bare in chat and roll < 0.7:
                typed.append(self._r.choice(chat[bare]))
            elif bare.isalpha() and len(bare) > 3 and roll < 0.22:
                typed.append(bare[0] + re.sub(r"[aeiou](?=\w)", "", bare[1:]))
            elif bare.isalpha() and len(bare) > 3 and roll < 0.5:
                at = self._r.randrange(1, len(bare) - 1)
                typed.append(bare[:at] + bare[at + 1] + bare[at] + bare[at + 2 :])
            else:
                typed.append(word)
        text = typed[0]
        glue = self._r.random() < 0.4
        for word in typed[1:]:
            text += (
                word
                if glue and self._r.random() < 0.4 and not (text[-1].isdigit() or word[:1].isdigit())
                else f" {word}"
            )
        return text

    def _stumbling(self, words: list[str], language: str) -> str:
        """Hesitating at nearly every word."""
        fillers = self._fillers.get(language, ["..."])
        said = [word for w in words for word in ((self._r.choice(fillers), w) if self._r.random() < 0.4 else (w,))]
        return self._r.choice((" ", " ", "... ")).join(said)

    def _crackling(self, words: list[str]) -> str:
        """As over a bad line: noise between words, and one broken in two."""
        noise = self._r.choice(
            (
                ("[crackle]", "[hiss]"),
                ("*static*", "*static*"),
                ("krrk", "kshh"),
                ("(noise)", "..."),
                ("bzzt", "bzzt"),
                ("...", "..."),
            )
        )
        at = self._r.randrange(len(words))
        word = words[at]
        if len(word) > 4 and word.isalpha():
            cut = self._r.randrange(2, len(word) - 1)
            words = [*words[:at], f"{word[:cut]}...", self._r.choice(noise), f"...{word[cut:]}", *words[at + 1 :]]
        for _ in range(self._r.randint(1, 2)):
            words.insert(self._r.randrange(len(words) + 1), self._r.choice(noise))
        return " ".join(words)

    def _as_heard(self, word: str) -> str:
        """A word written as it sounds."""
        for letters, sound in self._r.sample(_SOUNDS, len(_SOUNDS)):
            if letters in word:
                return word.replace(letters, sound, 1)
        return word

    def _slip(self, text: str) -> str:
        places = [i for i, c in enumerate(text[:-1]) if c.isalpha() and text[i + 1].isalpha()]
        if not places:
            return text
        at, kind = self._r.choice(places), self._r.randrange(4)
        if kind == 0:
            return text[:at] + text[at + 1] + text[at] + text[at + 2 :]
        if kind == 1:
            return text[:at] + text[at + 1 :]
        if kind == 2:
            return text[: at + 1] + text[at:]
        near = _KEYS.get(text[at].lower(), "e")
        return text[:at] + self._r.choice(near) + text[at + 1 :]


def _misspellings(lines: list[str]) -> dict[str, list[str]]:
    """From lines "word: spelling, spelling"."""
    return {word: spellings.split(", ") for word, _, spellings in (line.partition(": ") for line in lines)}


_NO_ACCENTS = str.maketrans("àáâãäåçèéêëìíîïñòóôõöùúûü", "aaaaaaceeeeiiiinooooouuuu")
_KEYS = {
    c: (row[max(i - 1, 0)] + row[min(i + 1, len(row) - 1)]).replace(c, "") or "e"
    for row in ("qwertyuiop", "asdfghjkl", "zxcvbnm")
    for i, c in enumerate(row)
}
_SOUNDS = (
    ("ck", "k"),
    ("ce", "se"),
    ("ee", "ea"),
    ("ea", "ee"),
    ("ss", "s"),
    ("ll", "l"),
    ("ght", "te"),
    ("ph", "f"),
    ("er", "a"),
    ("ing", "in"),
    ("th", "d"),
    ("wh", "w"),
    ("cc", "k"),
    ("oo", "u"),
    ("ai", "ay"),
    ("ke", "k"),
    ("ed", "t"),
    ("ou", "ow"),
    ("tt", "t"),
    ("le", "el"),
    ("s", "z"),
    ("c", "k"),
    ("e", ""),
)
