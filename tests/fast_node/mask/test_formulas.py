"""The mask's formulas against numbers worked out by hand, with a preset of round numbers."""

from __future__ import annotations

import math
from typing import Any

import pytest

from fast_node.mask.entering import entry, follower_gap, must_leave
from fast_node.mask.gaps import allowed_speed, aside_m, side_gap
from fast_node.mask.lane_end import speed_before_end
from fast_node.mask.passing import pass_time_s, passing, start_pass
from fast_node.mask.vocabulary import (
    FRONT_GAP,
    LEAD,
    NO_LANE,
    NO_RETURN,
    NOTHING_TO_PASS,
    ONCOMING,
    OPEN,
    PRESETS,
    REAR_GAP,
    back_action,
)
from fast_node.policies.load import load_policy
from schemas.driving.road import LANE, lane_table
from schemas.wire.messages import MetaAction
from tests.mask_scenes import HIGHWAY, LANES, PLAIN, RAMP, SIGHT_M, moving, situation
from tests.scenes import car, lane


def test_the_presets_have_the_names_that_are_asked_for():
    assert set(PRESETS) == {"sim", "cautious"}


def test_the_shipped_policy_has_learnt_behind_this_version_of_the_mask():
    load_policy()  # refuses another


# Speeds that a gap admits.


@pytest.mark.parametrize(
    ("gap", "lead", "speed"),
    [
        (11.0, 10.0, 9.0),  # 2 m short of 3 m and 1 s: half of it in m/s below the lead's speed
        (20.0, 0.0, 8.5),
        (20.0, 10.0, math.sqrt(4 + 144 + 50) - 2),  # what it can brake from
        (1.0, 0.0, 0.0),
    ],
)
def test_a_gap_admits_the_speed_that_it_can_follow_at_and_brake_from(gap, lead, speed):
    assert allowed_speed(gap, lead, PLAIN) == pytest.approx(speed)


def test_the_last_two_metres_of_a_gap_are_not_braked_in():
    assert allowed_speed(1.0, 4.0, PLAIN._replace(follow_s=0.0)) == pytest.approx(math.sqrt(12) - 2)


def test_nobody_is_admitted_a_step_by_a_gap_just_above_nothing():
    assert allowed_speed(3.5, 0.0, PLAIN) == pytest.approx(0.25)


# Room for a follower.


@pytest.mark.parametrize(
    ("behind", "ego", "gap"),
    [
        (10.0, 8.0, 10 + 0.25 + 11.025 - 8),
        (10.0, 2.5, 15 + 0.5625 + 11.55625 - 0.78125),  # at half the walking pace it reacts half a second later
        (10.0, 0.0, 20 + 1 + 12.1),
        (0.0, 5.0, 4.0),  # never less than at a standstill, and a metre
    ],
)
def test_a_follower_that_is_spared_nothing_needs_room_to_stop(behind, ego, gap):
    assert follower_gap(behind, ego, True, PLAIN) == pytest.approx(gap)


def test_a_follower_that_is_spared_a_brake_needs_an_idm_gap_for_that_brake():
    assert follower_gap(10.0, 8.0, False, PLAIN) == pytest.approx(2 * (5 + 15 + 10 / math.sqrt(15)))


def test_a_follower_that_is_spared_little_still_needs_room_to_stop():
    assert follower_gap(20.0, 0.0, False, PLAIN._replace(courtesy_brake=12.0)) == pytest.approx(40 + 1 + 44.1)


# The time of a pass.


@pytest.mark.parametrize(
    ("distance", "faster", "top", "seconds"),
    [
        (0.0, 2.0, 5.0, 0.0),
        (0.0, -2.0, 5.0, 0.0),  # past it already, whatever the speed
        (-1.0, 2.0, 5.0, 0.0),
        (4.0, 2.0, 5.0, (math.sqrt(9.6) - 2) / 0.7),  # still gaining speed when it is past
        (12.0, 6.0, 3.0, 2.0),  # faster than promised already
        (0.5, 0.0, 3.0, 1 / math.sqrt(0.7)),
    ],
)
def test_a_pass_takes_as_long_as_its_acceleration_and_its_top_speed_have_it(distance, faster, top, seconds):
    assert pass_time_s(distance, faster, top) == pytest.approx(seconds)


# Sideways.


def test_cars_are_apart_by_what_is_between_their_sides():
    assert aside_m(car(0, 0, 1, 0), car(1, 9, 2, 0, y_m=7.0), HIGHWAY) == 1.0
    assert aside_m(car(0, 0, 1, 0), car(1, 9, 1, 0, y_m=2.5), HIGHWAY) == -0.5


