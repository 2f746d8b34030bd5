"""A checkpoint's two files: the weights (.safetensors) and their sidecar (.json), which has the weights' digest."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from schemas.runtime.files import read_bounded
from schemas.runtime.process import ConfigError
from schemas.wire.text import plain

Array = NDArray[np.float32]
MOST_SIDECAR_BYTES = 1_000_000
MOST_WEIGHTS_BYTES = 100_000_000
"""Some hundred times what is shipped."""
MOST_HEADS, MOST_LAYERS = 64, 64
DIGEST = "sha256"
"""The sidecar's key for the SHA-256 of the weights' file, in hexadecimal digits."""


class _Sidecar(msgspec.Struct):
    """The types of what a loader reads; what else stands there is kept as it is."""

    layout_hash: str = ""
    mask: str | None = None
    mask_preset: str = ""
    algorithm: str = ""
    variant: str = ""
    activation: str = ""
    sha256: str = ""
    heads: int = 1
    layers: int = 1
    width: int = 1
    steps: int = 0


def read_sidecar(path: Path) -> dict[str, Any]:
    """The `.json` sidecar of a policy, ours or a baseline. Raises `ConfigError` if missing or corrupt."""
    _both_are_there(path)
    try:
        sidecar = json.loads(read_bounded(path.with_suffix(".json"), MOST_SIDECAR_BYTES))
        known = msgspec.convert(sidecar, _Sidecar)
    except (ValueError, RecursionError, msgspec.ValidationError) as error:
        raise _corrupt(path, f"its sidecar: {error}") from None
    if not (1 <= known.heads <= MOST_HEADS and 1 <= known.layers <= MOST_LAYERS):
        raise _corrupt(path, f"its sidecar: {known.heads} heads, {known.layers} layers")
    return dict(sidecar)


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Sidecar and weights by name. Raises `ConfigError` where one is missing or corrupt, where the digest is missing or
    another one, and where a number is not finite."""
    sidecar = read_sidecar(path)
    data = read_bounded(path, MOST_WEIGHTS_BYTES)
    found, told = hashlib.sha256(data).hexdigest(), sidecar.get(DIGEST)
    if not told:
        raise ConfigError(
            f'{plain(path.name)} has no digest: if the file is yours, add "{DIGEST}": "{found}" to its .json'
        )
    if found != told:
        raise _corrupt(path, "its digest is another one than its sidecar's")
    try:
        weights: dict[str, Array] = load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise _corrupt(path, str(error)) from None
    for name, array in weights.items():
        if array.dtype != np.float32:
            raise _corrupt(path, f"{name} is {array.dtype}, not float32")
        if not np.isfinite(array).all():
            raise _corrupt(path, f"{name} has numbers that are not finite")
    return sidecar, weights


def write_checkpoint(path: Path, weights: Mapping[str, Array], sidecar: Mapping[str, object]) -> None:
    """Write both files, each whole or not at all, and the digest into the sidecar."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = save({name: np.ascontiguousarray(array) for name, array in weights.items()})
    text = json.dumps({**sidecar, DIGEST: hashlib.sha256(data).hexdigest()}, indent=1) + "\n"
    for file, content in ((path, data), (path.with_suffix(".json"), text.encode())):
        new = file.with_name(file.name + ".new")
        new.write_bytes(content)
        os.replace(new, file)


def _both_are_there(path: Path) -> None:
    if not path.name:
        raise ConfigError(f"{path} is a folder: give a file, FILE.safetensors")
    for file in (path, path.with_suffix(".json")):
        try:
            if file.exists():
                continue
        except (OSError, ValueError) as error:
            raise ConfigError(f"cannot read {plain(str(file), 300)}: {plain(str(error), 100)}") from None
        raise ConfigError(f"no policy at {plain(str(file), 300)}: train one with `fastslow train`")


def _corrupt(path: Path, why: str) -> ConfigError:
    return ConfigError(f"the policy {plain(path.name)} is corrupt ({plain(why, 200)}): restore it or train one anew")
