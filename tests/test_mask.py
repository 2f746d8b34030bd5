"""The safety mask and the coordination, on scenes made by hand and by hypothesis."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.choice import choose, narrow
from fast_node.mask import NOT_WISHED, OPEN, PRESETS, RULES, close_actions, pass_time_s, passing, survey
from schemas.messages import MetaAction
from schemas.wish import wished_lane
from sim_node import executor

LANES = [(0.0, 0.0, 3000.0, -1.0, 4.0, 8.0, -1e9, 0.0), (4.0, 0.0, 3000.0, 1.0, 4.0, 8.0, -1e9, 0.0)]
SIGHT_M = 250.0
SIM = PRESETS["sim"]


def car(number: int, x: float, lane: int, speed: float, y: float | None = None) -> list[float]:
    return [float(number), x, 4.0 * lane if y is None else y, speed, 0.0, 0.0, 5.0, 2.0, float(lane)]


def judge(rows, lanes, target_speed: float, lane: int, previous: int = -1) -> tuple[list[int], list[int]]:
    rule, vehicle = [0] * 6, [0] * 6
    near = [0] * (3 * len(lanes))
    opened = close_actions(rows, lanes, target_speed, lane, previous, SIGHT_M, near, rule, vehicle, SIM)
    assert opened == sum(r == OPEN for r in rule)
    return rule, vehicle


def closed(rows: list[list[float]], *, target_speed: float = 5.0, lane: int = 1, previous: int = -1) -> dict[int, str]:
    rule, _ = judge(rows, LANES, target_speed, lane, previous)
    return {a: RULES[r] for a, r in enumerate(rule) if r != OPEN}


def test_a_free_road_leaves_every_speed_open_and_nothing_to_pass():
    assert closed([car(0, 500, 1, 5)]) == {MetaAction.LEFT: "nothing to pass", MetaAction.RIGHT: "no lane there"}


def test_a_slow_lead_may_be_passed_when_the_oncoming_lane_is_free():
    assert MetaAction.LEFT not in closed([car(0, 500, 1, 4), car(1, 512, 1, 3.5)])


def test_oncoming_traffic_closes_the_way_past_a_slow_lead_and_is_named():
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(7, 600, 0, -6)]
    rule, vehicle = judge(rows, LANES, 4.0, 1)
    assert (RULES[rule[MetaAction.LEFT]], vehicle[MetaAction.LEFT]) == ("oncoming traffic", 7)


def test_leads_too_close_to_return_between_are_passed_together_if_there_is_time_for_both():
    two = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(2, 522, 1, 3.5)]
    assert MetaAction.LEFT not in closed(two)
    assert MetaAction.LEFT not in closed([*two[:2], car(7, 660, 0, -6)])
    assert closed([*two, car(7, 660, 0, -6)])[MetaAction.LEFT] == "oncoming traffic"


def test_a_queue_as_far_as_one_can_see_leaves_no_gap_to_return_to():
    queue = [car(i, 500 + 12 * i, 1, 3.5) for i in range(1, 21)]
    assert closed([car(0, 500, 1, 4), *queue])[MetaAction.LEFT] == "no gap to return to"


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
    assert abs(pass_time_s(20.0, 0.0, 3.0) - (3 / 0.7 + (20 - 4.5 / 0.7) / 3)) < 1e-9


def test_nothing_is_left_to_pass_once_there_is_room_to_return():
    rows, near = [car(0, 520, 0, 7), car(1, 510, 1, 4)], [0] * 6
    survey(rows, LANES, near)
    assert RULES[passing(rows, LANES, near, 1, 0, SIGHT_M, SIM)[0]] == "nothing to pass"


def test_the_wished_lane_is_the_oncoming_one_until_the_lead_is_passed():
    lead = car(3, 510, 1, 4)
    assert [wished_lane([car(0, x, 1, 6), lead], 1, 3) for x in (400, 495, 512, 520)] == [1, 0, 0, 1]


HIGHWAY = [(4.0 * k, 0.0, 9000.0, 1.0, 4.0, 28.0, -1e9, 0.0) for k in range(4)]
RAMP = [(0.0, 0.0, 750.0, 1.0, 4.0, 20.0, -1e9, 0.0), (4.0, 0.0, 750.0, 1.0, 4.0, 20.0, -1e9, 0.0),
        (8.0, 0.0, 350.0, 1.0, 4.0, 20.0, 230.0, 1.0)]


def closed_on(lanes, rows, lane: int, previous: int = -1, target_speed: float | None = None) -> dict[int, str]:
    rule, _ = judge(rows, lanes, rows[0][3] if target_speed is None else target_speed, lane, previous)
    return {a: RULES[r] for a, r in enumerate(rule) if r != OPEN}


def test_a_faster_car_behind_in_the_next_lane_closes_the_change():
    rows = [car(0, 500, 2, 22), car(4, 470, 1, 27)]
    assert closed_on(HIGHWAY, rows, 2) == {MetaAction.LEFT: "rear gap in lane"}


def test_a_car_that_moves_into_the_next_lane_from_beyond_closes_the_change():
    rows = [car(0, 500, 2, 22), [*car(4, 498, 0, 22)[:4], 1.5, *car(4, 498, 0, 22)[5:]]]
    rows[1][2] = 1.0
    assert closed_on(HIGHWAY, rows, 2)[MetaAction.LEFT] == "rear gap in lane"


def test_a_car_that_cuts_in_ahead_limits_the_speed_before_it_is_in_the_lane():
    rows = [car(0, 500, 2, 25), car(4, 536, 1, 20)]
    rows[1][4], rows[1][2] = 1.5, 5.5
    assert closed_on(HIGHWAY, rows, 2)[MetaAction.CRUISE] == "speed above the gap's"


def test_a_change_that_a_fast_car_from_behind_makes_unsafe_is_given_up():
    rows = [car(0, 500, 2, 15, y=7.2), car(4, 480, 1, 28)]
    assert closed_on(HIGHWAY, rows, 1, previous=2)[MetaAction.CRUISE] == "give up the change"


def test_nobody_leaves_the_ramp_before_it_lies_beside_the_road():
    assert closed_on(RAMP, [car(0, 200, 2, 15)], 2)[MetaAction.LEFT] == "no lane there"
    assert MetaAction.LEFT not in closed_on(RAMP, [car(0, 240, 2, 15)], 2)


def test_nobody_drives_from_the_road_onto_the_ramp():
    assert closed_on(RAMP, [car(0, 260, 1, 15)], 1)[MetaAction.RIGHT] == "no lane there"


def test_the_end_of_the_ramp_slows_the_ego_down_and_then_stops_it():
    blocked = [car(i, 300 + 12 * i, 1, 14) for i in range(-4, 5) if i]
    assert closed_on(RAMP, [car(0, 300, 2, 18), *blocked], 2)[MetaAction.CRUISE] == "lane ends"
    assert set(range(5)) <= set(closed_on(RAMP, [car(0, 335, 2, 12), *blocked], 2))


vehicles = st.lists(
    st.tuples(st.floats(-100, 200), st.sampled_from([0, 1]), st.floats(0, 12), st.floats(-0.5, 4.5)), max_size=12)


@settings(max_examples=300, deadline=None)
@given(vehicles, st.floats(0, 12), st.floats(0, 12), st.sampled_from([(1, -1), (0, 1), (1, 0), (0, -1)]))
def test_emergency_braking_is_always_open_and_every_closure_has_a_rule(others, speed, target, lanes):
    rows = [car(0, 500, lanes[0], speed)] + [
        car(i + 1, 500 + x, lane, v if lane == 1 else -v, y) for i, (x, lane, v, y) in enumerate(others)]
    rule, _ = judge(rows, LANES, target, *lanes)
    assert rule[MetaAction.EMERGENCY_BRAKE] == OPEN


wishes = st.tuples(st.sampled_from([-1, 0, 1]), st.floats(0, 8), st.floats(0.5, 4))


@settings(max_examples=500, deadline=None)
@given(vehicles, st.floats(0, 12), st.floats(0, 12), st.sampled_from([(1, -1), (0, 1), (1, 0), (0, -1)]), wishes,
       st.lists(st.floats(-5, 5), min_size=5, max_size=5), st.booleans())
def test_whatever_the_state_the_wish_and_the_policy_what_is_done_is_in_the_safe_set(
        others, speed, target, lanes, wish, logits, holding):
    rows = [car(0, 500, lanes[0], speed)] + [
        car(i + 1, 500 + x, lane, v if lane == 1 else -v, y) for i, (x, lane, v, y) in enumerate(others)]
    rule, _ = judge(rows, LANES, target, *lanes)
    wished, near = rule.copy(), [0] * 6
    survey(rows, LANES, near)
    narrow(wished, rows, near, LANES, target, *lanes, *wish)
    meta, _ = choose(logits, wished, holding)
    assert rule[meta] == OPEN
    assert meta != MetaAction.EMERGENCY_BRAKE or all(r != OPEN for r in rule[:5])  # a wish alone never brakes


def narrowed(rows, target_speed: float, wish_lane: int, wish_mps: float = 28.0, headway_s: float = 1.0,
             lane: int = 1, previous: int = -1) -> set[int]:
    rule, near = [OPEN] * 6, [0] * 12
    survey(rows, HIGHWAY, near)
    narrow(rule, rows, near, HIGHWAY, target_speed, lane, previous, wish_lane, wish_mps, headway_s)
    return {a for a in range(5) if rule[a] == NOT_WISHED}


def test_an_open_change_to_the_wished_lane_is_all_that_is_left():
    assert narrowed([car(0, 500, 1, 20)], 20.0, 3) == set(range(5)) - {MetaAction.RIGHT}


def test_nobody_leaves_the_wished_lane_or_drives_faster_than_wished():
    assert narrowed([car(0, 500, 1, 20)], 20.0, 1, 20.0) == {
        MetaAction.SPEED_UP, MetaAction.LEFT, MetaAction.RIGHT}
    assert MetaAction.CRUISE in narrowed([car(0, 500, 1, 20)], 20.0, 1, 15.0)


def test_the_wished_headway_limits_the_speed_behind_a_leader():
    rows = [car(0, 500, 1, 20), car(1, 535, 1, 20)]  # 30 m, 1.5 s
    assert MetaAction.CRUISE not in narrowed(rows, 20.0, 1, 28.0, 1.0)
    assert MetaAction.CRUISE in narrowed(rows, 20.0, 1, 28.0, 2.5)


def test_a_change_that_can_go_on_is_not_given_up():
    assert MetaAction.RIGHT in narrowed([car(0, 500, 1, 20)], 20.0, -1, lane=1, previous=2)


def test_a_car_that_stands_askew_is_as_wide_as_it_is():
    rows = [car(0, 500, 1, 10), car(1, 515, 2, 0, y=7.0)]
    assert MetaAction.CRUISE not in closed_on(RAMP, rows, 1)
    rows[1][5] = 0.9
    assert MetaAction.CRUISE in closed_on(RAMP, rows, 1)


@settings(max_examples=200, deadline=None)
@given(vehicles, st.floats(0, 8), st.floats(0, 8))
def test_the_compiled_mask_of_training_closes_what_the_driving_mask_closes(others, speed, target):
    import numba

    from fast_node.training import rollout

    assert isinstance(rollout._close, numba.core.registry.CPUDispatcher)
    rows = np.array([car(0, 500, 1, speed)] + [
        car(i + 1, 500 + x, lane, v if lane == 1 else -v, y) for i, (x, lane, v, y) in enumerate(others)], np.float64)
    rule, vehicle = np.zeros(6, np.int64), np.zeros(6, np.int64)
    rollout._close(rows, np.array(LANES), target, 1, -1, SIGHT_M, np.zeros(6, np.int64), rule, vehicle, SIM)
    assert (rule.tolist(), vehicle.tolist()) == judge(rows.tolist(), LANES, target, 1)


@settings(max_examples=300, deadline=None)
@given(st.floats(0, 28), st.floats(0, 28), st.floats(1, 120), st.floats(-3, 3), st.sampled_from([0, 1, 2]))
def test_after_any_open_action_the_mask_can_still_avoid_a_lead_that_brakes_fully(v, lead_v, gap, accel, first):
    x, lead_x, target = 500.0, 505.0 + gap, v + 1.0
    for tick in range(30):
        rows = [car(0, x, 1, v), car(1, lead_x, 1, lead_v)]
        rule, _ = judge(rows, HIGHWAY, target, 1)
        if tick == 0 and rule[first] != OPEN:
            return
        meta = first if tick == 0 else next(
            (a for a in (MetaAction.SPEED_UP, MetaAction.CRUISE, MetaAction.SLOW_DOWN) if rule[a] == OPEN),
            MetaAction.EMERGENCY_BRAKE)
        target, _, _ = executor.edit_set_points(int(meta), target, 1, -1, [], x, math.nan, 0.0, 28.0)
        accel = executor.acceleration_command(v, target, accel, int(meta), 1 / 15)
        v += accel / 15
        x += v / 15
        lead_v = max(lead_v - 6.0 / 15, 0.0)
        lead_x += lead_v / 15
        assert lead_x - x > 5.0


@settings(max_examples=200, deadline=None)
@given(st.floats(1, 28), st.floats(1, 28), st.floats(-120, -1))
def test_after_an_open_change_a_follower_that_reacts_late_and_brakes_fully_does_not_reach_the_ego(v, other_v, behind):
    follower = 500.0 - 5.0 + behind
    rule, _ = judge([car(0, 500, 2, v), car(1, follower, 1, other_v)], HIGHWAY, v, 2)
    if rule[MetaAction.LEFT] != OPEN:
        return
    x = 500.0
    for tick in range(60):  # the ego brakes with 5, as the rule assumes; the other after its reaction time with 6
        v = max(v - 5.0 / 15, 0.0)
        x += v / 15
        if tick >= 12:
            other_v = max(other_v - 6.0 / 15, 0.0)
        follower += other_v / 15
        assert x - follower > 5.0
