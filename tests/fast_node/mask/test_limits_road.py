"""Which actions the mask closes before the end of a lane and in an oncoming one, on either side of each limit."""

from __future__ import annotations

import math

import pytest

from schemas.driving.road import lane_table
from tests.mask_limits import (
    CRUISE,
    ENDS,
    FINISH,
    GIVE_UP,
    LEFT,
    NO_LANE,
    ONCOMING,
    REAR,
    RIGHT,
    SLOW_DOWN,
    SPEED_UP,
    Closed,
    all_but,
    cap,
    closed,
)
from tests.mask_scenes import LANES, RAMP
from tests.scenes import car, lane

# The end of a lane: the ramp ends at 350 m. To stop from 8 m/s: 4 + 8 m, and 4 m before the end.

BLOCKED = [car(20 + k, 300 + 9 * k, 1, 8) for k in range(-5, 8)]


@pytest.mark.parametrize(("x", "shut"), [(333.9, False), (334.0, False), (334.1, True)])
def test_the_ego_stops_where_it_can_just_stop_before_the_end(x, shut):
    found = closed(car(0, x, 2, 8), *BLOCKED, lanes=RAMP, lane=2, speed=0.0)
    assert [found.get(a) == (ENDS, -1) for a in (SLOW_DOWN, CRUISE)] == [shut] * 2


@pytest.mark.parametrize(("speed", "shut"), [(4.79, set()), (4.81, {SPEED_UP}), (4.9, {SPEED_UP}), (20.0, {SPEED_UP})])
def test_the_set_point_comes_down_before_the_end(speed, shut):
    # 10 m before 20 m before the end: sqrt(2.4 * 10) = 4.899.
    found = closed(car(0, 320, 2, 1), *BLOCKED, lanes=RAMP, lane=2, speed=speed)
    assert {a for a in found if found[a] == (ENDS, -1)} == shut
    assert cap(car(0, 320, 2, 1), *BLOCKED, lanes=RAMP, lane=2, speed=speed) == pytest.approx(math.sqrt(24))


def on_the_way(x: float, y: float, v: float) -> Closed:
    """The ego on its way from the ramp to lane 1."""
    return closed(car(0, x, 2 if y > 6 else 1, v, y_m=y), lanes=RAMP, lane=1, previous=2, speed=v)


@pytest.mark.parametrize(("x", "shut"), [(325.9, False), (326.0, False), (326.1, True)])
def test_no_way_back_where_there_is_no_room_to_stop_in_it(x, shut):
    # 4 + 8 m to stop, 8 m for a second, 4 m before the end.
    assert (on_the_way(x, 5.0, 8.0).get(RIGHT) == (ENDS, -1)) == shut