@pytest.mark.parametrize(
    ("y", "sideways", "apart"),
    [
        (8.0, -1.0, -2.0),  # on its way into the ego's lane, where it settles
        (7.0, 1.0, 1.0),  # on its way to the middle of its own
        (6.5, -0.3, 0.5),  # it sways
    ],
)
def test_cars_are_apart_by_what_will_be_between_them_where_that_is_less(y, sideways, apart):
    assert aside_m(car(0, 0, 1, 0), moving(car(1, 9, 2, 0, y_m=y), sideways), HIGHWAY) == pytest.approx(apart)


@pytest.mark.parametrize(
    ("ego", "other", "y", "gap"),
    [
        (0.0, 0.0, 8.0, 0.25 + 2 * (0.0625 + 0.015625)),
        (1.0, 0.0, 8.0, 0.25 + 0.5625 + 0.390625 + 0.078125),
        (0.0, -1.0, 8.0, 0.25 + 2 * (0.0625 + 0.015625)),  # where it goes is known
        (-1.0, 0.0, 0.0, 0.25 + 0.5625 + 0.390625 + 0.078125),
        (-1.0, 1.0, 8.0, 0.25),
    ],
)
def test_an_ego_that_nears_a_car_sideways_needs_room_to_brake_sideways(ego, other, y, gap):
    rows = moving(car(0, 0, 1, 9), ego), moving(car(1, 9, 1, 9, y_m=y), other)
    assert side_gap(*rows, PLAIN) == pytest.approx(gap)


def test_a_car_of_which_it_is_in_doubt_how_it_moves_sideways_needs_room_for_that():
    track = [*car(1, 9, 2, 9), 0.0, 0.5, 0.0, 2.5]  # half a metre, and 2.5 m/s, of which two fifths are likely
    assert side_gap(car(0, 0, 1, 9), track, PLAIN) == pytest.approx(0.2 + 0.25 + 0.078125 + 0.5625 + 0.390625)


# The end of a lane.


@pytest.mark.parametrize(("x", "speed"), [(250.0, math.sqrt(2.4 * 80)), (330.0, 0.0), (340.0, 0.0), (329.0, 2.4**0.5)])
def test_a_speed_before_the_end_of_a_lane_comes_to_rest_twenty_metres_before(x, speed):
    assert speed_before_end(situation([car(0, x, 2, 9)], RAMP, 2)) == pytest.approx(speed)


# Entering a lane.


def test_the_ego_must_leave_a_lane_that_ends_first():
    ends = situation([car(0, 300, 2, 9)], RAMP, 2)
    assert must_leave(ends, 1)
    assert not must_leave(situation([car(0, 300, 1, 9)], RAMP, 1), 0)
    assert not must_leave(situation([car(0, 300, 1, 9)], RAMP, 1), 2)


@pytest.mark.parametrize(("x", "must"), [(619.5, True), (620.0, False), (900.0, False)])
def test_the_ego_must_leave_a_borrowed_lane_when_an_oncoming_car_is_near(x, must):
    # 6 s at 9 + 6 m/s and 30 m.
    assert must_leave(situation([car(0, 500, 0, 9), car(1, x, 0, -6)], LANES, 0), 1) == must


THREE_LANES = lane_table((lane(0, oncoming=True), lane(1, oncoming=True, limit_mps=8.0), lane(2, limit_mps=8.0)))


def test_in_the_second_of_two_oncoming_lanes_it_is_who_comes_there_that_counts():
    assert must_leave(situation([car(0, 500, 1, 9), car(1, 520, 1, -6)], THREE_LANES, 1), 2)
    lead, oncoming = car(1, 520, 2, 0), car(2, 540, 1, -6)
    assert passing(situation([car(0, 500, 2, 8), lead, oncoming], THREE_LANES, 2), home=2, away=1) == (ONCOMING, 2)


def test_the_ego_need_not_leave_a_borrowed_lane_where_nobody_comes():
    assert not must_leave(situation([car(0, 500, 0, 9)], LANES, 0), 1)


def entered(*others: list[float], v: float = 8.0, lanes: Any = HIGHWAY, x: float = 500.0) -> tuple[int, int]:
    """Whether the ego may enter the lane to its left."""
    lane = len(lanes) - 1
    return entry(situation([car(0, x, lane, v), *others], lanes, lane), lane - 1)


# To stop behind a lead at 8 m/s from 8 m/s: 4 + 0.125 + 8.5**2 / 8 - 64 / 16 m, and 1.5 m.
FRONT_M = 4 + 0.125 + 9.03125 - 4 + 1.5


