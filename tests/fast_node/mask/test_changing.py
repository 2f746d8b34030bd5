"""A change in progress never traps the ego."""

from __future__ import annotations

from hypothesis import assume, given
from hypothesis import strategies as st

from fast_node.mask import OPEN, PRESETS
from fast_node.mask.vocabulary import GIVE_UP_CHANGE
from schemas.driving.road import LANE
from schemas.wire.messages import MetaAction
from tests.mask_scenes import (
    HIGHWAY,
    LEFT,
    RIGHT,
    braking,
    car,
    closed,
    closed_on,
    either_side,
    every_preset,
    judge,
    presets,
    scenes,
    speeds,
)


def test_a_change_home_that_oncoming_traffic_keeps_from_being_given_up_is_finished_without_delay():
    waits = [car(0, 520, 0, 0.5, y_m=0.04), car(1, 545, 1, 4.5), car(2, 503, 1, 5.4), car(7, 580, 0, -5)]
    crawling, moving = (closed(waits, target_speed=v, lane=1, previous=0) for v in (0.0, 5.0))
    assert [crawling.get(a) for a in range(4)] == ["rear gap in lane", "rear gap in lane", None, "oncoming traffic"]
    assert [moving.get(a) for a in range(4)] == ["rear gap in lane", None, None, "oncoming traffic"]


def test_a_change_that_a_fast_car_from_behind_makes_unsafe_is_given_up():
    rows = [car(0, 500, 2, 15, y_m=7.2), car(4, 480, 1, 28)]
    assert closed_on(HIGHWAY, rows, 1, previous=2)[MetaAction.CRUISE] == "give up the change"


def test_a_change_is_completed_when_a_car_has_come_up_in_the_lane_that_is_mostly_left():
    rows = [car(0, 500, 1, 15, y_m=5.8), car(4, 480, 1, 28), car(5, 494, 2, 15)]
    shut = closed_on(HIGHWAY, rows, 1, previous=2)
    assert (shut.get(MetaAction.CRUISE), shut.get(MetaAction.RIGHT)) == (None, "rear gap in lane")


@given(scenes(), presets)
def test_a_change_is_given_up_only_where_that_is_open_and_the_ego_has_not_left_its_lane(scene, preset):
    reasons, _ = judge(scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset])
    if GIVE_UP_CHANGE in reasons:
        back = LEFT if scene.previous < scene.lane else RIGHT
        assert (scene.previous >= 0, reasons[back], int(scene.rows[0][LANE])) == (True, OPEN, scene.previous)


@every_preset
@either_side
@given(speeds, speeds, st.floats(-60, -5.5), st.floats(0.05, 0.45))
def test_a_follower_that_brakes_at_once_does_not_reach_an_ego_that_may_go_on_with_its_change(
    preset, side, v, other_v, behind, share
):
    p, aim = PRESETS[preset], 1 if side == MetaAction.LEFT else 3
    y = 8.0 + share * (4.0 * aim - 8.0)
    rows = [car(0, 500, 2, v, y_m=y), car(1, 500 + behind, aim, other_v)]
    reasons, _ = judge(rows, HIGHWAY, v, aim, previous=2, preset=p)
    assume(reasons[MetaAction.CRUISE] == OPEN)
    ego, follower = braking(500.0, v, p.shown_brake), braking(500.0 + behind, other_v, p.follower_brake, p.reaction_s)
    assert all(ego(k / 30)[0] - follower(k / 30)[0] >= 5.0 for k in range(300))
