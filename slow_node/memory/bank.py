"""The memory bank D and its retrieval M_t (paper's Eq. 6): SQLite on disk, exact cosine in NumPy.

Sentences are embedded from the command alone; the scene travels with the example as text. Only the shipped examples may
overrule the model (`slow_node.planning.directive`): what was learnt on the road came from the model itself.
"""

from __future__ import annotations

import math
import sqlite3
import stat
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, Field

from schemas.driving.measures import INF
from schemas.runtime.process import ConfigError
from slow_node.llm.embedding import DIMENSION, Embedder, Vector
from slow_node.memory.examples import EXAMPLES, embed_command, read_shipped, shipped_vectors
from slow_node.memory.preferences import TABLE, Preferring
from slow_node.understanding.slots import Slots

SHIPPED = "seed"
"""The outcome of an example that is shipped, as banks and their exports have it."""
GIVEN_UP = ("superseded", "cancelled")
MAX_LEARNT = 2000
"""The bank's bound: beyond it the oldest learnt example goes."""
SAME_COSINE = 0.98
"""A learnt command this near to another learnt one with the same decision is the same experience: they are merged."""
FILE_BYTES, TEXT_CHARS = 200_000_000, 10_000
"""Of a bank's file, and of each text in it, at most: ours have some megabytes, and some hundred characters."""
TAKEN_BACK = "taken back"  # outcome of a wish that the passenger found to be too much
Lesson = Literal["", "less", "gentler"]
NEAR_MISS_S = 1.5
"""A smaller time to collision is a near miss, in the usual sense of traffic conflict studies."""


@dataclass(frozen=True)
class Example:
    """A command, the scene it was said in, and what it was taken to mean."""

    command: str
    scene: str
    slots: Slots
    outcome: str = SHIPPED
    """What came of it the last time: "seed" for what is shipped, else "fulfilled", "expired, held up by RULE", ..."""
    took_s: float = 0.0
    """From the directive to its end, the last time."""
    min_ttc_s: float = INF
    """Smallest time to collision meanwhile, the worst of all times; inf where nothing came closer, or was not kept."""
    fulfilled: int = 0
    failed: int = 0
    """How often it came true, and how often not."""
    trouble: str = ""
    """The last outcome that was other than plainly "fulfilled", with the rule that was in the way."""
    cosine: float = 0.0
    id: int = 0

    @property
    def shipped(self) -> bool:
        return self.outcome == SHIPPED

    @property
    def warning(self) -> str:
        """What went wrong so far, for the prompt; "" where nothing did."""
        times = self.fulfilled + self.failed
        notes = [self.trouble] if self.trouble else []
        if self.failed and times > 1:
            notes = [f"{self.trouble} ({self.failed} of {times} times)"]
        if self.min_ttc_s < NEAR_MISS_S:
            notes.append(f"near miss, {self.min_ttc_s:.1f} s from a collision")
        return f"{'last time' if times <= 1 else 'before'}: {'; '.join(notes)}" if notes else ""

    @property
    def lesson(self) -> Lesson:
        """What to do differently the next time; "" for nothing."""
        if self.trouble.startswith(TAKEN_BACK):
            return "less"
        return "gentler" if self.min_ttc_s < NEAR_MISS_S else ""

    def after(self, older: Example) -> Example:
        """The two as one experience: the newer's words and outcome, with what went wrong in both."""
        return replace(
            self,
            min_ttc_s=min(self.min_ttc_s, older.min_ttc_s),
            fulfilled=self.fulfilled + older.fulfilled,
            failed=self.failed + older.failed,
            trouble=self.trouble or older.trouble,
        )


def wordless(slots: Slots) -> Slots:
    """The slots without a model's own words: what one model has said is never shown to another as its own turn."""
    return slots.model_copy(update={"reasoning": "", "say": ""})


