"""The exported policy: the attention network of the paper in NumPy, from safetensors and a JSON sidecar. No torch.

Axes: N vehicle rows, F features, D model width, H heads.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from fast_node.features import LAYOUT_HASH
from fast_node.mask import VERSION as MASK_VERSION
from schemas.process import ConfigError

Array = NDArray[np.float32]
SHIPPED = Path(__file__).parent / "checkpoints" / "two_way.safetensors"


class Policy:
    """softmax(W_pi z^(L) + b_pi) over the five meta-actions (paper Eq. 12), as logits."""

    def __init__(self, weights: dict[str, Array], sidecar: dict[str, object]) -> None:
        self.weights, self.sidecar = weights, sidecar
        self.layers = int(str(sidecar["layers"]))
        self.heads = int(str(sidecar["heads"]))

    def logits(self, x: Array) -> Array:
        """(N, F) -> (5,) logits."""
        w = self.weights
        z = x @ w["embed.weight"].T + w["embed.bias"]  # (N, D), Eq. 10
        present = x[:, 0] > 0
        for layer in range(self.layers):
            z = self._encode(z, present, f"layers.{layer}.")
        out: Array = z[0] @ w["policy.weight"].T + w["policy.bias"]
        return out

    def _encode(self, z: Array, present: NDArray[np.bool_], p: str) -> Array:
        """Eq. 11 on a normalised input; the residual term is our departure, for stability."""
        w = self.weights
        mean = z.mean(-1, keepdims=True)
        var = ((z - mean) ** 2).mean(-1, keepdims=True)
        u = (z - mean) / np.sqrt(var + np.float32(1e-5)) * w[p + "norm.weight"] + w[p + "norm.bias"]
        n, d = u.shape
        q, k, v = np.split(u @ w[p + "qkv.weight"].T + w[p + "qkv.bias"], 3, axis=-1)
        q, k, v = (a.reshape(n, self.heads, d // self.heads).transpose(1, 0, 2) for a in (q, k, v))  # (H, N, D/H)
        scores = q @ k.transpose(0, 2, 1) / np.float32(np.sqrt(d // self.heads))
        scores = np.where(present, scores, np.float32(-1e9))
        weights = np.exp(scores - scores.max(-1, keepdims=True))
        weights /= weights.sum(-1, keepdims=True)
        attended = (weights @ v).transpose(1, 0, 2).reshape(n, d) @ w[p + "out.weight"].T + w[p + "out.bias"]
        hidden = np.maximum(u @ w[p + "up.weight"].T + w[p + "up.bias"], 0)
        out: Array = z + attended + hidden @ w[p + "down.weight"].T + w[p + "down.bias"]
        return out


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
