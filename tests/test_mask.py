"""The safety mask and the coordination, on scenes made by hand and by hypothesis."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.coordination import wished_lane
from fast_node.mask import OPEN, RULES, close_actions, pass_time_s, passing
from schemas.messages import MetaAction

LANES = [(0.0, 0.0, 3000.0, -1.0, 4.0, 20.0), (4.0, 0.0, 3000.0, 1.0, 4.0, 20.0)]


def car(number: int, x: float, lane: int, speed: float, y: float | None = None) -> list[float]:
    return [float(number), x, 4.0 * lane if y is None else y, speed, 0.0, 0.0, 5.0, 2.0, float(lane)]


def closed(rows: list[list[float]], *, target_speed: float = 5.0, lane: int = 1, previous: int = -1) -> dict[int, str]:
    rule, vehicle = [0] * 6, [0] * 6
    close_actions(rows, LANES, target_speed, lane, previous, rule, vehicle)
    return {a: RULES[r] for a, r in enumerate(rule) if r != OPEN}


def test_a_free_road_leaves_every_speed_open_and_nothing_to_pass():
    assert closed([car(0, 500, 1, 5)]) == {MetaAction.LEFT: "nothing to pass", MetaAction.RIGHT: "no lane there"}


def test_a_slow_lead_may_be_passed_when_the_oncoming_lane_is_free():
    assert MetaAction.LEFT not in closed([car(0, 500, 1, 4), car(1, 512, 1, 3.5)])


def test_oncoming_traffic_closes_the_way_past_a_slow_lead_and_is_named():
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(7, 600, 0, -6)]
    rule, vehicle = [0] * 6, [0] * 6
    close_actions(rows, LANES, 4.0, 1, -1, rule, vehicle)
    assert (RULES[rule[MetaAction.LEFT]], vehicle[MetaAction.LEFT]) == ("oncoming traffic", 7)


def test_a_second_lead_too_close_to_return_before_it_closes_the_pass():
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(2, 520, 1, 3.5)]
    assert closed(rows)[MetaAction.LEFT] == "no gap to return to"


def test_a_car_beside_or_close_behind_closes_the_return():
    assert closed([car(0, 500, 0, 7), car(1, 497, 1, 4)], lane=0)[MetaAction.RIGHT] == "rear gap in lane"


def test_a_pass_that_oncoming_traffic_makes_impossible_is_given_up():
    rows = [car(0, 500, 0, 5), car(1, 508, 1, 4), car(7, 560, 0, -6)]
    assert closed(rows, lane=0)[MetaAction.SPEED_UP] == "give up the pass"


def test_too_close_a_lead_leaves_only_the_emergency_brake():
    assert set(range(5)) <= set(closed([car(0, 500, 1, 8), car(1, 507, 1, 1)]))


def test_the_set_point_may_not_exceed_what_the_gap_admits():
    rows = [car(0, 500, 1, 4), car(1, 511, 1, 4)]
    assert closed(rows, target_speed=8.0)[MetaAction.CRUISE] == "speed above the gap's"


def test_the_time_of_a_pass_agrees_with_the_distance_gained():
    # 3 m/s faster is reached after 3 / 0.7 s and 6.43 m; the other 13.57 m take 13.57 / 3 s.
    assert abs(pass_time_s(20.0, 0.0) - (3 / 0.7 + (20 - 4.5 / 0.7) / 3)) < 1e-9


def test_nothing_is_left_to_pass_once_there_is_room_to_return():
    assert RULES[passing([car(0, 520, 0, 7), car(1, 510, 1, 4)], 1, 0)[0]] == "nothing to pass"


def test_the_wished_lane_is_the_oncoming_one_until_the_lead_is_passed():
    lead = car(3, 510, 1, 4)
    assert [wished_lane([car(0, x, 1, 6), lead], 1, 3) for x in (400, 495, 512, 520)] == [1, 0, 0, 1]


vehicles = st.lists(
    st.tuples(st.floats(-100, 200), st.sampled_from([0, 1]), st.floats(0, 12), st.floats(-0.5, 4.5)), max_size=12)


@settings(max_examples=300, deadline=None)
@given(vehicles, st.floats(0, 12), st.floats(0, 12), st.sampled_from([(1, -1), (0, 1), (1, 0), (0, -1)]))
def test_emergency_braking_is_always_open_and_every_closure_has_a_rule(others, speed, target, lanes):
    rows = [car(0, 500, lanes[0], speed)] + [
        car(i + 1, 500 + x, lane, v if lane == 1 else -v, y) for i, (x, lane, v, y) in enumerate(others)]
    rule, vehicle = [0] * 6, [0] * 6
    opened = close_actions(rows, LANES, target, lanes[0], lanes[1], rule, vehicle)
    assert rule[MetaAction.EMERGENCY_BRAKE] == OPEN
    assert opened == sum(r == OPEN for r in rule)


@settings(max_examples=200, deadline=None)
@given(vehicles, st.floats(0, 8), st.floats(0, 8))
def test_the_compiled_mask_of_training_closes_what_the_driving_mask_closes(others, speed, target):
    import numba

    from fast_node.training import rollout

    assert isinstance(rollout._close, numba.core.registry.CPUDispatcher)
    rows = np.array([car(0, 500, 1, speed)] + [
        car(i + 1, 500 + x, lane, v if lane == 1 else -v, y) for i, (x, lane, v, y) in enumerate(others)], np.float64)
    rule, vehicle = np.zeros(6, np.int64), np.zeros(6, np.int64)
    rollout._close(rows, np.array(LANES), target, 1, -1, rule, vehicle)
    plain = [0] * 6
    close_actions(rows.tolist(), LANES, target, 1, -1, plain, [0] * 6)
    assert rule.tolist() == plain
