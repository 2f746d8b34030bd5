"""Wishes whose passenger has not had the last reply, kept in a file: a node that starts again tells of their end."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from schemas.runtime.process import log
from schemas.wire.messages import Command, Reply
from slow_node.planning.replies import sentence

RESTARTED = "the slow node was restarted"
MOST_CHARS = 80
"""Of a wish's words in a reply."""


class Wish(Struct, frozen=True, kw_only=True):
    """One that is open."""

    command: Command
    language: str = "en"


class Unanswered:
    """The file; without a path nothing is kept."""

    def __init__(self, path: str = "") -> None:
        self._path = Path(path) if path else None
        self.left = self._read()
        """What another process of this run has left open."""
        self._kept = tuple(wish.command.id for wish in self.left)

    def keep(self, wishes: Sequence[Wish]) -> None:
        """Write what is open now, if that has changed. A disk that cannot take it costs only the telling."""
        ids = tuple(wish.command.id for wish in wishes)
        if self._path is None or ids == self._kept:
            return
        self._kept = ids
        new = self._path.with_suffix(".new")
        try:
            new.write_bytes(msgspec.json.encode(list(wishes)))
            os.replace(new, self._path)
        except OSError as error:
            log("slow", "wishes", f"open wishes cannot be kept: {error}")

    def _read(self) -> tuple[Wish, ...]:
        if self._path is None:
            return ()
        try:
            return tuple(msgspec.json.decode(self._path.read_bytes(), type=list[Wish]))
        except (OSError, msgspec.DecodeError):
            return ()


def told(wish: Wish, epoch: int, now_ns: int) -> Reply:
    """The last reply to a wish that a restart has ended."""
    text = wish.command.text
    return Reply(
        epoch=epoch,
        stamp_ns=now_ns,
        command_id=wish.command.id,
        outcome="failed",
        text=text[:200],
        why=RESTARTED,
        say=sentence("restarted", wish.language, text=text[:MOST_CHARS]),
    )
