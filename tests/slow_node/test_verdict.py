"""Who is right where reader and language model differ: the likelier one, and never a model against a refusal."""

from __future__ import annotations

import pytest

from schemas.wire.program import Program, Step, Trigger
from slow_node.planning.program_text import same
from slow_node.understanding.slots import Outcome, Slots
from slow_node.verdict import Said, agrees, unsaid, weighed

LEFT = Program(outcome="directive", steps=(Step(act="lane", side="left", count=1),))


def said(outcome: Outcome = "directive", confidence: float = 0.9, *, agreed: bool = False) -> Said:
    return Said(Program(outcome=outcome), Slots(outcome=outcome), confidence, agreed, "something")


FASTER, NOTHING, DANGER = (
    Slots(outcome="directive", speed="faster"), Slots(outcome="out_of_scope"), Slots(outcome="refused"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("model", "first", "confidence", "sure", "acted", "verdict"),
    [
        (said(agreed=True), FASTER, 0.2, False, True, "confirmed"),
        (said(), FASTER, 0.6, False, True, "refined"),
        (said("unclear"), FASTER, 0.6, False, True, "withdrew"),
        (said(), FASTER, 0.3, False, False, "decided"),
        (said(confidence=0.5), FASTER, 0.6, False, True, "overruled"),
        (said(confidence=0.2), FASTER, 0.3, False, False, "overruled"),
        (said(confidence=1.0), FASTER, 1.0, True, True, "overruled"),
        (said(confidence=1.0), DANGER, 0.0, False, False, "overruled"),
        (said("unclear", 1.0), DANGER, 0.0, False, False, "overruled"),
        (said(), NOTHING, 0.6, False, True, "refined"),
    ],
)
def test_the_likelier_answer_counts_and_a_refusal_stands(
    model: Said, first: Slots, confidence: float, sure: bool, acted: bool, verdict: str
) -> None:
    found, why = weighed(model, first, confidence, sure=sure, acted=acted)
    assert found == verdict
    assert bool(why) == (verdict == "overruled")


def drive(value: float, **fields: object) -> Program:
    step = Step(act="drive", value=value, unit="mps", **fields)  # type: ignore[arg-type]
    return Program(outcome="directive", steps=(step,))


def test_a_number_that_nobody_said_makes_an_answer_unusable() -> None:
    assert unsaid(drive(25.0), "90 km/h please", None) == ""
    assert unsaid(drive(30.0), "90 km/h please", None) == "30 mps"
    assert unsaid(drive(30.0), "as the one before", drive(30.0)) == ""
    assert unsaid(drive(20.0, when=Trigger(kind="time", value=9.0)), "72 km/h in ten seconds", None) == "9"
    half = Program(outcome="directive", steps=(Step(act="slower", value=0.5, unit="times", mode="factor"),))
    assert unsaid(half, "half as fast", None) == ""


def test_two_programs_agree_where_they_ask_for_the_same_in_other_words_at_once() -> None:
    slots = Slots(outcome="directive", lane="left")
    bare = Program(outcome="directive", steps=(Step(act="lane", side="left"),))
    later = Program(outcome="directive", steps=(Step(act="lane", side="left", when=Trigger(kind="done")),))
    assert agrees(LEFT, slots, bare, slots)
    assert not agrees(later, slots, bare, slots)
    assert same(drive(25.0), drive(25.2, mode="to"))
    assert not same(drive(25.0), drive(25.2, mode="at_most"))
