"""The baselines' exported policies: stable-baselines3's multi-layer perceptrons in NumPy. No torch.

Axes: ... any batch axes, N vehicle rows, F features.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fast_node.mask import VERSION as MASK_VERSION
from fast_node.policies.checkpoint import read_checkpoint
from schemas.driving.features import FEATURES, LAYOUT_HASH, LAYOUTS, N_ROWS
from schemas.runtime.process import ConfigError

Array = NDArray[np.float32]
BASELINES = ("ppo", "dqn", "a2c")
LEARNERS = (*BASELINES, "maskable-ppo")
"""All that `fastslow train` knows; of the baselines there are checkpoints in the repository."""
VARIANTS = ("bare", "masked")
"""As published, without mask and directive; or with both."""
PARTS = ("mask-only", "wish-only")
"""With one of them, to tell what it does."""
WISH = tuple(FEATURES.index(name) for name in ("y_des", "v_des", "headway", "y_wished"))
"""The directive's columns, of the ego's row: what a baseline that is not told of it does not get to see."""


class MlpPolicy:
    """The ego's five preferences from all rows at once: logits of PPO and A2C, Q values of DQN."""

    def __init__(self, weights: dict[str, Array], sidecar: Mapping[str, object]) -> None:
        self.sidecar = sidecar
        self._layers = [
            (np.ascontiguousarray(weights[f"{k}.weight"].T), weights[f"{k}.bias"]) for k in range(len(weights) // 2)
        ]
        self._features = len(self._layers[0][0]) // N_ROWS
        if not told(str(sidecar["variant"])):
            first = self._layers[0][0].copy().reshape(N_ROWS, self._features, -1)
            first[0, WISH] = 0.0  # as if the wish itself were zero
            self._layers[0] = first.reshape(self._layers[0][0].shape), self._layers[0][1]
        self._relu = sidecar["activation"] == "relu"

    def logits(self, x: Array) -> Array:
        """(..., N, F) -> (..., 5)"""
        z = x[..., : self._features].reshape(*x.shape[:-2], -1)
        for weight, bias in self._layers[:-1]:
            z = z @ weight + bias
            z = np.maximum(z, 0) if self._relu else np.tanh(z)
        out: Array = z @ self._layers[-1][0] + self._layers[-1][1]
        return out


def masked(variant: str) -> bool:
    """Whether it learns and drives behind our mask."""
    return variant in ("masked", "mask-only")


def told(variant: str) -> bool:
    """Whether it gets to see the directive."""
    return variant in ("masked", "wish-only")


def shipped(algorithm: str, variant: str) -> Path:
    """The baseline that is in the repository: learnt from seed 0 on the roads and the budget of our own policy."""
    return Path(__file__).parents[1] / "checkpoints" / f"{algorithm}-{variant}.safetensors"


def load_mlp(path: Path) -> MlpPolicy:
    """The policy in `path` with its `.json` sidecar. Raises `ConfigError` if missing, corrupt or made for others."""
    sidecar, weights = read_checkpoint(path)
    if sidecar.get("algorithm") not in LEARNERS:
        raise ConfigError(f"{path.name} holds no baseline: train one with `fastslow train --algorithm`")
    mask = MASK_VERSION if masked(str(sidecar.get("variant"))) else None
    if (layout := sidecar.get("layout_hash")) not in LAYOUTS:
        raise ConfigError(f"{path.name} has layout_hash {layout!r}, this code {LAYOUT_HASH!r}: train it anew")
    if (found := sidecar.get("mask")) != mask:
        raise ConfigError(f"{path.name} has mask {found!r}, this code {mask!r}: train it anew")
    try:
        if (columns := weights["0.weight"].shape[1]) != N_ROWS * LAYOUTS[layout]:
            raise ValueError(f"{columns} columns instead of {N_ROWS * LAYOUTS[layout]}")
        return MlpPolicy(weights, sidecar)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ConfigError(f"{path.name} does not fit its sidecar ({error!r}): train it anew") from None
