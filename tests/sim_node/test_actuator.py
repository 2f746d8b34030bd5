"""The actuator: what it lets through, what it refuses, and that nothing reckless comes of what it lets through."""

from __future__ import annotations

import pytest

from schemas.wire.messages import MetaAction
from sim_node.actuator import ADMITTED, GAP, LANE_END, ONCOMING, REASONS, TAKEN
from tests.actuator_scenes import BRAKE, CRUISE, LEFT, RIGHT, SPEED_UP, asked
from tests.scenes import car


def test_every_reason_has_its_words() -> None:
    words = {TAKEN: "the place is taken", GAP: "gap too small", ONCOMING: "oncoming traffic", LANE_END: "lane ends"}
    assert dict(enumerate(REASONS)) == {ADMITTED: "", **words}


@pytest.mark.parametrize("meta", list(MetaAction))
def test_on_a_free_road_everything_is_carried_out(meta: int) -> None:
    assert asked(meta) == (meta, ADMITTED, -1)


def test_the_ego_brakes_where_it_could_hardly_stop_behind_the_car_ahead() -> None:
    # From 20 m/s behind a standing car: 2 m in 0.1 s, 25 m to stop, half a metre left.
    assert asked(SPEED_UP, car(7, 100.0 + 5.0 + 27.4, 1, 0.0, 4.0)) == (BRAKE, GAP, 7)
    assert asked(SPEED_UP, car(7, 100.0 + 5.0 + 27.6, 1, 0.0, 4.0)) == (SPEED_UP, ADMITTED, -1)


def test_a_car_that_draws_away_or_is_in_another_lane_is_not_braked_for() -> None:
    assert asked(CRUISE, car(7, 106.0, 1, 20.1, 4.0))[0] == CRUISE
    assert asked(CRUISE, car(7, 106.0, 0, 0.0, 0.0))[0] == CRUISE
    assert asked(CRUISE, car(-1, 106.0, 1, 0.0, 4.0))[0] == CRUISE


def test_a_car_that_drifts_into_the_ego_s_way_is_braked_for() -> None:
    assert asked(CRUISE, car(7, 110.0, 0, 10.0, 1.7))[0] == CRUISE
    assert asked(CRUISE, car(7, 110.0, 0, 10.0, 1.7, vy_mps=1.0)) == (BRAKE, GAP, 7)


def test_a_car_that_stands_askew_takes_up_more_of_the_road() -> None:
    assert asked(CRUISE, car(7, 110.0, 0, 0.0, 1.0), v=10.0)[0] == CRUISE
    assert asked(CRUISE, car(7, 110.0, 0, 0.0, 1.0, heading_rad=0.6), v=10.0) == (BRAKE, GAP, 7)


def test_the_ego_stops_before_an_oncoming_car() -> None:
    # 2 m in 0.1 s and 25 m to stop; a fast one takes 2 m and 80 m. Half a metre left.
    assert asked(CRUISE, car(7, 100.0 + 5.0 + 109.0, 1, -20.0, 4.0)) == (BRAKE, ONCOMING, 7)
    assert asked(CRUISE, car(7, 100.0 + 5.0 + 110.0, 1, -20.0, 4.0))[0] == CRUISE


def test_a_slow_oncoming_car_is_taken_to_come_on_while_the_ego_brakes() -> None:
    # 20 m/s: 27 m to stop in 2.5 s, in which 5 m/s make 12.5 m. 32 m/s: 67.2 m in 4 s, of which 3 s count.
    for v, gap in ((20.0, 27.0 + 12.5 + 0.5), (32.0, 67.2 + 15.0 + 0.5)):
        assert asked(CRUISE, car(7, 105.0 + gap - 0.1, 1, -5.0, 4.0), v=v) == (BRAKE, ONCOMING, 7)
        assert asked(CRUISE, car(7, 105.0 + gap + 0.1, 1, -5.0, 4.0), v=v)[0] == CRUISE


def test_the_ego_does_not_brake_for_an_oncoming_car_whose_lane_it_has_left_in_time() -> None:
    facing = car(7, 140.0, 0, -10.0, 0.0)
    assert asked(CRUISE, facing, v=10.0, y=0.0, aim=1, left=0)[0] == CRUISE
    assert asked(CRUISE, car(7, 115.0, 0, -10.0, 0.0), v=10.0, y=0.0, aim=1, left=0)[1] == ONCOMING


