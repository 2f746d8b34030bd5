"""A change in progress never traps the ego."""

from __future__ import annotations

from schemas.wire.messages import MetaAction
from tests.mask_scenes import HIGHWAY, car, closed, closed_on


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
