"""The reader acts first: what the language model's verdict changes when it comes, and that nothing waits for it."""

from __future__ import annotations

import pytest

from schemas.runtime.clock import NS
from schemas.wire.messages import Verdict
from schemas.wire.program import Program, Step, Trigger
from slow_node.effects import Abandon, Interpret
from slow_node.interpretation import Interpretation
from slow_node.planning.steps import summary
from slow_node.understanding.slots import Slots
from tests.ride import HURRY, LEFT, Ride, directives, scene

RIGHT = Slots(outcome="directive", lane="right")
NOTHING = Slots(outcome="out_of_scope")
DANGER = Slots(outcome="refused")


def riding(*, asks_again: bool = False) -> Ride:
    ride = Ride(asks_again=asks_again)
    ride.look(1, (1, 40.0, 10.0))
    return ride


def calls(ride: Ride) -> list[Interpret]:
    return [effect for effect in ride.out if isinstance(effect, Interpret)]


def test_what_the_reader_is_sure_of_is_done_before_the_model_has_answered() -> None:
    ride = riding()
    ride.read(LEFT)
    assert [d.target_lane for d in ride.directives] == [0]
    assert [(r.outcome, r.verdict) for r in ride.replies] == [("heard", ""), ("issued", "")]


@pytest.mark.parametrize("verdict", ["confirmed", "overruled", "unanswered"])
def test_a_verdict_that_changes_nothing_is_told_and_no_directive_follows(verdict: Verdict) -> None:
    ride = riding()
    ride.answer(ride.read(LEFT), LEFT, verdict, why="because")
    assert len(ride.directives) == 1
    last = ride.replies[-1]
    assert (last.outcome, last.verdict, last.why, last.say) == ("issued", verdict, "because", "")
    assert ride.deliberation.metrics[verdict] == 1


def test_a_refined_command_goes_on_under_its_own_name_with_another_directive() -> None:
    ride = riding()
    ride.answer(ride.read(LEFT), RIGHT, "refined")
    assert [d.target_lane for d in ride.directives] == [0, 2]
    assert len({d.command_id for d in ride.directives}) == 1
    assert [(r.outcome, r.verdict) for r in ride.replies[2:]] == [("issued", "refined")]
    ride.tell("fulfilled")
    assert ride.outcomes[-1] == "fulfilled"


def test_a_withdrawn_command_gives_its_directive_back_and_says_why() -> None:
    ride = riding()
    ride.answer(ride.read(LEFT), NOTHING, "withdrew")
    assert [(d.manoeuvre, d.target_lane) for d in ride.directives] == [("cruise", 0), ("cruise", None)]
    last = ride.replies[-1]
    assert (last.outcome, last.verdict) == ("refused", "withdrew")
    assert last.say
    assert ride.wait(60, 1, (1, 40.0, 10.0)) == []


def test_a_verdict_after_the_end_keeps_the_outcome_that_was_told() -> None:
    ride = riding()
    call = ride.read(LEFT)
    ride.tell("fulfilled")
    ride.answer(call, LEFT, "confirmed")
    assert [(r.outcome, r.verdict) for r in ride.replies[-2:]] == [("fulfilled", ""), ("fulfilled", "confirmed")]


def test_what_is_over_cannot_be_withdrawn() -> None:
    ride = riding()
    call = ride.read(LEFT)
    ride.tell("fulfilled")
    before = len(ride.directives)
    ride.answer(call, NOTHING, "withdrew")
    last = ride.replies[-1]
    assert (last.outcome, last.verdict, len(ride.directives)) == ("fulfilled", "overruled", before)
    assert "said 'out_of_scope'" in last.why
    assert "withdrew" not in ride.deliberation.metrics


def test_a_wish_that_had_its_last_reply_is_not_open_while_the_model_still_thinks() -> None:
    ride = riding(asks_again=True)
    ride.read(LEFT)
    assert [wish.command.id for wish in ride.deliberation.open_wishes()] == [1]
    ride.tell("fulfilled")
    assert ride.deliberation.open_wishes() == []


@pytest.mark.parametrize("verdict", ["confirmed", "refined", "withdrew", "overruled", "decided"])
def test_a_late_answer_about_a_superseded_command_changes_nothing(verdict: Verdict) -> None:
    ride = riding()
    first = ride.read(LEFT)
    assert [e for e in ride.hear() if isinstance(e, Abandon)]
    ride.answer(calls(ride)[-1], RIGHT, provisional=True)
    before = list(ride.out)
    assert ride.answer(first, NOTHING, verdict) == []
    assert ride.out == before
    assert ride.directives[-1].target_lane == 2