def experience(
    command: str, scene: str, slots: Slots, outcome: str, took_s: float = 0.0, min_ttc_s: float = INF
) -> Example:
    """A decision and what came of it, this once. What the passenger gave up has neither come true nor failed."""
    slots = wordless(slots)
    came_true = outcome.startswith("fulfilled")
    given_up = outcome.startswith(GIVEN_UP)
    return Example(
        command,
        scene,
        slots,
        outcome,
        took_s,
        min_ttc_s,
        int(came_true),
        int(not (came_true or given_up)),
        "" if outcome in ("fulfilled", *GIVEN_UP) else outcome,
    )


class Row(BaseModel):
    """An example as `fastslow memory export` writes it; `import` reads the same, with or without the last six."""

    id: int = 0
    command: str = Field(min_length=1, max_length=4000)
    scene: str = Field(max_length=1000)
    slots: Slots
    outcome: str = Field(min_length=1, max_length=200)
    took_s: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    min_ttc_s: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    fulfilled: int = Field(default=0, ge=0, le=1_000_000)
    failed: int = Field(default=0, ge=0, le=1_000_000)
    trouble: str = Field(default="", max_length=200)

    @classmethod
    def of(cls, example: Example) -> Row:
        """Times rounded to hundredths of a second."""
        return cls.model_construct(
            id=example.id,
            command=example.command,
            scene=example.scene,
            slots=example.slots,
            outcome=example.outcome,
            took_s=round(example.took_s, 2),
            min_ttc_s=None if math.isinf(example.min_ttc_s) else round(example.min_ttc_s, 2),
            fulfilled=example.fulfilled,
            failed=example.failed,
            trouble=example.trouble,
        )

    def learnt(self) -> Example:
        """To be merged into a bank. Raises ValueError for a shipped one: those are never learnt."""
        if self.outcome == SHIPPED:
            raise ValueError('outcome "seed" is what the shipped examples have; say what came of it, e.g. "fulfilled"')
        once = experience(
            self.command,
            self.scene,
            self.slots,
            self.outcome,
            self.took_s,
            INF if self.min_ttc_s is None else self.min_ttc_s,
        )
        if not self.fulfilled + self.failed:
            return once
        return replace(once, fulfilled=self.fulfilled, failed=self.failed, trouble=self.trouble)


