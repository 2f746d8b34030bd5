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

from schemas.runtime.process import ConfigError

Floats = NDArray[np.float64]

CANDIDATES = 12


class Search(Struct):
    """Where the search is: a normal distribution over weights, and how many generations it has behind it. As JSON it is
    what `Described.read` reads."""

    weights: dict[str, float]
    """The mean of each, by its name."""
    widths: dict[str, float]
    """By the same names, in the same order."""
    generation: int = 0
    seed: int = 0

    def drawn(self) -> Floats:
        """(C, D) this generation's candidates in units of the width: pairs of opposites, the same every time."""
        rng = np.random.default_rng((self.seed, self.generation))
        half = rng.standard_normal((CANDIDATES // 2, len(self.weights)))
        return np.concatenate([half, -half])

    def candidates(self) -> list[dict[str, float]]:
        """The weights to try."""
        tried = _listed(self.weights) + _listed(self.widths) * self.drawn()
        return [self._named(one) for one in tried]

    def tell(self, worth: Floats) -> None:
        """Move on, by what each candidate (C,) was worth."""
        drawn, widths = self.drawn(), _listed(self.widths)
        utility = np.empty(len(worth))
        utility[np.argsort(-worth, kind="stable")] = utilities(len(worth))
        dimensions = len(self.weights)
        rate = (3.0 + math.log(dimensions)) / (10.0 * math.sqrt(dimensions))
        self.weights = self._named(_listed(self.weights) + widths * (utility @ drawn))
        self.widths = self._named(widths * np.exp(rate * (utility @ (drawn * drawn - 1.0))))
        self.generation += 1

    def save(self, path: Path, about: dict[str, Any]) -> None:
        """Write it, with what else there is to say, so that it can go on."""
        part = path.with_suffix(".part")
        content = msgspec.json.encode({**msgspec.to_builtins(self), **about})
        part.write_bytes(msgspec.json.format(content, indent=1) + b"\n")
        part.replace(path)

    def resume(self, path: Path) -> Search:
        """The search of a file that `save` has written; this one where there is no file. Raises `ConfigError`."""
        if not path.exists():
            return self
        try:
            search = msgspec.json.decode(path.read_bytes(), type=Search)
            if not list(search.weights) == list(search.widths) == list(self.weights):
                raise ValueError(f"it weighs {', '.join(search.weights)}, not {', '.join(self.weights)}")
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} cannot be gone on with: {error}; name another file") from None
        return search

    def _named(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.weights, values.tolist(), strict=True))


def _listed(named: dict[str, float]) -> Floats:
    return np.array(list(named.values()))


def utilities(count: int) -> Floats:
    """What each rank counts, the best first; they add up to 0 (Wierstra et al. 2014, section 3.1)."""
    raw = np.maximum(0.0, math.log(count / 2 + 1) - np.log(np.arange(1, count + 1)))
    return np.asarray(raw / raw.sum() - 1.0 / count)
