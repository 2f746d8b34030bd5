"""Thoughts on record, read back and worded for people."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import msgspec
from msgspec import Struct

from deploy.record.reader import NotARecordingError, open_recording
from schemas.runtime.files import lines_bounded
from schemas.runtime.process import ConfigError
from schemas.wire.text import plain
from schemas.wire.thought import Thought
from slow_node.config import THOUGHTS

LINE_BYTES = 4_000_000
"""Of a thought on file: a few answers, each bounded by a quarter of that."""
MOST = 20_000
"""Thoughts that are shown at once, the newest: days of a passenger who never stops."""
SHOWN_CHARS = 240
"""Of each text, unless all is asked for."""
LABEL = 10


class Kept(Struct, frozen=True):
    """A thought, and when it was kept."""

    time: str
    """ISO 8601, UTC."""
    thought: Thought


def find(where: Path | None) -> Path:
    """The file meant: `where`, in the folder `where`, or of the newest run below `runs/`. Raises `ConfigError`."""
    if where is None:
        runs = sorted(Path("runs").glob(f"*/{THOUGHTS}"), key=lambda path: path.stat().st_mtime)
        if not runs:
            raise ConfigError(f"no run below runs/ has thoughts: give a run's folder, a {THOUGHTS} or a recording")
        return runs[-1]
    file = where / THOUGHTS if where.is_dir() else where
    if not file.is_file():
        raise ConfigError(f"there is no {file}: give a run's folder, its {THOUGHTS} or its recording")
    return file


def kept_in(file: Path, last: int | None = None) -> list[Kept]:
    """The thoughts in a run's JSONL file, or in a recording (there cut to the bus's size), oldest first; of those the
    newest `last`.

    Lines that are none are left out and told of on stderr. Raises `ConfigError` for a file of another kind.
    """
    try:
        return list(deque(_recorded(file) if file.suffix == ".mcap" else _written(file), min(last or MOST, MOST)))
    except (OSError, NotARecordingError) as error:
        raise ConfigError(f"{file} cannot be read: {error}") from None


def _recorded(file: Path) -> Iterator[Kept]:
    for arrived_ns, _, message in open_recording(file).messages(("thought",)):
        if isinstance(message, Thought):
            yield Kept(datetime.fromtimestamp(arrived_ns / 1e9, UTC).isoformat(timespec="milliseconds"), message)


def _written(file: Path) -> Iterator[Kept]:
    bad, good = 0, 0
    with file.open("rb") as opened:
        for line in lines_bounded(opened, LINE_BYTES):
            try:
                if line is None:
                    raise msgspec.ValidationError("too long")
                row = msgspec.json.decode(line, type=dict[str, object])
                kept = Kept(str(row.pop("time", "")), msgspec.convert(row, Thought))
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                bad += 1
                continue
            good += 1
            yield kept
    if bad and not good:
        raise ConfigError(f"{file} holds no thoughts: give a run's {THOUGHTS} or its recording")
    if bad:
        print(f"fastslow: {bad} lines of {file} are no thoughts, or cut off", file=sys.stderr)


def worded(kept: Kept, *, full: bool = False) -> list[str]:
    """Lines for a terminal. full: with all of every text."""
    thought = kept.thought
    clock = plain(kept.time[11:19])
    by = f", by {plain(thought.source)}" if thought.source else ""
    model = f", language model: {thought.verdict}" if thought.verdict else ""
    lines = [f"{clock} {plain(thought.command)!r}: {plain(thought.outcome)}{by}{model}".strip()]
    for label, text in _parts(thought):
        shown = plain(text, None if full else SHOWN_CHARS)
        if shown:
            lines.append(f"  {label:<{LABEL}} {shown}")
    if thought.trimmed:
        lines.append(f"  {'':<{LABEL}} (cut to the bus's size; the run's {THOUGHTS} has all)")
    return lines


def _parts(thought: Thought) -> Iterator[tuple[str, str]]:
    yield "again", thought.again
    yield "read as", thought.reading
    for number, one in enumerate(thought.recalled):
        words = f"{one.similarity:.2f} {one.command!r} {one.slots} {one.outcome}"
        yield "recalled" if not number else "", words
    for turn in thought.prompt:
        yield f"to {turn.role}" if turn.role != "assistant" else "example", turn.content
    answers = list(thought.answers)
    left = sum(not one_try.failed for one_try in thought.tries)
    for one_try in thought.tries:
        tokens = f", {one_try.prompt_tokens} + {one_try.answer_tokens} tokens" if one_try.prompt_tokens else ""
        how = f", {one_try.finish}" if one_try.finish else ""
        yield "asked", f"{thought.model} for {one_try.asked}: {one_try.ms:,.0f} ms{tokens}{how}"
        yield "failed", one_try.failed
        yield "thinking", one_try.thinking
        if not one_try.failed:
            if left <= len(answers):  # a message on the bus has the newest alone
                yield "answer", answers.pop(0)
            left -= 1
        yield "unusable", one_try.unusable
    if not thought.tries:
        yield "asked", "no model"
    for guard in thought.guards:
        yield "guard", guard
    yield "taken as", thought.slots
    spans = ", ".join(f"{name} {ms:,.0f} ms" for name, ms in thought.spans_ms.items())
    cost = "" if not thought.cost_usd else f"; {thought.cost_usd:.6f} USD"
    yield "took", f"{spans}{cost}"
