"""The exported policy: the attention network of the paper in NumPy, from safetensors and a JSON sidecar. No torch.

Axes: ... any batch axes, N vehicle rows, F features, D model width, H heads.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from fast_node.mask import VERSION as MASK_VERSION
from schemas.features import LAYOUT_HASH
from schemas.process import ConfigError

Array = NDArray[np.float32]
SHIPPED = Path(__file__).parent / "checkpoints" / "fastslow.safetensors"


class Policy:
    """softmax(W_pi z^(L) + b_pi) over the five meta-actions (paper Eq. 12), as logits."""

    def __init__(self, weights: dict[str, Array], sidecar: dict[str, object]) -> None:
        self.weights, self.sidecar = weights, sidecar
        self.layers = int(str(sidecar["layers"]))
        self.heads = int(str(sidecar["heads"]))

    def logits(self, x: Array) -> Array:
        """(..., N, F) -> (..., 5) logits. Only the ego's row is read out, so the last layer computes only that row."""
        return self._forward(x)[0]

    def attention(self, x: Array) -> Array:
        """(N, F) -> (H, N): how much the ego attends to each row in the last layer, per head; sums to 1 over N."""
        return self._forward(x)[1][..., 0, :]

    def _forward(self, x: Array) -> tuple[Array, Array]:
        w = self.weights
        z: Array = x @ w["embed.weight"].T + w["embed.bias"]  # (..., N, D), Eq. 10
        present = x[..., 0] > 0
        for layer in range(self.layers):
            z, weights = self._encode(z, present, f"layers.{layer}.", layer == self.layers - 1)
        out: Array = z[..., 0, :] @ w["policy.weight"].T + w["policy.bias"]
        return out, weights

    def _encode(self, z: Array, present: NDArray[np.bool_], p: str, ego_only: bool) -> tuple[Array, Array]:
        """Eq. 11 on a normalised input; the residual term is our departure, for stability. Also the weights."""
        w = self.weights
        mean = z.mean(-1, keepdims=True)
        var = ((z - mean) ** 2).mean(-1, keepdims=True)
        u = (z - mean) / np.sqrt(var + np.float32(1e-5)) * w[p + "norm.weight"] + w[p + "norm.bias"]
        d = u.shape[-1]
        asks = slice(0, 1) if ego_only else slice(None)
        qkv, bias = w[p + "qkv.weight"], w[p + "qkv.bias"]
        q = self._heads(u[..., asks, :] @ qkv[:d].T + bias[:d])
        k, v = (self._heads(a) for a in np.split(u @ qkv[d:].T + bias[d:], 2, axis=-1))
        scores = q @ k.swapaxes(-1, -2) / np.float32(np.sqrt(d // self.heads))
        scores = np.where(present[..., None, None, :], scores, np.float32(-1e9))
        weights = np.exp(scores - scores.max(-1, keepdims=True))
        weights /= weights.sum(-1, keepdims=True)
        merged = (weights @ v).swapaxes(-2, -3)
        attended = merged.reshape(*merged.shape[:-2], d) @ w[p + "out.weight"].T + w[p + "out.bias"]
        hidden = np.maximum(u[..., asks, :] @ w[p + "up.weight"].T + w[p + "up.bias"], 0)
        out: Array = z[..., asks, :] + attended + hidden @ w[p + "down.weight"].T + w[p + "down.bias"]
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
