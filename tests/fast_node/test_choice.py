"""What the intent rules out, scene by scene, and what is chosen of the rest."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import pytest

from fast_node.choice import (
    DECIDED,
    HELD,
    HOLD_OFF_TICKS,
    MASKED,
    SOURCES,
    WISHED,
    choose,
    hold_off,
    narrow,
    worth_entering,
)
from fast_node.mask.vocabulary import BRAKE, CRUISE, LEAD, LEFT, NOT_WISHED, OPEN, RIGHT, SLOW_DOWN, SPEED_UP
from schemas.driving.episode import held

ALL = (SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT)
SPEEDS = {SLOW_DOWN, CRUISE, SPEED_UP}
ANY, ALONE, FAST = -1, (), 28.0


def lane(
    number: int, end: float = 9000.0, way: float = 1.0, ramp: float = 0.0, opens: float = -1e9
) -> tuple[float, ...]:
    return (4.0 * number, 0.0, end, way, 4.0, FAST, opens, ramp)


HIGHWAY = [lane(k) for k in range(4)]
TWO_WAY = [lane(0, way=-1.0), lane(1)]
THIRD_ENDS = [lane(0), lane(1), lane(2, end=600.0), lane(3)]


def car(x: float, speed: float, in_lane: int, length: float = 7.0) -> list[float]:
    return [1.0, x, 4.0 * in_lane, speed, 0.0, 0.0, length, 2.0, float(in_lane)]


def ruled_out(
    *cars: list[float],
    opened: Collection[int] = ALL,
    speed: float = 10.0,
    ego_speed: float = 0.0,
    aim: int = 1,
    leaves: int = -1,
    left: int = -1,
    cap: float = math.inf,
    wish: tuple[int, float, float] = (ANY, FAST, 1.0),
    lanes: list[tuple[float, ...]] = HIGHWAY,
) -> set[int]:
    """What the intent closes of the actions `opened`. cars: the first is the lead; aim, leaves: the lanes of a change;
    left: not to be entered again yet; speed: the set-point; wish: lane, speed, headway. The ego is 5 m long."""
    reasons = [OPEN if a in opened else LEAD for a in ALL] + [OPEN]
    before, near = list(reasons), [-1] * (3 * len(lanes))
    if cars:
        near[3 * aim] = 1
    narrow(reasons, [car(500.0, ego_speed, aim, 5.0), *cars], near, lanes, speed, aim, leaves, left, *wish, cap)
    changed = {a for a in range(6) if reasons[a] != before[a]}
    assert all(before[a] == OPEN and reasons[a] == NOT_WISHED for a in changed)
    return changed


# An oncoming lane.


@pytest.mark.parametrize("other", [SLOW_DOWN, CRUISE, SPEED_UP, RIGHT])
def test_an_oncoming_lane_that_nobody_wishes_to_borrow_is_closed_where_anything_else_is_open(other):
    assert ruled_out(opened={LEFT, other}, lanes=TWO_WAY) == {LEFT}


def test_an_oncoming_lane_stays_open_where_only_braking_is_left():
    assert ruled_out(opened={LEFT}, lanes=TWO_WAY) == set()


def test_an_oncoming_lane_that_the_wish_borrows_is_all_that_is_left():
    assert ruled_out(lanes=TWO_WAY, wish=(0, FAST, 1.0)) == {*SPEEDS, RIGHT}


def test_a_lane_of_our_direction_stays_open_where_no_lane_is_wished():
    assert ruled_out() == set()


def test_a_lane_that_is_closed_already_keeps_its_reason():
    assert ruled_out(opened={CRUISE}, lanes=TWO_WAY) == set()


# A change towards the wished lane.


@pytest.mark.parametrize(("wished", "side"), [(0, LEFT), (2, RIGHT), (3, RIGHT)])
def test_an_open_change_towards_the_wished_lane_is_all_that_is_left(wished, side):
    assert ruled_out(wish=(wished, FAST, 1.0)) == set(ALL) - {side}


def test_an_open_change_of_two_lanes_to_the_left_is_all_that_is_left():
    assert ruled_out(aim=2, wish=(0, FAST, 1.0)) == set(ALL) - {LEFT}


@pytest.mark.parametrize(("wished", "side", "other"), [(0, LEFT, RIGHT), (2, RIGHT, LEFT)])
def test_while_the_change_is_closed_only_the_other_side_is(wished, side, other):
    assert ruled_out(opened=set(ALL) - {side}, wish=(wished, FAST, 1.0)) == {other}


def test_a_change_towards_the_wished_lane_waits_where_the_next_lane_ends():
    assert ruled_out(lanes=THIRD_ENDS, wish=(3, FAST, 1.0)) == {LEFT}


def test_a_change_out_of_a_lane_that_ends_waits_for_nothing():
    assert ruled_out(lanes=THIRD_ENDS, aim=2, wish=(1, FAST, 1.0)) == set(ALL) - {LEFT}


def test_a_change_to_the_left_out_of_the_last_lane_looks_at_the_lane_to_its_left():
    ends = [lane(0), lane(1), lane(2, end=600.0), lane(3)]
    assert ruled_out(lanes=ends, aim=3, wish=(0, FAST, 1.0)) == {RIGHT}


@pytest.mark.parametrize("left", [0, 2])
def test_while_a_change_is_under_way_no_other_is_begun(left):
    back = LEFT if left == 0 else RIGHT
    assert ruled_out(leaves=left, wish=(3, FAST, 1.0), opened=set(ALL) - {LEFT + RIGHT - back}) == {back}


# A change under way.


@pytest.mark.parametrize(("left", "back"), [(0, LEFT), (2, RIGHT)])
def test_a_change_that_can_go_on_is_not_given_up(left, back):
    assert ruled_out(leaves=left) == {back}


@pytest.mark.parametrize(("left", "back"), [(0, LEFT), (2, RIGHT)])
@pytest.mark.parametrize("other", SPEEDS)
def test_a_change_is_given_up_where_the_mask_leaves_nothing_else_alone(left, back, other):
    assert ruled_out(leaves=left, opened={back}) == set()
    assert ruled_out(leaves=left, opened={back, other}) == {back}


def test_a_pass_may_be_given_up():
    assert ruled_out(lanes=[lane(0, way=-1.0), lane(1)], aim=0, leaves=1, opened={*SPEEDS, RIGHT}) == set()


def test_a_way_back_that_is_closed_keeps_its_reason():
    assert ruled_out(leaves=0, opened=SPEEDS) == set()


# In the wished lane.


def test_nobody_leaves_the_wished_lane():
    assert ruled_out(wish=(1, FAST, 1.0)) == {LEFT, RIGHT}


def test_nobody_leaves_the_leftmost_lane_where_it_is_wished():
    assert ruled_out(aim=0, opened={*SPEEDS, RIGHT}, wish=(0, FAST, 1.0)) == {RIGHT}


def test_a_wished_lane_that_ends_may_be_left():
    assert ruled_out(lanes=THIRD_ENDS, aim=2, wish=(2, FAST, 1.0)) == set()


def test_a_borrowed_lane_may_be_left_whatever_lane_is_wished():
    assert ruled_out(lanes=TWO_WAY, aim=0, opened={*SPEEDS, RIGHT}, wish=(0, FAST, 1.0)) == set()


# A lane that was left.


@pytest.mark.parametrize(("left", "side"), [(0, LEFT), (2, RIGHT)])
def test_a_lane_that_was_left_is_not_entered_again_yet(left, side):
    assert ruled_out(left=left) == {side}
    assert ruled_out(left=left, opened={side}) == set()


def test_a_wish_does_not_enter_a_lane_again_that_was_left_either():
    assert ruled_out(left=0, wish=(0, FAST, 1.0)) == {LEFT, RIGHT}


def test_a_lane_that_was_left_is_entered_again_out_of_one_that_ends_or_is_borrowed():
    assert ruled_out(left=1, lanes=THIRD_ENDS, aim=2) == set()
    assert ruled_out(left=1, lanes=TWO_WAY, aim=0, opened={*SPEEDS, RIGHT}) == set()


def test_the_lane_that_a_change_leaves_is_held_off_for_three_seconds_after_it():
    left = (-1, 0)
    for _ in range(30):
        left = hold_off(*left, target_lane=2, previous_lane=1)
    assert left == (1, HOLD_OFF_TICKS) == (1, 45)
    for _ in range(44):
        left = hold_off(*left, target_lane=2, previous_lane=-1)
    assert left == (1, 1)
    assert hold_off(*left, target_lane=2, previous_lane=-1)[1] == 0


def test_the_leftmost_lane_is_held_off_as_any_other():
    assert hold_off(-1, 0, target_lane=1, previous_lane=0) == (0, HOLD_OFF_TICKS)


def test_the_lane_of_a_change_that_was_given_up_is_held_off():
    left = hold_off(-1, 0, target_lane=2, previous_lane=1)
    assert hold_off(*left, target_lane=1, previous_lane=2) == (2, HOLD_OFF_TICKS)


# A lane worth entering.


def lead(gap: float, speed: float = 10.0, in_lane: int = 1) -> list[float]:
    """A car of 7 m so far ahead of the ego's 5 m, bumper to bumper."""
    return car(500.0 + gap + 6.0, speed, in_lane)


