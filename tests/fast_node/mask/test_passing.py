"""A pass is over before anybody who comes can be met, or given up in time."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.mask import PRESETS, REASONS
from fast_node.mask.neighbours import survey
from fast_node.mask.passing import pass_time_s, passing
from fast_node.mask.vocabulary import Situation
from schemas.driving.road import LANE_LIMIT
from schemas.wire.messages import MetaAction
from tests.mask_scenes import (
    EAGER,
    LANES,
    SIGHT_M,
    SIM,
    accels,
    ahead_by,
    car,
    closed,
    every_preset,
    in_lane,
    judge,
    likings,
    steady,
    touched,
)


def test_a_free_road_leaves_every_speed_open_and_nothing_to_pass():
    assert closed([car(0, 500, 1, 5)]) == {MetaAction.LEFT: "nothing to pass", MetaAction.RIGHT: "no lane there"}


def test_a_slow_lead_may_be_passed_when_the_oncoming_lane_is_free():
    assert MetaAction.LEFT not in closed([car(0, 500, 1, 4), car(1, 512, 1, 3.5)])


def test_oncoming_traffic_closes_the_way_past_a_slow_lead_and_is_named():
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(7, 600, 0, -6)]
    reasons, vehicle = judge(rows, LANES, 4.0, 1)
    assert (REASONS[reasons[MetaAction.LEFT]], vehicle[MetaAction.LEFT]) == ("oncoming traffic", 7)


def test_leads_too_close_to_return_between_are_passed_together_if_there_is_time_for_both():
    two = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(2, 522, 1, 3.5)]
    assert MetaAction.LEFT not in closed(two)
    assert MetaAction.LEFT not in closed([*two[:2], car(7, 660, 0, -6)])
    assert closed([*two, car(7, 660, 0, -6)])[MetaAction.LEFT] == "oncoming traffic"


def in_doubt(row: list[float], speed_mps: float) -> list[float]:
    """The track of a car whose speed may be so far off."""
    return [*row, 0.0, 0.0, speed_mps, 0.0]


@pytest.mark.parametrize(("unsure", "by"), [(0.0, None), (2.0, "oncoming traffic")])
def test_who_may_be_slower_leaves_less_room_to_return_to(unsure, by):
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), in_doubt(car(2, 534, 1, 3.5), unsure), car(7, 660, 0, -6)]
    assert closed(rows).get(MetaAction.LEFT) == by


@pytest.mark.parametrize(("unsure", "by"), [(0.0, None), (0.9, "oncoming traffic")])
def test_who_comes_may_be_faster(unsure, by):
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), in_doubt(car(7, 635, 0, -6), unsure)]
    assert closed(rows).get(MetaAction.LEFT) == by


def test_a_queue_as_far_as_one_can_see_leaves_no_gap_to_return_to():
    queue = [car(i, 500 + 12 * i, 1, 3.5) for i in range(1, 21)]
    assert closed([car(0, 500, 1, 4), *queue])[MetaAction.LEFT] == "no gap to return to"


def test_a_pass_that_oncoming_traffic_makes_impossible_is_given_up():
    rows = [car(0, 500, 0, 5), car(1, 508, 1, 4), car(7, 560, 0, -6)]
    assert closed(rows, lane=0)[MetaAction.SPEED_UP] == "give up the pass"


def test_the_time_of_a_pass_agrees_with_the_distance_gained():
    # 3 m/s faster is reached after 3 / 0.7 s and 6.43 m; the other 13.57 m take 13.57 / 3 s.
    assert abs(pass_time_s(20.0, 0.0, 3.0) - (3 / 0.7 + (20 - 4.5 / 0.7) / 3)) < 1e-9


def test_nothing_is_left_to_pass_once_there_is_room_to_return():
    rows, near = [car(0, 520, 0, 7), car(1, 510, 1, 4)], [0] * 6
    survey(rows, LANES, near)
    there = Situation(rows, LANES, near, 7.0, 0, -1, SIGHT_M, 3000.0, SIM)
    assert REASONS[passing(there, home=1, away=0)[0]] == "nothing to pass"


@every_preset
@settings(max_examples=200, deadline=None)
@given(st.floats(0, 8), st.floats(0, 8), st.floats(0.1, 40), st.floats(20, 400), accels, likings)
def test_after_an_open_pass_nobody_meets_an_oncoming_car_that_comes_at_its_limit(
    preset, v, lead_v, gap, meeting_gap, accel, liking
):
    p = PRESETS[preset]
    others = [(1, steady(505.0 + gap, lead_v)), (0, steady(505.0 + meeting_gap, -LANES[0][LANE_LIMIT]))]
    for _, rows in ahead_by(2.0, in_lane(1, v, accel), LANES, others, MetaAction.LEFT, liking, p):
        assert not touched(rows)


@every_preset
@settings(max_examples=100, deadline=None)
@given(st.floats(0, 8), st.floats(0, 8), st.floats(0.1, 40), st.floats(20, 400), accels)
def test_an_open_pass_is_over_before_an_oncoming_car_at_its_limit_arrives(preset, v, lead_v, gap, meeting_gap, accel):
    p = PRESETS[preset]
    others = [(1, steady(505.0 + gap, lead_v)), (0, steady(505.0 + meeting_gap, -LANES[0][LANE_LIMIT]))]
    home = (MetaAction.RIGHT, *EAGER)
    for _, rows in ahead_by(30.0, in_lane(1, v, accel), LANES, others, MetaAction.LEFT, home, p):
        assert not touched(rows)
