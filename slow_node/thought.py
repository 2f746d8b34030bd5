"""How a command was understood, as it is published for people who look: the topic `thought`, bounded in size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from schemas.wire.messages import Recalled, Thought, Turn
from slow_node.llm.dialect import Chat
from slow_node.memory.bank import Example
from slow_node.understanding.slots import Slots

PROMPT_BYTES, ANSWER_BYTES, ANSWERS = 6000, 1500, 2
"""Of all turns together, and of each answer: a message of this topic stays below its `max_bytes` in any language."""
COMMAND_BYTES, SLOTS_BYTES, NOTE_BYTES = 500, 500, 300
RECALLED, RECALLED_BYTES = 8, 120
TURNS = 20
"""Of the prompt, the newest."""


@dataclass
class Trace:
    """What happens while a command is interpreted. The interpreter fills it in."""

    reading: str = ""
    """What the intent parser made of it."""
    nearest: tuple[Example, ...] = ()
    prompt: Chat = field(default_factory=list)
    answers: list[str] = field(default_factory=list)
    """The model's, as they came: the second one is a repair."""
    guards: list[str] = field(default_factory=list)
    """What was changed of the answer, or why it was not followed."""
    spans_ms: dict[str, float] = field(default_factory=dict)
    prompt_tokens: int = 0
    answer_tokens: int = 0


class _Cutter:
    """Cuts texts to a number of UTF-8 bytes, and remembers whether it had to."""

    def __init__(self) -> None:
        self.cut = False

    def __call__(self, text: str, most: int) -> str:
        raw = text.encode(errors="replace")
        if len(raw) <= most:
            return raw.decode()
        self.cut = True
        return raw[:most].decode(errors="ignore") + "…"


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
    """The message for a trace; what is too long for it is cut off, and `trimmed` says so."""
    cut = _Cutter()
    turns = trace.prompt[-TURNS:]
    room = _share([len(turn["content"].encode(errors="replace")) for turn in turns], PROMPT_BYTES)
    return Thought(
        epoch=epoch,
        stamp_ns=stamp_ns,
        command_id=command_id,
        command=cut(command, COMMAND_BYTES),
        source=cut(source, RECALLED_BYTES),
        outcome=outcome,
        reading=cut(trace.reading, NOTE_BYTES),
        recalled=tuple(
            Recalled(
                command=cut(example.command, RECALLED_BYTES),
                similarity=round(example.cosine, 3),
                slots=cut(_bare(example.slots), RECALLED_BYTES),
                outcome=cut(example.outcome, RECALLED_BYTES),
            )
            for example in trace.nearest[:RECALLED]
        ),
        prompt=tuple(Turn(role=turn["role"], content=cut(turn["content"], room)) for turn in turns),
        answers=tuple(cut(answer, ANSWER_BYTES) for answer in trace.answers[-ANSWERS:]),
        guards=tuple(cut(guard, NOTE_BYTES) for guard in trace.guards[:ANSWERS]),
        slots="" if slots is None else cut(_bare(slots), SLOTS_BYTES),
        spans_ms={name: round(ms, 2) for name, ms in trace.spans_ms.items()},
        prompt_tokens=trace.prompt_tokens,
        answer_tokens=trace.answer_tokens,
        trimmed=cut.cut or len(turns) < len(trace.prompt),
    )


def _bare(slots: Slots) -> str:
    """What decides what the car does, without the words about it."""
    return slots.model_copy(update={"reasoning": "", "say": ""}).compact()


def _share(sizes: Sequence[int], total: int) -> int:
    """The most that each may have, so that all together have `total` at most: the short ones leave room to the long."""
    left, most = total, total
    for place, size in enumerate(sorted(sizes)):
        most = left // (len(sizes) - place)
        if size > most:
            return most
        left -= size
    return most
