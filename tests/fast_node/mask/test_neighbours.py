"""Who is near the ego, and where the others are heading."""

from __future__ import annotations

import math
from typing import Any

import pytest

from fast_node.mask.neighbours import half_width, heads_for, settles_at, survey
from schemas.driving.road import lane_table
from tests.mask_scenes import HIGHWAY, RAMP, moving
from tests.scenes import car, lane


@pytest.mark.parametrize(("sine", "half"), [(0.0, 1.0), (0.6, 2.3), (-0.6, 2.3)])
def test_a_car_askew_takes_up_its_length_too(sine, half):
    assert half_width(moving(car(1, 0, 0, 0), sine=sine)) == pytest.approx(half)


BEGINS = lane_table((lane(0), lane(1), lane(2, start_m=100.0)))
ENDS = lane_table((lane(0), lane(1), lane(2, end_m=350.0)))

# Where other cars are heading.


def heading(row: list[float], lanes: Any = HIGHWAY, end: float = 9000.0) -> int:
    return heads_for(row, lanes, end, 2.0)


@pytest.mark.parametrize(("sideways", "lane"), [(0.5, 2), (-0.5, 0), (0.3, 1), (-0.3, 1), (0.0, 1)])
def test_a_car_that_moves_sideways_heads_for_the_next_lane(sideways, lane):
    assert heading(moving(car(1, 500, 1, 9, y_m=4.0 + math.copysign(1.5, sideways)), sideways)) == lane


def test_a_car_that_stays_at_the_edge_of_its_lane_heads_for_that():
    assert heading(car(1, 500, 1, 9, y_m=2.0)) == 1


def test_nobody_comes_out_of_a_lane_at_the_end_of_the_road():
    assert heading(car(1, 8900, 1, 9)) == 1


@pytest.mark.parametrize(("y", "lane"), [(5.1, 2), (5.0, 2), (4.9, 1)])
def test_a_car_heads_for_a_lane_that_it_reaches_within_two_seconds(y, lane):
    # At 0.5 m/s it comes a metre far; the next lane begins at y = 6.
    assert heading(moving(car(1, 500, 1, 9, y_m=y), 0.5)) == lane


@pytest.mark.parametrize(("lane", "sideways"), [(0, -2.0), (3, 2.0)])
def test_a_car_that_moves_off_the_road_heads_for_no_other_lane(lane, sideways):
    assert heading(moving(car(1, 500, lane, 9), sideways)) == lane


@pytest.mark.parametrize(("x", "lane"), [(99.0, 1), (100.0, 2), (500.0, 2)])
def test_nobody_heads_for_a_lane_before_it_begins(x, lane):
    assert heading(moving(car(1, x, 1, 9, y_m=5.9), 1.0), BEGINS) == lane


@pytest.mark.parametrize(("x", "lane"), [(230.0, 2), (230.5, 1), (349.0, 1)])
def test_a_car_may_come_out_of_a_ramp_once_that_lies_beside_the_road(x, lane):
    assert heading(car(1, x, 2, 9), RAMP, 750.0) == lane


@pytest.mark.parametrize(("x", "lane"), [(200.0, 2), (200.5, 1)])
def test_a_car_may_come_out_of_a_lane_from_150_metres_before_its_end(x, lane):
    assert heading(car(1, x, 2, 9), ENDS, 1e4) == lane


def test_nobody_comes_out_of_the_leftmost_lane_to_the_left():
    ends = lane_table((lane(0, end_m=350.0), lane(1)))
    assert heading(car(1, 349, 0, 9), ends, 3000.0) == 0


@pytest.mark.parametrize(("y", "sine", "lane"), [(5.0, 0.6, 2), (3.0, 0.6, 0), (3.0, -0.6, 0), (4.0, 0.6, 1)])
def test_a_car_askew_heads_for_the_lane_that_it_reaches_into(y, sine, lane):
    # Askew by 0.6 it is 2.3 m to a side, and the ego that would be there 1 m.
    assert heading(moving(car(1, 500, 1, 9, y_m=y), sine=sine)) == lane


