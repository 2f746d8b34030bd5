"""Which actions the mask closes, scene by scene on either side of each limit, with a preset of round numbers."""

from __future__ import annotations

import math

import pytest

from tests.mask_limits import (
    CHANGING,
    CRUISE,
    FRONT,
    GAP,
    GIVE_UP_CHANGE,
    LEFT,
    NEAR,
    NO_LANE,
    REAR,
    RIGHT,
    SLOW_DOWN,
    SPEED_UP,
    all_but,
    cap,
    closed,
)
from tests.mask_scenes import HIGHWAY, RAMP, moving
from tests.scenes import car

EGO = car(0, 500, 1, 8)


def test_an_empty_road_leaves_everything_open():
    assert closed(EGO) == {}
    assert cap(EGO) == pytest.approx(math.sqrt(2.4 * (9000 - 500 - 20)))  # the road's own end


def test_there_is_no_lane_beyond_the_road():
    assert closed(car(0, 500, 0, 8), lane=0) == {LEFT: (NO_LANE, -1)}
    assert closed(car(0, 500, 3, 8), lane=3) == {RIGHT: (NO_LANE, -1)}


@pytest.mark.parametrize(("previous", "there"), [(0, RIGHT), (2, LEFT)])
def test_a_second_change_waits_for_the_first(previous, there):
    assert closed(EGO, previous=previous) == {there: (CHANGING, -1)}


# A car ahead. To stop behind one of 8 m/s from 8 m/s: 4 + 6.4 - 4 m.


def test_too_near_a_car_ahead_everything_is_closed():
    assert closed(EGO, car(11, 505 + 7.39, 1, 8)) == all_but(by=NEAR, who=11)


def test_just_far_enough_only_a_greater_set_point_is_too_fast():
    assert closed(EGO, car(11, 505 + 7.41, 1, 8)) == {SPEED_UP: (GAP, 11)}
    assert cap(EGO, car(11, 505 + 7.41, 1, 8)) == pytest.approx(8 - 0.5 * 3.59)  # 3.59 m short of 3 m and a second


@pytest.mark.parametrize("speed", [0.0, 8.0, 9.0, 30.0])
def test_the_cap_is_what_the_gap_admits_whatever_the_set_point(speed):
    assert cap(EGO, car(11, 516, 1, 10), speed=speed) == pytest.approx(9.0)
    assert CRUISE not in closed(EGO, car(11, 516, 1, 10), speed=speed)


def test_the_cap_is_what_the_ego_can_brake_from():
    # After half a second, 11 m at 4 m/s2, and what a lead at 10 m/s needs at 8: v**2 / 8 + v / 2 = 9 + 100 / 16.
    assert cap(EGO, car(11, 516, 1, 10), lanes=HIGHWAY) == pytest.approx(9.0)
    assert cap(EGO, car(11, 525, 1, 10)) == pytest.approx(math.sqrt(4 + 8 * 18 + 50) - 2)


def test_the_cap_is_five_metres_per_second_less_than_the_speed_where_only_slowing_down_is_left():
    pulls_away = car(11, 505 + 3.0, 1, 8.5)
    assert set(closed(EGO, pulls_away)) == {CRUISE, SPEED_UP, LEFT, RIGHT}
    assert cap(EGO, pulls_away) == 3.0
    assert cap(car(0, 500, 1, 4), car(11, 505 + 0.5, 1, 4.5), speed=4.0) == 0.0


UNSURE = [5.0, 0.0, 2.5, 0.0]
"""Doubt about a track: 5 m and 2.5 m/s, of which 2 m and 1 m/s are likely."""


@pytest.mark.parametrize(("gap", "shut"), [(10.33, True), (10.34, False)])
def test_an_emergency_brake_is_for_what_is_likely(gap, shut):
    # Behind one of 7 m/s, 2 m nearer: 4 + 6.4 - 49 / 16 m, and a metre: 8.3375 + 2...
    found = closed(EGO, [*car(11, 505 + gap, 1, 8), *UNSURE])
    assert (found.get(SLOW_DOWN) == (NEAR, 11)) == shut


