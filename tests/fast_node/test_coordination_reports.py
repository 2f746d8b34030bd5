"""What is reported of a directive that the mask holds back: delayed, overridden, carried out."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.wire.messages import EventKind, MetaAction, Reason
from tests.follower import DEFAULT_HEADWAY_S, HIGHWAY, LEAD, OVERTAKE, PASSED, Follower, Told, observation, shut
from tests.scenes import car, directive

DELAYED, OVERRIDDEN, CARRIED_OUT = EventKind.DELAYED, EventKind.OVERRIDDEN, EventKind.CARRIED_OUT
EXPIRED, FULFILLED = EventKind.EXPIRED, EventKind.FULFILLED
LEFT, RIGHT, CRUISE, SPEED_UP = MetaAction.LEFT, MetaAction.RIGHT, MetaAction.CRUISE, MetaAction.SPEED_UP


@pytest.fixture
def follower() -> Follower:
    return Follower()


# What the mask holds back: lane changes.

REAR = shut(LEFT, by=Reason.REAR_GAP, vehicle=8)
FRONT = shut(LEFT, by=Reason.FRONT_GAP, vehicle=9)
TO_THE_LEFT, TO_THE_RIGHT = directive(target_lane=0), directive(target_lane=3)
ROAD: dict[str, Any] = {"lanes": HIGHWAY, "lane": 1}


def test_a_change_that_the_mask_holds_back_is_reported_once_with_its_rule_and_vehicle(follower):
    assert follower.at(observation(3, **ROAD), TO_THE_LEFT, FRONT).told == [(DELAYED, "front gap in lane", 9, 3, 0.0)]
    assert follower.at(observation(4, **ROAD), None, FRONT).told == []


def test_a_change_to_the_right_is_held_back_by_what_closes_the_right(follower):
    right = shut(RIGHT, by=Reason.FRONT_GAP, vehicle=7)
    assert follower.at(observation(0, **ROAD), TO_THE_RIGHT, {**FRONT, **right}).told == [
        (DELAYED, "front gap in lane", 7, 0, 0.0)
    ]


@pytest.mark.parametrize("told_lane", [TO_THE_RIGHT, directive(target_lane=1), directive(target_speed_mps=25.0)])
def test_what_closes_a_lane_that_is_not_asked_for_holds_nothing_back(follower, told_lane):
    assert DELAYED not in follower.at(observation(0, **ROAD), told_lane, FRONT).kinds


def test_another_rule_is_reported_with_the_beginning_of_the_delay(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    later = follower.at(observation(15, **ROAD), None, shut(LEFT, by=Reason.CHANGING))
    assert later.told == [(DELAYED, "one change at a time", -1, 0, 1.0)]
    assert follower.at(observation(16, **ROAD), None, FRONT).told == []


def test_a_change_that_begins_after_a_delay_is_reported_with_the_last_rule_and_the_length(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(15, **ROAD), None, shut(LEFT, by=Reason.CHANGING, vehicle=6))
    begun = follower.at(observation(30, **ROAD), None, None, LEFT)
    assert begun.told == [(CARRIED_OUT, "one change at a time", 6, 0, 2.0)]
    assert follower.at(observation(31, **ROAD), None, None, LEFT).told == []


def test_a_change_that_is_free_again_but_not_begun_is_not_reported(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    assert follower.at(observation(1, **ROAD)).told == []
    assert follower.at(observation(2, **ROAD), None, None, RIGHT).told == []
    assert follower.at(observation(30, **ROAD), None, None, LEFT).told == [
        (CARRIED_OUT, "front gap in lane", 9, 0, 2.0)
    ]


def test_a_change_that_was_not_held_back_is_not_reported(follower):
    assert follower.at(observation(0, **ROAD), TO_THE_LEFT, None, LEFT).told == []


def test_a_delay_ends_where_its_change_is_no_longer_asked_for(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(1, lanes=HIGHWAY, lane=0, previous_lane=1))
    assert follower.at(observation(30, **ROAD), None, FRONT).told == [(DELAYED, "front gap in lane", 9, 30, 0.0)]


def test_what_ends_tells_the_last_rule_that_held_it_up(follower):
    follower.at(observation(0, **ROAD), directive(target_lane=0, ttl_s=1.0), FRONT)
    assert follower.at(observation(30, **ROAD)).told == [(EXPIRED, "front gap in lane", 9, 0, 2.0)]


def test_after_its_end_a_directive_delays_nothing(follower):
    follower.at(observation(0, **ROAD), directive(target_lane=0, ttl_s=1.0), FRONT)
    follower.at(observation(30, **ROAD), None, FRONT)
    assert follower.at(observation(31, **ROAD), None, FRONT).told == []


def test_once_a_directive_is_fulfilled_it_delays_nothing(follower):
    assert follower.at(observation(0, lanes=HIGHWAY, lane=0), TO_THE_LEFT).kinds == [FULFILLED]
    assert follower.at(observation(1, **ROAD), None, FRONT).told == []


def test_told_nothing_nothing_is_delayed(follower):
    assert follower.at(observation(0, lane=0), None, shut(RIGHT, by=Reason.FRONT_GAP)).told == []


# A car behind: accelerate first, then change.


def test_held_back_by_a_car_behind_the_ego_accelerates_first_and_says_so_once(follower):
    first = follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    assert (first.speed, first.told) == (
        5,
        [(DELAYED, "rear gap in lane", 8, 0, 0.0), (OVERRIDDEN, "rear gap in lane", 8, 0, 0.0)],
    )
    assert follower.at(observation(1, **ROAD), None, REAR) == (0, 26.0, DEFAULT_HEADWAY_S, [])


def test_held_back_by_a_car_ahead_it_does_not_accelerate(follower):
    assert follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT).kinds == [DELAYED]
    assert follower.at(observation(1, **ROAD), None, FRONT).speed == 5


def test_where_the_limit_is_asked_for_already_nothing_is_overridden(follower):
    fast = directive(target_lane=0, target_speed_mps=40.0)
    assert follower.at(observation(0, **ROAD), fast, REAR).kinds == [DELAYED]


def test_just_below_the_limit_the_speed_is_overridden(follower):
    fast = directive(target_lane=0, target_speed_mps=25.5)
    assert follower.at(observation(0, **ROAD), fast, REAR).kinds == [DELAYED, OVERRIDDEN]


def test_a_later_car_behind_is_told_with_the_beginning_of_the_delay(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    assert follower.at(observation(15, **ROAD), None, REAR).told == [
        (DELAYED, "rear gap in lane", 8, 0, 1.0),
        (OVERRIDDEN, "rear gap in lane", 8, 0, 1.0),
    ]


def test_the_ego_keeps_accelerating_until_the_change_that_it_accelerated_for_is_over(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    follower.at(observation(1, **ROAD), None, None, LEFT)
    assert follower.at(observation(2, lanes=HIGHWAY, lane=0, previous_lane=1)).speed == 25.0
    assert follower.at(observation(3, lanes=HIGHWAY, lane=0)).speed == 5


def test_the_ego_keeps_accelerating_while_it_leaves_the_leftmost_lane(follower):
    home = directive(target_lane=1)
    follower.at(observation(0, lanes=HIGHWAY, lane=0), home, shut(RIGHT, by=Reason.REAR_GAP))
    follower.at(observation(1, lanes=HIGHWAY, lane=0), None, None, RIGHT)
    assert follower.at(observation(2, lanes=HIGHWAY, lane=1, previous_lane=0)).speed == 26.0


def test_another_rule_ends_the_acceleration(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    follower.at(observation(1, **ROAD), None, FRONT)
    assert follower.at(observation(2, **ROAD), None, FRONT).speed == 5


# What the mask holds back: speeds.

FASTER = directive(target_speed_mps=8.0, target_lane=1)
GAP = shut(SPEED_UP, by=Reason.SPEED_FOR_GAP, vehicle=3)


def test_a_speed_out_of_reach_for_a_second_is_reported_once(follower):
    told_at = {t: follower.at(observation(t), FASTER if t == 2 else None, GAP).told for t in range(2, 60)}
    assert {t: events for t, events in told_at.items() if events} == {
        17: [(DELAYED, "speed above the gap's", 3, 2, 1.0)]
    }


def test_a_speed_that_is_open_for_a_moment_is_out_of_reach_from_then_on(follower):
    for t in range(30):
        assert follower.at(observation(t), FASTER if t == 0 else None, GAP if t != 14 else None).told == []


def test_only_what_closes_a_faster_speed_delays_one(follower):
    for t in range(30):
        assert follower.at(observation(t), FASTER if t == 0 else None, shut(CRUISE, LEFT, by=Reason.LEAD)).told == []


@pytest.mark.parametrize(("speed", "reported"), [(7.0, []), (6.9, [DELAYED])])
def test_a_speed_is_out_of_reach_only_where_it_is_more_than_a_metre_per_second_off(follower, speed, reported):
    kinds = [
        k for t in range(30) for k in follower.at(observation(t, speed=speed), FASTER if not t else None, GAP).kinds
    ]
    assert kinds == reported


def test_the_delay_of_a_speed_is_told_again_once_the_speed_was_reached(follower):
    def wait(ticks: range) -> list[Told]:
        return [e for t in ticks for e in follower.at(observation(t), FASTER if not t else None, GAP).told]

    assert wait(range(20)) == [(DELAYED, "speed above the gap's", 3, 0, 1.0)]
    follower.at(observation(20, speed=7.2), None, GAP)
    assert wait(range(21, 60)) == [(DELAYED, "speed above the gap's", 3, 21, 1.0)]


def test_the_rule_told_of_a_speed_is_the_one_that_holds_it_back_then(follower):
    for t in range(15):
        follower.at(observation(t), FASTER if t == 0 else None, GAP)
    lead = shut(SPEED_UP, by=Reason.LEAD, vehicle=4)
    assert follower.at(observation(15), None, lead).told == [(DELAYED, "lead too close", 4, 0, 1.0)]


def test_a_speed_that_was_reported_is_not_reported_by_another_rule(follower):
    for t in range(20):
        follower.at(observation(t), FASTER if t == 0 else None, GAP)
    assert follower.at(observation(20), None, shut(SPEED_UP, by=Reason.LEAD)).told == []


def test_elsewhere_than_in_the_lane_asked_for_the_speed_is_not_told_of(follower):
    there = directive(target_speed_mps=20.0, target_lane=0)
    for t in range(30):
        assert follower.at(observation(t, **ROAD), there if t == 0 else None, GAP).told == []


def test_a_speed_waits_anew_after_a_lane_was_waited_for(follower):
    there = directive(target_speed_mps=20.0, target_lane=0)
    follower.at(observation(0, lanes=HIGHWAY, lane=0), there, GAP)
    assert follower.at(observation(1, **ROAD), None, {**GAP, **FRONT}).kinds == [DELAYED]
    told_at = [t for t in range(2, 40) if follower.at(observation(t, lanes=HIGHWAY, lane=0), None, GAP).told]
    assert told_at == [17]


def test_a_speed_that_was_told_of_is_not_told_of_again_after_a_lane_was_waited_for(follower):
    there = directive(target_speed_mps=20.0, target_lane=0)
    told_at = [
        t for t in range(20) if follower.at(observation(t, lanes=HIGHWAY, lane=0), there if not t else None, GAP).told
    ]
    follower.at(observation(20, **ROAD), None, {**GAP, **FRONT})
    told_at += [t for t in range(21, 50) if follower.at(observation(t, lanes=HIGHWAY, lane=0), None, GAP).told]
    assert told_at == [15]


# A directive that is renewed, and one that replaces it.


def test_a_renewed_directive_counts_from_the_first(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(15, **ROAD), directive(id=6, target_lane=0), None)
    assert follower.at(observation(30, lanes=HIGHWAY, lane=0)).told == [(FULFILLED, "front gap in lane", 9, 0, 2.0)]


def test_a_directive_of_another_command_counts_from_its_own_beginning(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(15, **ROAD), directive(id=6, command_id=9, target_lane=0), None)
    assert follower.at(observation(30, lanes=HIGHWAY, lane=0)).told == [(FULFILLED, None, -1, 15, 1.0)]


def test_the_same_command_after_its_end_counts_from_its_new_beginning(follower):
    follower.at(observation(0, lanes=HIGHWAY, lane=1), TO_THE_LEFT, FRONT)
    follower.at(observation(1, lanes=HIGHWAY, lane=0))
    follower.at(observation(15, lanes=HIGHWAY, lane=0), directive(id=6, target_lane=1), None)
    assert follower.at(observation(30, **ROAD)).told == [(FULFILLED, None, -1, 15, 1.0)]


def test_the_same_command_said_again_after_its_end_is_no_new_wish(follower):
    follower.at(observation(0, lanes=HIGHWAY, lane=0), TO_THE_LEFT)
    assert follower.at(observation(15, lanes=HIGHWAY, lane=0), directive(id=6, target_lane=0)).told == []


def test_a_renewed_lane_is_delayed_anew(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    assert follower.at(observation(15, **ROAD), directive(id=6, target_lane=0), FRONT).told == [
        (DELAYED, "front gap in lane", 9, 15, 0.0)
    ]


def test_a_renewed_speed_is_delayed_anew(follower):
    for t in range(15):
        follower.at(observation(t), FASTER if t == 0 else None, GAP)
    again = directive(id=6, target_speed_mps=8.0, target_lane=1)
    told_at = [t for t in range(15, 60) if follower.at(observation(t), again if t == 15 else None, GAP).told]
    assert told_at == [30]


def test_a_renewed_overtake_keeps_the_car_to_pass_and_what_was_told(follower):
    oncoming = shut(LEFT, by=Reason.ONCOMING, vehicle=2)
    assert follower.at(observation(0, LEAD), OVERTAKE, oncoming).kinds == [DELAYED]
    again = directive(id=6, manoeuvre="overtake", target_speed_mps=8.0)
    assert follower.at(observation(1, car(2, 508, 1, 4), LEAD), again, oncoming).kinds == []
    assert follower.at(observation(2, car(2, 508, 1, 4), PASSED, lane=0)).lane == 1


def test_an_overtake_of_another_command_looks_for_a_car_to_pass_anew(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    again = directive(id=6, command_id=9, manoeuvre="overtake", target_speed_mps=8.0)
    follower.at(observation(1, PASSED, car(2, 520, 1, 4)), again)
    assert follower.at(observation(2, PASSED, car(2, 520, 1, 4))).lane == 0


def test_a_cruise_after_an_overtake_has_nobody_to_pass(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    cruise = directive(id=6, command_id=9, target_lane=1)
    assert follower.at(observation(1, LEAD), cruise).told == [(FULFILLED, None, -1, 1, 0.0)]


def test_another_directive_ends_the_acceleration_for_a_car_behind(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    follower.at(observation(1, **ROAD), None, None, LEFT)
    under_way = observation(2, lanes=HIGHWAY, lane=0, previous_lane=1)
    assert follower.at(under_way, directive(id=6, command_id=9, target_lane=0)).speed == 5
