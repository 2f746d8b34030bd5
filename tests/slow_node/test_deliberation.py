"""Deliberation over time: what becomes of a wish after it was understood, and the gates before it is issued."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from schemas.runtime.clock import NS
from schemas.wire.messages import Reply
from slow_node.effects import Interpret
from slow_node.interpretation import Interpretation
from slow_node.planning.replies import sentence
from slow_node.understanding.slots import Slots
from tests.ride import CANCEL, HURRY, LEFT, TWO_WAY, Car, Ride, directives, lane, riding

WISHES = {
    "faster": Slots(outcome="directive", speed="faster"),
    "speed": Slots(outcome="directive", target_speed_mps=10.0),
    "slower": Slots(outcome="directive", speed="slower"),
    "stop": Slots(outcome="directive", speed="stop"),
    "gap": Slots(outcome="directive", gap="farther"),
    "lane": LEFT,
    "stay": Slots(outcome="directive", overtake=False),
    "overtake": HURRY,
}


@pytest.mark.parametrize("slots", WISHES.values(), ids=WISHES.keys())
def test_any_wish_is_renewed_unchanged_before_its_time_to_live_ends(slots: Slots) -> None:
    ride = riding(slots, 1, (1, 40.0, 10.0))
    ride.wait(80, 1, (1, 40.0, 10.0))
    stamps = [d.stamp_ns / NS for d in ride.directives]
    assert len(stamps) == 3
    assert max(np.diff(stamps)) < ride.directives[0].ttl_s
    assert len({(d.manoeuvre, d.target_lane, d.target_speed_mps, d.headway_s) for d in ride.directives}) == 1


@pytest.mark.parametrize("slots", WISHES.values(), ids=WISHES.keys())
def test_a_wish_that_did_not_come_true_in_two_minutes_is_given_up_and_says_so(slots: Slots) -> None:
    ride = riding(slots, 1, (1, 40.0, 10.0))
    ride.wait(119, 1, (1, 40.0, 10.0))
    assert ride.outcomes == ["heard", "issued"]
    ride.wait(40, 1, (1, 40.0, 10.0))
    assert ride.outcomes == ["heard", "issued", "expired"]
    assert ride.replies[-1].say == sentence("expired", slots.language)
    assert ride.now_s - ride.directives[-1].stamp_ns / NS > ride.directives[-1].ttl_s


def test_a_directive_that_expired_all_the_same_is_renewed_by_the_next_scene() -> None:
    ride = riding(LEFT, 1)
    ride.now_s += 40.0
    ride.tell("expired")
    assert [d.target_lane for d in directives(ride.look(1))] == [0]


def test_a_wish_whose_lane_has_ended_is_renewed_without_it() -> None:
    ride = riding(LEFT, 1)
    ride.lanes = (lane(end_m=-10.0), lane(), lane())
    ride.wait(28, 1)
    assert [d.target_lane for d in ride.directives] == [0, None]


def test_a_wish_that_came_true_is_not_renewed_where_the_fast_node_keeps_it() -> None:
    ride = riding(LEFT, 1)
    ride.tell("fulfilled")
    assert ride.wait(60, 0) == []


def test_a_wished_gap_is_held_after_it_was_reached() -> None:
    ride = riding(WISHES["gap"], 1, (1, 40.0, 10.0))
    ride.tell("fulfilled")
    ride.tell("fulfilled")
    ride.wait(200, 1, (1, 40.0, 10.0))
    assert {(d.manoeuvre, d.headway_s) for d in ride.directives[1:]} == {("cruise", 3.0)}
    assert len(ride.directives) == 9
    assert ride.outcomes == ["heard", "issued", "fulfilled"]


# --- planning again ------------------------------------------------------------------------------------------------


def test_an_overtake_that_is_delayed_is_planned_again() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    assert [d.reasoning for d in directives(ride.tell("delayed", "rear gap in lane"))] == [
        "again: delayed by the fast system (rear gap in lane)"
    ]


def test_an_overtake_is_planned_again_when_its_lane_is_clear_again() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), (0, 5.0, 15.0))
    assert ride.look(1, (1, 40.0, 10.0), (0, 6.0, 15.0)) == []
    assert [d.reasoning for d in directives(ride.look(1, (1, 40.0, 10.0)))] == ["again: lane 0 is clear again"]


def test_an_overtake_is_planned_again_when_its_car_is_passed() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.look(0, (1, 2.0, 10.0))
    assert [d.reasoning for d in directives(ride.look(0, (1, -20.0, 10.0)))] == ["again: the car ahead is passed"]


def test_it_plans_again_at_most_once_in_three_seconds_and_forgets_nothing() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    for _ in range(20):
        ride.tell("delayed", "rear gap in lane")
        ride.look(1, (1, 40.0, 10.0))
    assert len(ride.directives) == 2
    ride.look(1, (1, 40.0, 10.0), after_s=3.0)
    assert len(ride.directives) == 3


def test_a_plan_that_stays_the_same_is_not_said_again() -> None:
    ride = riding(LEFT, 1)
    assert ride.tell("delayed", "rear gap in lane") == []
    assert ride.deliberation.metrics["replans"] == 1


def test_a_hurry_overtakes_once_a_slow_car_is_ahead() -> None:
    ride = riding(WISHES["faster"], 1, lanes=TWO_WAY)
    assert [d.manoeuvre for d in directives(ride.look(1, (1, 40.0, 10.0)))] == ["overtake"]
    assert [d.manoeuvre for d in ride.directives] == ["cruise", "overtake"]


def test_while_it_faces_oncoming_traffic_nothing_but_the_way_home_is_asked_for() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), lanes=TWO_WAY)
    ride.look(0, (1, 10.0, 10.0))
    assert ride.tell("delayed", "rear gap in lane") == []
    assert [d.target_lane for d in directives(ride.look(0, (1, -10.0, 10.0)))] == [1]
    assert ride.tell("delayed", "rear gap in lane") == []


def test_a_new_command_is_interpreted_with_what_is_being_delayed() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.tell("delayed", "rear gap in lane")
    call = next(e for e in ride.hear() if isinstance(e, Interpret))
    assert (call.context.delayed, call.context.delayed_by) == ("overtake", "rear gap in lane")


def test_a_hurry_passes_the_second_slow_car_too_and_ends_on_its_own_side() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), lanes=TWO_WAY)
    for _ in range(2):
        ride.look(0, (1, 10.0, 10.0), after_s=4.0)
        ride.look(0, (1, -10.0, 10.0), after_s=4.0)
        ride.look(1, (1, -20.0, 10.0), after_s=4.0)
        ride.tell("fulfilled")
        ride.look(1, (1, 60.0, 10.0), after_s=4.0)
    assert [(d.manoeuvre, d.target_lane) for d in ride.directives] == [("overtake", 0), ("overtake", 1)] * 2 + [
        ("overtake", 0)
    ]


def test_after_the_last_reply_a_hurry_goes_on_without_further_ones() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), lanes=TWO_WAY)
    ride.tell("fulfilled")
    ride.look(1, (1, 60.0, 10.0), after_s=4.0)
    ride.tell("fulfilled")
    ride.wait(200, 1)
    assert len(ride.directives) > 5
    assert ride.outcomes == ["heard", "issued", "fulfilled"]
    assert ride.learnt == ["fulfilled"]


def test_a_wish_for_one_overtake_ends_with_it() -> None:
    ride = riding(Slots(outcome="directive", overtake=True), 1, (1, 40.0, 10.0))
    ride.tell("fulfilled")
    assert ride.wait(10, 0, (0, 40.0, 10.0)) == []


def passed_on_the_left(slots: Slots = HURRY) -> Ride:
    """One-way, over from lane 1 to lane 0 and past the slow car."""
    ride = riding(slots, 1, (1, 40.0, 10.0))
    ride.look(0, (1, -30.0, 10.0), after_s=4.0)
    ride.tell("fulfilled")
    return ride


def test_a_hurry_keeps_right_again_after_it_passed_on_the_left() -> None:
    ride = passed_on_the_left()
    ride.wait(10, 0, (1, -40.0, 10.0))
    assert [(d.manoeuvre, d.target_lane) for d in ride.directives[-2:]] == [("overtake", 0), ("cruise", 1)]
    ride.tell("fulfilled")
    assert ride.wait(10, 1) == []


@pytest.mark.parametrize("car", [(1, 85.0, 15.0), (1, -8.0, 20.0)], ids=["slower car ahead", "car beside"])
def test_a_hurry_stays_on_the_left_while_the_right_lane_is_not_free(car: Car) -> None:
    ride = passed_on_the_left()
    assert ride.wait(10, 0, car) == []


def test_a_hurry_that_was_asked_back_stays_where_a_slow_car_turns_up_on_the_right() -> None:
    ride = passed_on_the_left()
    ride.look(0, (1, -40.0, 10.0), after_s=4.0)
    ride.look(0, (1, 90.0, 10.0), after_s=4.0)
    assert [d.target_lane for d in ride.directives[-3:]] == [0, 1, None]


def test_a_hurry_does_not_go_farther_right_than_it_began() -> None:
    ride = riding(HURRY, 1)
    ride.tell("fulfilled")
    assert ride.wait(10, 1) == []


def test_in_a_new_world_the_wish_is_planned_anew() -> None:
    ride = riding(LEFT, 1)
    assert [d.target_lane for d in directives(ride.look(2, epoch=2))] == [1]


# --- the end of an intent ------------------------------------------------------------------------------------------


def test_never_mind_is_issued_and_fulfilled_at_once() -> None:
    ride = Ride()
    ride.look(1)
    assert [e.outcome for e in ride.say(CANCEL) if isinstance(e, Reply)] == ["issued", "fulfilled"]
    assert ride.wait(60, 1) == []


@pytest.mark.parametrize(("slots", "outcome"), [(CANCEL, "cancelled"), (LEFT, "superseded")])
def test_a_replaced_intent_says_so_in_its_own_language(slots: Slots, outcome: Any) -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    reply = next(e for e in ride.say(slots) if isinstance(e, Reply))
    assert (reply.command_id, reply.outcome, reply.say) == (1, outcome, sentence(outcome, "de"))


@pytest.mark.parametrize(("slots", "outcome"), [(CANCEL, "cancelled"), (LEFT, "superseded")])
def test_a_replaced_intent_is_learnt_where_it_was_held_up(slots: Slots, outcome: str) -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.tell("delayed", "rear gap in lane")
    ride.say(slots)
    assert ride.learnt == [f"{outcome}, held up by rear gap in lane"]


def test_a_replaced_intent_that_nothing_held_up_teaches_nothing() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.say(LEFT)
    assert ride.learnt == []


def test_a_replaced_intent_issues_nothing_more() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.say(Slots(outcome="directive", speed="slower"))
    ride.tell("delayed", "rear gap in lane", number=0)
    ride.wait(60, 1, (1, 40.0, 10.0))
    assert {d.manoeuvre for d in ride.directives[1:]} == {"cruise"}


def test_what_cannot_be_interpreted_is_said_in_the_language_last_spoken() -> None:
    ride = riding(HURRY, 1)
    ride.say(None, reached=False)
    ride.say(None)
    assert [r.say for r in ride.replies if r.outcome in ("failed", "refused")] == [
        sentence("failed", "de"),
        sentence("unclear", "de"),
    ]


# --- gates ---------------------------------------------------------------------------------------------------------


def test_without_a_recent_scene_a_command_is_refused_uninterpreted() -> None:
    ride = riding(HURRY, 1)
    ride.now_s += 10.1
    ride.hear()
    assert ride.outcomes[-2:] == ["heard", "refused"]
    assert ride.replies[-1].say == sentence("blind", "de")


def test_a_command_before_the_first_observation_is_held_until_it_comes() -> None:
    ride = Ride()
    assert not [e for e in ride.hear() if isinstance(e, Interpret)]
    assert ride.outcomes == ["heard"]
    calls = [e for e in ride.look(1, after_s=30.0) if isinstance(e, Interpret)]
    assert (len(calls), ride.outcomes) == (1, ["heard"])
    ride.deliberation.on_interpretation(calls[0].id, Interpretation(LEFT), ride._now())
    assert not [e for e in ride.look(1) if isinstance(e, Interpret)]


def test_of_two_commands_before_the_first_observation_the_newer_one_is_held() -> None:
    ride = Ride()
    ride.hear()
    ride.hear()
    assert ride.outcomes == ["heard", "heard", "superseded"]
    assert len([e for e in ride.look(1) if isinstance(e, Interpret)]) == 1


def test_an_answer_to_a_scene_older_than_ten_seconds_is_refused() -> None:
    ride = Ride()
    ride.look(1)
    ride.say(LEFT, thinks_s=10.1)
    assert (ride.outcomes, ride.directives) == (["heard", "refused"], [])
    assert "too late" in ride.replies[-1].why


def test_an_answer_of_a_model_that_may_be_slow_is_planned_for_the_road_as_it_is_then() -> None:
    ride = Ride(budget_s=30.0)
    ride.look(2)
    call = next(e for e in ride.hear() if isinstance(e, Interpret))
    ride.look(1, after_s=25.0)
    issued = ride.deliberation.on_interpretation(call.id, Interpretation(LEFT), ride._now())
    assert [d.target_lane for d in directives(issued)] == [0]


def test_an_answer_that_took_longer_than_the_budget_allows_is_refused() -> None:
    ride = Ride(budget_s=30.0)
    ride.look(1)
    call = next(e for e in ride.hear() if isinstance(e, Interpret))
    ride.look(1, after_s=33.0)
    (refusal,) = ride.deliberation.on_interpretation(call.id, Interpretation(LEFT), ride._now())
    assert isinstance(refusal, Reply)
    assert "too late" in refusal.why


def test_the_road_is_checked_before_the_age_of_the_scene() -> None:
    ride = Ride()
    ride.look(0)
    ride.say(LEFT, thinks_s=10.1)
    assert ride.replies[-1].why == "no lane to the left"


def test_a_command_older_than_ten_seconds_is_refused_and_replaces_nothing() -> None:
    ride = Ride()
    ride.look(1)
    call = next(e for e in ride.hear() if isinstance(e, Interpret))
    ride.hear(old_s=10.1)
    ride.deliberation.on_interpretation(call.id, Interpretation(LEFT), ride._now())
    assert ride.outcomes == ["heard", "refused"]
    assert ride.replies[-1].why == "the command came 10 s late"
