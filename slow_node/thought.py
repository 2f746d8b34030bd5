"""How a command was understood, for people who look: bounded in size on the topic `thought`, whole in a file."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from schemas.runtime.process import log
from schemas.wire.messages import Verdict
from schemas.wire.text import json_line
from schemas.wire.thought import Recalled, Thought, Try, Turn
from slow_node.llm.dialect import Chat
from slow_node.llm.model import Call
from slow_node.memory.bank import Example
from slow_node.understanding.slots import Slots

ROOM_BYTES = 12_500
"""Of all texts together: with what encodes them, a message stays below its topic's `max_bytes` in any language."""
TURNS, TRIES, ANSWERS, RECALLED, GUARDS = 20, 6, 2, 8, 4
"""How many of each a message has; of the first three the newest."""
FILE_BYTES = 16_000_000
"""A file that has grown so long makes room for another; the one before it is kept beside it."""


@dataclass
class Trace:
    """What happens while a command is interpreted. The interpreter fills it in."""

    began_s: float = field(default_factory=time.time)
    """Unix time."""
    reading: str = ""
    """What the intent parser made of it."""
    nearest: tuple[Example, ...] = ()
    model: str = ""
    """Who was asked; "": nobody."""
    prompt: Chat = field(default_factory=list)
    calls: list[Call] = field(default_factory=list)
    """Every exchange with the model's server."""
    answers: list[str] = field(default_factory=list)
    """The model's, as they came: the second one is a repair."""
    parses: list[str] = field(default_factory=list)
    """Of each answer, why it could not be used; "" where it could."""
    guards: list[str] = field(default_factory=list)
    """What was changed of the answer, or why it was not followed."""
    spans_ms: dict[str, float] = field(default_factory=dict)
    prompt_tokens: int = 0
    answer_tokens: int = 0
    cost_usd: float | None = None
    verdict: Verdict = ""
    """What the model's answer did to the reader's."""
    again: str = ""
    """Why the model was asked once more."""


def thought_of(
    trace: Trace,
    *,
    epoch: int,
    stamp_ns: int,
    command_id: int,
    command: str,
    source: str,
    outcome: str,
    slots: Slots | None,
) -> Thought:
    """All of a trace. Only `shortened` makes it fit for the bus."""
    return Thought(
        epoch=epoch,
        stamp_ns=stamp_ns,
        command_id=command_id,
        command=command,
        source=source,
        outcome=outcome,
        reading=trace.reading,
        recalled=tuple(
            Recalled(
                command=example.command,
                similarity=round(example.cosine, 3),
                slots=_bare(example.slots),
                outcome=example.outcome,
            )
            for example in trace.nearest
        ),
        prompt=tuple(Turn(role=turn["role"], content=turn["content"]) for turn in trace.prompt),
        answers=tuple(trace.answers),
        guards=tuple(trace.guards),
        slots="" if slots is None else _bare(slots),
        spans_ms={name: round(ms, 2) for name, ms in trace.spans_ms.items()},
        prompt_tokens=trace.prompt_tokens,
        answer_tokens=trace.answer_tokens,
        model=trace.model,
        tries=tuple(_tries(trace)),
        cost_usd=trace.cost_usd,
        verdict=trace.verdict,
        again=trace.again,
    )


def _tries(trace: Trace) -> Iterator[Try]:
    parses = iter(trace.parses)
    for call in trace.calls:
        answer = call.answer
        yield Try(
            ms=round(call.ms, 2),
            asked=call.format,
            failed=call.error,
            unusable="" if call.error else next(parses, ""),
            thinking=answer.thinking if answer else "",
            finish=answer.finish if answer else "",
            prompt_tokens=answer.prompt_tokens if answer else 0,
            answer_tokens=answer.answer_tokens if answer else 0,
        )


def shortened(thought: Thought, room_bytes: int = ROOM_BYTES) -> Thought:
    """The message for the bus; what is too long for it is cut off, and `trimmed` says so."""
    few = replace(
        thought,
        prompt=thought.prompt[-TURNS:],
        tries=thought.tries[-TRIES:],
        answers=thought.answers[-ANSWERS:],
        recalled=thought.recalled[:RECALLED],
        guards=thought.guards[:GUARDS],
    )
    raw = msgspec.to_builtins(few)
    sizes: list[int] = []

    def measure(text: str) -> str:
        sizes.append(len(_utf8(text)))
        return text

    _each_text(raw, measure)
    most = _share(sizes, room_bytes)
    cut = _each_text(raw, lambda text: _cut(text, most))
    short: Thought = msgspec.convert(cut, Thought)
    return replace(short, trimmed=few != thought or max(sizes) > most)


class ThoughtsFile:
    """Appends whole thoughts to a file, a JSON object on each line. A full disk costs the file, not the node."""

    def __init__(self, path: str) -> None:
        """`path` "": nothing is kept."""
        self._path = Path(path) if path else None

    def write(self, thought: Thought) -> None:
        """Keep one; it is on the disk's side when this returns."""
        if self._path is None:
            return
        line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **msgspec.to_builtins(thought)}
        try:
            if self._path.exists() and self._path.stat().st_size > FILE_BYTES:
                os.replace(self._path, self._path.with_suffix(".old.jsonl"))
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json_line(line) + "\n")
        except OSError as error:
            log("slow", "thoughts", f"no thought is kept in {self._path} any more: {error.strerror}")
            self._path = None


def _bare(slots: Slots) -> str:
    """What decides what the car does, without the words about it."""
    return slots.model_copy(update={"reasoning": "", "say": ""}).compact()


def _each_text(raw: Any, change: Callable[[str], str]) -> Any:
    """The same structure with every text changed; keys stay."""
    if isinstance(raw, str):
        return change(raw)
    if isinstance(raw, dict):
        return {key: _each_text(value, change) for key, value in raw.items()}
    return [_each_text(one, change) for one in raw] if isinstance(raw, (list, tuple)) else raw


def _utf8(text: str) -> bytes:
    return text.encode(errors="replace")


def _cut(text: str, most: int) -> str:
    raw = _utf8(text)
    return raw.decode() if len(raw) <= most else raw[:most].decode(errors="ignore") + "…"


def _share(sizes: Sequence[int], total: int) -> int:
    """The most that each may have, so that all together have `total` at most: the short ones leave room to the long."""
    left, most = total, total
    for place, size in enumerate(sorted(sizes)):
        most = left // (len(sizes) - place)
        if size > most:
            return most
        left -= size
    return most
