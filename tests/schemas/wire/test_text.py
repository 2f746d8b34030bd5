"""Texts of strangers, made fit to be shown."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from deploy.run.status import Live
from schemas.wire.messages import Reply
from schemas.wire.text import json_line, plain

NASTY = "\x1b]0;owned\x07\x1b[2J done\nheard \u009b1mforged \x7f \u202eright to left \u2028 next \ud800"


@given(st.text(), st.integers(1, 40))
def test_any_text_is_one_line_that_a_terminal_takes_for_nothing_else(text: str, most: int) -> None:
    shown = plain(text, most)
    assert len(shown) <= most
    assert not [c for c in shown if c < " " or "\x7f" <= c <= "\x9f" or c in "\u2028\u2029\u202e"]
    shown.encode()
    assert plain(shown) == shown


@given(st.text())
def test_json_is_fit_for_a_terminal_and_loses_nothing(text: str) -> None:
    line = json_line({"text": text})
    assert json.loads(line) == {"text": text}
    assert not [c for c in line if c < " " or "\x7f" <= c <= "\x9f" or c == "\u202e"]


def test_words_keep_their_letters_signs_and_pictures() -> None:
    said = "Schneller, s\u0027il vous plaît! \u0646\u0639\u0645 界 👨\u200d👩\u200d👧"
    assert plain(said) == said


def test_what_a_model_says_cannot_forge_a_line_of_the_run() -> None:
    reply = Reply(epoch=1, stamp_ns=1, command_id=1, outcome="issued", text=NASTY, say=NASTY, why=NASTY)
    line = Live().reply(reply)
    assert line.isprintable()
    assert line.startswith("  issued")
