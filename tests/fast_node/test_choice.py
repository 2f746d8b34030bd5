"""What the intent rules out, scene by scene, and what is chosen of the rest."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pytest

from fast_node.choice import DECIDED, HELD, MASKED, SOURCES, WISHED, choose, narrow
from fast_node.mask.vocabulary import BRAKE, CRUISE, LEAD, LEFT, NOT_WISHED, OPEN, RIGHT, SLOW_DOWN, SPEED_UP

ALL = (SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT)
SPEEDS = {SLOW_DOWN, CRUISE, SPEED_UP}
ANY, ALONE, FAST = -1, (), 28.0


def lane(number: int, end: float = 9000.0, way: float = 1.0, ramp: float = 0.0) -> tuple[float, ...]:
    return (4.0 * number, 0.0, end, way, 4.0, FAST, -1e9, ramp)


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
    left: int = -1,
    wish: tuple[int, float, float] = (ANY, FAST, 1.0),
    lanes: list[tuple[float, ...]] = HIGHWAY,
) -> set[int]:
    """What the intent closes of the actions `opened`. cars: the first is the lead; aim, left: the lanes of a change;
    speed: the set-point; wish: lane, speed, headway. The ego is 5 m long and stands, so that nothing is eased."""
    rule = [OPEN if a in opened else LEAD for a in ALL] + [OPEN]
    before, near = list(rule), [-1] * (3 * len(lanes))
    if cars:
        near[3 * aim] = 1
    narrow(rule, [car(500.0, ego_speed, aim, 5.0), *cars], near, lanes, speed, aim, left, *wish)
    changed = {a for a in range(6) if rule[a] != before[a]}
    assert all(before[a] == OPEN and rule[a] == NOT_WISHED for a in changed)
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
    assert ruled_out(left=left, wish=(3, FAST, 1.0), opened=set(ALL) - {LEFT + RIGHT - back}) == {back}


# A change under way.


@pytest.mark.parametrize(("left", "back"), [(0, LEFT), (2, RIGHT)])
def test_a_change_that_can_go_on_is_not_given_up(left, back):
    assert ruled_out(left=left) == {back}


@pytest.mark.parametrize(("left", "back"), [(0, LEFT), (2, RIGHT)])
def test_a_change_that_cannot_go_on_at_this_speed_may_be_given_up(left, back):
    assert ruled_out(left=left, opened=set(ALL) - {CRUISE}) == set()


def test_a_pass_may_be_given_up():
    assert ruled_out(lanes=[lane(0, way=-1.0), lane(1)], aim=0, left=1, opened={*SPEEDS, RIGHT}) == set()


def test_a_way_back_that_is_closed_keeps_its_reason():
    assert ruled_out(left=0, opened=SPEEDS) == set()


# Where the ego may not even slow down, nothing milder than braking is taken away.


def test_who_may_not_slow_down_may_do_all_that_is_safe():
    assert ruled_out(opened={CRUISE, SPEED_UP, LEFT, RIGHT}, left=0, speed=20.0, wish=(1, 5.0, 1.0)) == set()


# In the wished lane.


def test_nobody_leaves_the_wished_lane():
    assert ruled_out(wish=(1, FAST, 1.0)) == {LEFT, RIGHT}


def test_nobody_leaves_the_leftmost_lane_where_it_is_wished():
    assert ruled_out(aim=0, opened={*SPEEDS, RIGHT}, wish=(0, FAST, 1.0)) == {RIGHT}


def test_a_wished_lane_that_ends_may_be_left():
    assert ruled_out(lanes=THIRD_ENDS, aim=2, wish=(2, FAST, 1.0)) == set()


def test_a_borrowed_lane_may_be_left_whatever_lane_is_wished():
    assert ruled_out(lanes=TWO_WAY, aim=0, opened={*SPEEDS, RIGHT}, wish=(0, FAST, 1.0)) == set()


# Speeds.


def greatest(*cars: list[float], **given: object) -> float:
    """The greatest set-point [m/s], to a hundredth, that may be kept."""
    kept = [c for c in range(0, 3001) if CRUISE not in ruled_out(*cars, speed=c / 100 + 0.005, **given)]  # type: ignore[arg-type]
    assert kept == list(range(len(kept)))
    return kept[-1] / 100


def test_the_wished_speed_may_be_kept_and_no_greater_one():
    assert greatest(wish=(ANY, 12.0, 1.0)) == 12.0
    assert ruled_out(speed=12.0 + 0.01, wish=(ANY, 12.0, 1.0)) == {SPEED_UP}


def test_a_hundredth_above_the_wished_speed_may_be_kept():
    assert ruled_out(speed=12.0 + 0.01, wish=(ANY, 12.0, 1.0)) == {SPEED_UP}


def lead(gap: float, speed: float = 10.0, in_lane: int = 1) -> list[float]:
    """A car of 7 m so far ahead of the ego's 5 m, bumper to bumper."""
    return car(500.0 + gap + 6.0, speed, in_lane)


