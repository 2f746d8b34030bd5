"""The ego never drives over the end of a lane."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.mask import PRESETS
from fast_node.mask.lane_end import OUT_M
from schemas.driving.road import LANE_END, LANE_Y
from schemas.wire.messages import MetaAction
from tests.mask_scenes import (
    EAGER,
    RAMP,
    accels,
    ahead_by,
    capped,
    car,
    closed_on,
    every_preset,
    in_lane,
    likings,
    steady,
)


def test_the_end_of_the_ramp_slows_the_ego_down_and_then_stops_it():
    blocked = [car(i, 300 + 12 * i, 1, 14) for i in range(-4, 5) if i]
    assert closed_on(RAMP, [car(0, 300, 2, 18), *blocked], 2)[MetaAction.SPEED_UP] == "lane ends"
    assert capped([car(0, 300, 2, 18), *blocked], RAMP, 18.0, 2)[2] == pytest.approx((2 * 1.2 * 30) ** 0.5)
    assert set(range(5)) <= set(closed_on(RAMP, [car(0, 335, 2, 12), *blocked], 2))


def test_a_change_is_completed_when_going_back_would_not_stop_before_the_lane_ends():
    close_behind = car(4, 318, 1, 20)
    there = closed_on(RAMP, [car(0, 330, 2, 14, y_m=6.5), close_behind], 1, previous=2)
    assert (there.get(MetaAction.CRUISE), there.get(MetaAction.RIGHT)) == (None, "lane ends")
    before = closed_on(RAMP, [car(0, 300, 2, 14, y_m=6.5), car(4, 288, 1, 20)], 1, previous=2)
    assert (before.get(MetaAction.CRUISE), before.get(MetaAction.RIGHT)) == ("give up the change", None)


@every_preset
@settings(max_examples=200, deadline=None)
@given(
    st.floats(230, 349),
    st.floats(0, 20),
    accels,
    st.sampled_from([*EAGER, MetaAction.LEFT]),
    likings,
    st.lists(st.tuples(st.floats(-60, 100), st.floats(0, 20)), max_size=3),
)
def test_after_any_open_action_nobody_drives_over_the_end_of_the_ramp(preset, x, v, accel, first, liking, others):
    p = PRESETS[preset]
    main = [(1, steady(x + dx, speed)) for dx, speed in others]
    for ego, _ in ahead_by(6.0, in_lane(2, v, accel, x), RAMP, main, first, liking, p):
        assert ego.x < RAMP[2][LANE_END] or ego.y < RAMP[2][LANE_Y] - OUT_M + 0.3