class Memory(Preferring):
    """Open with a file's path, or with "" for a bank that ends with the process. Safe to call from any thread.

    `shipped` None: nothing is planted. Raises `ConfigError` where the file cannot be used.
    """

    def __init__(self, embedder: Embedder, path: str = "", shipped: Path | None = EXAMPLES) -> None:
        self._embedder = embedder
        self._lock = threading.Lock()
        self._examples: list[Example] = []
        self._vectors: Vector = np.empty((0, DIMENSION), np.float32)
        _refuse_odd(path)
        try:
            self._db = sqlite3.connect(path or ":memory:", check_same_thread=False)
            _refuse_foreign(self._db)
            self._db.execute("PRAGMA journal_mode=WAL")
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")  # two processes may open one bank at once
                self._migrate()
            if shipped is not None:
                self._plant(shipped)
            self._load()
        except (sqlite3.Error, ValueError, TypeError) as error:
            why = str(error).splitlines()[0]
            raise ConfigError(f"the memory bank {path} cannot be used: {why}; {_fix(error)}") from None

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
        """M_t: the k examples most similar to a command, best first; of the equally similar, the shipped first."""
        if k <= 0 or not self._examples:
            return []
        query = embed_command(self._embedder, command)
        with self._lock:
            cosines = self._vectors @ query
            order = np.argsort(-np.round(cosines, 3), kind="stable")  # shipped vectors are of half precision
            return [replace(self._examples[i], cosine=float(cosines[i])) for i in order[:k]]

    def learn(
        self, command: str, scene: str, slots: Slots, outcome: str, took_s: float = 0.0, min_ttc_s: float = INF
    ) -> None:
        """Keep a decision and what came of it, merged with like experiences."""
        self.add([experience(command, scene, slots, outcome, took_s, min_ttc_s)])

    def add(self, examples: Sequence[Example]) -> int:
        """Learn experiences, all or none, and return how many examples of the bank hold them now.

        A like one (`SAME_COSINE`) with the same decision is merged, the same command with another decision replaced:
        the newest reading of the same words counts. Shipped ones are left as they are.
        """
        vectors = [embed_command(self._embedder, example.command) for example in examples]
        with self._lock:
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")
                self._load()  # another process may have edited the bank meanwhile
                ids = {self._merge(example, vector) for example, vector in zip(examples, vectors, strict=True)}
            return sum(example.id in ids for example in self._examples)

    def forget(self, identity: int) -> bool:
        """Remove one example by its id, until a shipped one is planted again; False where there is none."""
        with self._lock:
            gone = (
                self._db.execute(
                    "DELETE FROM experience WHERE id = ? AND space = ?", (identity, self._embedder.name)
                ).rowcount
                > 0
            )
            self._db.commit()
            self._load()
        return gone

    def _merge(self, new: Example, vector: Vector) -> int:
        """Store one experience in the place of those like it; its id."""
        like = self._vectors @ vector > SAME_COSINE
        replaced, kept, learnt = [], [], 0
        for index in reversed(range(len(self._examples))):  # newest first
            old = self._examples[index]
            if not old.shipped and like[index] and old.slots.decision() == new.slots.decision():
                new = new.after(old)
                replaced.append((old.id,))
            elif not old.shipped and (old.command == new.command or learnt >= MAX_LEARNT - 1):
                replaced.append((old.id,))
            else:
                learnt += not old.shipped
                kept.append(index)
        kept.reverse()
        self._db.executemany("DELETE FROM experience WHERE id = ?", replaced)
        new = replace(new, id=self._insert(new, vector))
        self._examples = [*(self._examples[index] for index in kept), new]
        self._vectors = np.vstack([self._vectors[kept], vector])
        return new.id

    def _migrate(self) -> None:
        """Make the table. Banks of fastslow 0.1.0 had one row per command, without the history of what came of it."""
        self._db.execute(TABLE)
        columns = {column[1] for column in self._db.execute("PRAGMA table_info(experience)")}
        if "trouble" in columns:
            return
        if columns:
            self._db.execute("ALTER TABLE experience RENAME TO experience_0_1")
        self._db.execute(
            "CREATE TABLE experience (id INTEGER PRIMARY KEY AUTOINCREMENT, space TEXT, command TEXT, scene TEXT,"
            " slots TEXT, outcome TEXT, took_s REAL, min_ttc_s REAL, fulfilled INTEGER, failed INTEGER, trouble TEXT,"
            " vector BLOB)"
        )
        self._db.execute("CREATE UNIQUE INDEX one_seed ON experience (space, command) WHERE outcome = 'seed'")
        if columns:
            self._db.execute(
                "INSERT INTO experience SELECT rowid, space, command, scene, slots, outcome, took_s,"
                f" {'min_ttc_s' if 'min_ttc_s' in columns else 'NULL'}, outcome LIKE 'fulfilled%',"
                " outcome != 'seed' AND outcome NOT LIKE 'fulfilled%',"
                " CASE WHEN outcome IN ('seed', 'fulfilled') THEN '' ELSE outcome END, vector"
                " FROM experience_0_1 ORDER BY rowid"
            )
            self._db.execute("DROP TABLE experience_0_1")

    def _plant(self, path: Path) -> None:
        known = {
            command
            for (command,) in self._db.execute(
                "SELECT command FROM experience WHERE space = ? AND outcome = 'seed'", (self._embedder.name,)
            )
        }
        shipped = read_shipped(path)
        missing = [index for index, example in enumerate(shipped) if example.command not in known]
        if not missing:
            return
        vectors = shipped_vectors(self._embedder, shipped, path)
        for index in missing:
            example = shipped[index]
            vector = embed_command(self._embedder, example.command) if vectors is None else vectors[index]
            self._insert(Example(example.command, example.scene, example.slots), vector)
        self._db.commit()

    def _insert(self, example: Example, vector: Vector) -> int:
        """The row's id. A shipped one that another process planted meanwhile is left as it is."""
        row = self._db.execute(
            "INSERT OR IGNORE INTO experience (space, command, scene, slots, outcome, took_s, min_ttc_s, fulfilled,"
            " failed, trouble, vector) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                self._embedder.name,
                example.command,
                example.scene,
                example.slots.compact(),
                example.outcome,
                example.took_s,
                None if example.min_ttc_s == INF else example.min_ttc_s,
                example.fulfilled,
                example.failed,
                example.trouble,
                vector.tobytes(),
            ),
        )
        return row.lastrowid or 0

    def _load(self) -> None:
        rows = self._db.execute(
            "SELECT command, scene, slots, outcome, took_s, min_ttc_s, fulfilled, failed, trouble, id, vector"
            " FROM experience WHERE space = ? ORDER BY id",
            (self._embedder.name,),
        ).fetchall()
        self._examples = [_example(row) for row in rows]
        vectors = np.frombuffer(b"".join(r[-1] for r in rows), np.float32).reshape(len(rows), DIMENSION)
        if not np.isfinite(vectors).all():
            raise ValueError("a vector that is not finite")
        self._vectors = vectors