@pytest.mark.parametrize(("x", "shut"), [(345.0, False), (345.1, True)])
def test_who_stands_a_metre_before_the_last_moment_may_creep_on(x, shut):
    found = on_the_way(x, 8.0, 0.0)
    assert [found.get(a) == (ENDS, -1) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [shut] * 3


def test_no_way_back_into_a_leftmost_lane_that_ends():
    road = lane_table((lane(0, end_m=350.0), lane(1)))
    found = closed(car(0, 335, 0, 8, y_m=1.0), lanes=road, lane=1, previous=0)
    assert found[LEFT] == (ENDS, -1)


def test_at_the_end_of_the_road_a_change_may_be_given_up():
    found = closed(car(0, 8980, 2, 8, y_m=6.5), previous=2, speed=0.0)
    assert RIGHT not in found


@pytest.mark.parametrize(
    ("room", "y", "v", "shut"),
    [
        (4.29, 7.2, 4.0, True),  # 1.5 m are left: 4 * (0.4 + 0.45 * 1.5) = 4.3 m
        (4.31, 7.2, 4.0, False),
        (3.99, 7.2, 4.0, False),  # too late: 2 + 2 m to stop
        (1.09, 6.2, 1.0, True),  # half a metre is left: 1.1 m
        (1.11, 6.2, 1.0, False),
        (1.09, 9.8, 1.0, True),  # on the other side of it
    ],
)
def test_who_moves_out_in_time_does_not_stop_before_the_end(room, y, v, shut):
    found = on_the_way(346 - room, y, v)
    assert [found.get(a) == (ENDS, -1) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [shut] * 3


@pytest.mark.parametrize(("y", "shut"), [(8.0, True), (5.6, False)])
def test_who_is_out_of_the_way_of_the_end_does_not_stop(y, shut):
    # Slowly: 1 m/s needs 0.5 + 0.125 m to stop, and 2.2 m for every metre that is left sideways.
    found = on_the_way(344.5, y, 1.0)
    assert [found.get(a) == (ENDS, -1) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [shut] * 3


@pytest.mark.parametrize(("x", "shut"), [(344.2, False), (344.4, True), (345.375, True), (345.4, False)])
def test_who_is_late_stops_while_there_is_room_to(x, shut):
    # Room is what is left to 346 m: from a tick and a metre more than 0.625 m down to 0.625 m.
    found = on_the_way(x, 8.0, 1.0)
    assert [found.get(a) == (ENDS, -1) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [shut] * 3


# In the oncoming lane, the ego's lane being 0 and its home 1.


def borrowed(*cars: list[float], v: float = 8.0, speed: float = 8.0, x: float = 500.0) -> Closed:
    return closed(car(0, x, 0, v), *cars, lanes=LANES, lane=0, speed=speed)


def test_a_pass_that_can_be_finished_is_left_alone():
    assert set(borrowed(car(11, 506, 1, 2), car(12, 900, 0, -6))) == {LEFT, RIGHT}


@pytest.mark.parametrize(("x", "reason"), [(605, GIVE_UP), (590, ONCOMING)])
def test_behind_a_lead_that_cannot_be_passed_any_more_the_way_home_is_all_that_is_left(x, reason):
    found = borrowed(car(11, 540, 1, 8), car(12, x, 0, -6))
    assert found == {**all_but(LEFT, RIGHT, by=reason, who=12), LEFT: (NO_LANE, -1)}


@pytest.mark.parametrize(
    ("v", "speed", "kept"), [(8.0, 8.0, False), (8.0, 0.5, True), (0.5, 8.0, True), (0.6, 0.6, False)]
)
def test_behind_a_lead_that_cannot_be_passed_the_ego_falls_back(v, speed, kept):
    found = borrowed(car(11, 505, 1, v), car(12, 570, 0, -6), v=v, speed=speed)
    assert found[SPEED_UP] == (GIVE_UP, 12)
    assert (CRUISE not in found) == kept
    assert SLOW_DOWN not in found


def test_in_the_second_of_two_oncoming_lanes_the_ego_goes_home_before_somebody_comes_there():
    road = lane_table((lane(0, oncoming=True), lane(1, oncoming=True, limit_mps=8.0), lane(2, limit_mps=8.0)))
    found = closed(car(0, 500, 1, 8), car(12, 590, 1, -6), lanes=road)
    assert [found.get(a) == (ONCOMING, 12) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [True] * 3


def test_alongside_a_car_at_home_the_pass_is_finished():
    found = borrowed(car(11, 502, 1, 6), car(12, 590, 0, -6))
    assert found[SLOW_DOWN] == (FINISH, 12)
    assert not {CRUISE, SPEED_UP} & set(found)


@pytest.mark.parametrize(("x", "reason"), [(502.4, FINISH), (502.5, None), (502.6, None)])
def test_alongside_is_with_the_front_beyond_the_other_s_middle(x, reason):
    assert borrowed(car(11, x, 1, 6), car(12, 590, 0, -6)).get(SLOW_DOWN, (None, 0))[0] == reason


def test_before_a_car_at_home_that_keeps_the_ego_from_moving_in_the_pass_is_finished():
    found = borrowed(car(11, 490.5, 1, 8), car(12, 590, 0, -6), car(13, 530, 1, 7))
    assert (found[RIGHT], found[SLOW_DOWN]) == ((REAR, 11), (FINISH, 12))


@pytest.mark.parametrize(("gap", "home"), [(93.9, True), (94.0, False), (94.1, False)])
def test_with_nothing_left_to_pass_the_ego_goes_home_before_somebody_comes(gap, home):
    # 6 s at 8 + 6 m/s and 10 m.
    found = borrowed(car(12, 505 + gap, 0, -6))
    assert [found.get(a) == (ONCOMING, 12) for a in (SLOW_DOWN, CRUISE, SPEED_UP)] == [home] * 3


@pytest.mark.parametrize(
    ("v", "gap", "shut"), [(5.0, 15.22, True), (5.0, 15.23, False), (0.0, 9.59, True), (0.0, 9.61, False)]
)
def test_with_no_way_home_the_ego_stops_before_somebody_who_comes(v, gap, shut):
    # 2.5 + 3.125 m for the ego, which is in the wrong lane; 3 + 3.6 m for the other, and 3 m between.
    found = borrowed(car(11, 501, 1, 6), car(12, 505 + gap, 0, -6), v=v, speed=v)
    assert [found.get(a) == (ONCOMING, 12) for a in (CRUISE, SPEED_UP)] == [shut] * 2
