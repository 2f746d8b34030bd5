"""The memory bank D and its retrieval M_t (paper's Eq. 5): SQLite on disk, exact cosine in NumPy.

Sentences are embedded from the command alone: similar wishes, not similar roads, are what the answer depends on; the
scene travels with the example as text. Only the shipped seeds may overrule the model (see `slow_node.directive`):
what was learnt on the road came from the model itself.
"""

from __future__ import annotations

import sqlite3
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from schemas.measures import INF
from schemas.process import ConfigError
from slow_node.embedding import DIMENSION, Embedder, Vector
from slow_node.seeds import SEEDS, embed_command, read_seeds, shipped_vectors
from slow_node.slots import Slots

MAX_LEARNT = 2000
"""The bank's bound: beyond it the oldest learnt example goes."""
SAME_COSINE = 0.98
"""A learnt command this near to another learnt one with the same decision is the same experience, and replaces it."""
NEAR_MISS_S = 1.5
"""A smaller time to collision is a near miss, in the usual sense of traffic conflict studies."""


@dataclass(frozen=True)
class Example:
    """A command, the scene it was said in, and what it was taken to mean."""

    command: str
    scene: str
    slots: Slots
    outcome: str = "seed"
    """What came of it: "seed" for what is shipped, else "fulfilled", "expired, held up by RULE", ..."""
    took_s: float = 0.0
    min_ttc_s: float = INF
    """Smallest time to collision meanwhile; inf where nothing came closer, or where it was not kept yet."""
    cosine: float = 0.0
    id: int = 0

    @property
    def seed(self) -> bool:
        return self.outcome == "seed"

    @property
    def warning(self) -> str:
        """What went wrong last time, for the prompt; "" where nothing did."""
        notes = [] if self.outcome in ("seed", "fulfilled") else [self.outcome]
        if self.min_ttc_s < NEAR_MISS_S:
            notes.append(f"near miss, {self.min_ttc_s:.1f} s from a collision")
        return f"last time: {'; '.join(notes)}" if notes else ""


class Memory:
    """Open with a file's path, or with "" for a bank that ends with the process. Safe to call from any thread.

    `seeds` None: nothing is planted. Raises `ConfigError` where the file cannot be used.
    """

    def __init__(self, embedder: Embedder, path: str = "", seeds: Path | None = SEEDS) -> None:
        self._embedder = embedder
        self._lock = threading.Lock()
        try:
            self._db = sqlite3.connect(path or ":memory:", check_same_thread=False)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute(
                "CREATE TABLE IF NOT EXISTS experience (space TEXT, command TEXT, scene TEXT, slots TEXT, outcome TEXT,"
                " took_s REAL, vector BLOB, min_ttc_s REAL, PRIMARY KEY (space, command))"
            )
            self._migrate()
            if seeds is not None:
                self._plant(seeds)
            self._load()
        except sqlite3.Error as error:
            raise ConfigError(f"memory_path {path!r} cannot be used: {error}; give another path or remove it") from None

    def close(self) -> None:
        with self._lock:
            self._db.close()

    def __len__(self) -> int:
        return len(self._examples)

    def examples(self) -> list[Example]:
        """The whole bank, oldest first."""
        with self._lock:
            return list(self._examples)

    def nearest(self, command: str, k: int) -> list[Example]:
        """M_t: the k examples most similar to a command, best first."""
        if k <= 0 or not self._examples:
            return []
        query = embed_command(self._embedder, command)
        with self._lock:
            cosines = self._vectors @ query
            return [replace(self._examples[i], cosine=float(cosines[i])) for i in np.argsort(-cosines)[:k]]

    def learn(self, command: str, scene: str, slots: Slots, outcome: str, took_s: float = 0.0,
              min_ttc_s: float = INF) -> None:
        """Keep a decision and what came of it. Seeds are left as they are; a like experience is replaced."""
        vector = embed_command(self._embedder, command)
        with self._lock:
            cosines = self._vectors @ vector
            for index in np.flatnonzero(cosines > SAME_COSINE):
                old = self._examples[index]
                if not old.seed and old.slots.decision() == slots.decision():
                    self._db.execute("DELETE FROM experience WHERE rowid = ?", (old.id,))
            self._db.execute("DELETE FROM experience WHERE space = ? AND command = ? AND outcome != 'seed'",
                             (self._embedder.name, command))
            self._insert(Example(command, scene, slots, outcome, took_s, min_ttc_s), vector)
            self._db.execute(
                "DELETE FROM experience WHERE rowid IN (SELECT rowid FROM experience WHERE outcome != 'seed' AND"
                " space = ? ORDER BY rowid DESC LIMIT -1 OFFSET ?)",
                (self._embedder.name, MAX_LEARNT),
            )
            self._db.commit()
            self._load()

    def forget(self, identity: int) -> bool:
        """Remove one example by its id, until a seed is planted again; False where there is none."""
        with self._lock:
            gone = self._db.execute("DELETE FROM experience WHERE rowid = ? AND space = ?",
                                    (identity, self._embedder.name)).rowcount > 0
            self._db.commit()
            self._load()
        return gone

    def _migrate(self) -> None:
        """Banks of fastslow 0.1.0 did not keep the time to collision."""
        with self._db:
            self._db.execute("BEGIN IMMEDIATE")  # two processes may open an old bank at once
            if "min_ttc_s" not in {column[1] for column in self._db.execute("PRAGMA table_info(experience)")}:
                self._db.execute("ALTER TABLE experience ADD COLUMN min_ttc_s REAL")

    def _plant(self, path: Path) -> None:
        known = {
            command
            for (command,) in self._db.execute("SELECT command FROM experience WHERE space = ?", (self._embedder.name,))
        }
        seeds = read_seeds(path)
        missing = [index for index, seed in enumerate(seeds) if seed.command not in known]
        if not missing:
            return
        vectors = shipped_vectors(self._embedder, seeds, path)
        for index in missing:
            seed = seeds[index]
            vector = embed_command(self._embedder, seed.command) if vectors is None else vectors[index]
            self._insert(Example(seed.command, seed.scene, seed.slots), vector)
        self._db.commit()

    def _insert(self, example: Example, vector: Vector) -> None:
        self._db.execute(
            "INSERT OR IGNORE INTO experience (space, command, scene, slots, outcome, took_s, vector, min_ttc_s)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (self._embedder.name, example.command, example.scene, example.slots.compact(), example.outcome,
             example.took_s, vector.tobytes(), None if example.min_ttc_s == INF else example.min_ttc_s),
        )

    def _load(self) -> None:
        rows = self._db.execute(
            "SELECT command, scene, slots, outcome, took_s, min_ttc_s, rowid, vector FROM experience WHERE space = ?"
            " ORDER BY rowid",
            (self._embedder.name,),
        ).fetchall()
        self._examples = [
            Example(c, s, Slots.model_validate_json(j), o, took, INF if ttc is None else ttc, id=i)
            for c, s, j, o, took, ttc, i, _ in rows]
        self._vectors = np.frombuffer(b"".join(r[-1] for r in rows), np.float32).reshape(-1, DIMENSION)