def _refuse_odd(path: str) -> None:
    """Raises `ConfigError` for what is no file, which SQLite would wait for, and for one too large to be a bank."""
    try:
        there = Path(path).stat() if path else None
    except FileNotFoundError:  # it will be made
        return
    except (OSError, ValueError) as error:
        raise ConfigError(f"the memory bank {path} cannot be used: {error}; give another path") from None
    if there is not None and not stat.S_ISREG(there.st_mode):
        raise ConfigError(f"the memory bank {path} is no file: give another path")
    if there is not None and there.st_size > FILE_BYTES:
        raise ConfigError(f"the memory bank {path} is larger than {FILE_BYTES:,} bytes: give another path")


def _refuse_foreign(db: sqlite3.Connection) -> None:
    """Raises ValueError for the database of another program, into which nothing is written."""
    tables = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    columns = {column[1] for column in db.execute("PRAGMA table_info(experience)")}
    if tables - {"experience", "preference", "sqlite_sequence"} or (
        columns and not {"space", "command", "vector"} <= columns
    ):
        raise ValueError("it is another program's database")


def _fix(error: Exception) -> str:
    """What a user can do about it."""
    why = str(error)
    if "locked" in why:
        return "another process holds it: end that, or try again later"
    if "readonly" in why or "unable to open" in why:
        return "make it and its folder writable, or give another path"
    if "full" in why:
        return "make room on its disk, or give another path"
    return "give another path, or move it away"


def _example(row: tuple[Any, ...]) -> Example:
    """Raises ValueError for values that a bank does not have: SQLite keeps any type in any column."""
    command, scene, slots, outcome, took, ttc, good, bad, trouble, identity, vector = row
    texts = (command, scene, slots, outcome, trouble)
    if not all(isinstance(text, str) and len(text) <= TEXT_CHARS for text in texts):
        raise ValueError(f"example {identity} has a text that is none, or too long")
    times = (took, INF if ttc is None else ttc)
    if not all(isinstance(time, (int, float)) and time >= 0.0 for time in (*times, good, bad)):
        raise ValueError(f"example {identity} has a number that is none")
    if not isinstance(vector, bytes) or len(vector) != 4 * DIMENSION:
        raise ValueError(f"example {identity} has a vector of another length")
    return Example(command, scene, _slots(slots, outcome), outcome, *times, good, bad, trouble, id=identity)


def _slots(stored: str, outcome: str) -> Slots:
    """Banks of earlier versions have kept a model's words."""
    slots = Slots.model_validate_json(stored)
    return slots if outcome == SHIPPED else wordless(slots)