def test_the_speed_cap_is_for_what_is_possible():
    # 5 m nearer, and at 7.5 m/s: 18 m less 2 to brake in.
    track = [*car(11, 505 + 23, 1, 10), *UNSURE]
    assert cap(EGO, track) == pytest.approx(math.sqrt(4 + 8 * 16 + 7.5**2 / 2) - 2)


@pytest.mark.parametrize(("lead", "shut"), [(8.0, True), (8.01, False)])
def test_behind_a_car_that_is_pulling_away_there_is_no_emergency_brake(lead, shut):
    assert (closed(EGO, car(11, 505 + 3.0, 1, lead)).get(SLOW_DOWN) == (NEAR, 11)) == shut


def test_a_gap_of_just_what_is_needed_is_far_enough():
    # From 10 m/s: 5 + 10 m, less the 4 m of a lead at 8 m/s, and a metre.
    assert SLOW_DOWN not in closed(car(0, 500, 1, 10), car(11, 505 + 12, 1, 8))


@pytest.mark.parametrize(
    ("speed", "shut"), [(8.0, set()), (8.89, set()), (8.91, {SPEED_UP}), (9.0, {SPEED_UP}), (20.0, {SPEED_UP})]
)
def test_the_set_point_rises_to_what_the_gap_admits(speed, shut):
    # 2 m short of 3 m and a second: 9 m/s behind 10.
    assert closed(EGO, car(11, 516, 1, 10), speed=speed) == {int(a): (GAP, 11) for a in shut}


def test_the_car_that_admits_the_least_is_named():
    cars = car(12, 516, 1, 10), car(11, 525, 1, 0), car(13, 517, 1, 10)
    assert closed(EGO, *cars, speed=8.45) == {SPEED_UP: (GAP, 11)}
    assert cap(EGO, *cars) == 8.5


@pytest.mark.parametrize(
    "other", [car(11, 499.9, 1, 8), car(11, 507, 1, -0.11), car(-1, 507, 1, 8), car(11, 507, 3, 8)]
)
def test_who_is_behind_or_comes_head_on_or_is_not_there_or_far_aside_is_no_lead(other):
    assert not {CRUISE, SPEED_UP, SLOW_DOWN} & set(closed(EGO, other))


def test_who_rolls_back_is_a_lead_that_stands():
    assert closed(EGO, car(11, 505 + 11.39, 1, -0.1)) == all_but(by=NEAR, who=11)
    assert closed(EGO, car(11, 505 + 11.41, 1, -0.1)) == {SPEED_UP: (GAP, 11)}
    assert cap(EGO, car(11, 505 + 11.41, 1, -0.1)) == pytest.approx(0.5 * 8.41)


def test_beside_the_ego_is_ahead_of_it():
    assert closed(EGO, car(11, 500, 1, 8)) == all_but(by=NEAR, who=11)


@pytest.mark.parametrize(
    ("gap", "lead", "v", "speed", "shut"),
    [
        (17.0, 10, 8, 8.89, False),  # as 11 m elsewhere: 9 m/s
        (17.0, 10, 8, 8.91, True),
        (5.9, 3, 1, 2.84, False),  # not where they are not there: 2.95 m/s
        (5.9, 3, 1, 2.86, True),
        (6.0, 3, 1, 2.89, False),
        (6.1, 3, 1, 0.0, True),
    ],
)
def test_in_a_lane_that_ends_six_metres_more_are_kept_to_a_car_ahead(gap, lead, v, speed, shut):
    found = closed(car(0, 240, 2, v), car(11, 245 + gap, 2, lead), lanes=RAMP, lane=2, speed=speed)
    assert (found.get(SPEED_UP) == (GAP, 11)) == shut


@pytest.mark.parametrize(("y", "shut"), [(6.40, True), (6.40625, False)])
def test_a_car_at_the_edge_of_the_lane_is_too_near_where_it_is_so_sideways_too(y, shut):
    # 0.40625 m, side to side.
    assert (closed(EGO, car(11, 510, 1, 8, y_m=y)).get(SLOW_DOWN) == (NEAR, 11)) == shut


# A car ahead in the next lane, 0.25 + 2 * 0.078125 m to be kept at its side.