@pytest.mark.parametrize("x", [92.0, 100.0, 103.0])
def test_no_change_into_a_place_that_is_taken(x: float) -> None:
    assert asked(LEFT, car(7, x, 0, 20.0, 0.0)) == (CRUISE, TAKEN, 7)


def test_no_change_before_a_car_that_comes_too_fast() -> None:
    # 30 m/s to 20 m/s: 15 m in half a second, 75 m to stop, less the ego's 40 m.
    assert asked(LEFT, car(7, 100.0 - 5.0 - 49.0, 0, 30.0, 0.0)) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, car(7, 100.0 - 5.0 - 51.0, 0, 30.0, 0.0)) == (LEFT, ADMITTED, -1)


def test_a_slow_ego_is_noticed_later() -> None:
    behind = car(7, 100.0 - 5.0 - 15.0, 0, 10.0, 0.0)
    assert asked(LEFT, behind, v=5.0)[0] == LEFT
    assert asked(LEFT, behind, v=0.0)[0] == CRUISE


def test_no_change_before_an_oncoming_car_but_behind_one_that_has_gone_by() -> None:
    assert asked(LEFT, car(7, 202.0, 0, -10.0, 0.0)) == (CRUISE, TAKEN, 7)
    assert asked(LEFT, car(7, 203.0, 0, -10.0, 0.0)) == (LEFT, ADMITTED, -1)
    assert asked(LEFT, car(7, 95.0, 0, -10.0, 0.0)) == (LEFT, ADMITTED, -1)


def test_a_change_before_one_is_braked_for_what_is_ahead_all_the_same() -> None:
    others = car(6, 101.0, 0, 20.0, 0.0), car(7, 120.0, 1, 0.0, 4.0)
    assert asked(LEFT, *others) == (BRAKE, GAP, 7)


def test_a_running_change_into_a_place_that_is_taken_is_given_up_while_the_ego_is_in_its_lane() -> None:
    beside = car(7, 99.0, 0, 20.0, 0.0)
    assert asked(CRUISE, beside, y=3.5, aim=0, left=1) == (RIGHT, TAKEN, 7)
    assert asked(BRAKE, beside, y=3.5, aim=0, left=1)[0] == BRAKE
    assert asked(CRUISE, beside, y=1.0, aim=0, left=1)[0] == CRUISE  # too late: it is there


def test_a_change_is_not_given_up_where_the_ego_could_not_stop_in_its_own_lane() -> None:
    ahead, beside = car(6, 120.0, 1, 0.0, 4.0), car(7, 99.0, 0, 20.0, 0.0)
    assert asked(CRUISE, ahead, beside, y=3.5, aim=0, left=1) == (BRAKE, GAP, 6)


def test_giving_a_change_up_is_refused_where_the_lane_that_was_left_is_taken() -> None:
    assert asked(RIGHT, car(7, 101.0, 1, 20.0, 4.0), y=1.0, aim=0, left=1) == (CRUISE, TAKEN, 7)
    assert asked(RIGHT, y=1.0, aim=0, left=1) == (RIGHT, ADMITTED, -1)


def test_the_ego_stops_before_its_lane_ends_unless_it_is_out_of_it_in_time() -> None:
    # 20 m/s: 27 m to stop, 4 m for what stands there, half a metre left.
    ends = [1000.0, 131.4, 1000.0]
    assert asked(CRUISE, ends=ends) == (BRAKE, LANE_END, -1)
    assert asked(CRUISE, ends=[1000.0, 131.6, 1000.0])[0] == CRUISE
    assert asked(CRUISE, y=2.5, aim=0, left=1, ends=ends)[0] == CRUISE  # 10 m are enough for half a metre
    assert asked(CRUISE, y=4.0, aim=0, left=1, ends=[1000.0, 115.0, 1000.0]) == (BRAKE, LANE_END, -1)


def test_a_lane_that_ends_too_soon_is_not_entered() -> None:
    assert asked(RIGHT, ends=[1000.0, 1000.0, 130.0]) == (CRUISE, LANE_END, -1)
