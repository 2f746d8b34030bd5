"""The exported policy: the attention network of the paper in NumPy, from safetensors and a JSON sidecar. No torch.

Axes: ... any batch axes, N vehicle rows, F features, D model width, H heads.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fast_node.mask import PRESETS
from fast_node.mask import VERSION as MASK_VERSION
from fast_node.policies.checkpoint import read_checkpoint
from schemas.driving.features import FEATURES, LAYOUT_HASH, LAYOUTS
from schemas.runtime.process import ConfigError

Array = NDArray[np.float32]
Wide = NDArray[np.float64]
Present = NDArray[np.bool_]
PRESENCE = FEATURES.index("presence")
SHIPPED = Path(__file__).parents[1] / "checkpoints" / "fastslow.safetensors"


class AttentionPolicy:
    """softmax(W_pi z^(L) + b_pi) over the five meta-actions (paper Eq. 13), as logits.

    The last layer is computed for the ego alone, and folded: see `training.network.Encoder.ego`. What follows its
    softmax and its ReLU is linear down to the logits, and so one small matrix.
    """

    def __init__(self, weights: dict[str, Array], sidecar: dict[str, object]) -> None:
        self.sidecar = sidecar
        self._heads = int(str(sidecar["heads"]))
        layers = int(str(sidecar["layers"]))
        w = {name: array.astype(np.float64) for name, array in weights.items()}
        self._features = w["embed.weight"].shape[1]
        self._embed, self._embed_bias = _floats(w["embed.weight"].T, w["embed.bias"])
        self._below = [_Layer(w, f"layers.{k}.", self._heads) for k in range(layers - 1)]
        self._fold(w, f"layers.{layers - 1}.")

    def _fold(self, w: dict[str, Wide], p: str) -> None:
        d, h = w["embed.weight"].shape[0], self._heads
        scale, shift = w[p + "norm.weight"], w[p + "norm.bias"]
        query, key, value = w[p + "qkv.weight"].reshape(3, h, d // h, d)
        q_bias, _, v_bias = w[p + "qkv.bias"].reshape(3, h, d // h)
        q_bias = q_bias + query @ shift
        root = np.sqrt(d // h)
        asks = np.einsum("hkd,hke->dhe", query * scale, key * scale).reshape(d, h * d) / root
        asks_bias = np.einsum("hk,hke->he", q_bias, key * scale).reshape(h * d) / root
        up, up_bias = (w[p + "up.weight"] * scale).T, w[p + "up.bias"] + w[p + "up.weight"] @ shift
        self._asks, self._asks_bias = _floats(np.hstack([asks, up]), np.hstack([asks_bias, up_bias]))
        out = w[p + "out.weight"].reshape(d, h, d // h)
        to_logits = w["policy.weight"].T
        attended = np.einsum("hkd,ohk->hdo", value * scale, out).reshape(h * d, d)
        bias = w[p + "out.weight"] @ (v_bias + value @ shift).reshape(d) + w[p + "out.bias"] + w[p + "down.bias"]
        self._last, self._last_bias = _floats(
            np.vstack([attended, w[p + "down.weight"].T]) @ to_logits, bias @ to_logits + w["policy.bias"]
        )
        (self._residual,) = _floats(to_logits)

    def logits(self, x: Array) -> Array:
        """(..., N, F) -> (..., 5) logits."""
        if x.ndim == 2 and (present := np.flatnonzero(x[:, PRESENCE])).size:
            x = x[: present[-1] + 1]  # one scene, as the node asks: absent vehicles at the end only cost time
        return self._forward(x)[0]

    def attention(self, x: Array) -> Array:
        """(N, F) -> (H, N): how much the ego attends to each row in the last layer, per head; sums to 1 over N."""
        return self._forward(x)[1]

    def _forward(self, x: Array) -> tuple[Array, Array]:
        x = x[..., : self._features]
        present = x[..., PRESENCE] > 0
        z: Array = x @ self._embed + self._embed_bias  # (..., N, D), Eq. 11
        for layer in self._below:
            z = layer.encode(z, present)
        u = normalised(z)
        asks = u[..., 0, :] @ self._asks + self._asks_bias
        width = self._heads * u.shape[-1]
        keys = asks[..., :width].reshape(*asks.shape[:-1], self._heads, u.shape[-1])
        weights = attention_weights(keys @ u.swapaxes(-1, -2), present[..., None, :])
        attended = (weights @ u).reshape(*asks.shape[:-1], width)
        hidden = np.concatenate([attended, np.maximum(asks[..., width:], 0)], -1)
        out: Array = hidden @ self._last + z[..., 0, :] @ self._residual + self._last_bias
        return out, weights


class _Layer:
    """An encoder layer below the last: Eq. 12 for every row, on a normalised input and with a residual term."""

    def __init__(self, w: dict[str, Wide], p: str, heads: int) -> None:
        self._heads = heads
        scale, shift = w[p + "norm.weight"], w[p + "norm.bias"]
        self._in, self._in_bias = _floats(
            np.vstack([w[p + "qkv.weight"], w[p + "up.weight"]]).T * scale[:, None],
            np.hstack([w[p + "qkv.bias"], w[p + "up.bias"]])
            + np.vstack([w[p + "qkv.weight"], w[p + "up.weight"]]) @ shift,
        )
        self._out, self._out_bias = _floats(
            np.hstack([w[p + "out.weight"], w[p + "down.weight"]]).T, w[p + "out.bias"] + w[p + "down.bias"]
        )

    def encode(self, z: Array, present: Present) -> Array:
        """(..., N, D) -> (..., N, D)"""
        d, h = z.shape[-1], self._heads
        inner = normalised(z) @ self._in + self._in_bias
        q, k, v = (inner[..., i * d : (i + 1) * d].reshape(*z.shape[:-1], h, d // h).swapaxes(-2, -3) for i in range(3))
        weights = attention_weights(q @ k.swapaxes(-1, -2) / np.float32(np.sqrt(d // h)), present[..., None, None, :])
        attended = (weights @ v).swapaxes(-2, -3).reshape(z.shape)
        out: Array = z + np.concatenate([attended, np.maximum(inner[..., 3 * d :], 0)], -1) @ self._out + self._out_bias
        return out


def normalised(z: Array) -> Array:
    """Mean 0 and variance 1 over the last axis; scale and shift of the norm are in the weights that follow."""
    share = _shares(z.shape[-1])
    u = z - z @ share
    u /= np.sqrt((u * u) @ share + np.float32(1e-5))
    return u


@cache
def _shares(width: int) -> Array:
    """(width, 1) of 1 / width: a product with it is a mean, and quicker."""
    return np.full((width, 1), 1.0 / width, np.float32)


def attention_weights(scores: NDArray[Any], present: Present) -> Array:
    """Softmax over the last axis of what is present."""
    e: Array = np.exp(scores - scores.max(-1, keepdims=True)) * present
    e /= e.sum(-1, keepdims=True)
    return e


def _floats(*arrays: Wide) -> list[Array]:
    return [np.ascontiguousarray(a, np.float32) for a in arrays]


def load_attention(path: Path = SHIPPED) -> AttentionPolicy:
    """The policy in `path` with its `.json` sidecar. Raises `ConfigError` if missing, corrupt or made for others."""
    sidecar, weights = read_checkpoint(path)
    if (algorithm := sidecar.get("algorithm", "ours")) != "ours":
        raise ConfigError(f"{path.name} holds a baseline, {algorithm!r}: give the policy of `fastslow train`")
    if (layout := sidecar.get("layout_hash")) not in LAYOUTS:
        raise ConfigError(f"{path.name} has layout_hash {layout!r}, this code {LAYOUT_HASH!r}: train anew")
    if (mask := sidecar.get("mask")) != MASK_VERSION:
        raise ConfigError(f"{path.name} has mask {mask!r}, this code {MASK_VERSION!r}: train anew")
    if (preset := sidecar.setdefault("mask_preset", "sim")) not in PRESETS:
        raise ConfigError(f"{path.name} has mask_preset {preset!r}, this code {', '.join(PRESETS)}: train anew")
    found = len({name.split(".")[1] for name in weights if name.startswith("layers.")})
    if sidecar.get("layers") != found:
        raise ConfigError(f"{path.name} has {found} layers, its sidecar says {sidecar.get('layers')!r}: train anew")
    try:
        if (columns := weights["embed.weight"].shape[1]) != LAYOUTS[layout]:
            raise ValueError(f"{columns} columns instead of {LAYOUTS[layout]}")
        return AttentionPolicy(weights, sidecar)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ConfigError(f"{path.name} does not fit its sidecar ({error!r}): train anew") from None
