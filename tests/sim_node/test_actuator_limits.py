"""The actuator at its limits, reckoned by hand: a little less room, and it says otherwise."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.driving.road import LANE, VY
from sim_node.actuator import ADMITTED, GAP, LANE_END, ONCOMING, TAKEN, check
from tests.actuator_scenes import BRAKE, CRUISE, LANES, LEFT, RIGHT, asked
from tests.scenes import car

FREE = (CRUISE, ADMITTED, -1)


def ahead(gap: float, v: float, lane: int = 1) -> list[float]:
    return car(7, 100.0 + 5.0 + gap, lane, v, 4.0 * lane)


def behind(gap: float, v: float, lane: int = 0) -> list[float]:
    return car(7, 100.0 - 5.0 - gap, lane, v, 4.0 * lane)


def test_behind_a_car_that_drives_there_is_less_to_stop_in() -> None:
    # From 20 m/s behind 10 m/s: 27 m less 5.56 m, and half a metre.
    assert asked(CRUISE, ahead(21.9, 10.0)) == (BRAKE, GAP, 7)
    assert asked(CRUISE, ahead(22.0, 10.0)) == FREE


def test_to_the_centimetre_behind_a_car_that_stands() -> None:
    assert asked(CRUISE, ahead(27.48, 0.0)) == (BRAKE, GAP, 7)
    assert asked(CRUISE, ahead(27.52, 0.0)) == FREE


def test_who_stands_may_stand_half_a_metre_behind_another() -> None:
    assert asked(CRUISE, ahead(0.45, 0.0), v=0.0) == (BRAKE, GAP, 7)
    assert asked(CRUISE, ahead(0.55, 0.0), v=0.0) == FREE


def test_a_car_as_fast_or_abreast_does_not_draw_away() -> None:
    assert asked(CRUISE, ahead(3.0, 20.0)) == (BRAKE, GAP, 7)
    assert asked(CRUISE, ahead(-5.0, 10.0)) == (BRAKE, GAP, 7)


@pytest.mark.parametrize("y", [2.0, 6.0])
def test_a_car_that_just_touches_the_way_is_beside_it(y: float) -> None:
    assert asked(CRUISE, car(7, 110.0, 0, 10.0, y)) == FREE


def test_a_car_drifts_for_half_a_second() -> None:
    assert asked(CRUISE, car(7, 110.0, 0, 10.0, 0.0, vy_mps=1.5)) == FREE


def test_every_car_is_looked_at() -> None:
    assert asked(CRUISE, car(6, 50.0, 1, 20.0, 4.0), ahead(5.0, 0.0)) == (BRAKE, GAP, 7)
    assert asked(LEFT, car(6, 200.0, 2, 20.0, 8.0), car(7, 100.0, 0, 20.0, 0.0)) == (CRUISE, TAKEN, 7)


def test_a_slow_car_behind_leaves_two_metres() -> None:
    assert asked(LEFT, behind(1.9, 5.0)) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, behind(2.1, 5.0))[0] == LEFT


@pytest.mark.parametrize(("v", "room"), [(0.0, 15.0 + 100.0 / 12.0), (2.5, 10.0 + 100.0 / 12.0 - 0.625)])
def test_a_slow_ego_is_noticed_the_later_the_slower_it_is(v: float, room: float) -> None:
    # Behind 10 m/s: half a second, and one more for an ego that stands.
    assert asked(LEFT, behind(room - 0.1, 10.0), v=v) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, behind(room + 0.1, 10.0), v=v)[0] == LEFT


@pytest.mark.parametrize(("y", "free"), [(-1.9, False), (-2.5, True)])
def test_a_place_is_as_wide_as_the_ego(y: float, free: bool) -> None:
    assert (asked(LEFT, car(7, 99.0, 0, 20.0, y))[0] == LEFT) == free


def test_the_place_behind_a_car_needs_the_room_to_stop_and_no_more() -> None:
    assert asked(LEFT, ahead(21.9, 10.0, lane=0)) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, ahead(22.5, 10.0, lane=0))[0] == LEFT


def test_a_change_is_not_begun_close_behind_a_faster_car_but_goes_on_behind_one() -> None:
    assert asked(LEFT, ahead(1.0, 21.0, lane=0)) == (CRUISE, TAKEN, 7)
    assert asked(CRUISE, ahead(0.5, 21.0, lane=0), y=3.5, aim=0, left=1) == FREE


def test_beyond_the_road_s_edge_there_is_nothing_to_refuse() -> None:
    assert asked(LEFT, car(7, 100.0, 2, 20.0, 8.0), y=0.0, aim=0) == (LEFT, ADMITTED, -1)
    assert asked(RIGHT, y=8.0, aim=2) == (RIGHT, ADMITTED, -1)


def test_during_a_change_no_third_lane_is_asked_about() -> None:
    assert asked(RIGHT, car(7, 100.0, 2, 20.0, 8.0), y=2.5, aim=1, left=0) == (RIGHT, ADMITTED, -1)


def test_giving_up_a_change_within_the_own_lane_asks_for_nobody_behind() -> None:
    assert asked(RIGHT, behind(1.5, 20.0, lane=1), y=3.5, aim=0, left=1) == (RIGHT, ADMITTED, -1)


def test_a_change_out_of_the_leftmost_lane_is_given_up_too_and_to_the_left() -> None:
    assert asked(CRUISE, car(7, 99.0, 1, 20.0, 4.0), y=0.5, aim=1, left=0) == (LEFT, TAKEN, 7)


def test_a_change_towards_a_car_that_stands_is_given_up_where_the_own_lane_is_free() -> None:
    assert asked(CRUISE, ahead(20.0, 0.0, lane=0), y=3.5, aim=0, left=1) == (RIGHT, GAP, 7)


def test_a_change_goes_on_where_only_the_own_lane_is_blocked() -> None:
    stands, beside = car(6, 115.0, 1, 0.0, 5.6), car(7, 99.0, 0, 20.0, 0.0)
    assert asked(CRUISE, stands, beside, y=3.5, aim=0, left=1) == FREE


def test_the_ego_is_not_in_its_own_way() -> None:
    ego = car(0, 100.0, 1, 20.0, 2.1)
    ego[VY] = -1.0
    assert check([ego], LANES, [1000.0] * 3, CRUISE, 0, 1) == FREE


def leaving(gap: float, *others: list[float]) -> tuple[int, int, int]:
    """10 m/s, a metre off the middle of a car that comes at 10 m/s: 0.6 s, 12 m of closing, to be past it."""
    return asked(CRUISE, car(7, 105.0 + gap, 0, -10.0, 0.5), *others, v=10.0, y=1.5, aim=1, left=0)


def test_what_comes_towards_the_lane_that_is_being_left_is_braked_for_if_the_ego_is_not_out_in_time() -> None:
    assert leaving(11.8) == (BRAKE, ONCOMING, 7)
    assert leaving(12.2) == FREE
    assert leaving(12.2, car(8, 111.0, 1, 0.0, 4.0)) == (BRAKE, GAP, 8)


def ends_in(room: float, v: float, y: float, here: int = 1) -> tuple[int, int, int]:
    """On the way from a lane that ends in `room` metres, less what stands there, to one that goes on."""
    ego = car(0, 100.0, here, v, y)
    assert ego[LANE] == here
    ends: Any = [1000.0, 104.0 + room, 1000.0]
    return check([ego], LANES, ends, CRUISE, 0, 1)


@pytest.mark.parametrize(
    ("v", "y", "room"),
    [
        (20.0, 2.5, 8.0),  # half a metre to go: 0.4 s
        (1.5, 2.25, 0.5),  # a quarter: 0.3 s, but no less than half a metre
    ],
)
def test_a_lane_s_end_is_passed_where_the_ego_is_aside_in_time(v: float, y: float, room: float) -> None:
    assert ends_in(room - 0.1, v, y) == (BRAKE, LANE_END, -1)
    assert ends_in(room + 0.1, v, y) == FREE


def test_who_is_two_metres_aside_is_past_what_stands_at_the_lane_s_end() -> None:
    assert ends_in(0.2, 20.0, 2.0) == FREE
