"""What a directive comes down to at each tick, how long it is in force, and when it is fulfilled."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.driving.intent import ANY_LANE
from schemas.runtime.clock import NS
from schemas.wire.messages import Event, EventKind
from tests.follower import DEFAULT_HEADWAY_S, HIGHWAY, LEAD, OVERTAKE, PASSED, TWO_WAY, Follower, in_short, observation
from tests.scenes import car, directive, lane

EXPIRED, FULFILLED = EventKind.EXPIRED, EventKind.FULFILLED


@pytest.fixture
def follower() -> Follower:
    return Follower()


# What is done when nothing is told.


def test_told_nothing_the_ego_keeps_its_lane_its_set_point_and_the_usual_headway(follower):
    assert follower.at(observation(0, target_speed_mps=6.6)) == (1, 7, DEFAULT_HEADWAY_S, [])


def test_without_a_set_point_the_speed_it_has_is_kept(follower):
    assert follower.at(observation(0, target_speed_mps=0.0, speed=3.4)).speed == 3


def test_the_speed_kept_is_that_of_the_first_tick_of_the_world(follower):
    follower.at(observation(0, target_speed_mps=6.0))
    assert follower.at(observation(1, target_speed_mps=7.0)).speed == 6
    assert follower.at(observation(0, target_speed_mps=7.0, epoch=2)).speed == 7


def test_a_new_world_ends_the_directive_of_the_old_one(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0))
    assert follower.at(observation(0, epoch=2), directive(target_speed_mps=7.0)).speed == 5


def test_in_a_new_world_a_directive_may_have_a_smaller_number(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0))
    assert follower.at(observation(0, epoch=2), directive(epoch=2, id=1, target_speed_mps=6.0)).speed == 6


# Which directive is followed, and how long.


def test_a_directive_stays_in_force_until_the_next_one(follower):
    follower.at(observation(0), directive(target_speed_mps=6.0))
    assert follower.at(observation(1)).speed == 6
    assert follower.at(observation(2), directive(id=6, target_speed_mps=7.0)).speed == 7


@pytest.mark.parametrize("number", [4, 5])
def test_a_directive_that_is_not_newer_is_ignored(follower, number):
    follower.at(observation(0), directive(target_speed_mps=6.0))
    assert follower.at(observation(1), directive(id=number, target_speed_mps=7.0)).speed == 6


def test_a_directive_is_in_force_to_the_end_of_its_time_to_live_and_no_longer(follower):
    short = directive(stamp_ns=NS, target_speed_mps=7.0, target_lane=0, ttl_s=2.0)
    two_lanes: dict[str, Any] = {"lanes": HIGHWAY, "lane": 1}
    assert follower.at(observation(0, **two_lanes), short, now_s=3.0)[:2] == (0, 7.0)
    late = follower.at(observation(30, **two_lanes), now_s=3.0 + 1e-9)
    assert late == (ANY_LANE, 7.0, DEFAULT_HEADWAY_S, [(EXPIRED, None, -1, 0, 2.0)])


def test_the_end_of_a_directive_is_reported_once(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0, ttl_s=1.0))
    assert [follower.at(observation(tick)).kinds for tick in (20, 21)] == [[EXPIRED], []]


def test_a_directive_that_is_fulfilled_does_not_expire(follower):
    assert follower.at(observation(0), directive(target_speed_mps=5.0, ttl_s=1.0)).kinds == [FULFILLED]
    assert follower.at(observation(20)).kinds == []


def test_once_fulfilled_a_speed_is_kept_beyond_the_time_to_live(follower):
    follower.at(observation(0, speed=7.0), directive(target_speed_mps=7.0, ttl_s=1.0))
    assert follower.at(observation(20)).speed == 7


def test_a_speed_that_was_never_reached_stands_beyond_the_time_to_live(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0, ttl_s=1.0))
    assert [follower.at(observation(tick)).speed for tick in (20, 2000)] == [7.0, 7.0]


def test_a_fulfilled_cruise_goes_on_as_it_was_told(follower):
    follower.at(observation(0), directive(target_speed_mps=5.0, headway_s=3.0))
    assert follower.at(observation(1)) == (1, 5.0, 3.0, [])


def test_a_stop_that_is_fulfilled_is_followed_by_standing(follower):
    assert follower.at(observation(0, speed=0.2), directive(manoeuvre="stop", ttl_s=1.0)).kinds == [FULFILLED]
    assert follower.at(observation(2000, speed=0.0)) == (1, 0.0, DEFAULT_HEADWAY_S, [])


# Which speed.


@pytest.mark.parametrize(("asked", "speed"), [(7.5, 7.5), (30.0, 8.0), (-1.0, 0.0), (0.0, 0.0)])
def test_a_speed_is_that_of_the_directive_within_the_limit_of_the_lane(follower, asked, speed):
    assert follower.at(observation(0), directive(target_speed_mps=asked)).speed == speed


def test_in_a_borrowed_lane_the_limit_is_that_of_the_way_home(follower):
    assert follower.at(observation(0, lane=0), directive(target_speed_mps=30.0)).speed == 8.0


def test_a_cruise_without_a_speed_keeps_the_speed(follower):
    assert follower.at(observation(0, target_speed_mps=6.0), directive(target_lane=1)).speed == 6


def test_an_overtake_without_a_speed_goes_up_to_the_limit(follower):
    assert follower.at(observation(0), directive(manoeuvre="overtake")).speed == 8.0


def test_an_overtake_with_a_speed_keeps_to_it(follower):
    assert follower.at(observation(0), directive(manoeuvre="overtake", target_speed_mps=7.0)).speed == 7.0


def test_a_stop_is_standing_in_the_own_lane_whatever_else_it_says(follower):
    stop = directive(manoeuvre="stop", target_speed_mps=7.0, target_lane=3)
    assert follower.at(observation(0, lanes=HIGHWAY), stop)[:2] == (1, 0.0)


# Which headway.


@pytest.mark.parametrize(
    ("fields", "headway"),
    [
        ({}, DEFAULT_HEADWAY_S),
        ({"style": "normal"}, DEFAULT_HEADWAY_S),
        ({"style": "assertive"}, 1.2),
        ({"style": "calm"}, 2.0),
        ({"style": "calm", "headway_s": 0.8}, 0.8),
        ({"style": "calm", "headway_s": 0.0}, 2.0),
    ],
)
def test_the_headway_is_that_of_the_directive_or_of_its_style(follower, fields, headway):
    assert follower.at(observation(0), directive(**fields)).headway == headway


# Which lane.


@pytest.mark.parametrize(("asked", "lane"), [(0, 0), (2, 2), (3, 3), (4, ANY_LANE), (-1, ANY_LANE), (-2, ANY_LANE)])
def test_the_lane_is_that_of_the_directive_where_there_is_one(follower, asked, lane):
    assert follower.at(observation(0, lanes=HIGHWAY), directive(target_lane=asked)).lane == lane


def test_nobody_cruises_in_the_oncoming_lane(follower):
    assert follower.at(observation(0), directive(target_lane=0)).lane == 1


def test_from_a_borrowed_lane_it_goes_home(follower):
    assert follower.at(observation(0, lane=0)).lane == 1


def test_from_a_lane_that_ends_it_goes_to_the_nearest_that_goes_on(follower):
    road = [lane(k, end_m=900 if k < 2 else 400) for k in range(4)]
    lanes = tuple(road)
    assert [follower.at(observation(0, lanes=lanes, lane=k)).lane for k in range(4)] == [ANY_LANE, ANY_LANE, 1, 1]
    assert follower.at(observation(1, lanes=lanes, lane=1, previous_lane=2)).lane == 1
    assert follower.at(observation(2, lanes=lanes, lane=1)).lane == ANY_LANE


@pytest.mark.parametrize("asked", [5.1, 5.0, 4.0, None])
def test_any_lane_will_do_for_who_is_told_no_lane(follower, asked):
    assert follower.at(observation(0, lanes=HIGHWAY), directive(target_speed_mps=asked)).lane == ANY_LANE


def test_who_is_told_to_go_faster_in_a_lane_goes_to_that_lane(follower):
    assert follower.at(observation(0, lanes=HIGHWAY), directive(target_speed_mps=20.0, target_lane=2)).lane == 2


def test_any_lane_will_do_to_overtake_where_none_is_oncoming(follower):
    assert (
        follower.at(observation(0, car(1, 520, 1, 3), lanes=HIGHWAY), directive(manoeuvre="overtake")).lane == ANY_LANE
    )


def test_a_lane_that_is_told_to_overtake_in_is_taken_where_none_is_oncoming(follower):
    told_lane = directive(manoeuvre="overtake", target_lane=2)
    assert follower.at(observation(0, car(1, 520, 1, 3), lanes=HIGHWAY), told_lane).lane == 2


def test_the_oncoming_lane_is_taken_beside_the_car_to_pass_and_left_once_that_is_passed(follower):
    assert follower.at(observation(0, LEAD), OVERTAKE).lane == 0
    assert follower.at(observation(1, PASSED, lane=0)).lane == 1


def test_the_car_to_pass_is_the_one_that_was_ahead_when_the_directive_came(follower):
    follower.at(observation(0, LEAD, car(2, 530, 1, 4)), OVERTAKE)
    assert follower.at(observation(1, PASSED, car(2, 530, 1, 4), lane=0)).lane == 1


def test_the_car_to_pass_is_looked_for_in_the_own_lane_from_the_borrowed_one(follower):
    assert follower.at(observation(0, LEAD, car(2, 505, 0, -4), lane=0), OVERTAKE).lane == 0


@pytest.mark.parametrize(("asked", "lane"), [(1, 1), (0, 0)])
def test_who_is_told_to_overtake_in_the_own_lane_stays_in_it(follower, asked, lane):
    told_lane = directive(manoeuvre="overtake", target_lane=asked)
    assert follower.at(observation(0, LEAD), told_lane).lane == lane


def test_with_nobody_to_pass_the_own_lane_is_kept(follower):
    assert follower.at(observation(0), OVERTAKE).lane == 1


def test_beside_the_leftmost_lane_there_is_none_to_borrow(follower):
    mirrored: dict[str, Any] = {"lanes": (HIGHWAY[0], lane(1, oncoming=True)), "lane": 0}
    assert follower.at(observation(0, car(1, 520, 0, 3), **mirrored), OVERTAKE).lane == 0
    assert follower.at(observation(1, car(1, 480, 0, 3), **mirrored)).lane == 0


# When a directive is fulfilled.


def test_a_fulfilled_directive_is_reported_with_its_length_and_what_it_is_an_answer_to(follower):
    follower.at(observation(3), directive(target_speed_mps=7.0))
    follower.at(observation(33, speed=7.0, stamp_ns=77))
    (event,) = follower.events
    assert event == Event(
        epoch=1,
        stamp_ns=77,
        kind=FULFILLED,
        node="fast",
        tick=33,
        reason=None,
        since_tick=3,
        duration_s=2.0,
        directive_id=5,
        command_id=4,
    )
    assert in_short(event) == (FULFILLED, None, -1, 3, 2.0)


@pytest.mark.parametrize(("speed", "met"), [(6.5, True), (6.25, False), (7.5, True), (7.75, False)])
def test_a_speed_is_met_within_half_a_metre_per_second(follower, speed, met):
    assert follower.at(observation(0, speed=speed), directive(target_speed_mps=7.0)).kinds == [FULFILLED] * met


def test_a_speed_above_the_limit_is_met_at_the_limit(follower):
    assert follower.at(observation(0, speed=8.0), directive(target_speed_mps=30.0)).kinds == [FULFILLED]


def test_a_stop_is_met_only_at_a_standstill(follower):
    assert follower.at(observation(0, speed=5.0), directive(manoeuvre="stop")).kinds == []


def test_a_lane_alone_is_met_at_any_speed(follower):
    seen = observation(0, lanes=HIGHWAY, speed=1.0)
    assert follower.at(seen, directive(target_lane=1)).kinds == [FULFILLED]


def test_a_lane_is_met_once_it_is_aimed_for_and_the_change_is_over(follower):
    there = directive(target_lane=2)
    assert follower.at(observation(0, lanes=HIGHWAY, lane=1), there).kinds == []
    assert follower.at(observation(1, lanes=HIGHWAY, lane=2, previous_lane=1)).kinds == []
    assert follower.at(observation(2, lanes=HIGHWAY, lane=2, previous_lane=0)).kinds == []
    assert follower.at(observation(3, lanes=HIGHWAY, lane=2)).kinds == [FULFILLED]


def test_a_speed_in_any_lane_is_met_in_any(follower):
    seen = observation(0, lanes=HIGHWAY, speed=20.0)
    assert follower.at(seen, directive(target_speed_mps=20.0)) == (ANY_LANE, 20.0, 1.5, [(FULFILLED, None, -1, 0, 0.0)])


@pytest.mark.parametrize(("x", "met"), [(516.0, True), (515.9, True), (515.5, True), (513.9, False)])
def test_a_headway_is_met_with_nine_tenths_of_it(follower, x, met):
    # 2 s at 5 m/s are 10 m, nine tenths of it 9 m; the cars are 5 m long.
    seen = observation(0, car(2, 505.5, 0, -5), car(1, x, 1, 5))
    assert follower.at(seen, directive(headway_s=2.0)).kinds == [FULFILLED] * met


def test_a_headway_of_exactly_nine_tenths_is_met(follower):
    assert follower.at(observation(0, car(1, 514.0, 1, 5)), directive(headway_s=2.0)).kinds == [FULFILLED]


def test_the_headway_is_kept_to_the_next_car_and_to_no_other(follower):
    seen = observation(0, car(2, 560, 1, 5), car(1, 515, 1, 5), car(3, 503, 0, 5), lanes=HIGHWAY)
    assert follower.at(seen, directive(headway_s=2.0)).kinds == [FULFILLED]


def test_a_style_asks_for_no_headway_before_it_is_fulfilled(follower):
    assert follower.at(observation(0, car(1, 506, 1, 5)), directive(style="calm")).kinds == [FULFILLED]


def test_an_overtake_is_fulfilled_when_the_car_is_passed_the_ego_is_home_and_the_change_over(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, LEAD)).kinds == []
    assert follower.at(observation(2, PASSED, lane=0)).kinds == []
    assert follower.at(observation(3, PASSED, previous_lane=0)).kinds == []
    assert follower.at(observation(4, PASSED)).kinds == [FULFILLED]


def test_an_overtake_is_not_fulfilled_while_there_is_no_room_to_move_in_before_the_car(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, car(1, 491.5, 1, 4))).kinds == []


def test_an_overtake_is_not_fulfilled_by_losing_the_car_ahead_out_of_reach(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, car(1, 580, 1, 8))).kinds == []


def test_an_overtake_is_fulfilled_whatever_the_speed_and_whoever_is_ahead_then(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, PASSED, car(2, 510, 1, 4), speed=3.0)).kinds == [FULFILLED]


def test_with_nobody_to_pass_on_a_two_way_road_an_overtake_is_not_fulfilled(follower):
    assert follower.at(observation(0, speed=8.0), OVERTAKE).kinds == []


def test_with_nobody_to_pass_where_no_lane_is_oncoming_the_speed_will_do(follower):
    assert follower.at(observation(0, lanes=HIGHWAY, speed=8.0), OVERTAKE).kinds == [FULFILLED]
    left = Follower()
    assert left.at(observation(0, lanes=HIGHWAY, speed=8.0, lane=0), OVERTAKE).kinds == [FULFILLED]


def test_an_oncoming_lane_beyond_the_next_is_not_borrowed(follower):
    two_of_ours = (TWO_WAY[0], TWO_WAY[1], lane(2, limit_mps=8.0))
    assert follower.at(observation(0, lanes=two_of_ours, speed=8.0, lane=2), OVERTAKE).kinds == [FULFILLED]
