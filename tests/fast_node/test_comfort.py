"""The speed that is comfortable: behind a lead, on a ramp, and reached without hard braking."""

from __future__ import annotations

import math
from typing import Any

import pytest

from fast_node.choice import comfortable_mps
from schemas.driving.intent import ASSERTIVE, CALM, NORMAL
from schemas.driving.road import LANE_END
from tests.mask_scenes import HIGHWAY, RAMP
from tests.scenes import car

FAST = 28.0


def lead(gap: float, speed: float = 10.0, in_lane: int = 1) -> list[float]:
    """A car of 7 m so far ahead of the ego's 5 m, bumper to bumper."""
    return car(1, 500.0 + gap + 6.0, in_lane, speed, length_m=7.0)


def comfortable(
    *cars: list[float],
    speed: float = 0.0,
    accel: float = 0.0,
    wish: tuple[float, float] = (FAST, 1.0),
    aim: int = 1,
    style: int = NORMAL,
    lanes: Any = HIGHWAY,
    x: float = 500.0,
) -> float:
    """The comfortable speed [m/s]; cars: the first is ahead in the lane `aim`, or comes into it."""
    near = [-1] * (3 * len(lanes))
    if cars:
        near[3 * aim] = 1
    return comfortable_mps([car(0, x, aim, speed), *cars], near, lanes, aim, accel, *wish, style)


def test_alone_the_wished_speed_is_comfortable():
    assert comfortable(wish=(12.0, 1.0)) == 12.0


def test_at_the_end_of_the_road_nobody_brakes():
    assert comfortable(x=HIGHWAY[1][LANE_END] - 20.0, speed=20.0, wish=(20.0, 1.0)) == 20.0


@pytest.mark.parametrize(
    ("gap", "headway", "speed"),
    [
        (30.0, 1.0, 10 + math.sqrt(52.5 + 36) - 6),  # 30 - 2.5 - 10 m to close in, braking with 1.5 at last
        (30.0, 0.5, 10 + math.sqrt(67.5 + 36) - 6),
        (30.0, 2.0, 10 + math.sqrt(22.5 + 36) - 6),
        (12.5, 1.0, 10.0),  # just the headway: as fast as the lead
        (11.5, 1.0, 9.75),  # a quarter per second and metre
        (10.0, 1.0, 9.375),
        (2.6, 1.0, 7.525),
        (2.4, 1.0, 7.5),  # no more than 2.5 m/s slower
        (1.0, 0.0, 9.625),  # nearer than at a standstill
    ],
)
def test_behind_a_lead_the_speed_brings_the_wished_headway_about(gap, headway, speed):
    assert comfortable(lead(gap), wish=(FAST, headway)) == pytest.approx(speed)


def test_behind_a_lead_the_wished_speed_is_the_most():
    assert comfortable(lead(30.0), wish=(12.0, 1.0)) == 12.0


def test_a_car_that_rolls_back_counts_as_standing():
    assert comfortable(lead(12.5, speed=-0.09), wish=(FAST, 6.0)) == pytest.approx(math.sqrt(30 + 36) - 6)


def test_a_car_that_only_comes_into_the_lane_needs_no_headway():
    assert comfortable(lead(10.0, in_lane=2)) == FAST


@pytest.mark.parametrize(("x", "speed"), [(200.0, 240**0.5), (229.0, 240**0.5), (230.0, 240**0.5), (300.0, 72**0.5)])
def test_on_a_ramp_the_speed_is_what_may_be_driven_where_it_opens(x, speed):
    # 120 m before its end, 20 of them to spare: braking with 1.2.
    assert comfortable(lanes=RAMP, aim=2, x=x) == pytest.approx(speed)


@pytest.mark.parametrize(
    ("accel", "speed"), [(0.0, 19.9), (1.0, 19.9), (-1.0, 18.9), (-1.89, 18.01), (-1.95, 18.0), (-6.0, 18.0)]
)
def test_comfort_brakes_with_two_and_comes_to_that_slowly(accel, speed):
    # A tenth of a metre per second squared more each tick: 1.5 m/s3.
    assert comfortable(speed=20.0, accel=accel, wish=(10.0, 1.0)) == pytest.approx(speed)


@pytest.mark.parametrize(("style", "brake", "jerk"), [(CALM, 1.5, 1.0), (NORMAL, 2.0, 1.5), (ASSERTIVE, 3.0, 2.5)])
def test_a_style_brakes_as_hard_and_as_soon_as_it_likes(style, brake, jerk):
    assert comfortable(speed=20.0, wish=(10.0, 1.0), style=style) == pytest.approx(20 - jerk / 15)
    assert comfortable(speed=20.0, accel=-6.0, wish=(10.0, 1.0), style=style) == pytest.approx(20 - brake)


@pytest.mark.parametrize(("style", "brake"), [(CALM, 1.0), (NORMAL, 1.5), (ASSERTIVE, 2.2)])
def test_a_style_closes_in_as_fast_as_it_likes(style, brake):
    closing = math.sqrt(2 * brake * 17.5 + (4 * brake) ** 2) - 4 * brake
    assert comfortable(lead(30.0), style=style) == pytest.approx(10 + closing)


def test_comfort_does_not_hold_up_what_is_hardly_slower():
    assert comfortable(speed=20.0, wish=(19.95, 1.0)) == 19.95
