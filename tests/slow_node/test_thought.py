"""How a command was understood, within the bounds of its topic."""

from __future__ import annotations

import pytest

from schemas.wire.codec import decode, encode
from schemas.wire.messages import Thought
from schemas.wire.topics import THOUGHT
from slow_node.memory.bank import Example
from slow_node.thought import Trace, thought_of
from slow_node.understanding.slots import Slots

SLOTS = Slots(outcome="directive", speed="faster")


def thought(trace: Trace, command: str = "faster") -> Thought:
    return thought_of(
        trace, epoch=1, stamp_ns=1, command_id=3, command=command, source="m", outcome="issued", slots=SLOTS
    )


@pytest.mark.parametrize("letter", ["x", "ü", "界", "🚗", "\ud800"])
@pytest.mark.parametrize("turns", [2, 18, 60])
def test_a_thought_is_small_enough_to_be_sent_whatever_was_thought(letter: str, turns: int) -> None:
    long = letter * 5000
    slots = Slots(outcome="directive", reasoning="x" * 400, say="ü" * 300)
    trace = Trace(
        reading=long,
        nearest=(Example(long, long, slots, outcome=long, cosine=0.9),) * 8,
        prompt=[{"role": "user", "content": long}] * turns,
        answers=[long] * 3,
        guards=[long] * 5,
        spans_ms={"parser": 1.0, "memory": 2.0, "model": 3.0},
    )
    message = thought(trace, long)
    assert message.trimmed
    assert decode(THOUGHT, encode(message)) == message


def test_what_fits_is_left_as_it_is() -> None:
    prompt = [{"role": "system", "content": "s" * 4000}, {"role": "user", "content": "faster"}]
    message = thought(Trace(prompt=prompt, answers=['{"outcome":"directive"}'], spans_ms={"model": 812.345}))
    assert [turn.content for turn in message.prompt] == [turn["content"] for turn in prompt]
    assert (message.answers, message.spans_ms, message.trimmed) == (
        ('{"outcome":"directive"}',),
        {"model": 812.35},
        False,
    )


def test_a_long_turn_is_cut_before_a_short_one() -> None:
    prompt = [{"role": "system", "content": "s" * 9000}, {"role": "user", "content": "the very words"}]
    message = thought(Trace(prompt=prompt))
    assert message.prompt[1].content == "the very words"
    assert 5000 < len(message.prompt[0].content) < 6100