def worth(
    ahead: list[float] | None, aim: int, own: int, headway: float = 1.5, speed: float = 20.0, **road: Any
) -> bool:
    lanes = road.get("lanes", HIGHWAY)
    near = [-1] * (3 * len(lanes))
    if ahead:
        near[3 * aim] = 1
    rows = [car(500.0, speed, own, 5.0), *([ahead] if ahead else [])]
    return worth_entering(rows, near, lanes, own, aim, headway)


@pytest.mark.parametrize(
    ("gap", "headway", "entered"),
    [(22.1, 1.5, True), (21.9, 1.5, False), (12.1, 0.5, True), (11.9, 0.5, False), (-3.0, 0.5, False)],
)
def test_a_lane_is_entered_with_a_second_s_headway_after_a_second_or_the_wished_one(gap, headway, entered):
    # 2 m/s faster than the next car there: 2 m are lost until then.
    assert worth(lead(gap, 18.0, 2), 2, 1, headway) == entered


@pytest.mark.parametrize(("speed", "entered"), [(4.9, True), (5.1, False)])
def test_a_lane_that_ends_soon_is_not_worth_entering(speed, entered):
    # 100 m are left: ten seconds, and 50 m.
    assert worth(None, 2, 1, speed=speed, lanes=THIRD_ENDS) == entered


