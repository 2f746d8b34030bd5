"""The exported policy: the attention network of the paper in NumPy, from safetensors and a JSON sidecar. No torch.

Axes: ... any batch axes, N vehicle rows, F features, D model width, H heads.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from fast_node.mask import VERSION as MASK_VERSION
from schemas.features import LAYOUT_HASH
from schemas.process import ConfigError

Array = NDArray[np.float32]
SHIPPED = Path(__file__).parent / "checkpoints" / "fastslow.safetensors"


class _Layer(NamedTuple):
    """An encoder layer, transposed and contiguous; the norm's scale and shift are folded into what follows it."""

    q: Array
    q_bias: Array
    kv: Array
    kv_bias: Array
    out: Array
    up: Array
    up_bias: Array
    down: Array
    bias: Array
    """Of `out` and `down` together."""


class Policy:
    """softmax(W_pi z^(L) + b_pi) over the five meta-actions (paper Eq. 12), as logits."""

    def __init__(self, weights: dict[str, Array], sidecar: dict[str, object]) -> None:
        self.weights, self.sidecar = weights, sidecar
        self.heads = int(str(sidecar["heads"]))
        self._layers = [self._fold(f"layers.{k}.") for k in range(int(str(sidecar["layers"])))]
        self._embed, self._policy = (np.ascontiguousarray(weights[f"{n}.weight"].T) for n in ("embed", "policy"))
        self._mean = np.full((len(self._policy), 1), 1.0 / len(self._policy), np.float32)

    def logits(self, x: Array) -> Array:
        """(..., N, F) -> (..., 5) logits. Only the ego's row is read out, so the last layer computes only that row."""
        here = x[..., 0] > 0  # rows of absent vehicles change nothing
        return self._forward(x[here] if x.ndim == 2 else x[..., here.any(axis=tuple(range(x.ndim - 2))), :])[0]

    def attention(self, x: Array) -> Array:
        """(N, F) -> (H, N): how much the ego attends to each row in the last layer, per head; sums to 1 over N."""
        return self._forward(x)[1][..., 0, :]

    def _fold(self, p: str) -> _Layer:
        w = {k[len(p):]: v.astype(np.float64) for k, v in self.weights.items() if k.startswith(p)}
        scale, shift = w["norm.weight"], w["norm.bias"]
        d = len(scale)
        qkv, bias = scale[:, None] * w["qkv.weight"].T, w["qkv.bias"] + shift @ w["qkv.weight"].T
        root = np.sqrt(d // self.heads)
        parts = (qkv[:, :d] / root, bias[:d] / root, qkv[:, d:], bias[d:], w["out.weight"].T,
                 scale[:, None] * w["up.weight"].T, w["up.bias"] + shift @ w["up.weight"].T, w["down.weight"].T,
                 w["out.bias"] + w["down.bias"])
        return _Layer(*(np.ascontiguousarray(a, np.float32) for a in parts))

    def _forward(self, x: Array) -> tuple[Array, Array]:
        z: Array = x @ self._embed + self.weights["embed.bias"]  # (..., N, D), Eq. 10
        present = x[..., 0] > 0
        for layer in self._layers:
            z, weights = self._encode(z, present, layer, layer is self._layers[-1])
        out: Array = z[..., 0, :] @ self._policy + self.weights["policy.bias"]
        return out, weights

    def _encode(self, z: Array, present: NDArray[np.bool_], layer: _Layer, ego_only: bool) -> tuple[Array, Array]:
        """Eq. 11 on a normalised input; the residual term is our departure, for stability. Also the weights."""
        u = z - z @ self._mean
        u /= np.sqrt((u * u) @ self._mean + np.float32(1e-5))
        asks = u[..., :1, :] if ego_only else u
        q = self._heads(asks @ layer.q + layer.q_bias)
        k, v = (self._heads(a) for a in np.split(u @ layer.kv + layer.kv_bias, 2, axis=-1))
        scores = q @ k.swapaxes(-1, -2)
        if not present.all():
            scores = np.where(present[..., None, None, :], scores, np.float32(-1e9))
        weights = np.exp(scores - scores.max(-1, keepdims=True))
        weights /= weights.sum(-1, keepdims=True)
        merged = (weights @ v).swapaxes(-2, -3)
        attended = merged.reshape(*merged.shape[:-2], u.shape[-1]) @ layer.out
        hidden = np.maximum(asks @ layer.up + layer.up_bias, 0)
        out: Array = z[..., : asks.shape[-2], :] + attended + hidden @ layer.down + layer.bias
        return out, weights

    def _heads(self, a: Array) -> Array:
        """(..., N, D) -> (..., H, N, D/H)"""
        return a.reshape(*a.shape[:-1], self.heads, a.shape[-1] // self.heads).swapaxes(-2, -3)


def load_policy(path: Path = SHIPPED) -> Policy:
    """The policy in `path` with its `.json` sidecar. Raises `ConfigError` if missing, corrupt or made for others."""
    sidecar_path = path.with_suffix(".json")
    try:
        sidecar = json.loads(sidecar_path.read_text())
        weights = load_file(path)
    except FileNotFoundError as error:
        raise ConfigError(f"no policy at {error.filename}: train one with `fastslow train`") from None
    except (SafetensorError, json.JSONDecodeError, OSError) as error:
        raise ConfigError(f"the policy {path.name} is corrupt ({error}): restore it or train one anew") from None
    for name, want in (("layout_hash", LAYOUT_HASH), ("mask", MASK_VERSION)):
        if sidecar.get(name) != want:
            raise ConfigError(f"{path.name} has {name} {sidecar.get(name)!r}, this code {want!r}: train anew")
    return Policy(weights, sidecar)
