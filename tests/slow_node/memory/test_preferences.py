"""What stands for every drive, and what outcomes teach: said, kept, shown in driving, taken back."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.driving.measures import INF
from schemas.wire.messages import Command
from schemas.wire.program import Step, Trigger
from slow_node.effects import Interpret, Prefer, Remember
from slow_node.interpretation import Interpretation
from slow_node.lessons import alike, lesson_for
from slow_node.llm.embedding import HashedEmbedder
from slow_node.memory.bank import Example, Memory, experience
from slow_node.memory.preferences import Manner, Preference
from slow_node.planning.replies import SENTENCES
from slow_node.planning.scene import describe
from slow_node.understanding.reading.lexicon import Row, rows
from slow_node.understanding.reading.standing import is_only_standing, standing
from slow_node.understanding.slots import Slots
from slow_node.understanding.text import fold
from tests.ride import TWO_WAY, Ride, directives, scene

GENTLE = Manner(frozenset({"gentle"}))
FASTER = Slots(outcome="directive", speed="faster")
LEAD = (1, 40.0, 10.0)


def riding(manner: Manner = GENTLE) -> Ride:
    ride = Ride()
    ride.deliberation.manner = manner
    return ride


@pytest.mark.parametrize("row", rows("standing", "stands"), ids=lambda row: str(row.fields["kind"]))
def test_a_standing_preference_is_known_in_every_language_and_not_beside_it(row: Row) -> None:
    assert [c for c in row.fields["matches"] if row.search(fold(c)) is None] == []
    assert [c for c in row.fields["passes"] if row.search(fold(c)) is not None] == []


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("I get carsick", ("gentle", True)),
        ("forget that I get carsick", ("gentle", False)),
        ("Vergiss, dass ich reisekrank bin", ("gentle", False)),
        ("go faster", None),
    ],
)
def test_what_is_said_for_every_drive_holds_until_it_is_taken_back(command: str, said: tuple[str, bool] | None) -> None:
    assert standing(command) == said


@pytest.mark.parametrize("row", rows("standing", "stands"), ids=lambda row: str(row.fields["kind"]))
def test_what_is_said_for_every_drive_asks_for_nothing_now_unless_more_is_said(row: Row) -> None:
    assert [c for c in row.fields["matches"] if not is_only_standing(c)] == []
    assert [
        c for c in row.fields["matches"] if is_only_standing(f"{c}, go left") or is_only_standing(f"Brake! {c}")
    ] == []


def test_preferences_outlive_the_process_and_can_be_dropped(tmp_path: Path) -> None:
    path = str(tmp_path / "bank.sqlite")
    first = Memory(HashedEmbedder(), path, None)
    first.prefer(Preference("gentle", "I get carsick"))
    first.close()
    second = Memory(HashedEmbedder(), path, None)
    assert second.preferences() == (Preference("gentle", "I get carsick"),)
    assert (second.drop("gentle"), second.drop("gentle"), second.preferences()) == (True, False, ())
    second.close()


def test_a_drive_begins_in_the_passengers_manner_before_anything_is_said() -> None:
    ride = riding()
    (directive,) = directives(ride.look(1, LEAD))
    assert (directive.style, directive.target_speed_mps, directive.command_id) == ("calm", None, 0)
    assert directives(ride.look(1, LEAD)) == []


def test_without_preferences_a_drive_begins_without_a_directive() -> None:
    assert directives(riding(Manner()).look(1, LEAD)) == []


def test_every_wish_is_driven_calmly_for_who_gets_carsick_and_an_overtake_not_assertively() -> None:
    ride = riding()
    ride.look(1, LEAD)
    ride.ask_for(Step(act="drive", value=12.0, unit="mps", mode="to"))
    ride.ask_for(Step(act="overtake"))
    assert [(d.manoeuvre, d.style) for d in ride.directives[-2:]] == [("cruise", "calm"), ("overtake", "normal")]


def test_a_gap_that_is_named_counts_before_the_one_that_is_preferred() -> None:
    ride = riding(Manner(frozenset({"room"})))
    ride.look(1, LEAD)
    ride.ask_for(Step(act="drive", value=12.0, unit="mps", mode="to"))
    ride.ask_for(Step(act="gap", value=1.5, unit="s", mode="to"))
    assert [d.headway_s for d in ride.directives[-2:]] == [3.0, 1.5]


def test_a_hurry_overtakes_nobody_for_who_is_afraid_of_it_unless_that_is_asked_for() -> None:
    ride = riding(Manner(frozenset({"no_passing"})))
    ride.look(1, LEAD)
    ride.ask_for(Step(act="faster"))
    ride.ask_for(Step(act="overtake"))
    assert [d.manoeuvre for d in ride.directives] == ["follow", "overtake"]


def asked(ride: Ride, text: str) -> Interpret:
    """A command in these words, which is to be understood."""
    now_ns = ride._now()
    ride.said += 1
    command = Command(epoch=1, stamp_ns=now_ns, id=ride.said, text=text)
    heard = ride._keep(ride.deliberation.on_command(command, now_ns))
    return next(effect for effect in heard if isinstance(effect, Interpret))


def say(ride: Ride, text: str, found: Interpretation) -> list[object]:
    """A command in these words, understood so."""
    call = asked(ride, text)
    return list(ride._keep(ride.deliberation.on_interpretation(call.id, found, ride._now())))


def test_i_get_carsick_is_kept_said_so_and_driven_at_once() -> None:
    ride = riding(Manner())
    ride.look(1, LEAD)
    out = say(ride, "I get carsick", Interpretation(Slots(outcome="out_of_scope")))
    assert Prefer("gentle", "I get carsick", True) in out
    assert (ride.directives[-1].style, ride.replies[-1].say) == ("calm", SENTENCES["prefers_gentle"]["en"])
    assert ride.outcomes == ["heard", "fulfilled"]


CARSICK = Interpretation(Slots(outcome="out_of_scope"))
SLOWER = Slots(outcome="directive", speed="slower")


def test_what_is_to_last_goes_on_in_the_new_manner_and_ends_when_its_time_is_over() -> None:
    ride = riding(Manner())
    ride.look(1)
    ride.ask_for(Step(act="drive", value=10.0, unit="mps", mode="to", until=Trigger(kind="time", value=20.0)))
    say(ride, "my daughter gets car sick, just so you know", CARSICK)
    assert [(d.command_id, d.target_speed_mps, d.style) for d in ride.directives] == [
        (1, 10.0, "normal"),
        (1, 10.0, "calm"),
    ]
    assert ride.outcomes == ["heard", "issued", "heard", "fulfilled"]
    ride.wait(21, 1)
    assert [(r.command_id, r.outcome) for r in ride.replies[4:]] == [(1, "fulfilled")]


def test_the_second_step_comes_after_the_first_though_a_preference_was_named_between() -> None:
    ride = riding(Manner())
    ride.look(1)
    ride.ask_for(Step(act="lane", side="left", count=1), Step(act="slower", when=Trigger(kind="done")))
    say(ride, "my daughter gets car sick, just so you know", CARSICK)
    assert [(d.target_lane, d.style, d.step) for d in ride.directives] == [(0, "normal", 0), (0, "calm", 0)]
    ride.tell("fulfilled")
    assert (ride.directives[-1].command_id, ride.directives[-1].step, ride.directives[-1].style) == (1, 1, "calm")
    ride.tell("fulfilled")
    assert [(r.command_id, r.outcome) for r in ride.replies[-1:]] == [(1, "fulfilled")]


@pytest.mark.parametrize("found", [CARSICK, Interpretation(SLOWER)], ids=["read as talk", "read as a wish"])
def test_who_gets_carsick_begins_no_wish_whatever_is_read_into_it(found: Interpretation) -> None:
    ride = riding(Manner())
    ride.look(1)
    ride.ask_for(Step(act="lane", side="left", count=1))
    say(ride, "my daughter gets car sick, just so you know", found)
    assert [(d.command_id, d.target_lane, d.style) for d in ride.directives] == [(1, 0, "normal"), (1, 0, "calm")]
    assert ride.outcomes == ["heard", "issued", "heard", "fulfilled"]


def test_who_gets_carsick_and_asks_for_something_is_given_that() -> None:
    ride = riding(Manner())
    ride.look(1)
    say(ride, "I get carsick, so drive slower", Interpretation(SLOWER))
    assert (ride.directives[-1].target_speed_mps or 15.0) < 15.0
    assert (ride.directives[-1].style, ride.outcomes) == ("calm", ["heard", "issued"])


def test_a_model_that_reads_a_wish_into_a_preference_is_overruled() -> None:
    ride = riding(Manner())
    ride.look(1)
    ride.ask_for(Step(act="lane", side="left", count=1))
    words = "my daughter gets car sick"
    ride.answer(begun := asked(ride, words), SLOWER, provisional=True)
    ride.answer(begun, SLOWER.model_copy(update={"gap": "larger"}), "refined")
    assert [d.command_id for d in ride.directives] == [1, 1]
    assert (ride.replies[-1].outcome, ride.replies[-1].verdict) == ("fulfilled", "overruled")


def test_a_hurry_overtakes_nobody_any_more_once_the_passenger_is_afraid_of_it_but_what_was_asked_for_is_done() -> None:
    for overtake, manoeuvres in ((None, ["overtake", "follow"]), (True, ["overtake", "overtake"])):
        ride = Ride(TWO_WAY)
        ride.look(1, (1, 30.0, 8.0))
        ride.say(FASTER.model_copy(update={"overtake": overtake}))
        say(ride, "I'm scared of overtaking", CARSICK)
        assert [d.manoeuvre for d in ride.directives] == manoeuvres


def test_what_is_taken_back_is_forgotten_and_a_danger_is_no_preference() -> None:
    ride = riding()
    ride.look(1, LEAD)
    out = say(ride, "forget that I get carsick", Interpretation(Slots(outcome="directive", cancel=True)))
    assert Prefer("gentle", "forget that I get carsick", False) in out
    assert ride.directives[-1].style == "normal"
    refused = say(ride, "I get carsick, ram him", Interpretation(Slots(outcome="refused")))
    assert not any(isinstance(effect, Prefer) for effect in refused)
    assert ride.deliberation.manner == Manner()


# --- reflection ----------------------------------------------------------------------------------------------------


def learnt(outcome: str, min_ttc_s: float = INF, here: str = "", cosine: float = 0.9) -> Example:
    from dataclasses import replace

    return replace(
        experience("faster", here or describe(scene(1, LEAD)), FASTER, outcome, 3.0, min_ttc_s), cosine=cosine
    )


def test_a_wish_that_was_too_much_is_remembered_as_that() -> None:
    ride = riding(Manner())
    ride.look(1)
    ride.ask_for(Step(act="faster"))
    out = ride.ask_for(Step(act="less"), outcome="unclear")
    assert [(e.outcome, e.slots.speed) for e in out if isinstance(e, Remember)][:1] == [
        ("taken back: it was too much", "faster")
    ]


def test_a_near_miss_teaches_gentleness_and_what_was_too_much_to_do_less() -> None:
    now = scene(1, LEAD)
    assert lesson_for(FASTER, now, [learnt("taken back: it was too much")]) == "less"
    assert lesson_for(FASTER, now, [learnt("fulfilled", 1.0)]) == "gentler"
    assert lesson_for(FASTER, now, [learnt("fulfilled", 4.0)]) == ""


def test_a_lesson_is_of_the_same_words_the_same_decision_and_a_road_like_that() -> None:
    now, other = scene(1, LEAD), describe(scene(1))
    assert lesson_for(FASTER, now, [learnt("taken back: ", here=other)]) == ""
    assert lesson_for(FASTER, now, [learnt("taken back: ", cosine=0.5)]) == ""
    assert lesson_for(Slots(outcome="directive", speed="slower"), now, [learnt("taken back: ")]) == ""
    assert alike(describe(scene(1, LEAD, speed=15.0)), describe(scene(1, LEAD, speed=18.0)))
    assert not alike(describe(scene(1, LEAD, speed=15.0)), describe(scene(1, LEAD, speed=25.0)))


def test_after_too_much_the_same_words_change_only_a_bit_and_that_is_said() -> None:
    ride = riding(Manner())
    ride.look(1)
    say(ride, "faster", Interpretation(FASTER, lesson="less"))
    assert ride.directives[-1].target_speed_mps == pytest.approx(15.0 + 5 / 3.6, abs=0.01)
    assert ride.replies[-1].say.endswith(SENTENCES["lesson_less"]["en"])


def test_after_a_near_miss_the_same_wish_is_driven_calmly() -> None:
    ride = riding(Manner())
    ride.look(1)
    say(ride, "faster", Interpretation(FASTER, lesson="gentler"))
    assert ride.directives[-1].style == "calm"


def test_a_lesson_stands_when_the_wish_is_planned_again_and_when_it_is_renewed() -> None:
    ride = Ride(TWO_WAY)
    ride.look(1, (1, 30.0, 8.0))
    say(ride, "overtake", Interpretation(Slots(outcome="directive", overtake=True), lesson="gentler"))
    ride.tell("delayed", "oncoming traffic")
    ride.wait(60, 1, (1, 30.0, 8.0))
    assert len(ride.directives) > 2
    assert {(d.manoeuvre, d.style) for d in ride.directives} == {("overtake", "normal")}