@pytest.mark.parametrize(
    ("gap", "headway", "speed"),
    [
        (30.0, 1.0, 13.5),  # a fifth of 30 - 2.5 - 10 m faster than the lead
        (30.0, 0.5, 14.5),
        (30.0, 2.0, 11.5),
        (12.5, 1.0, 10.0),  # just the headway: as fast as the lead
        (11.5, 1.0, 9.8),
        (10.0, 1.0, 9.5),  # half a metre per second slower, and no more
        (3.0, 1.0, 9.5),
        (1.0, 0.0, 9.7),  # nearer than at a standstill
    ],
)
def test_behind_a_lead_the_speed_brings_the_wished_headway_about(gap, headway, speed):
    assert greatest(lead(gap), wish=(ANY, FAST, headway)) == pytest.approx(speed)


def test_behind_a_lead_the_wished_speed_is_the_most():
    assert greatest(lead(30.0), wish=(ANY, 12.0, 1.0)) == 12.0


def test_towards_a_car_that_rolls_back_there_are_five_seconds_to_a_collision():
    assert greatest(lead(12.5, speed=-0.09), wish=(ANY, FAST, 6.0)) == pytest.approx(1.91)
    assert greatest(lead(22.5, speed=-0.09), wish=(ANY, FAST, 6.0)) == pytest.approx(3.91)


def test_a_car_that_rolls_back_near_the_ego_is_not_approached():
    assert ruled_out(lead(2.4, speed=-0.09), speed=0.0, wish=(ANY, FAST, 6.0)) == {CRUISE, SPEED_UP}


def test_a_car_that_only_comes_into_the_lane_needs_no_headway():
    assert greatest(lead(10.0, in_lane=2)) == 28.0


def test_on_a_ramp_no_headway_is_needed():
    assert greatest(lead(10.0), lanes=[lane(0), lane(1, ramp=1.0)]) == 28.0


def test_in_the_leftmost_lane_the_lead_is_the_one_there():
    assert greatest(lead(30.0, in_lane=0), aim=0) == 13.5


@pytest.mark.parametrize(("ego_speed", "eased"), [(16.5, set()), (16.4, {CRUISE}), (10.0, {CRUISE})])
def test_the_set_point_is_lowered_to_just_below_the_speed_and_no_further(ego_speed, eased):
    assert ruled_out(speed=15.0, ego_speed=ego_speed, wish=(ANY, 10.0, 1.0)) - {SPEED_UP} == eased


@pytest.mark.parametrize(("speed", "closed"), [(9.0, set()), (9.99, set()), (10.0, {SPEED_UP}), (10.005, {SPEED_UP})])
def test_the_speed_rises_to_the_wished_one(speed, closed):
    assert ruled_out(speed=speed, wish=(ANY, 10.0, 1.0)) == closed


@pytest.mark.parametrize(("speed", "closed"), [(12.5, set()), (12.6, {SPEED_UP})])
def test_behind_a_lead_the_speed_rises_by_whole_steps_as_far_as_the_headway_admits(speed, closed):
    assert ruled_out(lead(30.0), speed=speed) == closed


def test_a_step_that_ends_at_the_wished_speed_is_as_long_as_that():
    assert ruled_out(lead(30.0), speed=13.0, wish=(ANY, 13.4, 1.0)) == set()


def test_speeds_that_are_closed_already_keep_their_reason():
    assert ruled_out(speed=20.0, opened={SLOW_DOWN}, wish=(ANY, 10.0, 1.0)) == set()


# The choice.


def chosen(logits: tuple[float, ...], holding: bool = False, **rules: int) -> tuple[int, int]:
    """With the actions named closed by these rules."""
    names = ("slow_down", "cruise", "speed_up", "left", "right", "brake")
    return choose(logits, [rules.get(name, OPEN) for name in names], holding)


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
    assert chosen((0.0,) * 5, holding=True, **SHUT) == (BRAKE, MASKED)


@pytest.mark.parametrize("liked", [SLOW_DOWN, CRUISE, SPEED_UP])
def test_between_two_decisions_the_speed_holds(liked):
    assert chosen(tuple(float(a == liked) for a in ALL), holding=True) == (CRUISE, HELD)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_an_open_change_that_the_policy_wants_waits_for_no_decision(side):
    assert chosen(tuple(float(a == side) for a in ALL), holding=True) == (side, DECIDED)


def test_a_closed_change_that_the_policy_wants_holds_the_speed():
    assert chosen((0.0, 0.0, 1.0, 2.0, 0.0), holding=True, left=LEAD) == (CRUISE, HELD)


def test_between_two_decisions_a_closed_speed_is_decided_anew():
    assert chosen((0.0, 3.0, 1.0, 0.0, 0.0), holding=True, cruise=LEAD) == (SPEED_UP, MASKED)


def test_each_verdict_has_the_word_for_it_that_is_sent():
    assert [SOURCES[by] for by in (HELD, DECIDED, MASKED, WISHED)] == ["policy", "policy", "masked", "coordination"]