@pytest.mark.parametrize(("y", "shut"), [(6.40, True), (6.41, False)])
def test_a_car_beside_the_lane_is_in_the_way_where_it_is_too_near_sideways(y, shut):
    found = closed(EGO, car(11, 510, 2, 8, y_m=y))
    assert [found.get(a) == (NEAR, 11) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [shut] * 3


def test_a_car_beside_the_lane_closes_no_change():
    found = closed(EGO, car(11, 510, 2, 8, y_m=6.40))
    assert LEFT not in found
    assert found[RIGHT][0] == FRONT


def test_a_car_that_is_just_far_enough_aside_is_not_in_the_way():
    assert not {CRUISE, SPEED_UP, SLOW_DOWN} & set(closed(EGO, car(11, 506.5, 2, 8, y_m=6.40625)))


@pytest.mark.parametrize(("gap", "reason"), [(6.89, (NEAR, 11)), (6.91, None)])
def test_a_car_beside_the_lane_may_be_half_a_metre_nearer(gap, reason):
    assert closed(EGO, car(11, 505 + gap, 2, 8, y_m=6.40)).get(SLOW_DOWN) == reason


@pytest.mark.parametrize(("speed", "shut"), [(8.0, set()), (8.89, set()), (8.91, {SPEED_UP}), (20.0, {SPEED_UP})])
def test_a_car_beside_the_lane_is_reached_in_a_second_and_a_half_at_the_earliest(speed, shut):
    # At 11.5 m a metre less makes 7 m/s more than its 2 m/s.
    found = closed(EGO, car(11, 516.5, 2, 2, y_m=6.40), speed=speed)
    assert {a for a in found if found[a] == (GAP, 11)} == shut
    assert cap(EGO, car(11, 516.5, 2, 2, y_m=6.40), speed=speed) == 9.0


@pytest.mark.parametrize(
    ("y", "sideways", "shut"),
    [
        (7.9, -1.0, True),
        (8.0, -1.0, False),
        (8.1, -1.0, False),
        (6.5, -0.4, True),
        (6.5, -0.3, False),
        (7.9, 1.0, False),
    ],
)
def test_a_car_that_crosses_into_the_lane_within_two_seconds_is_in_it(y, sideways, shut):
    found = closed(EGO, moving(car(11, 516, 2, 8, y_m=y), sideways))
    assert (found.get(SPEED_UP) == (GAP, 11)) == shut


def test_a_car_that_crosses_from_the_left_is_in_the_lane_too():
    found = closed(EGO, moving(car(11, 516, 0, 8, y_m=0.1), 1.0))
    assert found[SPEED_UP] == (GAP, 11)


# While the ego changes from lane 2 to lane 1.

LEAVES = car(0, 500, 2, 8, y_m=6.5)


def test_the_change_goes_on_but_not_back_behind_a_car_that_is_too_near_there():
    found = closed(LEAVES, car(11, 511, 2, 8), previous=2)
    assert found == {**all_but(LEFT, by=NEAR, who=11), LEFT: (CHANGING, -1)}


def test_a_change_behind_a_car_that_is_too_near_may_be_given_up_while_they_are_apart():
    apart = closed(LEAVES, car(11, 511, 1, 8, y_m=4.15), previous=2)
    assert RIGHT not in apart
    assert apart[CRUISE] == (NEAR, 11)


@pytest.mark.parametrize("y", [4.25, 4.3, 4.6])
def test_a_change_behind_a_car_may_not_be_given_up_where_they_are_not_apart(y):
    # 6.5 - 4.25 - 2 m are no more than the quarter of a metre that they may sway.
    assert closed(LEAVES, car(11, 511, 1, 8, y_m=y), previous=2)[RIGHT] == (NEAR, 11)


BEGINS = car(0, 500, 2, 8, y_m=7.9)
"""A change to lane 1 that has hardly begun: 1.9 m aside from who is there."""


def test_a_change_behind_a_car_that_is_too_near_is_given_up_before_they_are_near_sideways():
    assert closed(BEGINS, car(11, 511, 1, 8), previous=2) == {
        **all_but(RIGHT, LEFT, by=NEAR, who=11),
        LEFT: (CHANGING, -1),
    }


def test_whoever_changes_lanes_behind_a_car_that_is_faster_brakes_for_it():
    assert closed(BEGINS, car(11, 507, 1, 8.5), previous=2)[SLOW_DOWN] == (NEAR, 11)


def test_a_change_that_is_mostly_done_is_not_given_up_behind_a_car_that_is_too_near():
    mostly = car(0, 500, 1, 8, y_m=5.9)
    assert closed(mostly, car(11, 511, 1, 8, y_m=3.55), previous=2)[RIGHT] == (NEAR, 11)


# A car behind, while the ego changes. At 10 m/s to the ego's 8: 5 + 10 - 8 m and one more.


@pytest.mark.parametrize(("gap", "by"), [(7.99, True), (8.0, False), (8.01, False)])
def test_a_change_before_a_car_that_could_not_stop_is_given_up(gap, by):
    found = closed(LEAVES, car(11, 495 - gap, 1, 10), previous=2)
    assert [found.get(a) == (GIVE_UP_CHANGE, 11) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [by] * 3
    assert RIGHT not in found


def test_a_change_that_is_mostly_done_is_not_given_up_before_a_car():
    found = closed(car(0, 500, 1, 8, y_m=5.5), car(11, 490, 1, 10), previous=2)
    assert not {SLOW_DOWN, CRUISE, SPEED_UP} & set(found)


BESIDE = car(12, 499, 2, 8)
"""In the lane that the ego has left: no way back."""
DONE = car(0, 500, 1, 4, y_m=5.5)


@pytest.mark.parametrize(
    ("speed", "shut"), [(4.9, {SLOW_DOWN, CRUISE}), (5.1, {SLOW_DOWN}), (5.0, {SLOW_DOWN}), (0.0, {SLOW_DOWN, CRUISE})]
)
def test_a_change_without_a_way_back_is_finished_and_not_at_a_crawl(speed, shut):
    found = closed(DONE, car(11, 485, 1, 10), BESIDE, previous=2, speed=speed)
    assert {a for a in found if found[a] == (REAR, 11)} == shut


@pytest.mark.parametrize(("behind", "shut"), [(4.1, True), (4.0, False), (3.0, False)])
def test_only_before_a_faster_car_is_a_change_finished_without_delay(behind, shut):
    found = closed(DONE, car(11, 494, 1, behind), BESIDE, previous=2, speed=5.0)
    assert (found.get(SLOW_DOWN) == (REAR, 11)) == shut


@pytest.mark.parametrize(("gap", "shut"), [(11.74, True), (11.75, False)])
def test_before_a_car_that_can_just_stop_a_change_may_be_finished_slowly(gap, shut):
    # From 9.5 m/s: 9.5 + 0.25 + 10 m; the ego, from 8 m/s, in 8 m.
    found = closed(car(0, 500, 1, 8, y_m=5.5), car(11, 495 - gap, 1, 9.5), BESIDE, previous=2)
    assert (found.get(SLOW_DOWN) == (REAR, 11)) == shut


def test_a_car_far_behind_leaves_time_to_finish_a_change():
    assert SLOW_DOWN not in closed(DONE, car(11, 440, 1, 10), BESIDE, previous=2, speed=5.0)


@pytest.mark.parametrize(("gap", "shut"), [(11.74, True), (11.75, False)])
def test_a_change_is_finished_without_delay_only_before_a_car_that_could_not_stop(gap, shut):
    # From 9.5 m/s: 9.5 + 0.25 + 10 m; the ego, from 8 m/s, in 8 m.
    found = closed(car(0, 500, 1, 8, y_m=5.5), car(11, 495 - gap, 1, 9.5), BESIDE, previous=2)
    assert (found.get(SLOW_DOWN) == (REAR, 11)) == shut


def test_a_change_without_a_way_back_is_finished_at_what_the_car_ahead_admits():
    cars = car(11, 485, 1, 10), BESIDE, car(13, 511, 1, 3)
    found = closed(DONE, *cars, previous=2, speed=5.0)
    assert (found[SPEED_UP], found.get(CRUISE), found[SLOW_DOWN]) == ((GAP, 13), None, (REAR, 11))
    assert cap(DONE, *cars, previous=2, speed=5.0) == 3.0
