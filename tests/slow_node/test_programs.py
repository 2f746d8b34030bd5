"""Programs over time: what is waited for, one step after the other, what goes by the wish before, and questions."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.wire.messages import Command
from schemas.wire.program import Outcome, Program, Step, Trigger
from slow_node.agenda import WAIT_MAX_S
from slow_node.planning.replies import SENTENCES, spoken_length
from slow_node.unanswered import Unanswered, Wish, told
from slow_node.understanding.slots import Slots
from tests.ride import HURRY, LIMIT, ONE_WAY, TWO_WAY, Ride, directives, lane

LEFT = Step(act="lane", side="left", count=1)
RIGHT = Step(act="lane", side="right", count=1)


def later(step: Step, **trigger: object) -> Step:
    return Step(act=step.act, side=step.side, count=step.count, when=Trigger(**trigger))  # type: ignore[arg-type]


def riding(*cars: tuple[int, float, float], lanes: object = None) -> Ride:
    ride = Ride(lanes) if lanes is not None else Ride()  # type: ignore[arg-type]
    ride.look(1, *cars)
    return ride


# --- triggers ------------------------------------------------------------------------------------------------------


def test_a_step_in_ten_seconds_is_sent_after_ten_seconds_and_not_before() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="time", value=10.0))
    ride.wait(9, 1)
    assert (ride.directives, ride.outcomes) == ([], ["heard", "heard"])
    ride.wait(2, 1)
    assert [d.target_lane for d in ride.directives] == [0]
    assert ride.outcomes == ["heard", "heard", "issued"]
    assert ride.events == [("waiting", "10 s"), ("due", "10 s")]


def test_while_it_waits_reply_and_event_say_for_what_and_what_comes_then() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="time", value=10.0))
    reply = ride.replies[-1]
    assert (reply.waits_for, reply.say) == ("10 s", "I do that in 10 s. Then: Moving left when it is safe.")


def test_a_step_after_so_many_metres_is_sent_there() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="distance", value=100.0))
    ride.look(1, at_m=90.0)
    assert ride.directives == []
    assert [d.target_lane for d in directives(ride.look(1, at_m=101.0))] == [0]


def test_a_step_when_a_lane_is_free_waits_while_somebody_is_in_it() -> None:
    beside, gone = (0, 3.0, 15.0), (0, 40.0, 15.0)
    ride = riding(beside)
    ride.ask_for(later(LEFT, kind="free", side="left"))
    assert (ride.look(1, beside), ride.replies[-1].waits_for) == ([], "room on the left")
    assert [d.target_lane for d in directives(ride.look(1, gone))] == [0]


def test_a_step_when_a_lane_is_free_is_done_at_once_where_it_is() -> None:
    ride = riding()
    assert [d.target_lane for d in directives(ride.ask_for(later(LEFT, kind="free", side="left")))] == [0]


def test_a_step_after_a_faster_car_waits_until_that_has_passed() -> None:
    ride = riding((0, -20.0, 20.0), (1, 60.0, 15.0))
    ride.ask_for(later(LEFT, kind="passed", object="car"))
    assert ride.look(1, (0, 0.0, 20.0), (1, 60.0, 15.0)) == []
    assert [d.target_lane for d in directives(ride.look(1, (0, 12.0, 20.0), (1, 60.0, 15.0)))] == [0]


def test_an_overtake_after_the_oncoming_car_waits_for_it() -> None:
    lead = (1, 30.0, 8.0)
    ride = riding(lead, (0, 80.0, -10.0), lanes=TWO_WAY)
    ride.ask_for(Step(act="overtake", when=Trigger(kind="passed", object="oncoming")))
    assert (ride.directives, ride.replies[-1].waits_for) == ([], "the oncoming car to pass")
    ride.look(1, lead, (0, 10.0, -10.0))
    assert ride.directives == []
    assert [d.manoeuvre for d in directives(ride.look(1, lead, (0, -15.0, -10.0)))] == ["overtake"]


def test_an_overtake_once_nothing_is_coming_waits_for_a_clear_road() -> None:
    lead = (1, 30.0, 8.0)
    ride = riding(lead, (0, 100.0, -10.0), lanes=TWO_WAY)
    ride.ask_for(Step(act="overtake", when=Trigger(kind="clear")))
    assert ride.directives == []
    assert [d.manoeuvre for d in directives(ride.look(1, lead))] == ["overtake"]


@pytest.mark.parametrize(("goal", "before", "reached"), [(18.0, 16.0, 17.6), (10.0, 12.0, 10.4)])
def test_a_step_at_a_speed_is_sent_once_that_is_reached_from_either_side(
    goal: float, before: float, reached: float
) -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="speed", value=goal))
    assert ride.look(1, speed=before) == []
    assert [d.target_lane for d in directives(ride.look(1, speed=reached))] == [0]


def test_what_does_not_come_in_a_minute_is_given_up_and_said_so() -> None:
    beside = (0, 3.0, 15.0)
    ride = riding(beside)
    ride.ask_for(later(LEFT, kind="free", side="left"))
    ride.wait(int(WAIT_MAX_S) - 1, 1, beside)
    assert ride.outcomes == ["heard", "heard"]
    ride.wait(3, 1, beside)
    assert (ride.outcomes[-1], ride.directives) == ("expired", [])
    assert ride.replies[-1].say == SENTENCES["waited_in_vain"]["en"]


def test_a_new_command_replaces_what_waits() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="time", value=10.0))
    ride.ask_for(Step(act="slower"))
    ride.wait(15, 1)
    assert ride.outcomes[:5] == ["heard", "heard", "heard", "superseded", "issued"]
    assert {d.target_lane for d in ride.directives} == {None}


def test_what_waits_is_given_up_in_a_new_world() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="time", value=10.0))
    ride.look(1, epoch=2)
    assert ride.outcomes[-1] == "expired"


def test_a_condition_on_a_lane_that_is_not_there_is_refused_at_once() -> None:
    ride = Ride()
    ride.look(0)
    ride.ask_for(later(LEFT, kind="free", side="left"))
    assert (ride.outcomes[-1], ride.replies[-1].say) == ("refused", SENTENCES["no_lane"]["en"])


# --- one after the other -------------------------------------------------------------------------------------------

FIRST_LEFT_THEN_SLOWER = (LEFT, Step(act="slower", when=Trigger(kind="done")))


def test_the_lane_that_a_step_has_reached_is_kept_by_the_next_which_names_none() -> None:
    ride = riding()
    ride.ask_for(*FIRST_LEFT_THEN_SLOWER)
    ride.look(0)
    ride.tell("fulfilled")
    assert (ride.directives[-1].target_lane, ride.directives[-1].target_speed_mps) == (0, pytest.approx(13.0))


def test_the_second_step_is_sent_when_the_first_is_fulfilled_and_the_passenger_hears_of_the_end_once() -> None:
    ride = riding()
    ride.ask_for(*FIRST_LEFT_THEN_SLOWER)
    ride.wait(5, 1)
    assert [d.target_lane for d in ride.directives] == [0]
    ride.tell("fulfilled")
    assert ride.directives[-1].target_speed_mps == pytest.approx(13.0)
    assert "fulfilled" not in ride.outcomes
    ride.tell("fulfilled")
    assert ride.outcomes[-1] == "fulfilled"


def test_a_reset_while_something_is_waited_for_ends_that_and_plans_what_is_under_way_again() -> None:
    ride = riding()
    ride.say(HURRY)
    ride.ask_for(later(LEFT, kind="time", value=30.0))
    sent = ride.look(1, epoch=2)
    assert [d.epoch for d in directives(sent)] == [2]
    assert ride.outcomes[-1] == "expired"


def test_a_step_of_a_command_that_expires_with_its_world_is_not_planned_again() -> None:
    ride = riding()
    ride.ask_for(LEFT, later(RIGHT, kind="time", value=5.0))
    ride.tell("fulfilled")
    assert directives(ride.look(1, epoch=2)) == []


def test_what_is_to_last_for_a_distance_begins_anew_in_a_new_world() -> None:
    ride = Ride()
    ride.look(1, at_m=2000.0)
    ride.ask_for(Step(act="slower", until=Trigger(kind="distance", value=500.0)))
    ride.look(1, epoch=2, at_m=0.0)
    ride.look(1, epoch=2, at_m=490.0)
    assert ride.outcomes[-1] == "issued"
    ride.look(1, epoch=2, at_m=501.0)
    assert ride.outcomes[-1] == "fulfilled"


def test_a_speed_that_is_reached_and_is_to_last_for_minutes_does_not_expire() -> None:
    ride = riding()
    ride.ask_for(Step(act="drive", value=10.0, unit="mps", mode="to", until=Trigger(kind="time", value=180.0)))
    ride.tell("fulfilled")
    ride.wait(179, 1)
    assert set(ride.outcomes) == {"heard", "issued"}
    ride.wait(2, 1)
    assert ride.outcomes[-1] == "fulfilled"


def test_a_distance_that_was_named_is_waited_for_as_long_as_it_takes() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="distance", value=2000.0))
    for k in range(1, 100):
        ride.look(1, after_s=1.0, at_m=20.0 * k)
    assert ride.directives == []
    ride.look(1, after_s=1.0, at_m=2001.0)
    assert [d.target_lane for d in ride.directives] == [0]


def test_a_distance_is_not_waited_for_for_ever_by_a_car_that_stands() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="distance", value=2000.0))
    ride.wait(401, 1)
    assert ride.outcomes[-1] == "expired"


def test_the_rest_of_a_program_is_superseded_by_a_newer_one_that_waits_and_what_is_under_way_ends_in_silence() -> None:
    ride = riding()
    ride.ask_for(*FIRST_LEFT_THEN_SLOWER)
    ride.ask_for(later(RIGHT, kind="time", value=30.0))
    assert ride.outcomes.count("superseded") == 1
    ride.tell("fulfilled")
    assert "fulfilled" not in ride.outcomes


@pytest.mark.parametrize("outcome", ["directive", "unclear"])
def test_a_program_without_a_step_is_answered_whatever_its_slots_say(outcome: Outcome) -> None:
    ride = Ride(TWO_WAY)
    ride.look(0)
    ride.say(Slots(outcome="directive", lane="right"), program=Program(outcome=outcome))
    assert (ride.outcomes[-1], ride.directives) == ("refused", [])


def test_a_wish_that_has_no_more_of_it_is_not_said_to_be_unknown() -> None:
    ride = riding((1, 60.0, 10.0))
    ride.ask_for(Step(act="overtake"))
    follow(ride, "more")
    assert ride.replies[-1].say == SENTENCES["unclear"]["en"]


def test_long_ways_are_told_in_kilometres_or_miles() -> None:
    assert [spoken_length(m, miles) for m, miles in ((999.0, False), (2000.0, False), (3219.0, True))] == [
        "999 m", "2.0 km", "2.0 mi"]  # fmt: skip


def test_a_directive_carries_its_program_and_what_comes_next() -> None:
    ride = riding()
    ride.ask_for(*FIRST_LEFT_THEN_SLOWER)
    first = ride.directives[0]
    assert (first.steps, first.step, first.waits_for) == (FIRST_LEFT_THEN_SLOWER, 0, "the step before")
    ride.tell("fulfilled")
    assert (ride.directives[-1].step, ride.directives[-1].waits_for) == (1, "")


def test_a_command_of_one_step_says_no_more_than_its_directive() -> None:
    ride = riding()
    ride.ask_for(LEFT)
    assert (ride.directives[0].steps, ride.directives[0].waits_for) == ((), "")


def test_a_first_step_that_never_comes_true_takes_the_second_with_it() -> None:
    ride = riding()
    ride.ask_for(*FIRST_LEFT_THEN_SLOWER)
    ride.wait(125, 1)
    assert ride.outcomes[-1] == "expired"
    assert {d.target_speed_mps for d in ride.directives} == {None}


def test_a_step_that_lasts_ends_in_normal_driving() -> None:
    ride = riding()
    ride.ask_for(Step(act="drive", value=10.0, unit="mps", mode="to", until=Trigger(kind="time", value=20.0)))
    ride.tell("fulfilled")
    assert "fulfilled" not in ride.outcomes
    ride.wait(22, 1)
    last = ride.directives[-1]
    assert (last.manoeuvre, last.target_speed_mps, last.target_lane) == ("cruise", None, None)
    assert ride.outcomes[-1] == "fulfilled"


# --- values on the road ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (Step(act="faster", value=2.0, unit="mps", mode="by"), 17.0),
        (Step(act="slower", value=0.5, unit="times", mode="factor"), 7.5),
        (Step(act="drive", value=12.0, unit="mps", mode="at_least"), 15.0),
        (Step(act="drive", value=18.0, unit="mps", mode="at_least"), 18.0),
        (Step(act="drive", value=12.0, unit="mps", mode="at_most"), 12.0),
        (Step(act="drive", object="limit", mode="at_most"), 15.0),
        (Step(act="faster"), LIMIT),
    ],
    ids=str,
)
def test_a_speed_is_meant_against_the_speed_of_now(step: Step, expected: float) -> None:
    ride = riding()
    ride.ask_for(step)
    assert ride.directives[0].target_speed_mps == pytest.approx(expected)


@pytest.mark.parametrize(
    ("step", "expected_s"),
    [
        (Step(act="farther", value=15.0, unit="m", mode="by"), 3.0),
        (Step(act="farther", value=1.5, unit="times", mode="factor"), 3.0),
        (Step(act="gap", value=30.0, unit="m", mode="to"), 2.0),
        (Step(act="gap", value=15.0, unit="m", mode="at_least"), 2.0),
        (Step(act="closer", value=6.0, unit="m", mode="by"), 1.6),
    ],
    ids=str,
)
def test_a_gap_is_meant_against_the_gap_of_now(step: Step, expected_s: float) -> None:
    ride = riding((1, 35.0, 15.0))  # 30 m, 2 s
    ride.ask_for(step)
    assert ride.directives[0].headway_s == pytest.approx(expected_s)


@pytest.mark.parametrize(
    ("step", "lane"),
    [
        (Step(act="lane", count=1), 0),
        (Step(act="lane", count=3), 2),
        (Step(act="lane", side="rightmost", count=1), 2),
        (Step(act="lane", side="either"), 0),
        (Step(act="lane", side="right", count=1), 2),
    ],
    ids=str,
)
def test_a_lane_by_number_is_that_lane(step: Step, lane: int) -> None:
    ride = riding()
    ride.ask_for(step)
    assert ride.directives[0].target_lane == lane


@pytest.mark.parametrize("step", [Step(act="lane", count=4), Step(act="lane", side="left", count=2)], ids=str)
def test_a_lane_that_is_not_there_is_refused(step: Step) -> None:
    ride = riding()
    ride.ask_for(step)
    assert (ride.outcomes[-1], ride.replies[-1].say) == ("refused", SENTENCES["no_lane"]["en"])


def test_closer_where_it_is_close_is_refused_with_the_numbers_and_widens_nothing() -> None:
    ride = riding((1, 17.0, 15.0))  # 12 m, 0.8 s
    ride.ask_for(Step(act="closer"))
    assert ride.directives == []
    assert ride.replies[-1].say == "We are as close as is safe already: 12 m, 0.8 s."


# --- dialogue -------------------------------------------------------------------------------------------------------


def follow(ride: Ride, act: str) -> None:
    ride.ask_for(Step(act=act), outcome="unclear")  # type: ignore[arg-type]


def test_more_and_less_and_the_other_way_go_by_the_wish_before() -> None:
    ride = riding()
    ride.ask_for(Step(act="slower", value=2.0, unit="mps", mode="by"))
    follow(ride, "more")
    follow(ride, "opposite")
    assert [d.target_speed_mps for d in ride.directives] == [13.0, 13.0, 17.0]


def test_too_much_takes_half_of_it_back() -> None:
    ride = riding()
    ride.ask_for(Step(act="slower", value=4.0, unit="mps", mode="by"))
    ride.look(1, speed=11.0)
    follow(ride, "less")
    assert ride.directives[-1].target_speed_mps == pytest.approx(13.0)


def test_the_other_way_after_a_lane_is_the_other_side() -> None:
    ride = riding()
    ride.ask_for(LEFT)
    follow(ride, "opposite")
    assert [d.target_lane for d in ride.directives] == [0, 2]


def test_again_is_the_same_from_where_we_are_now() -> None:
    ride = riding()
    ride.ask_for(LEFT)
    ride.look(2)
    follow(ride, "again")
    assert [d.target_lane for d in ride.directives] == [0, 1]


def test_back_to_how_it_was_is_the_speed_of_then() -> None:
    ride = riding()
    ride.ask_for(Step(act="slower", value=5.0, unit="mps", mode="by"))
    ride.look(1, speed=10.0)
    follow(ride, "back")
    assert ride.directives[-1].target_speed_mps == pytest.approx(15.0)


@pytest.mark.parametrize("act", ["more", "less", "again", "opposite"])
def test_without_a_wish_before_it_the_car_asks_what_is_meant(act: str) -> None:
    ride = riding()
    follow(ride, act)
    assert (ride.outcomes[-1], ride.replies[-1].say) == ("refused", SENTENCES["no_wish_before"]["en"])


# --- questions ------------------------------------------------------------------------------------------------------


def answers(ride: Ride, question: str) -> str:
    ride.ask_for(question=question, outcome="out_of_scope")  # type: ignore[arg-type]
    assert (ride.outcomes[-1], ride.replies[-1].directive_id) == ("fulfilled", None)
    return ride.replies[-1].say


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("speed", "We drive 54 km/h; the limit is 72 km/h."),
        ("limit", "The limit here is 72 km/h; we drive 54 km/h."),
        ("gap", "The car ahead is 30 m away, 2.0 s at our speed, and drives 36 km/h."),
        ("lane", "We are in lane 2 of 3, counted from the left."),
        ("why_slow", "The car ahead drives 36 km/h and is 30 m away."),
        (
            "why_not_overtake",
            "Nobody has asked me to. The car ahead drives 36 km/h: say so, and I pass it when it is safe.",
        ),
        ("waiting", "I wait for nothing. We drive 54 km/h; the limit is 72 km/h."),
        ("safe", "Yes: 30 m, 2.0 s, to the car ahead, and I do only what leaves room to brake."),
        ("plan", "I drive on in lane 2 of 3 at 54 km/h; nothing else is asked for."),
    ],
)
def test_a_question_is_answered_with_the_numbers_of_now(question: str, answer: str) -> None:
    assert answers(riding((1, 35.0, 10.0)), question) == answer


def test_why_not_names_what_the_mask_holds_it_up_by() -> None:
    ride = riding((1, 35.0, 10.0), (0, 60.0, -10.0), lanes=TWO_WAY)
    ride.ask_for(Step(act="overtake"))
    ride.tell("delayed", "oncoming traffic")
    assert answers(ride, "why_not_overtake") == "I want to, but there is oncoming traffic 55 m away."
    assert answers(ride, "waiting") == "I want to, but there is oncoming traffic 55 m away."


def test_a_question_leaves_the_wish_before_it_alone() -> None:
    ride = riding((0, 3.0, 15.0))
    ride.ask_for(later(LEFT, kind="free", side="left"))
    assert answers(ride, "waiting") == "I wait for room in the lane."
    assert [d.target_lane for d in directives(ride.look(1))] == [0]


# --- what lacks its side, sizes and second thoughts ----------------------------------------------------------------


def change_lanes(ride: Ride) -> str:
    ride.ask_for(Step(act="lane"), outcome="unclear")
    return ride.replies[-1].say


def test_another_lane_without_a_side_is_asked_back_with_the_lane_that_we_are_in() -> None:
    ride = riding()
    assert change_lanes(ride) == "To the left or to the right? We are in lane 2 of 3, counted from the left."
    assert ride.directives == []


@pytest.mark.parametrize(("here", "key"), [(0, "only_side_right"), (2, "only_side_left")])
def test_at_the_edge_of_the_road_the_one_lane_that_there_is_is_named(here: int, key: str) -> None:
    ride = Ride()
    ride.look(here)
    assert change_lanes(ride) == SENTENCES[key]["en"]


def test_do_it_after_all_turns_a_wish_that_was_denied_into_one() -> None:
    ride = riding((1, 30.0, 8.0))
    ride.ask_for(Step(act="overtake", polarity="not"))
    ride.ask_for(Step(act="again", object="now"), outcome="unclear")
    assert ride.directives[-1].manoeuvre == "overtake"


def test_do_it_now_begins_what_waited() -> None:
    ride = riding()
    ride.ask_for(later(LEFT, kind="time", value=10.0))
    ride.ask_for(Step(act="again", object="now"), outcome="unclear")
    assert ride.directives[-1].target_lane == 0


def test_do_it_after_a_question_about_overtaking_overtakes() -> None:
    ride = riding((1, 30.0, 8.0))
    ride.ask_for(question="safe", outcome="out_of_scope")
    ride.ask_for(Step(act="again", object="now"), outcome="unclear")
    assert ride.directives[-1].manoeuvre == "overtake"


def test_a_number_alone_is_another_size_of_the_wish_before() -> None:
    ride = riding()
    ride.ask_for(Step(act="gap", value=2.0, unit="s", mode="to"))
    ride.ask_for(Step(act="again", object="number", value=3.0), outcome="unclear")
    assert ride.directives[-1].headway_s == pytest.approx(3.0)
    ride.ask_for(later(LEFT, kind="time", value=5.0))
    ride.ask_for(Step(act="again", object="number", value=10.0), outcome="unclear")
    assert ride.replies[-1].waits_for == "10 s"


# --- the exit, and what is said of the whole -----------------------------------------------------------------------

RAMP = (*ONE_WAY, lane(kind="ramp", start_m=300.0, end_m=600.0))


def test_what_is_to_last_until_the_exit_ends_where_a_lane_leaves_the_road() -> None:
    ride = riding(lanes=RAMP)
    ride.ask_for(Step(act="keep", object="lane", until=Trigger(kind="exit")))
    assert ride.replies[-1].say == "I will stay in this lane. Until the exit, 300 m ahead."
    ride.look(1, at_m=299.0)
    assert ride.outcomes[-1] == "issued"
    ride.look(1, at_m=301.0)
    assert ride.outcomes[-1] == "fulfilled"


def test_where_no_exit_is_in_sight_that_is_said() -> None:
    ride = riding()
    ride.ask_for(Step(act="keep", object="lane", until=Trigger(kind="exit")))
    assert ride.replies[-1].say.endswith(SENTENCES["lasts_road"]["en"])


def test_the_first_reply_names_what_comes_then_and_until_when() -> None:
    ride = riding()
    ride.ask_for(LEFT, Step(act="slower", when=Trigger(kind="done"), until=Trigger(kind="time", value=20.0)))
    assert ride.replies[-1].say == "Moving left when it is safe. Then: Slowing down to 47 km/h."
    ride.tell("fulfilled")
    ride.ask_for(Step(act="slower", until=Trigger(kind="time", value=20.0)))
    assert ride.replies[-1].say == "Slowing down to 47 km/h. For 20 s."


# --- what is open when the process ends ----------------------------------------------------------------------------


def test_a_wish_is_open_until_its_last_reply() -> None:
    ride = riding()
    assert ride.deliberation.open_wishes() == []
    ride.ask_for(later(LEFT, kind="time", value=10.0))
    assert [wish.command.id for wish in ride.deliberation.open_wishes()] == [1]
    ride.wait(11, 1)
    assert [wish.command.id for wish in ride.deliberation.open_wishes()] == [1]
    ride.tell("fulfilled")
    assert ride.deliberation.open_wishes() == []


def test_who_comes_after_a_killed_process_finds_what_was_open_and_says_so_in_its_language(tmp_path: Path) -> None:
    file = str(tmp_path / "wishes.json")
    command = Command(epoch=1, stamp_ns=0, id=7, text="in zehn Sekunden nach links")
    Unanswered(file).keep([Wish(command=command, language="de")])
    (left,) = Unanswered(file).left
    reply = told(left, 2, 5)
    assert (reply.command_id, reply.outcome, reply.epoch) == (7, "failed", 2)
    assert reply.say == SENTENCES["restarted"]["de"].format(text=command.text)


def test_nothing_is_open_after_a_file_that_is_empty_missing_or_broken(tmp_path: Path) -> None:
    file = tmp_path / "wishes.json"
    assert Unanswered(str(file)).left == ()
    file.write_text('[{"command": ')
    assert Unanswered(str(file)).left == ()
    assert Unanswered("").left == ()