@pytest.mark.parametrize(("metres", "reason"), [(-0.01, (FRONT_GAP, 1)), (0.0, (OPEN, -1)), (0.01, (OPEN, -1))])
def test_the_ego_enters_where_it_can_stop_behind_the_car_ahead(metres, reason):
    assert entered(car(1, 505 + FRONT_M + metres, 2, 8)) == reason


def test_a_car_ahead_that_rolls_back_counts_as_standing():
    need = 4 + 0.125 + 9.03125 + 1.5
    assert entered(car(1, 505 + need + 0.001, 2, -0.09)) == (OPEN, -1)
    assert entered(car(1, 505 + need - 0.001, 2, -0.09)) == (FRONT_GAP, 1)


SPARED_M = 2 * (5 + 15 + 10 / math.sqrt(15))
"""Of a follower at 10 m/s when the ego has 8."""


@pytest.mark.parametrize(("gap", "reason"), [(SPARED_M - 0.01, (REAR_GAP, 1)), (SPARED_M + 0.01, (OPEN, -1))])
def test_the_ego_enters_where_the_car_behind_need_hardly_brake(gap, reason):
    assert entered(car(1, 495 - gap, 2, 10)) == reason


@pytest.mark.parametrize(("gap", "reason"), [(11.74, (REAR_GAP, 1)), (11.75, (OPEN, -1)), (11.76, (OPEN, -1))])
def test_from_a_lane_that_ends_it_enters_where_the_car_behind_can_stop(gap, reason):
    # From 9.5 m/s: 9.5 + 0.25 + 10 m; the ego, from 8 m/s, in 8 m.
    assert entered(car(1, 295 - gap, 1, 9.5), lanes=RAMP, x=300.0) == reason


def test_the_ego_does_not_enter_before_a_car_that_comes_head_on():
    assert entered(car(1, 560, 2, -9)) == (ONCOMING, 1)


@pytest.mark.parametrize(("x", "reason"), [(229.5, NO_LANE), (230.0, OPEN), (322.0, OPEN), (322.5, NO_LANE)])
def test_a_change_off_a_ramp_begins_between_its_opening_and_two_seconds_and_twelve_metres_before_its_end(x, reason):
    assert entered(lanes=RAMP, x=x) == (reason, -1)


@pytest.mark.parametrize(("x", "reason"), [(99.5, NO_LANE), (100.0, OPEN)])
def test_a_lane_is_entered_where_it_has_begun(x, reason):
    assert entered(lanes=lane_table((lane(0), lane(1, start_m=100.0), lane(2))), x=x) == (reason, -1)


@pytest.mark.parametrize(("x", "reason"), [(322.0, OPEN), (322.5, NO_LANE)])
def test_a_lane_that_ends_is_not_entered_at_its_end(x, reason):
    ends = lane_table((lane(0), lane(1, end_m=350.0), lane(2)))
    assert entered(lanes=ends, x=x) == (reason, -1)


def test_nobody_enters_a_ramp():
    road = lane_table((lane(0, ramp=True), lane(1)))
    assert entered(lanes=road, x=100.0) == (NO_LANE, -1)


def test_a_change_may_be_given_up_while_the_ego_has_not_left_the_lane():
    rows = [car(0, 500, 2, 8, y_m=6.5), car(1, 501, 2, 8)]
    assert entry(situation(rows, previous=2), 2) == (OPEN, -1)
    rows[0][LANE] = 1.0
    assert entry(situation(rows, previous=2), 2) == (FRONT_GAP, 1)


def test_a_change_may_be_given_up_to_a_lane_that_ends():
    assert entry(situation([car(0, 345, 1, 8, y_m=5.5)], RAMP, 1, previous=2), 2) == (OPEN, -1)


# Passing.


def passed(*others: list[float], v: float = 8.0, x: float = 500.0, sight: float = SIGHT_M) -> tuple[int, int]:
    """Whether the ego, in its own lane of a two-way road, can pass."""
    return passing(situation([car(0, x, 1, v), *others], LANES, 1, sight=sight), home=1, away=0)


# A lead that stands 20 m ahead, centre to centre: 29 m to gain, 3.75 s at 8 m/s (three quarters of the limit less 0 are
# 6, so that 8 m/s are enough), 2.5 s to return.
PASS_S = 29 / 8 + 2.5


