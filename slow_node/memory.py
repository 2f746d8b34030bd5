"""The memory bank D and its retrieval M_t (paper's Eq. 5): SQLite on disk, exact cosine in NumPy.

Sentences are embedded from the command alone: similar wishes, not similar roads, are what the answer depends on; the
scene travels with the example as text. Only the shipped seeds may overrule the model (see `slow_node.directive`):
what was learnt on the road came from the model itself.
"""

from __future__ import annotations

import sqlite3
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from schemas.process import ConfigError
from slow_node.embedding import DIMENSION, Embedder, Vector
from slow_node.slots import Slots

SEEDS = Path(__file__).with_name("examples.jsonl")
MAX_LEARNT = 2000
"""The bank's bound: beyond it the oldest learnt example goes."""


class _Seed(BaseModel):
    model_config = ConfigDict(extra="forbid")

    command: str
    scene: str
    slots: Slots


@dataclass(frozen=True)
class Example:
    """A command, the scene it was said in, and what it was taken to mean."""

    command: str
    scene: str
    slots: Slots
    seed: bool
    cosine: float = 0.0


class Memory:
    """Open with a file's path, or with "" for a bank that ends with the process. Safe to call from any thread."""

    def __init__(self, embedder: Embedder, path: str = "", seeds: Path = SEEDS) -> None:
        self._embedder = embedder
        self._lock = threading.Lock()
        try:
            self._db = sqlite3.connect(path or ":memory:", check_same_thread=False)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute(
                "CREATE TABLE IF NOT EXISTS example (space TEXT, command TEXT, scene TEXT, slots TEXT, outcome TEXT,"
                " vector BLOB, PRIMARY KEY (space, command))"
            )
            self._plant(seeds)
            self._load()
        except sqlite3.Error as error:
            raise ConfigError(f"memory_path {path!r} cannot be used: {error}; give another path or remove it") from None

    def close(self) -> None:
        with self._lock:
            self._db.close()

    def __len__(self) -> int:
        return len(self._examples)

    def nearest(self, command: str, k: int) -> list[Example]:
        """The k examples most similar to a command, best first."""
        query = self._embed(command)
        with self._lock:
            cosines = self._vectors @ query
            order = np.argsort(-cosines)[:k]
            found = [self._examples[i] for i in order]
        return [
            Example(e.command, e.scene, e.slots, e.seed, float(cosines[i])) for e, i in zip(found, order, strict=True)
        ]

    def learn(self, command: str, scene: str, slots: Slots, outcome: str) -> None:
        """Keep a decision that worked out. A command that the bank already knows is left as it is."""
        vector = self._embed(command)
        with self._lock:
            self._insert(command, scene, slots, outcome, vector)
            self._db.execute(
                "DELETE FROM example WHERE rowid IN (SELECT rowid FROM example WHERE outcome != 'seed' AND space = ?"
                " ORDER BY rowid DESC LIMIT -1 OFFSET ?)",
                (self._embedder.name, MAX_LEARNT),
            )
            self._db.commit()
            self._load()

    def _embed(self, command: str) -> Vector:
        """E(.) without final punctuation, which moves a short command's vector by as much as a word does."""
        return self._embedder.embed(command.rstrip(" .!?\u3002\uff01\uff1f"))

    def _plant(self, seeds: Path) -> None:
        known = {
            command
            for (command,) in self._db.execute("SELECT command FROM example WHERE space = ?", (self._embedder.name,))
        }
        for number, line in enumerate(seeds.read_text(encoding="utf-8").splitlines(), 1):
            try:
                seed = _Seed.model_validate_json(line)
            except ValidationError as error:
                raise ConfigError(f"{seeds}:{number}: {error.errors()[0]['msg']}") from None
            if seed.command not in known:
                self._insert(seed.command, seed.scene, seed.slots, "seed", self._embed(seed.command))
        self._db.commit()

    def _insert(self, command: str, scene: str, slots: Slots, outcome: str, vector: Vector) -> None:
        self._db.execute(
            "INSERT OR IGNORE INTO example VALUES (?, ?, ?, ?, ?, ?)",
            (self._embedder.name, command, scene, slots.compact(), outcome, vector.tobytes()),
        )

    def _load(self) -> None:
        rows = self._db.execute(
            "SELECT command, scene, slots, outcome, vector FROM example WHERE space = ? ORDER BY rowid",
            (self._embedder.name,),
        ).fetchall()
        self._examples = [Example(c, s, Slots.model_validate_json(j), o == "seed") for c, s, j, o, _ in rows]
        self._vectors = np.frombuffer(b"".join(r[4] for r in rows), np.float32).reshape(-1, DIMENSION)
