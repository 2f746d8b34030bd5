"""Speeds and gaps as a passenger may say them, in digits or words, with or without a unit."""

from __future__ import annotations

import random

from slow_node.training.stock import LIMIT_MPS
from slow_node.understanding.number_words import SPELLING_LANGUAGES, spelled
from slow_node.understanding.numbers import quantities

_SPEED_UNITS: dict[str, tuple[str, ...]] = {
    "en": (
        " km/h",
        " kmh",
        " kph",
        " kilometres per hour",
        " kilometers an hour",
        " k",
        " mph",
        " miles an hour",
        " miles per hour",
        " m/s",
        " meters per second",
        " knots",
        " clicks",
        "km/h",
        "mph",
    ),
    "de": (" km/h", " kmh", " Stundenkilometer", " Sachen", " Kilometer pro Stunde", " Meter pro Sekunde", "km/h"),
    "fr": (" km/h", " kilomètres à l'heure", " kilomètres heure", " à l'heure", " mètres par seconde", "km/h"),
    "es": (" km/h", " kilómetros por hora", " por hora", " metros por segundo", "km/h"),
    "it": (" km/h", " chilometri orari", " all'ora", " chilometri all'ora", " metri al secondo", "km/h"),
    "pt": (" km/h", " quilômetros por hora", " quilómetros por hora", " por hora", " metros por segundo", "km/h"),
    "nl": (" km/u", " km/h", " kilometer per uur", " per uur", " meter per seconde", "km/u"),
    "other": (" km/h", "km/h", " км/ч", "公里", " km"),
}
_TIME_UNITS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "en": ((" seconds", " seconds", " second", " secs", "s", "-second"), (" metres", " meters", " m", "m")),
    "de": ((" Sekunden", " Sekunden", " Sek", "s"), (" Meter", " Metern", " m")),
    "fr": ((" secondes", " s"), (" mètres", " m")),
    "es": ((" segundos", " s"), (" metros", " m")),
    "it": ((" secondi", " s"), (" metri", " m")),
    "pt": ((" segundos", " s"), (" metros", " m")),
    "nl": ((" seconden", " sec"), (" meter", " m")),
    "other": ((" s", " sek", "秒", " sekunder", " секунды"), (" m", "米", " метров", " meter")),
}


class SpokenNumbers:
    """Draws them; the same generator and calls give the same numbers."""

    def __init__(self, r: random.Random) -> None:
        self._r = r

    def _number(self, n: int, language: str, unit: str) -> str:
        if language in SPELLING_LANGUAGES and self._r.random() < 0.35:
            return f"{self._r.choice(spelled(language).get(n, (str(n),)))} {unit.strip()}".rstrip()
        return f"{n}{unit}"

    def speed(self, language: str) -> str:
        """A speed below what is far over the limit."""
        name = language if language in _SPEED_UNITS else "other"
        unit = self._r.choice(_SPEED_UNITS[name])
        one = quantities(f"50{unit}")[0].value / 50  # [m/s]
        low, high = round(8 / one), int(1.48 * LIMIT_MPS / one)
        n = self._r.choice((self._r.randint(low, high), 5 * self._r.randint(low // 5 + 1, high // 5)))
        if self._r.random() < 0.35:
            unit = ""
        return self._number(n, language, unit)

    def delta(self, language: str) -> str:
        """A difference of speeds."""
        name = language if language in _SPEED_UNITS else "other"
        unit = self._r.choice(_SPEED_UNITS[name]) if self._r.random() < 0.7 else ""
        return self._number(self._r.choice((2, 3, 5, 10, 15, 20, 25, 30)), language, unit)

    def headway(self, language: str) -> str:
        """A time gap, or a distance."""
        name = language if language in _TIME_UNITS else "other"
        seconds, metres = _TIME_UNITS[name]
        if self._r.random() < 0.35:
            return self._number(5 * self._r.randint(5, 24), language, self._r.choice(metres))
        if self._r.random() < 0.25:
            return f"{self._r.choice(('1.5', '2.5', '1,5', '2,5', '3.5', '1.2', '1.8'))}{self._r.choice(seconds)}"
        if language == "en" and self._r.random() < 0.15:
            return self._number(self._r.randint(1, 3), language, " and a half seconds")
        return self._number(self._r.randint(1, 6), language, self._r.choice(seconds))