def test_a_command_that_the_model_still_thinks_about_is_superseded_once() -> None:
    ride = riding()
    ride.read(LEFT)
    ride.say(RIGHT)
    assert ride.outcomes == ["heard", "issued", "heard", "superseded", "issued"]


def test_a_refusal_of_the_reader_stays_the_last_word_where_the_model_is_overruled() -> None:
    ride = riding()
    ride.answer(ride.read(DANGER), DANGER, "overruled", why="a refusal stands")
    assert ride.directives == []
    assert [(r.outcome, r.verdict) for r in ride.replies] == [("heard", ""), ("refused", ""), ("refused", "overruled")]


# --- asked again ---------------------------------------------------------------------------------------------------


def test_a_directive_that_is_held_up_is_thought_about_again_with_what_holds_it_up() -> None:
    ride = riding(asks_again=True)
    ride.say(HURRY)
    ride.tell("delayed", "rear gap in lane")
    again = calls(ride)[-1]
    assert again.context.again == "delayed by the fast system (rear gap in lane)"
    assert again.context.standing is not None
    assert (again.command_id, again.context.wishes) == (1, "faster, overtake")
    assert ride.directives[-1].reasoning.startswith("again: ")  # nothing has waited for it


def test_a_second_thought_about_what_goes_on_may_refine_it_and_changes_nothing_once_it_is_over() -> None:
    for over, sent in ((False, [0, 0, 2]), (True, [0, 0])):
        ride = riding(asks_again=True)
        ride.say(HURRY)
        ride.tell("delayed", "rear gap in lane")
        if over:
            ride.tell("fulfilled")
        ride.answer(calls(ride)[-1], RIGHT, "refined")
        assert [d.target_lane for d in directives(list(ride.out))][: len(sent)] == sent
        assert (2 in [d.target_lane for d in ride.directives]) is not over


def thought_again(*steps: Step) -> tuple[Ride, Interpret]:
    """A program whose first step is held up, and the model that is asked about it once more."""
    ride = riding(asks_again=True)
    ride.ask_for(*steps)
    ride.tell("delayed", "rear gap in lane")
    return ride, calls(ride)[-1]


GO_LEFT = Step(act="lane", side="left", count=1)


@pytest.mark.parametrize("verdict", ["confirmed", "refined", "overruled", "unanswered"])
def test_a_second_thought_that_changes_nothing_is_not_told(verdict: Verdict) -> None:
    ride, call = thought_again(GO_LEFT)
    assert ride.answer(call, LEFT, verdict) == []


def test_a_second_thought_that_takes_the_wish_back_says_so() -> None:
    ride, call = thought_again(GO_LEFT)
    ride.answer(call, NOTHING, "withdrew")
    assert [(r.outcome, r.verdict) for r in ride.replies[-1:]] == [("refused", "withdrew")]


def test_a_second_thought_about_what_is_done_does_it_not_again() -> None:
    ride, call = thought_again(GO_LEFT, Step(act="slower", when=Trigger(kind="done")))
    ride.tell("fulfilled")
    assert ride.directives[-1].step == 1
    assert ride.answer(call, RIGHT, "refined") == []
    assert ride.deliberation.metrics["overruled"] == 1


@pytest.mark.parametrize("steps", [(Step(act="more"),), (Step(act="lane", side="right", count=3),), ()])
def test_a_second_thought_that_cannot_be_done_leaves_what_stands(steps: tuple[Step, ...]) -> None:
    ride, call = thought_again(GO_LEFT)
    program = Program(outcome="directive", steps=steps)
    slots = summary(program, scene(1), "en") if steps else NOTHING
    found = Interpretation(slots, program=program, verdict="refined")
    assert ride.deliberation.on_interpretation(call.id, found, round(ride.now_s * NS)) == []


def test_the_model_is_not_asked_again_while_it_thinks_nor_where_it_is_not_to_be() -> None:
    thinking = riding(asks_again=True)
    thinking.read(HURRY)
    thinking.tell("delayed", "rear gap in lane")
    quiet = riding()
    quiet.say(HURRY)
    quiet.tell("delayed", "rear gap in lane")
    assert [len(calls(thinking)), len(calls(quiet))] == [1, 1]


def test_a_new_command_is_interpreted_with_the_turns_before_it_and_the_wish_that_stands() -> None:
    ride = riding()
    ride.say(LEFT)
    ride.tell("fulfilled")
    ride.say(HURRY)
    ride.hear()
    context = calls(ride)[-1].context
    assert context.turns == ("lane left", "faster, overtake")
    assert context.wishes == "faster, overtake"
