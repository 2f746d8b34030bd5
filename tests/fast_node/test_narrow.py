"""What the intent closes of what is safe."""

from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.choice import choose, narrow
from fast_node.mask import NOT_WISHED, OPEN, PRESETS
from fast_node.mask.neighbours import survey
from schemas.wire.messages import MetaAction
from tests.mask_scenes import HIGHWAY, LANES, car, judge, presets, scenes

wishes = st.tuples(
    st.sampled_from([-1, 0, 1]), st.floats(0, 8), st.floats(0.5, 4), st.floats(0, 30) | st.just(math.inf)
)


@settings(max_examples=300, deadline=None)
@given(
    scenes(),
    presets,
    wishes,
    st.sampled_from([-1, 0, 1, 2]),
    st.lists(st.floats(-5, 5), min_size=5, max_size=5),
    st.booleans(),
    st.sampled_from([0, 1, 2]),
)
def test_a_wish_narrows_what_is_safe_and_never_down_to_braking(scene, preset, wish, left, logits, due, goes_on):
    reasons, _ = judge(scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset])
    wished, near = reasons.copy(), [0] * (3 * len(scene.lanes))
    survey(scene.rows, scene.lanes, near)
    narrow(wished, scene.rows, near, scene.lanes, scene.target_speed, scene.lane, scene.previous, left, *wish)
    meta, _ = choose(logits, wished, due, goes_on)
    assert wished[meta] == reasons[meta] == OPEN
    assert all(after in (before, NOT_WISHED) for before, after in zip(reasons, wished, strict=True))
    assert meta != MetaAction.EMERGENCY_BRAKE or all(r != OPEN for r in reasons[:5])


def narrowed(
    rows,
    target_speed: float,
    wish_lane: int,
    wish_mps: float = 28.0,
    headway_s: float = 1.0,
    lane: int = 1,
    previous: int = -1,
    cap: float = math.inf,
) -> set[int]:
    reasons, near = [OPEN] * 6, [0] * 12
    survey(rows, HIGHWAY, near)
    narrow(reasons, rows, near, HIGHWAY, target_speed, lane, previous, -1, wish_lane, wish_mps, headway_s, cap)
    return {a for a in range(5) if reasons[a] == NOT_WISHED}


def test_giving_up_the_way_home_is_not_narrowed_down_to_braking():
    beside = [car(0, 500, 0, 0, y_m=0.0), car(11, 499, 1, 0, y_m=3.0)]
    reasons, _ = judge(beside, LANES, 0.0, 1, 0, PRESETS["cautious"])
    near = [0] * 6
    survey(beside, LANES, near)
    narrow(reasons, beside, near, LANES, 0.0, 1, 0, -1, -1, 0.0, 1.0, 0.0)
    assert [a for a in range(5) if reasons[a] == OPEN] == [MetaAction.LEFT]


def test_an_open_change_to_the_wished_lane_is_all_that_is_left():
    assert narrowed([car(0, 500, 1, 20)], 20.0, 3) == set(range(5)) - {MetaAction.RIGHT}


def test_nobody_leaves_the_wished_lane_or_drives_faster_than_wished():
    assert narrowed([car(0, 500, 1, 20)], 20.0, 1, 20.0) == {MetaAction.SPEED_UP, MetaAction.LEFT, MetaAction.RIGHT}
    assert MetaAction.SPEED_UP in narrowed([car(0, 500, 1, 20)], 20.0, -1, 28.0, cap=20.0)


def test_a_gap_that_is_safe_but_less_than_a_second_is_not_entered():
    near_ahead = [car(0, 500, 1, 20), car(1, 520, 2, 20)]
    assert narrowed(near_ahead, 20.0, -1) == {MetaAction.RIGHT}
    assert MetaAction.RIGHT in narrowed(near_ahead, 20.0, 2)  # not even where it is wished


def test_a_change_that_can_go_on_is_not_given_up():
    assert MetaAction.RIGHT in narrowed([car(0, 500, 1, 20)], 20.0, -1, lane=1, previous=2)
