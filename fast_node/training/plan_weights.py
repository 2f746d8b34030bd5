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
    """Where the search is: a normal distribution over weights, and how many generations it has behind it. As JSON it is
    what `gaps.read_weights` reads."""

    weights: dict[str, float]
    """The mean of each, by its name in `DESCRIBED`."""
    widths: dict[str, float]
    generation: int = 0
    seed: int = 0

    @staticmethod
    def begin(seed: int) -> Search:
        """At the weights by hand."""
        return Search(dict(START), {name: max(WIDTH, 0.1 * abs(value)) for name, value in START.items()}, 0, seed)

    def drawn(self) -> Floats:
        """(C, D) this generation's candidates in units of the width: pairs of opposites, the same every time."""
        rng = np.random.default_rng((self.seed, self.generation))
        half = rng.standard_normal((CANDIDATES // 2, len(DESCRIBED)))
        return np.concatenate([half, -half])

    def candidates(self) -> list[dict[str, float]]:
        """The weights to try."""
        tried = _listed(self.weights) + _listed(self.widths) * self.drawn()
        return [_named(one) for one in tried]

    def tell(self, worth: Floats) -> None:
        """Move on, by what each candidate (C,) was worth."""
        drawn, widths = self.drawn(), _listed(self.widths)
        utility = np.empty(len(worth))
        utility[np.argsort(-worth, kind="stable")] = utilities(len(worth))
        dimensions = len(DESCRIBED)
        rate = (3.0 + math.log(dimensions)) / (10.0 * math.sqrt(dimensions))
        self.weights = _named(_listed(self.weights) + widths * (utility @ drawn))
        self.widths = _named(widths * np.exp(rate * (utility @ (drawn * drawn - 1.0))))
        self.generation += 1

    def save(self, path: Path, about: dict[str, Any]) -> None:
        """Write it, with what else there is to say, so that it can go on."""
        part = path.with_suffix(".part")
        content = msgspec.json.encode({**msgspec.to_builtins(self), **about})
        part.write_bytes(msgspec.json.format(content, indent=1) + b"\n")
        part.replace(path)

    @staticmethod
    def resume(path: Path, seed: int) -> Search:
        """The search of a file that `save` has written; a new one where there is no file. Raises `ConfigError`."""
        if not path.exists():
            return Search.begin(seed)
        try:
            search = msgspec.json.decode(path.read_bytes(), type=Search)
            if not set(search.weights) == set(search.widths) == set(DESCRIBED):
                raise ValueError(f"it weighs {', '.join(search.weights)}, not {', '.join(DESCRIBED)}")
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} cannot be gone on with: {error}; name another file") from None
        return search


def _listed(named: dict[str, float]) -> Floats:
    return np.array([named[name] for name in DESCRIBED])


def _named(values: Floats) -> dict[str, float]:
    return dict(zip(DESCRIBED, values.tolist(), strict=True))


def utilities(count: int) -> Floats:
    """What each rank counts, the best first; they add up to 0 (Wierstra et al. 2014, section 3.1)."""
    raw = np.maximum(0.0, math.log(count / 2 + 1) - np.log(np.arange(1, count + 1)))
    return np.asarray(raw / raw.sum() - 1.0 / count)