def test_a_ramp_is_not_worth_entering():
    assert not worth(None, 0, 1, lanes=[lane(0, end=2000.0, ramp=1.0), lane(1)])


@pytest.mark.parametrize(("speed", "entered"), [(19.9, False), (20.1, True)])
def test_out_of_a_lane_that_ends_within_five_seconds_any_gap_is_worth_entering(speed, entered):
    assert worth(lead(5.0, speed), 1, 2, speed=speed, lanes=THIRD_ENDS) == entered


def test_what_is_not_worth_entering_is_closed_where_anything_else_is_open():
    near_ahead = [lead(5.0, 20.0, 1)]
    assert ruled_out(*near_ahead, ego_speed=20.0) == set()  # that one is in the own lane
    reasons, near = [OPEN] * 6, [-1, -1, -1, -1, -1, -1, 1, -1, -1, -1, -1, -1]
    narrow(
        reasons, [car(500.0, 20.0, 1, 5.0), lead(5.0, 20.0, 2)], near, HIGHWAY, 20.0, 1, -1, -1, ANY, FAST, 1.0, FAST
    )
    assert {a for a in ALL if reasons[a] != OPEN} == {RIGHT}
    reasons = [LEAD, LEAD, LEAD, LEAD, OPEN, OPEN]
    narrow(
        reasons, [car(500.0, 20.0, 1, 5.0), lead(5.0, 20.0, 2)], near, HIGHWAY, 20.0, 1, -1, -1, ANY, FAST, 1.0, FAST
    )
    assert reasons[RIGHT] == OPEN


# Speeds.


@pytest.mark.parametrize(("speed", "closed"), [(9.0, set()), (9.99, set()), (10.0, {SPEED_UP}), (15.0, {SPEED_UP})])
def test_the_set_point_rises_to_the_wished_speed(speed, closed):
    assert ruled_out(speed=speed, wish=(ANY, 10.0, 1.0)) == closed


@pytest.mark.parametrize(("speed", "closed"), [(11.89, set()), (11.91, {SPEED_UP}), (20.0, {SPEED_UP})])
def test_the_set_point_rises_to_the_cap(speed, closed):
    assert ruled_out(speed=speed, cap=12.0) == closed


def test_rising_stays_open_where_nothing_else_is():
    assert ruled_out(speed=20.0, opened={SPEED_UP}, wish=(ANY, 10.0, 1.0), cap=12.0) == set()


# The choice.


def chosen(logits: tuple[float, ...], goes_on: int | None = None, **rules: int) -> tuple[int, int]:
    """With the actions named closed by these rules; goes_on: what the last decision asks for meanwhile, if none is
    due."""
    names = ("slow_down", "cruise", "speed_up", "left", "right", "brake")
    reasons = [rules.get(name, OPEN) for name in names]
    return choose(logits, reasons, goes_on is None, CRUISE if goes_on is None else goes_on)


