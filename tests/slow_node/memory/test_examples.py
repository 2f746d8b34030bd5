"""The shipped examples and their vectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slow_node.llm.embedding import HashedEmbedder, Vector, load_embedder
from slow_node.memory.examples import embed_command, read_shipped, ship_vectors, shipped_vectors


def test_the_shipped_vectors_belong_to_the_shipped_examples() -> None:
    embedder = load_embedder()
    if isinstance(embedder, HashedEmbedder):
        pytest.skip("MiniLM is not installed")
    seeds = read_shipped()
    vectors = shipped_vectors(embedder, seeds)
    assert vectors is not None, "run `python -m slow_node.memory.examples`"
    assert len(vectors) == len(seeds)
    anew = [embed_command(embedder, seed.command) for seed in seeds[::25]]
    assert np.abs(vectors[::25] @ np.transpose(anew) - anew @ np.transpose(anew)).max() < 1e-3


@pytest.mark.parametrize("stale", ["examples", "embedder", "file"])
def test_stale_vectors_are_noticed_and_not_used(stale: str, tmp_path: Path) -> None:
    class Bins(HashedEmbedder):
        name = "bins"

    class Reversed(Bins):
        def embed(self, text: str) -> Vector:
            return super().embed(text[::-1])

    path = tmp_path / "examples.jsonl"
    path.write_text('{"command": "Faster", "scene": "", "slots": {"outcome": "directive", "speed": "faster"}}\n')
    ship_vectors(Bins(), path)
    assert shipped_vectors(Bins(), read_shipped(path), path) is not None
    if stale == "examples":
        path.write_text(path.read_text().replace("Faster", "Slower"))
    if stale == "file":
        path.with_suffix(".safetensors").write_bytes(b"damaged")
    assert shipped_vectors(Reversed() if stale == "embedder" else Bins(), read_shipped(path), path) is None
