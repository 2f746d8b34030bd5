"""What a passenger prefers on every drive, kept in the bank's file, and how it shows in driving."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterable
from dataclasses import dataclass

from msgspec.structs import replace

from schemas.wire.messages import Directive
from slow_node.understanding.slots import Slots

KINDS = {
    "gentle": "drives calmly, 2 s behind others",
    "room": "keeps 3 s behind others",
    "no_passing": "overtakes only when asked to",
}
"""Every kind, and what the car does for it."""
ROOM_S = 3.0
"""Where no gap is named."""


@dataclass(frozen=True)
class Preference:
    """One that was said, in the passenger's words."""

    kind: str
    said: str


TABLE = "CREATE TABLE IF NOT EXISTS preference (kind TEXT PRIMARY KEY, said TEXT)"


class Preferring:
    """The part of a memory bank that keeps preferences, in its database."""

    _db: sqlite3.Connection
    _lock: threading.Lock

    def preferences(self) -> tuple[Preference, ...]:
        """What the passenger prefers on every drive."""
        with self._lock:
            rows = self._db.execute("SELECT kind, said FROM preference ORDER BY kind").fetchall()
        return tuple(Preference(kind, said) for kind, said in rows if kind in KINDS)

    def prefer(self, preference: Preference) -> None:
        """Keep one, in the place of another of its kind."""
        with self._lock, self._db:
            self._db.execute("INSERT OR REPLACE INTO preference VALUES (?, ?)", (preference.kind, preference.said))

    def drop(self, kind: str) -> bool:
        """Remove one; False where there is none of that kind."""
        with self._lock, self._db:
            return self._db.execute("DELETE FROM preference WHERE kind = ?", (kind,)).rowcount > 0


@dataclass(frozen=True)
class Manner:
    """The preferences that stand, as they show in what is asked of the fast node. A wish that names a gap, a lane or an
    overtake is done as it was said."""

    kinds: frozenset[str] = frozenset()

    @classmethod
    def of(cls, preferences: Iterable[Preference]) -> Manner:
        return cls(frozenset(one.kind for one in preferences))

    def wished(self, slots: Slots) -> Slots:
        """A wish without what would overtake unasked."""
        if "no_passing" not in self.kinds or slots.outcome != "directive" or slots.overtake is not None:
            return slots
        hurries = slots.speed == "faster" and slots.lane == "none"
        return slots.model_copy(update={"overtake": False}) if hurries else slots

    def styled(self, draft: Directive) -> Directive:
        """A directive driven in the passenger's manner."""
        if not self.kinds or draft.manoeuvre == "stop":
            return draft
        if "room" in self.kinds and draft.headway_s is None and draft.manoeuvre != "overtake":
            draft = replace(draft, headway_s=ROOM_S)
        if "gentle" in self.kinds:
            draft = replace(draft, style="normal" if draft.manoeuvre == "overtake" else "calm")
        return draft
