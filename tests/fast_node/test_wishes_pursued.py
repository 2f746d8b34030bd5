"""What is driven to: a gap from both sides, and a car to overtake, near or far."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.driving.intent import ANY_LANE, CALM
from schemas.wire.messages import Directive, EventKind
from tests.follower import DEFAULT_HEADWAY_S, HIGHWAY, LEAD, OVERTAKE, PASSED, TWO_WAY, Follower, observation
from tests.scenes import car, directive, lane

EXPIRED, FULFILLED = EventKind.EXPIRED, EventKind.FULFILLED
ROAD: dict[str, Any] = {"lanes": HIGHWAY, "lane": 1}
"""One way; the limit is 26 m/s."""
LEFT_NOW: dict[str, Any] = {"lanes": HIGHWAY, "lane": 0}


@pytest.fixture
def follower() -> Follower:
    return Follower()


def wish(number: int, **fields: Any) -> Directive:
    """In answer to a command of its own."""
    return directive(id=number, command_id=number, **fields)


# The gap.


CLOSER = wish(1, manoeuvre="follow", headway_s=1.0)
"""At 20 m/s: 20 m, and from 18 to 26 m will do."""


def at_gap(
    follower: Follower,
    tick: int,
    told: Directive | None,
    gap_m: float,
    lead_mps: float = 20.0,
    speed: float = 20.0,
    set_point: float = 22.0,
) -> Any:
    ahead = car(1, 505 + gap_m, 1, lead_mps)
    return follower.at(observation(tick, ahead, **ROAD, speed=speed, target_speed_mps=set_point), told)


@pytest.mark.parametrize(
    ("gap_m", "speed", "met"), [(17.9, 18.0, False), (18.1, 22, True), (25.9, 22, True), (26.1, 26.0, False)]
)
def test_a_gap_is_driven_to_up_and_down_and_only_then_fulfilled(follower, gap_m, speed, met):
    assert at_gap(follower, 0, CLOSER, gap_m)[1:] == (speed, 1.0, [(FULFILLED, None, -1, 0, 0.0)] * met)


def test_a_gap_is_driven_to_in_the_own_lane_and_then_any_will_do(follower):
    assert [at_gap(follower, t, CLOSER, gap_m).lane for t, gap_m in enumerate((60.0, 40.0, 25.0, 25.0))] == [
        1,
        1,
        1,
        ANY_LANE,
    ]


def test_closer_goes_on_at_the_speed_of_the_car_that_was_driven_up_to(follower):
    at_gap(follower, 0, CLOSER, 60.0, lead_mps=24.0)
    assert at_gap(follower, 1, None, 25.0, lead_mps=24.0).kinds == [FULFILLED]
    assert at_gap(follower, 2, None, 25.0, lead_mps=24.0).speed == 24.0


def test_closer_to_a_slower_car_goes_on_at_the_speed_that_stands(follower):
    at_gap(follower, 0, CLOSER, 60.0)
    at_gap(follower, 1, None, 25.0)
    assert at_gap(follower, 2, None, 25.0).speed == 22


def test_a_speed_that_is_named_with_the_gap_is_not_exceeded_for_it_and_leaves_the_lane_open(follower):
    both = wish(1, headway_s=1.0, target_speed_mps=23.0)
    assert at_gap(follower, 0, both, 60.0)[:3] == (ANY_LANE, 23.0, 1.0)
    assert at_gap(follower, 1, None, 25.0, speed=23.0).kinds == [FULFILLED]


def test_more_room_is_made_at_a_steady_speed_below_that_of_the_car_ahead(follower):
    leads = [20.0, 20.5, 19.5, 20.9, 21.2]
    speeds = [at_gap(follower, t, wish(1, headway_s=3.0), 20.0, lead_mps=v).speed for t, v in enumerate(leads)]
    assert speeds == pytest.approx([18.0, 18.0, 18.0, 18.0, 19.2])


def test_more_room_is_never_made_by_driving_backwards(follower):
    assert at_gap(follower, 0, wish(1, headway_s=3.0), 2.0, lead_mps=1.0, speed=3.0).speed == 0.0


@pytest.mark.parametrize(
    ("gap_m", "lead_mps"), [(100.1, 20.0), (60.0, 25.6)], ids=["too far ahead", "as fast as the limit"]
)
def test_a_car_that_cannot_be_driven_up_to_is_nobody(follower, gap_m, lead_mps):
    assert at_gap(follower, 0, CLOSER, gap_m, lead_mps=lead_mps)[:2] == (ANY_LANE, 22)
    assert [(e.kind, e.detail) for e in follower.events] == [(FULFILLED, "nobody ahead to keep the gap to")]


@pytest.mark.parametrize(("gap_m", "lead_mps"), [(99.9, 20.0), (60.0, 25.4)])
def test_a_car_that_can_just_be_driven_up_to_is_driven_up_to(follower, gap_m, lead_mps):
    assert at_gap(follower, 0, CLOSER, gap_m, lead_mps=lead_mps)[:2] == (1, 26.0)


def test_at_speed_a_car_is_driven_up_to_from_five_seconds_away(follower):
    assert at_gap(follower, 0, CLOSER, 119.0, speed=24.0)[:2] == (1, 26.0)


def test_with_nobody_ahead_a_gap_is_fulfilled_at_once_and_stands(follower):
    assert follower.at(observation(0, **ROAD), CLOSER) == (ANY_LANE, 5, 1.0, [(FULFILLED, None, -1, 0, 0.0)])
    assert follower.events[0].detail == "nobody ahead to keep the gap to"
    assert follower.at(observation(1, car(1, 540, 1, 5), **ROAD)) == (ANY_LANE, 5, 1.0, [])


def test_an_event_of_a_gap_to_a_car_has_no_detail(follower):
    at_gap(follower, 0, CLOSER, 20.0)
    assert [(e.kind, e.detail) for e in follower.events] == [(FULFILLED, "")]


def test_a_lane_comes_before_the_gap_in_it(follower):
    both = wish(1, headway_s=1.0, target_lane=0)
    assert follower.at(observation(0, car(1, 560, 1, 5), **ROAD), both) == (0, 5, 1.0, [])
    assert follower.at(observation(1, car(1, 560, 0, 5), **LEFT_NOW)) == (0, 25.0, 1.0, [])


def test_a_gap_that_is_held_after_it_was_driven_to_is_not_driven_to_again(follower):
    at_gap(follower, 0, CLOSER, 20.0)
    held = directive(id=2, command_id=1, headway_s=1.0)
    assert at_gap(follower, 1, held, 60.0) == (ANY_LANE, 22, 1.0, [])


def test_a_gap_that_expired_is_driven_to_again_when_it_is_said_again(follower):
    at_gap(follower, 0, wish(1, headway_s=1.0, ttl_s=1.0), 60.0)
    assert at_gap(follower, 30, None, 60.0).kinds == [EXPIRED]
    again = directive(id=2, command_id=1, headway_s=1.0, ttl_s=100.0)
    assert at_gap(follower, 31, again, 60.0).speed == 26.0


def test_a_renewed_gap_is_driven_to_as_before(follower):
    renewed = directive(id=2, command_id=1, manoeuvre="follow", headway_s=1.0)
    assert [at_gap(follower, t, told, 60.0).speed for t, told in enumerate((CLOSER, None, renewed, None))] == [26.0] * 4


# The car to overtake.


def test_a_car_far_ahead_is_gone_after_up_to_the_limit_and_then_passed(follower):
    overtake = wish(1, manoeuvre="overtake", target_speed_mps=8.0, target_lane=0)
    assert follower.at(observation(0, car(1, 650, 1, 4)), overtake)[:2] == (1, 8.0)
    assert follower.at(observation(1, car(1, 560, 1, 4)))[:2] == (1, 8.0)
    assert follower.at(observation(2, car(1, 514, 1, 4)))[:2] == (0, 8.0)


@pytest.mark.parametrize(("x", "lane"), [(570.0, ANY_LANE), (560.0, 0)])
def test_on_a_road_of_one_way_the_lane_to_pass_in_is_taken_once_the_car_is_near(follower, x, lane):
    overtake = wish(1, manoeuvre="overtake", target_speed_mps=26.0, target_lane=0)
    assert follower.at(observation(0, car(1, x, 1, 4), **ROAD), overtake)[:2] == (lane, 26.0)


def test_once_the_ego_has_moved_over_to_pass_any_lane_will_do(follower):
    overtake = wish(1, manoeuvre="overtake", target_speed_mps=26.0, target_lane=0)
    follower.at(observation(0, LEAD, **ROAD), overtake)
    assert follower.at(observation(1, LEAD, lanes=HIGHWAY, lane=0, previous_lane=1)).lane == 0
    assert [follower.at(observation(2 + k, LEAD, lanes=HIGHWAY, lane=k)).lane for k in (0, 1)] == [ANY_LANE] * 2


def test_on_a_road_of_one_way_an_overtake_is_fulfilled_once_the_car_is_passed(follower):
    overtake = wish(1, manoeuvre="overtake", target_speed_mps=26.0, target_lane=0)
    assert follower.at(observation(0, LEAD, **ROAD), overtake).kinds == []
    assert follower.at(observation(1, LEAD, **LEFT_NOW, speed=25.0)).kinds == []
    assert follower.at(observation(2, PASSED, lanes=HIGHWAY, lane=1, previous_lane=0)).kinds == []
    assert follower.at(observation(3, PASSED, **LEFT_NOW)).kinds == [FULFILLED]
    assert follower.at(observation(4, PASSED, **LEFT_NOW))[:2] == (ANY_LANE, 25.0)


def test_whoever_comes_first_is_overtaken_where_nobody_was_ahead(follower):
    follower.at(observation(0), OVERTAKE)
    assert follower.at(observation(1, LEAD)).lane == 0


def test_a_car_that_is_not_seen_for_a_moment_is_still_the_one_to_pass(follower):
    other = car(2, 540, 1, 4)
    follower.at(observation(0, LEAD, other), OVERTAKE)
    assert follower.at(observation(14, other)).kinds == []
    assert follower.at(observation(15, PASSED, other)).kinds == [FULFILLED]


def test_a_car_that_was_ahead_and_is_gone_is_followed_by_the_next(follower):
    other = car(2, 540, 1, 4)
    follower.at(observation(0, LEAD, other), OVERTAKE)
    follower.at(observation(15, other))
    assert follower.at(observation(16, other)).lane == 0
    assert follower.at(observation(17, car(2, 490, 1, 4))).kinds == [FULFILLED]


def test_a_car_that_was_behind_and_is_gone_was_passed(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    follower.at(observation(1, car(1, 499, 1, 4), lane=0))
    assert [follower.at(observation(tick)).kinds for tick in (15, 16)] == [[], [FULFILLED]]


def test_an_overtake_that_was_planned_before_its_car_was_passed_is_no_new_one(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    follower.at(observation(9, PASSED))
    again, other = {"manoeuvre": "overtake", "target_speed_mps": 8.0}, car(2, 520, 1, 4)
    assert follower.at(observation(10, PASSED, other), directive(id=6, scene_tick=9, **again)).lane == 1
    assert follower.at(observation(11, PASSED, other), directive(id=7, scene_tick=10, **again)).lane == 0


def test_the_way_home_is_fulfilled_at_home_without_a_car_to_pass(follower):
    home = wish(1, manoeuvre="overtake", target_lane=1, target_speed_mps=8.0)
    assert follower.at(observation(0, LEAD, lane=0, speed=8.0), home) == (1, 8.0, DEFAULT_HEADWAY_S, [])
    assert follower.at(observation(1, LEAD, speed=8.0)).kinds == [FULFILLED]


def test_an_overtake_without_a_speed_leaves_the_limit_to_be_driven(follower):
    follower.at(observation(0, LEAD), wish(1, manoeuvre="overtake", ttl_s=1.0))
    assert follower.at(observation(20, LEAD))[:2] == (1, TWO_WAY[1].speed_limit_mps)


# Limits.


@pytest.mark.parametrize(("asked", "speed"), [(0.49, 0.0), (0.5, 0.5), (1.0, 1.0)])
def test_less_than_half_a_metre_per_second_is_standing(follower, asked, speed):
    assert follower.at(observation(0), wish(1, target_speed_mps=asked)).speed == speed


def test_a_slow_speed_is_gone_on_with(follower):
    follower.at(observation(0), wish(1, target_speed_mps=0.5))
    assert follower.at(observation(1), wish(2, target_lane=1)).speed == 0.5


def test_a_car_beside_the_ego_that_is_gone_was_not_passed(follower):
    other = car(2, 540, 1, 4)
    follower.at(observation(0, LEAD, other), OVERTAKE)
    follower.at(observation(1, car(1, 500, 1, 4), other, lane=0))
    follower.at(observation(16, other))
    assert follower.at(observation(17, other)) == (0, 8.0, DEFAULT_HEADWAY_S, [])


def test_whose_car_is_gone_on_the_way_home_looks_for_no_other(follower):
    other, home = car(2, 540, 1, 4), {"manoeuvre": "overtake", "target_lane": 1}
    follower.at(observation(0, LEAD, other), OVERTAKE)
    follower.at(observation(1, LEAD, other, lane=0), directive(id=6, **home))
    assert follower.at(observation(16, other, speed=8.0)).kinds == [FULFILLED]


def test_the_way_home_is_taken_before_the_car_is_passed_if_it_is_asked_for(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    home = directive(id=6, manoeuvre="overtake", target_lane=1)
    assert follower.at(observation(1, LEAD, lane=0), home).lane == 1


def test_what_expires_has_no_detail(follower):
    follower.at(observation(0, **ROAD), wish(1, target_lane=0, ttl_s=1.0))
    follower.at(observation(20, **ROAD))
    assert [(e.kind, e.detail) for e in follower.events] == [(EXPIRED, "")]


def test_at_speed_the_lane_to_pass_in_is_taken_from_five_seconds_away(follower):
    overtake = wish(1, manoeuvre="overtake", target_lane=0)
    near, nearest = car(1, 620, 1, 4), car(2, 490, 2, 5)
    assert follower.at(observation(0, nearest, near, **ROAD, speed=24.0), overtake).lane == 0
    assert Follower().at(observation(0, nearest, near, **ROAD, speed=23.0), overtake).lane == ANY_LANE


def test_other_cars_far_ahead_do_not_make_the_one_to_pass_far(follower):
    overtake = wish(1, manoeuvre="overtake", target_lane=0)
    assert follower.at(observation(0, LEAD, car(2, 640, 2, 5), **ROAD), overtake).lane == 0


def test_an_overtake_in_another_lane_that_was_planned_before_its_car_was_passed_is_no_new_one(follower):
    follower.at(observation(0, LEAD, **ROAD), wish(1, manoeuvre="overtake", target_lane=0))
    follower.at(observation(9, PASSED, **ROAD))
    again = directive(id=2, command_id=1, manoeuvre="overtake", target_lane=2, scene_tick=9)
    assert follower.at(observation(10, LEAD, **ROAD), again).lane == ANY_LANE


def test_a_lane_that_ends_soon_is_not_moved_over_to(follower):
    road: dict[str, Any] = {"lanes": (lane(0, end_m=540.0), lane(1), lane(2)), "lane": 1}
    standing = car(2, 100, 2, 0)
    overtake = wish(1, manoeuvre="overtake", target_lane=0)
    assert follower.at(observation(0, standing, LEAD, **road), overtake).lane == ANY_LANE


def test_an_overtake_with_a_gap_drives_to_none(follower):
    overtake = wish(1, manoeuvre="overtake", headway_s=3.0, target_speed_mps=5.0)
    assert follower.at(observation(0, car(1, 507, 1, 3), **ROAD), overtake) == (ANY_LANE, 5.0, 3.0, [])
    assert follower.at(observation(1, car(1, 480, 1, 3), **ROAD)).kinds == [FULFILLED]
    assert follower.events[-1].detail == ""


def test_a_stop_drives_to_no_gap(follower):
    assert follower.at(observation(0, car(1, 507, 1, 3)), wish(1, manoeuvre="stop", headway_s=3.0))[:2] == (1, 0.0)
    assert follower.at(observation(1, car(1, 507, 1, 0), speed=0.4)).kinds == [FULFILLED]


def test_a_gap_that_was_right_from_the_start_leaves_the_speed_as_it_was(follower):
    assert at_gap(follower, 0, CLOSER, 22.0, lead_mps=24.0).kinds == [FULFILLED]
    assert at_gap(follower, 1, None, 22.0, lead_mps=24.0).speed == 22


def test_a_car_that_drives_as_fast_as_the_named_speed_is_nobody(follower):
    both = wish(1, headway_s=1.0, target_speed_mps=20.0)
    assert at_gap(follower, 0, both, 60.0, lead_mps=19.6).kinds == [FULFILLED]
    assert at_gap(Follower(), 0, both, 60.0, lead_mps=19.4).kinds == []


def test_the_style_of_a_stop_is_not_that_of_what_came_before(follower):
    follower.at(observation(0), wish(1, target_speed_mps=4.0, style="calm"))
    follower.at(observation(1), wish(2, target_speed_mps=0.0, style="assertive"))
    assert follower.style == CALM


def test_while_the_ego_changes_lanes_it_has_not_moved_over_yet(follower):
    overtake = wish(1, manoeuvre="overtake", target_lane=1)
    assert follower.at(observation(0, car(1, 514, 1, 4), lanes=HIGHWAY, lane=1, previous_lane=0), overtake).lane == 1
