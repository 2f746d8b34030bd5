"""Policies that do not look: one order of preference, or chance. They show what the mask alone is worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.driving.features import Array
from schemas.runtime.process import ConfigError
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

WORDS = {
    "cruise": MetaAction.CRUISE,
    "slower": MetaAction.SLOW_DOWN,
    "faster": MetaAction.SPEED_UP,
    "left": MetaAction.LEFT,
    "right": MetaAction.RIGHT,
}
"""The five meta-actions, the mildest first: the order of those that are not named."""


class ConstantPolicy:
    """Prefers the actions in one order, always; those that are not named follow in the order of `WORDS`."""

    def __init__(self, *first: MetaAction) -> None:
        order = [*first, *(action for action in WORDS.values() if action not in first)]
        self._row = np.zeros(POLICY_ACTIONS, np.float32)
        self._row[order] = np.arange(POLICY_ACTIONS, 0, -1)

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        return np.broadcast_to(self._row, (*x.shape[:-2], POLICY_ACTIONS))


class RandomPolicy:
    """Draws its preferences. The same seed gives the same actions."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        return self._rng.random((*x.shape[:-2], POLICY_ACTIONS), np.float32)


def constant_of(words: str) -> ConstantPolicy:
    """The policy of "faster" or "faster,left". Raises `ConfigError` for an unknown, repeated or missing action."""
    named: Sequence[str] = [word.strip() for word in words.split(",")]
    if not set(named) <= WORDS.keys() or len(set(named)) < len(named):
        raise ConfigError(f"constant:{words}: name one or more different actions of {', '.join(WORDS)}")
    return ConstantPolicy(*(WORDS[word] for word in named))


def random_of(seed: str) -> RandomPolicy:
    """The policy of the seed "0" or "7"; "" is 0. Raises `ConfigError` for what is not a whole number from 0."""
    if seed and not (seed.isascii() and seed.isdecimal() and len(seed) < 20):
        raise ConfigError(f"random:{seed}: give a whole number from 0 as the seed, as in random:0")
    return RandomPolicy(int(seed or 0))
