"""The tables of the embedding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from safetensors.numpy import save

from slow_node.llm.embedding import HashedEmbedder, Rows, in_bytes


def test_rows_read_from_a_file_are_the_rows_of_its_matrix(tmp_path: Path) -> None:
    table = np.arange(12, dtype=np.float16).reshape(4, 3)
    path = tmp_path / "table.safetensors"
    path.write_bytes(save({"first": np.zeros(5, np.float32), "table": table}))
    assert (Rows(path, "table")[np.array([3, 0, 3])] == table[[3, 0, 3]]).all()


def test_rows_of_bytes_are_within_a_two_hundred_and_fiftieth_of_the_matrix(tmp_path: Path) -> None:
    table = np.random.default_rng(1).normal(size=(4, 96)).astype(np.float32)
    table[2] = 0.0
    path = tmp_path / "table.safetensors"
    grams, scales = in_bytes(table)
    path.write_bytes(save({"table": grams}))
    read = Rows(path, "table", scales.astype(np.float32))[np.array([3, 0, 2])]
    bound = np.abs(table[[3, 0, 2]]).max(axis=1, keepdims=True) / 250.0
    assert (np.abs(read - table[[3, 0, 2]]) <= bound).all()


def test_the_stand_in_for_the_embedding_gives_unit_vectors() -> None:
    assert np.isclose(np.linalg.norm(HashedEmbedder().embed("anything")), 1.0)