@pytest.mark.parametrize(("metres", "reason"), [(-0.1, (ONCOMING, 2)), (0.0, (OPEN, -1)), (0.1, (OPEN, -1))])
def test_a_pass_is_over_five_metres_before_an_oncoming_car(metres, reason):
    assert passed(car(1, 520, 1, 0), car(2, 505 + 29 + 6 * PASS_S + 5 + metres, 0, -6)) == reason


@pytest.mark.parametrize(("metres", "reason"), [(-0.1, (ONCOMING, -1)), (0.1, (OPEN, -1))])
def test_a_pass_is_over_before_who_may_come_from_beyond_sight_at_the_limit(metres, reason):
    assert passed(car(1, 520, 1, 0), sight=29 + 8 * PASS_S + 5 + 10 + metres) == reason


@pytest.mark.parametrize(("metres", "reason"), [(-0.1, (ONCOMING, 2)), (0.1, (OPEN, -1))])
def test_a_pass_of_a_car_that_moves_is_as_much_longer(metres, reason):
    # 2 m/s faster now, three quarters of the 2 m/s that the limit leaves or 3 m/s: 3 at last.
    seconds = (3 - 2) / 0.7 + (29 - (2 * (1 / 0.7) + 0.35 * (1 / 0.7) ** 2)) / 3 + 2.5
    assert (
        passed(car(1, 520, 1, 6), car(2, 505 + 29 + 6 * seconds + 6 * seconds + 5 + metres, 0, -6), sight=900) == reason
    )


@pytest.mark.parametrize(("metres", "reason"), [(-0.1, (ONCOMING, 2)), (0.1, (OPEN, -1))])
def test_a_pass_is_never_taken_to_be_faster_than_by_eight_metres_per_second(metres, reason):
    # Three quarters of 20 m/s would be more. From 8 m/s the 29 m take 3.625 s.
    road = lane_table((lane(0, oncoming=True, limit_mps=20.0), lane(1, limit_mps=20.0)))
    oncoming = car(2, 505 + 29 + 6 * PASS_S + 5 + metres, 0, -6)
    assert passing(situation([car(0, 500, 1, 8), car(1, 520, 1, 0), oncoming], road), home=1, away=0) == reason


@pytest.mark.parametrize(("x", "reason"), [(491.0, NOTHING_TO_PASS), (491.1, OPEN)])
def test_a_car_is_passed_with_four_metres_between(x, reason):
    assert passed(car(1, x, 1, 0))[0] == reason


@pytest.mark.parametrize(("x", "reason"), [(710.0, ONCOMING), (710.5, NO_RETURN)])
def test_what_is_ahead_of_a_car_near_the_end_of_sight_is_not_known(x, reason):
    assert passed(car(1, x, 1, 0))[0] == reason


# Between two that stand: 5 m of ego, 4 m behind it, 4 m, and what it needs to stop from 6 m/s: 3 + 0.125 + 6.5**2 / 8.
BETWEEN_M = 5 + 4 + 4 + 3 + 0.125 + 5.28125


@pytest.mark.parametrize(("metres", "reason"), [(0.01, OPEN), (0.0, OPEN), (-0.01, ONCOMING)])
def test_two_cars_are_passed_together_where_there_is_no_room_between(metres, reason):
    two = car(1, 520, 1, 0), car(2, 525 + BETWEEN_M + metres, 1, 0)
    alone = 505 + 29 + 6 * PASS_S + 5 + 0.1
    assert passed(*two, car(3, alone, 0, -6))[0] == reason


def pulled_out(gap: float, v: float, lead: float) -> tuple[int, int]:
    return start_pass(situation([car(0, 500, 1, v), car(1, 505 + gap, 1, lead)], LANES, 1, sight=900), 0)


@pytest.mark.parametrize(
    ("gap", "v", "lead", "reason"),
    [
        (5.9, 8.0, 6.0, (LEAD, 1)),  # 3 m and 1.5 s of what it gains
        (6.0, 8.0, 6.0, (OPEN, -1)),
        (2.9, 5.0, 6.0, (LEAD, 1)),
        (3.1, 5.0, 6.0, (OPEN, -1)),
    ],
)
def test_nobody_pulls_out_right_behind_a_lead(gap, v, lead, reason):
    assert pulled_out(gap, v, lead) == reason


def test_nobody_pulls_out_with_nothing_to_pass():
    assert start_pass(situation([car(0, 500, 1, 8)], LANES, 1), 0) == (NOTHING_TO_PASS, -1)


def test_a_change_is_given_up_to_the_side_that_it_came_from():
    rows = [car(0, 500, 1, 8)]
    assert [back_action(situation(rows, previous=k)) for k in (-1, 0, 2)] == [-1, MetaAction.LEFT, MetaAction.RIGHT]
