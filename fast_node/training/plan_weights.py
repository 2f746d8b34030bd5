"""Learning how plans are weighed, from nothing but what whole episodes are worth: separable natural evolution
strategies (Wierstra et al. 2014, section 4). No gradient passes through the simulator, the mask or the choice.

Axes: C candidates, D weights.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from fast_node.policies.gaps import BY_HAND, DESCRIBED
from schemas.runtime.process import ConfigError

Floats = NDArray[np.float64]

CANDIDATES = 12
START = {name: value / 10.0 for name, value in BY_HAND.items()} | {"never": 6.0}
"""Costs only matter beside each other: those by hand, a tenth as large; what never opens costs more than all that
does."""
WIDTH = 0.2


class Search(Struct):
    """Where the search is: a normal distribution over weights, and how many generations it has behind it."""

    mean: list[float]
    width: list[float]
    generation: int = 0
    seed: int = 0

    @staticmethod
    def begin(seed: int) -> Search:
        """At the weights by hand."""
        mean = [START[name] for name in DESCRIBED]
        return Search(mean, [max(WIDTH, 0.1 * abs(value)) for value in mean], 0, seed)

    def drawn(self) -> Floats:
        """(C, D) this generation's candidates in units of the width: pairs of opposites, the same every time."""
        rng = np.random.default_rng((self.seed, self.generation))
        half = rng.standard_normal((CANDIDATES // 2, len(self.mean)))
        return np.concatenate([half, -half])

    def candidates(self) -> Floats:
        """(C, D) weights to try."""
        return np.array(self.mean) + np.array(self.width) * self.drawn()

    def tell(self, worth: Floats) -> None:
        """Move on, by what each candidate (C,) was worth."""
        drawn, width = self.drawn(), np.array(self.width)
        utility = np.empty(len(worth))
        utility[np.argsort(-worth, kind="stable")] = utilities(len(worth))
        dimensions = len(self.mean)
        rate = (3.0 + math.log(dimensions)) / (10.0 * math.sqrt(dimensions))
        self.mean = (np.array(self.mean) + width * (utility @ drawn)).tolist()
        self.width = (width * np.exp(rate * (utility @ (drawn * drawn - 1.0)))).tolist()
        self.generation += 1

    def save(self, path: Path, about: dict[str, Any]) -> None:
        """Write the weights where `gaps.read_weights` reads them, with the search itself, so that it can go on."""
        weights = {name: round(value, 4) for name, value in zip(DESCRIBED, self.mean, strict=True)}
        content = msgspec.json.encode({"weights": weights, **about, "search": self})
        part = path.with_suffix(".part")
        part.write_bytes(msgspec.json.format(content, indent=1) + b"\n")
        part.replace(path)

    @staticmethod
    def resume(path: Path, seed: int) -> Search:
        """The search of a file that `save` has written; a new one where there is no file. Raises `ConfigError`."""

        class File(Struct):
            search: Search

        if not path.exists():
            return Search.begin(seed)
        try:
            return msgspec.json.decode(path.read_bytes(), type=File).search
        except (OSError, msgspec.MsgspecError) as error:
            raise ConfigError(f"{path} cannot be gone on with: {error}; name another file") from None


def utilities(count: int) -> Floats:
    """What each rank counts, the best first; they add up to 0 (Wierstra et al. 2014, section 3.1)."""
    raw = np.maximum(0.0, math.log(count / 2 + 1) - np.log(np.arange(1, count + 1)))
    return np.asarray(raw / raw.sum() - 1.0 / count)
