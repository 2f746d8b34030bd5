"""The examples that the memory bank ships with, and their sentence vectors.

Embedding a few hundred commands takes seconds, so their vectors ship beside them. After a change to the examples or to
the embedding, `python -m slow_node.memory.examples` embeds them anew; until then a stale file is noticed and not used.
"""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from schemas.runtime.process import ConfigError, log, run_node
from slow_node.llm.embedding import Embedder, HashedEmbedder, Vector, load_embedder
from slow_node.understanding.slots import Slots

EXAMPLES = Path(__file__).with_name("examples.jsonl")
SAME_SPACE_COSINE = 0.999
"""An embedder that puts the first example farther than this from its shipped vector is not the one that made it."""


class ShippedExample(BaseModel):
    """A shipped example: a command, the scene it was said in, and what it means."""

    model_config = ConfigDict(extra="forbid")

    command: str
    scene: str
    slots: Slots


def read_shipped(path: Path = EXAMPLES) -> list[ShippedExample]:
    """The examples of a file of JSON lines. Raises `ConfigError` for a line that is none."""
    examples = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            examples.append(ShippedExample.model_validate_json(line))
        except ValidationError as error:
            raise ConfigError(f"{path}:{number}: {error.errors()[0]['msg']}") from None
    return examples


def embed_command(embedder: Embedder, command: str) -> Vector:
    """E(.) without final punctuation, which moves a short command's vector by as much as a word does. Shape (384,)."""
    return embedder.embed(command.rstrip(" .!?\u3002\uff01\uff1f"))


def shipped_vectors(embedder: Embedder, examples: list[ShippedExample], path: Path = EXAMPLES) -> Vector | None:
    """(N, 384): the vectors that ship beside the examples; None where they are of other examples or another embedder.

    Stored as float16, which moves a cosine by less than 1e-3.
    """
    from safetensors import SafetensorError, safe_open

    if embedder.name == HashedEmbedder.name:
        return None  # it embeds them all in milliseconds
    try:
        with safe_open(path.with_suffix(".safetensors"), framework="numpy") as file:
            metadata = file.metadata() or {}
            vectors: Vector = file.get_tensor("vectors").astype(np.float32)
    except (OSError, SafetensorError):
        metadata, vectors = {}, np.empty((0, 0), np.float32)
    if metadata == _metadata(embedder, path) and (
        vectors[0] @ embed_command(embedder, examples[0].command) > SAME_SPACE_COSINE
    ):
        return vectors
    log(
        "slow",
        "examples",
        f"no vectors that belong to {path.name} and {embedder.name}: embedding every example takes "
        "seconds; run `python -m slow_node.memory.examples` once",
    )
    return None


def ship_vectors(embedder: Embedder, path: Path = EXAMPLES) -> int:
    """Embed the examples, write their vectors beside them and return how many they are.

    Raises `ConfigError` where only the fallback of MiniLM is installed.
    """
    from safetensors.numpy import save

    if embedder.name == HashedEmbedder.name:
        raise ConfigError("MiniLM is not installed: run `make setup`")
    vectors = np.stack([embed_command(embedder, example.command) for example in read_shipped(path)])
    path.with_suffix(".safetensors").write_bytes(
        save({"vectors": vectors.astype(np.float16)}, metadata=_metadata(embedder, path))
    )
    return len(vectors)


def _metadata(embedder: Embedder, path: Path) -> dict[str, str]:
    return {"embedder": embedder.name, "examples_sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def main() -> None:
    print(f"{ship_vectors(load_embedder())} vectors of {EXAMPLES.name} written")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(run_node("examples", main))
