"""The ego can always stop behind every car ahead."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fast_node.mask import PRESETS, REASONS
from schemas.driving import measures
from schemas.wire.messages import MetaAction
from tests.mask_scenes import (
    EAGER,
    HIGHWAY,
    LANES,
    RAMP,
    Ego,
    accels,
    ahead_by,
    braking,
    capped,
    car,
    closed,
    closed_on,
    every_preset,
    in_lane,
    likings,
    presets,
    pulls_away,
    speeds,
    touched,
)


def test_too_close_a_lead_leaves_only_the_emergency_brake():
    assert set(range(5)) <= set(closed([car(0, 500, 1, 8), car(1, 507, 1, 1)]))


def test_the_set_point_may_not_exceed_what_the_gap_admits():
    rows = [car(0, 500, 1, 4), car(1, 511, 1, 4)]
    assert closed(rows, target_speed=8.0)[MetaAction.SPEED_UP] == "speed above the gap's"
    # 6 m: 0.7 m more than 2.5 m and 0.7 s.
    assert capped(rows, LANES, 8.0, 1)[2] == pytest.approx(4.35)


def test_a_car_that_cuts_in_ahead_limits_the_speed_before_it_is_in_the_lane():
    rows = [car(0, 500, 2, 25), car(4, 536, 1, 20, y_m=5.5, vy_mps=1.5)]
    assert closed_on(HIGHWAY, rows, 2)[MetaAction.SPEED_UP] == "speed above the gap's"
    # 31 m, two of them not braked in: after 0.3 s with 6.5 m/s2, the lead with 9.
    cap = math.sqrt(1.95**2 + 2 * 6.5 * 29 + 6.5 / 9 * 20**2) - 1.95
    assert capped(rows, HIGHWAY, 25.0, 2)[2] == pytest.approx(cap)


def test_a_car_that_crosses_the_lane_between_limits_the_speed_however_fast_it_crosses():
    crossing = car(1, 545, 1, 15, y_m=5.2, vy_mps=4.5)
    behind_it = [car(0, 500, 3, 25, y_m=10.7), crossing]
    reasons, _, cap = capped(behind_it, HIGHWAY, 25.0, 2, 3)
    assert REASONS[reasons[MetaAction.SPEED_UP]] == "speed above the gap's"
    assert cap == pytest.approx(math.sqrt(1.95**2 + 2 * 6.5 * 38 + 6.5 / 9 * 15**2) - 1.95)


@pytest.mark.parametrize(("drift", "in_the_way"), [(0.31, True), (0.29, False), (0.0, False), (-0.31, False)])
def test_a_car_ahead_in_the_next_lane_is_in_the_way_where_it_drifts_towards_the_ego(drift: float, in_the_way: bool):
    rows = [car(0, 500, 2, 20), car(4, 508, 1, 20, y_m=5.65, vy_mps=drift)]
    assert (closed_on(HIGHWAY, rows, 2).get(MetaAction.CRUISE) == "lead too close") == in_the_way


@given(presets, st.floats(3.0, 33.0), st.integers(1, 40))
def test_the_ego_brakes_sideways_as_the_mask_takes_it_to(preset, speed, ticks):
    p = PRESETS[preset]
    ego = Ego(500.0, 8.0, speed, 0.0, 0.0, speed, 2, -1)
    for k in range(ticks):
        ego = ego.moved(int(MetaAction.LEFT if k == 0 else MetaAction.CRUISE), HIGHWAY, 40.0)
    assume(ego.previous == 2)
    start, towards = ego.y, -ego.row(HIGHWAY)[4]
    ego = ego.moved(int(MetaAction.RIGHT), HIGHWAY, 40.0)
    nearest = ego.y
    for _ in range(45):
        ego = ego.moved(int(MetaAction.CRUISE), HIGHWAY, 40.0)
        nearest = min(nearest, ego.y)
    assert start - nearest <= measures.rss_lateral_m(towards, 0.0, p.reaction_s, p.side_accel, p.side_brake, 0.0)


def test_a_car_that_stands_askew_is_as_wide_as_it_is():
    ego = car(0, 500, 1, 10)
    assert MetaAction.SPEED_UP not in closed_on(RAMP, [ego, car(1, 515, 2, 0, y_m=7.0)], 1)
    assert MetaAction.SPEED_UP in closed_on(RAMP, [ego, car(1, 515, 2, 0, y_m=7.0, heading_rad=0.9)], 1)


@every_preset
@settings(max_examples=200, deadline=None)
@given(speeds, speeds, st.floats(0.1, 120), accels, st.floats(-3, 3), st.sampled_from(EAGER), likings)
def test_after_any_open_action_the_mask_can_still_avoid_a_lead_that_brakes_fully(
    preset, v, lead_v, gap, accel, extra, first, liking
):
    p = PRESETS[preset]
    assume(not pulls_away(gap, lead_v, v, p))
    lead = (1, braking(505.0 + gap, lead_v, p.lead_brake))
    for _, rows in ahead_by(4.0, in_lane(1, v, accel, extra=extra), HIGHWAY, [lead], first, liking, p):
        assert not touched(rows)
