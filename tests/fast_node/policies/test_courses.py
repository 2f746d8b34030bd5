"""The choice of lane and speed: which scenes it is for, what it foresees, and that scenes are judged one by one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fast_node.policies.courses import (
    COUNT,
    COURSES,
    PLAN,
    PRESENT,
    SIDE,
    SPEEDS,
    TOTAL_S,
    WISHED,
    CoursePolicy,
    courses,
    to_choose,
)
from fast_node.policies.load import load_policy
from fast_node.policies.rule import RulePolicy
from schemas.driving.features import Array, features
from schemas.driving.intent import ANY_LANE
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction
from tests.scenes import car

V, FASTEST = 25.0, 30.0


def scene(
    *others: list[float],
    aim: int = ANY_LANE,
    left: bool = True,
    right: bool = True,
    changing: bool = False,
    ends: float = math.inf,
    borrows: bool = False,
) -> Array:
    """(1, N, F): the ego in lane 1 at 25 m/s wishes for 30 m/s, and for lane `aim`."""
    rows = [car(0, 0.0, 1, V), *others]
    y = math.nan if aim == ANY_LANE else 4.0 * aim
    return features(
        rows,
        y,
        FASTEST,
        1.2,
        V,
        changing,
        ends,
        left_open=left,
        right_open=right,
        lane=1,
        aim=max(aim, 0),
        borrows=borrows,
    )[None]


def known(x: Array, side: int, plan: int = WISHED) -> dict[str, float]:
    """What is known of the course to `side` at the speed `plan`."""
    course = int(np.flatnonzero((side == SIDE) & (plan == PLAN))[0])
    return dict(zip(COURSES.names, courses(x).known[0, course].tolist(), strict=True))


def choice(x: Array, weights: dict[str, float] | None = None) -> MetaAction:
    policy = CoursePolicy(RulePolicy(), None if weights is None else COURSES.in_order(weights))
    return MetaAction(int(policy.logits(x)[0].argmax()))


def test_it_chooses_where_no_other_lane_is_asked_for_and_none_is_oncoming() -> None:
    assert to_choose(scene()) == [True]
    assert to_choose(scene(aim=1)) == [True]
    assert to_choose(scene(aim=2)) == [False]
    assert to_choose(scene(borrows=True)) == [False]


def test_elsewhere_the_base_policy_decides() -> None:
    x = scene(aim=2)
    np.testing.assert_array_equal(CoursePolicy(RulePolicy()).logits(x), RulePolicy().logits(x))


def test_on_a_free_road_the_wished_speed_loses_only_what_it_takes_to_get_there() -> None:
    free = known(scene(), 0)
    way_up = (FASTEST - V) ** 2 / (2.0 * 1.5)  # with 1.5 m/s2, against the wished speed from the start
    assert 60.0 * free["later"] == pytest.approx(way_up, abs=4.0)
    assert free["near"] == free["nearest"] == free["close"] == free["crowd"] == free["rear"] == 0.0
    assert free["wished"] == 1.0
    assert free["up"] == free["turn"] == pytest.approx((FASTEST - V) / 5.0)


def test_behind_a_slow_car_less_way_is_made_than_in_the_free_lane_beside_it() -> None:
    x = scene(car(1, 60.0, 1, 18.0))
    own, left = known(x, 0), known(x, -1)
    least = (FASTEST - 18.0) * TOTAL_S - 60.0  # what it falls behind if it used up the whole gap
    assert 60.0 * own["later"] > least > 60.0 * left["later"]
    assert own["beyond"] <= own["later"]
    assert own["nearest"] > 0.0 == left["nearest"]


def test_a_queue_is_as_slow_as_its_slowest_car() -> None:
    one, queue = scene(car(1, 60.0, 1, 24.0)), scene(car(1, 60.0, 1, 24.0), car(2, 75.0, 1, 12.0))
    assert known(queue, 0)["later"] > known(one, 0)["later"] + 0.3


def test_the_car_behind_in_the_next_lane_has_to_brake_the_harder_the_nearer_it_is() -> None:
    near, far = (known(scene(car(1, -gap, 0, 33.0)), -1)["rear"] for gap in (35.0, 80.0))
    assert near == pytest.approx((33.0 - V) ** 2 / (2.0 * (35.0 - 5.0 - 0.5 * 33.0)) / 2.0, rel=1e-4)
    assert near > far > 0.0
    assert known(scene(car(1, -35.0, 1, 33.0)), 0)["rear"] == 0.0


def test_a_lane_that_is_closed_or_changed_to_already_is_no_choice() -> None:
    def sides(x: Array) -> set[int]:
        return set(SIDE[courses(x).there[0]].tolist())

    assert sides(scene()) == {-1, 0, 1}
    assert sides(scene(left=False)) == {0, 1}
    assert sides(scene(changing=True)) == {0}


def test_there_is_a_course_for_every_lane_and_speed() -> None:
    x = scene(car(1, 60.0, 1, 18.0))
    speeds = courses(x).speed[0, :SPEEDS]
    assert COUNT == 3 * SPEEDS
    assert speeds[WISHED] == FASTEST
    assert speeds[PRESENT] == V
    assert 18.0 in speeds.round(3)


def test_it_leaves_a_lane_with_a_slow_car_for_a_free_one_and_stays_where_none_is_better() -> None:
    slow = car(1, 50.0, 1, 15.0)
    assert choice(scene(slow)) in (MetaAction.LEFT, MetaAction.RIGHT)
    assert choice(scene(slow, left=False)) == MetaAction.RIGHT
    assert choice(scene(slow, car(2, 50.0, 0, 15.0), car(3, 50.0, 2, 15.0))) not in (MetaAction.LEFT, MetaAction.RIGHT)
    assert choice(scene()) == MetaAction.SPEED_UP


def test_the_weights_decide() -> None:
    slow = scene(car(1, 50.0, 1, 15.0))
    assert choice(slow, {"change": 100.0, "later": 1.0}) not in (MetaAction.LEFT, MetaAction.RIGHT)
    assert choice(slow, {"left": -1.0}) == MetaAction.LEFT
    assert choice(scene(), {"wished": 1.0, "present": -1.0}) == MetaAction.CRUISE


def test_many_scenes_are_judged_as_each_alone() -> None:
    several = np.concatenate(
        [scene(car(1, gap, 1, 18.0), car(2, gap + 30.0, 0, 22.0)) for gap in (30.0, 60.0, 90.0)] + [scene(aim=2)]
    )
    policy = CoursePolicy(RulePolicy())
    together = policy.logits(several)
    for k, x in enumerate(several):
        np.testing.assert_allclose(policy.logits(x), together[k], rtol=1e-5, atol=1e-5)


def test_a_file_of_other_weights_is_refused_with_the_fix(tmp_path: Path) -> None:
    path = tmp_path / "courses.json"
    path.write_text('{"weights": {"open": 1.0}}')
    with pytest.raises(ConfigError, match=r"(?s)it weighs open, not late, later.*make courses"):
        load_policy(f"courses:{path}")
