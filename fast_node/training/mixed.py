"""Scenes of several tasks as one, for one policy. Axis: S scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fast_node.training.rollout import Bools, Floats, Ints, Scenes
from schemas.driving.features import Array


class Mixed:
    """Several `Scenes`, one after the other along the first axis: one policy for all of them."""

    def __init__(self, parts: list[Scenes]) -> None:
        self.parts = parts
        self._cuts = np.cumsum([len(p.wish) for p in parts])[:-1]

    def _split(self, a: NDArray[Any]) -> list[NDArray[Any]]:
        return list(np.split(a, self._cuts))

    def observe(self) -> tuple[Array, Bools]:
        """Policy input (S, N, F) and the open actions (S, 5)."""
        return (np.concatenate([p.observe() for p in self.parts]), np.concatenate([p.open() for p in self.parts]))

    def decide(self, action: Ints) -> tuple[NDArray[np.float32], Bools, Bools]:
        """See `Scenes.decide`."""
        results = [p.decide(a) for p, a in zip(self.parts, self._split(action), strict=True)]
        earned, terminated, truncated = (np.concatenate(column) for column in zip(*results, strict=True))
        return earned, terminated, truncated

    def reset(self, which: Bools) -> None:
        """See `Scenes.reset`."""
        for part, some in zip(self.parts, self._split(which), strict=True):
            if some.any():
                part.reset(some)

    @property
    def returns(self) -> Floats:
        """(S,) rewards of the running episodes so far."""
        return np.concatenate([p.returns for p in self.parts])

    @property
    def age(self) -> Ints:
        """(S,) decisions of the running episodes so far."""
        return np.concatenate([p.age for p in self.parts])