@pytest.mark.parametrize("action", ALL)
def test_what_the_policy_likes_best_is_done(action):
    assert chosen(tuple(float(a == action) for a in ALL)) == (action, DECIDED)


def test_of_what_it_likes_the_same_the_first_is_done():
    assert chosen((1.0, 1.0, 0.0, 0.0, 1.0)) == (SLOW_DOWN, DECIDED)
    assert chosen((0.0, 1.0, 1.0, 0.0, 1.0)) == (CRUISE, DECIDED)
    assert chosen((0.0, 1.0, 1.0, 0.0, 1.0), cruise=LEAD) == (SPEED_UP, MASKED)
    assert chosen((1.0, 1.0, 0.0, 0.0, 0.0)) == (SLOW_DOWN, DECIDED)


def test_what_is_closed_is_not_done_but_the_next_best():
    assert chosen((-3.0, -2.0, -1.0, -4.0, -5.0), speed_up=LEAD) == (CRUISE, MASKED)
    assert chosen((-3.0, -2.0, -1.0, -4.0, -5.0), speed_up=LEAD, cruise=LEAD) == (SLOW_DOWN, MASKED)


def test_the_first_action_is_not_done_where_it_is_closed():
    assert chosen((3.0, 1.0, 2.0, 0.0, 0.0), slow_down=LEAD) == (SPEED_UP, MASKED)


def test_it_is_told_where_only_the_wish_was_against_it():
    assert chosen((3.0, 1.0, 2.0, 0.0, 0.0), slow_down=NOT_WISHED) == (SPEED_UP, WISHED)
    assert chosen((3.0, 1.0, 2.0, 0.0, 0.0), slow_down=LEAD, speed_up=NOT_WISHED) == (CRUISE, MASKED)


SHUT: dict[str, Any] = {"slow_down": LEAD, "cruise": LEAD, "speed_up": LEAD, "left": LEAD, "right": LEAD}


def test_where_all_is_closed_it_brakes():
    assert chosen((0.0,) * 5, **SHUT) == (BRAKE, MASKED)
    assert chosen((0.0,) * 5, SPEED_UP, **SHUT) == (BRAKE, MASKED)


@pytest.mark.parametrize("goes_on", [SLOW_DOWN, CRUISE, SPEED_UP])
@pytest.mark.parametrize("liked", ALL)
def test_between_two_decisions_the_last_one_goes_on(goes_on, liked):
    assert chosen(tuple(float(a == liked) for a in ALL), goes_on) == (goes_on, HELD)


@pytest.mark.parametrize(
    ("decided", "goes_on"),
    [(SLOW_DOWN, SLOW_DOWN), (CRUISE, CRUISE), (SPEED_UP, SPEED_UP), (LEFT, CRUISE), (RIGHT, CRUISE), (BRAKE, CRUISE)],
)
def test_a_speed_goes_on_to_change_and_a_lane_change_begins_once(decided, goes_on):
    assert held(decided) == goes_on


@pytest.mark.parametrize("goes_on", [SLOW_DOWN, SPEED_UP])
def test_between_two_decisions_a_step_that_is_closed_is_not_taken(goes_on):
    name = "slow_down" if goes_on == SLOW_DOWN else "speed_up"
    assert chosen((1.0, 0.0, 2.0, 3.0, 0.0), goes_on, **{name: LEAD}) == (CRUISE, HELD)


LIKES_RIGHT = (0.0, 0.0, 0.0, 0.0, 9.0)


def test_between_two_decisions_what_is_nearest_to_a_closed_speed_is_done():
    assert chosen(LIKES_RIGHT, SPEED_UP, speed_up=LEAD, cruise=LEAD) == (SLOW_DOWN, MASKED)
    assert chosen(LIKES_RIGHT, CRUISE, cruise=LEAD, slow_down=LEAD) == (SPEED_UP, MASKED)
    assert chosen(LIKES_RIGHT, CRUISE, cruise=LEAD, slow_down=LEAD, speed_up=LEAD) == (RIGHT, MASKED)
    assert chosen((0.0,) * 5, CRUISE, **{**SHUT, "left": OPEN}) == (LEFT, MASKED)


def test_between_two_decisions_it_is_told_where_only_the_wish_was_against_the_speed():
    assert chosen(LIKES_RIGHT, CRUISE, cruise=NOT_WISHED) == (SLOW_DOWN, WISHED)


def test_each_verdict_has_the_word_for_it_that_is_sent():
    assert [SOURCES[by] for by in (HELD, DECIDED, MASKED, WISHED)] == ["policy", "policy", "masked", "coordination"]
