"""A checkpoint that is not what was exported is refused in one line, before anything drives."""

from __future__ import annotations

import contextlib
import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save

from fast_node.policies.attention import SHIPPED
from fast_node.policies.load import BUILT_IN, load_policy
from fast_node.policies.mlp import shipped
from schemas.runtime.process import CONFIG, ConfigError

WEIGHTS = SHIPPED.read_bytes()
Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]
SIDECAR = json.loads(SHIPPED.with_suffix(".json").read_text())


def checkpoint(folder: Path, data: bytes = WEIGHTS, sidecar: bytes | None = None, **changed: Any) -> Path:
    """A copy of what is shipped with other bytes or another sidecar, its digest that of the bytes it should have."""
    path = folder / "p.safetensors"
    path.write_bytes(data)
    path.with_suffix(".json").write_bytes(sidecar or json.dumps({**SIDECAR, **changed}).encode())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as told:
        load_policy(str(path))
    said = str(told.value)
    assert said.isprintable()
    assert len(said) < 500
    return said


@settings(max_examples=20, deadline=None)
@given(st.integers(0, len(WEIGHTS) * 8 - 1))
def test_one_flipped_bit_anywhere_in_the_weights_is_refused(tmp_path_factory: pytest.TempPathFactory, bit: int) -> None:
    data = bytearray(WEIGHTS)
    data[bit // 8] ^= 1 << bit % 8
    assert "digest" in refusal(checkpoint(tmp_path_factory.mktemp("p"), bytes(data)))


def test_a_flipped_byte_ends_the_start_with_one_line_and_78(tmp_path: Path) -> None:
    path = checkpoint(tmp_path, WEIGHTS[:-1] + bytes([WEIGHTS[-1] ^ 1]))
    ended = subprocess.run(
        [sys.executable, "-m", "deploy", "evaluate", "--checkpoint", str(path), "--episodes", "1"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == CONFIG
    assert "digest" in ended.stderr.splitlines()[-1]
    assert "Traceback" not in ended.stderr


def test_a_checkpoint_without_a_digest_is_refused_and_told_what_to_add(tmp_path: Path) -> None:
    said = refusal(checkpoint(tmp_path, sha256=""))
    assert hashlib.sha256(WEIGHTS).hexdigest() in said


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused_whoever_signed_them(tmp_path: Path, value: float) -> None:
    weights = load(WEIGHTS)
    weights["policy.bias"] = np.full_like(weights["policy.bias"], value)
    data = save(weights)
    assert "not finite" in refusal(checkpoint(tmp_path, data, sha256=hashlib.sha256(data).hexdigest()))


@pytest.mark.parametrize("source", [SHIPPED, shipped("ppo", "masked")], ids=["ours", "ppo"])
@pytest.mark.parametrize(
    "change",
    [
        lambda w: {k: v.astype(np.float64) for k, v in w.items()},
        lambda w: {k: v[:1] for k, v in w.items()},
        lambda w: {k: v[:0] for k, v in w.items()},
        lambda w: {},
        lambda w: {"0.weight": np.zeros((5, 3), np.float32)},
        lambda w: {"layers.x": np.zeros(1, np.float32)},
    ],
    ids=["float64", "one row", "no row", "none", "one matrix", "a name"],
)
def test_signed_weights_of_other_shapes_or_types_are_refused(tmp_path: Path, change: Change, source: Path) -> None:
    data = save(change(load(source.read_bytes())))
    sidecar = json.loads(source.with_suffix(".json").read_text())
    sidecar["sha256"] = hashlib.sha256(data).hexdigest()
    assert refusal(checkpoint(tmp_path, data, json.dumps(sidecar).encode()))


@pytest.mark.parametrize(
    ("source", "first"), [(SHIPPED, "embed.weight"), (shipped("ppo", "masked"), "0.weight")], ids=["ours", "ppo"]
)
def test_weights_that_read_fewer_columns_than_their_layout_has_are_refused(
    tmp_path: Path, source: Path, first: str
) -> None:
    weights = load(source.read_bytes())
    data = save({**weights, first: weights[first][:, :-15].copy()})
    sidecar = json.loads(source.with_suffix(".json").read_text())
    sidecar["sha256"] = hashlib.sha256(data).hexdigest()
    assert "columns instead of" in refusal(checkpoint(tmp_path, data, json.dumps(sidecar).encode()))


@pytest.mark.parametrize("key", ["heads", "layers", "mask", "mask_preset", "layout_hash", "algorithm", "sha256"])
@pytest.mark.parametrize("value", [-1, 0, 10**30, 1.5, "x", "\x1b[2J", [], {}, [[[]]], True])
def test_a_sidecar_with_a_wrong_value_is_refused(tmp_path: Path, key: str, value: Any) -> None:
    refusal(checkpoint(tmp_path, **{key: value}))


@pytest.mark.parametrize(
    "text",
    [
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b"9" * 10_000,
        b"[]",
        b"null",
        b"\xff\xfe{}",
        b" " * 2_000_000,
        b'{"heads": ' + b"9" * 10_000 + b"}",
        b"{",
    ],
    ids=["deep list", "deep object", "long number", "list", "null", "no text", "huge", "long heads", "cut"],
)
def test_a_sidecar_that_is_none_is_refused(tmp_path: Path, text: bytes) -> None:
    refusal(checkpoint(tmp_path, sidecar=text))


@settings(max_examples=100, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*SIDECAR, "x"]), inner, max_size=3)
        ),
    )
)
def test_any_sidecar_loads_or_is_refused(tmp_path_factory: pytest.TempPathFactory, value: Any) -> None:
    path = checkpoint(
        tmp_path_factory.mktemp("p"),
        sidecar=json.dumps({**SIDECAR, **value} if isinstance(value, dict) else value).encode(),
    )
    with contextlib.suppress(ConfigError):
        load_policy(str(path))


@pytest.mark.parametrize(
    "spec", ["/", "./", "/dev/null", "/dev/zero", "a\0/b", "x/" + "y" * 5000, "/nowhere/p.safetensors"]
)
def test_a_path_that_is_no_checkpoint_is_refused(spec: str) -> None:
    refusal(Path(spec))


def test_every_shipped_checkpoint_has_its_digest() -> None:
    for file in SHIPPED.parent.glob("*.safetensors"):
        told = json.loads(file.with_suffix(".json").read_text())["sha256"]
        assert hashlib.sha256(file.read_bytes()).hexdigest() == told
        assert file.stem in BUILT_IN
