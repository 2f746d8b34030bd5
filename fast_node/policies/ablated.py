"""A driver with something taken away: what it sees, what it is told, what its network has learnt. For comparison."""

from __future__ import annotations

import numpy as np

from fast_node.policies.attention import SHIPPED, AttentionPolicy
from fast_node.policies.checkpoint import read_checkpoint
from fast_node.policies.mlp import WISH
from fast_node.policies.policy import Policy
from schemas.driving.features import Array
from schemas.runtime.process import ConfigError


class BlindPolicy:
    """A driver that sees the ego alone."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        alone = np.zeros_like(x)
        alone[..., 0, :] = x[..., 0, :]
        return self._policy.logits(alone)


class DeafPolicy:
    """A driver that is not told what is wished."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        untold = x.copy()
        untold[..., 0, WISH] = 0.0
        return self._policy.logits(untold)


def untrained_of(seed: str) -> AttentionPolicy:
    """The shipped network before it has learnt anything: weights drawn as torch draws them, of the seed "0" or "7"; ""
    is 0. Raises `ConfigError` for what is not a whole number from 0."""
    if seed and not (seed.isascii() and seed.isdecimal() and len(seed) < 20):
        raise ConfigError(f"untrained:{seed}: give a whole number from 0 as the seed, as in untrained:0")
    rng = np.random.default_rng(int(seed or 0))
    drawn = {}
    sidecar, learnt = read_checkpoint(SHIPPED)
    for name, array in sorted(learnt.items()):
        if "norm" in name:
            drawn[name] = np.ones_like(array) if name.endswith("weight") else np.zeros_like(array)
        else:
            bound = 1.0 / np.sqrt(array.shape[-1])
            drawn[name] = rng.uniform(-bound, bound, array.shape).astype(np.float32)
    return AttentionPolicy(drawn, sidecar)