@pytest.mark.parametrize("sine", [0.09, 0.1])
def test_a_car_hardly_askew_heads_for_its_lane_alone(sine):
    assert heading(moving(car(1, 500, 1, 9, y_m=5.9), sine=sine)) == 1


def test_a_car_askew_at_the_edge_heads_for_its_lane_alone():
    assert heading(moving(car(1, 500, 0, 9, y_m=-1.9), sine=0.6)) == 0
    assert heading(moving(car(1, 500, 3, 9, y_m=13.9), sine=0.6)) == 3


# Who is near.


def near(*rows: list[float], lanes: Any = HIGHWAY) -> list[int]:
    found = [7] * (3 * len(lanes))
    survey([car(0, 500, 1, 9), *rows], lanes, found)
    return found


def test_an_empty_road_has_nobody_near():
    assert near() == [-1] * 12


def test_the_nearest_car_ahead_and_behind_and_facing_is_found_in_each_lane():
    rows = [car(1, 540, 1, 9), car(2, 520, 1, 9), car(3, 480, 1, 9), car(4, 490, 1, 9), car(5, 500, 2, 9)]
    assert near(*rows) == [-1, -1, -1, 2, 4, -1, 5, -1, -1, -1, -1, -1]
    facing = [car(1, 560, 0, -9), car(2, 550, 0, -9), car(3, 495.5, 0, -9), car(4, 495, 0, -9)]
    assert near(*facing) == [-1, -1, 3, *[-1] * 9]


def test_a_car_that_is_not_there_is_not_found():
    assert near(car(-1, 510, 1, 9), car(0, 520, 1, 9)) == [-1, -1, -1, 2, *[-1] * 8]


def test_of_two_cars_at_the_same_place_the_first_is_found():
    assert near(car(1, 520, 1, 9), car(2, 520, 1, 9)) == [-1, -1, -1, 1, *[-1] * 8]


def test_a_car_that_hardly_rolls_back_is_not_oncoming():
    assert near(car(1, 520, 1, -0.1)) == [-1, -1, -1, 1, *[-1] * 8]


def test_a_car_that_changes_lanes_is_found_in_both():
    assert near(moving(car(1, 520, 1, 9, y_m=5.5), 1.0)) == [-1, -1, -1, 1, -1, -1, 1, *[-1] * 5]


# Where a motion sideways ends.


@pytest.mark.parametrize(
    ("lane", "y", "sideways", "end"),
    [
        (1, 4.0, 0.31, 8.0),  # out of its lane, once it is past the middle
        (1, 3.91, 0.31, 8.0),
        (1, 3.89, 0.31, 4.0),  # to the middle of its lane
        (1, 4.09, -0.31, 0.0),
        (1, 4.11, -0.31, 4.0),
        (1, 5.0, 0.3, 5.0),  # it sways
        (0, -0.5, -1.5, -3.5),  # off the road, 2 s far
        (3, 12.5, 1.5, 15.5),
    ],
)
def test_a_motion_sideways_ends_on_the_centre_line_that_comes_next(lane, y, sideways, end):
    assert settles_at(moving(car(1, 500, lane, 9, y_m=y), sideways), HIGHWAY) == pytest.approx(end)


def test_a_car_on_a_ramp_that_may_not_be_left_yet_follows_its_bend():
    row = moving(car(1, 200, 2, 9, y_m=9.0), -1.0)
    assert (heading(row, RAMP, 750.0), settles_at(row, RAMP)) == (2, 8.0)


@pytest.mark.parametrize(("unsure", "end"), [(0.69, 8.0), (0.71, 5.0)])
def test_a_motion_sideways_that_is_in_doubt_is_none(unsure, end):
    track = [*moving(car(1, 500, 1, 9, y_m=5.0), 1.0), 0.0, 0.0, 0.0, unsure]
    assert settles_at(track, HIGHWAY) == pytest.approx(end)
