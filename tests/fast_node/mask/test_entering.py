"""Whoever is in a lane that the ego enters can go on."""

from __future__ import annotations

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from fast_node.mask import OPEN, PRESETS
from fast_node.mask.entering import CREEP_MPS, FOLLOWER_BLIND_S
from schemas.wire.messages import MetaAction
from tests.mask_scenes import (
    EAGER,
    HIGHWAY,
    LEFT,
    RAMP,
    RIGHT,
    ROADS,
    SIM,
    accels,
    ahead_by,
    braking,
    car,
    closed,
    closed_on,
    either_side,
    every_preset,
    in_lane,
    judge,
    likings,
    pulls_away,
    speeds,
    touched,
)


def test_a_car_beside_or_close_behind_closes_the_return():
    assert closed([car(0, 500, 0, 7), car(1, 497, 1, 4)], lane=0)[MetaAction.RIGHT] == "rear gap in lane"


def test_a_faster_car_behind_in_the_next_lane_closes_the_change():
    rows = [car(0, 500, 2, 22), car(4, 470, 1, 27)]
    assert closed_on(HIGHWAY, rows, 2) == {MetaAction.LEFT: "rear gap in lane"}


def test_a_car_that_moves_into_the_next_lane_from_beyond_closes_the_change():
    rows = [car(0, 500, 2, 22), car(4, 498, 0, 22, y_m=1.0, vy_mps=1.5)]
    assert closed_on(HIGHWAY, rows, 2)[MetaAction.LEFT] == "rear gap in lane"


def test_nobody_leaves_the_ramp_before_it_lies_beside_the_road():
    assert closed_on(RAMP, [car(0, 200, 2, 15)], 2)[MetaAction.LEFT] == "no lane there"
    assert MetaAction.LEFT not in closed_on(RAMP, [car(0, 240, 2, 15)], 2)


def test_nobody_drives_from_the_road_onto_the_ramp():
    assert closed_on(RAMP, [car(0, 260, 1, 15)], 1)[MetaAction.RIGHT] == "no lane there"


@every_preset
@either_side
@settings(max_examples=200, deadline=None)
@given(speeds, speeds, speeds, st.floats(0.1, 80), st.floats(0.1, 80), accels, likings)
@example(2.0, 0.0, 2.0, 4.0, 2.0, 3.0, EAGER)
@example(2.6307, 2.8912, 0.0917, 10.5718, 2.8912, 2.6307, EAGER)
@example(3.5785, 4.2062, 2.9911, 4.4417, 2.5321, 1.9169, EAGER)
@example(20.9247, 1.016, 4.4515, 49.4412, 34.8752, 2.6596, EAGER)
@example(20.131, 26.6971, 27.9919, 68.9512, 2.3752, 2.9104, (1, 0, 2, 4, 3))
def test_after_an_open_change_the_leads_of_both_lanes_may_brake_fully(
    preset, side, v, lead_v, other_v, gap, other_gap, accel, liking
):
    p, aim = PRESETS[preset], 1 if side == MetaAction.LEFT else 3
    assume(not pulls_away(gap, lead_v, v, p))
    leads = [(2, braking(505.0 + gap, lead_v, p.lead_brake)), (aim, braking(505.0 + other_gap, other_v, p.lead_brake))]
    for _, rows in ahead_by(4.0, in_lane(2, v, accel), HIGHWAY, leads, side, liking, p):
        assert not touched(rows)


@either_side
def test_after_an_open_change_going_back_behind_a_lead_that_brakes_fully_is_not_all_that_is_left(side):
    lead, back = (2, braking(525.0, 20.0, SIM.lead_brake)), LEFT + RIGHT - side
    for _, rows in ahead_by(4.0, in_lane(2, 20.0), HIGHWAY, [lead], side, (*EAGER, back), SIM):
        assert not touched(rows)


@every_preset
@pytest.mark.parametrize(
    ("road", "side"), [("highway", MetaAction.LEFT), ("highway", MetaAction.RIGHT), ("merge", MetaAction.LEFT)]
)
@settings(max_examples=200, deadline=None)
@given(speeds, speeds, st.floats(-120, -0.1))
def test_after_an_open_change_a_follower_that_reacts_late_does_not_reach_the_ego_that_brakes(
    preset, road, side, v, other_v, behind
):
    p, lanes, x = PRESETS[preset], ROADS[road], 260.0
    rows = [car(0, x, 2, v), car(1, x - 5.0 + behind, 1 if side == MetaAction.LEFT else 3, other_v)]
    reasons, _ = judge(rows, lanes, v, 2, preset=p)
    assume(reasons[side] == OPEN)
    late = p.follower_reaction_s + FOLLOWER_BLIND_S * max(0.0, 1.0 - v / CREEP_MPS)
    ego, follower = braking(x, v, p.shown_brake), braking(x - 5.0 + behind, other_v, p.follower_brake, late, 0.5)
    assert all(ego(k / 30)[0] - follower(k / 30)[0] > 5.0 for k in range(300))
