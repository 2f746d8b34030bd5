"""The choice of gap: which scenes it is for, what it finds, and that one scene and many are planned alike."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast_node.choice import narrow
from fast_node.mask import OPEN, close_actions
from fast_node.mask.entering import CREEP_MPS
from fast_node.policies.gaps import GAPS, GapPolicy, best_of, described
from fast_node.policies.load import load_policy
from fast_node.policies.plans import NEVER_S, PLANS, PRESENT, SPARE_MOST_M, SPEEDS, plans, to_enter
from fast_node.policies.rule import RulePolicy, rule_logits
from schemas.driving.features import Array, features
from schemas.driving.road import NOBODY
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction
from tests.mask_scenes import HIGHWAY, SIGHT_M, SIM
from tests.scenes import car

WISHED, V = 30.0, 25.0


def scene(
    *others: list[float], aim: int = 1, ends: float = math.inf, borrows: bool = False, goal_m: float = 800.0
) -> Array:
    """(1, N, F): the ego in lane 0 at 25 m/s wishes to be in lane `aim`."""
    rows = [car(0, 0.0, 0, V), *others]
    x = features(rows, 4.0 * aim, WISHED, 1.2, V, False, ends, lane=0, aim=aim, goal_left=goal_m, borrows=borrows)
    return x[None]


def queue(gap_m: float, first_m: float = -100.0, count: int = 8, mps: float = 21.0) -> list[list[float]]:
    """Cars of the lane to be entered, evenly spaced: bumper to bumper `gap_m`."""
    return [car(1 + k, first_m + k * (gap_m + 5.0), 1, mps) for k in range(count)]


def test_it_plans_only_where_a_lane_of_our_direction_is_to_be_entered_in_time() -> None:
    assert to_enter(scene(aim=1)) == [1]
    assert to_enter(scene(aim=0)) == [0]
    assert to_enter(scene(aim=1, borrows=True)) == [0]
    assert to_enter(scene(aim=1, goal_m=5000.0)) == [0]
    assert to_enter(scene(aim=1, goal_m=5000.0, ends=200.0)) == [1]


def test_an_empty_lane_is_open_at_once_and_no_speed_is_given_up_for_it() -> None:
    known = plans(scene(), np.array([1]))
    assert known.open_s[0, 0] == 0.0
    assert known.there[0].tolist() == [True] * SPEEDS + [False] * (PLANS - SPEEDS)
    assert V <= best_of(known)[0] <= WISHED


def test_a_lane_without_a_gap_never_opens_and_the_wished_speed_is_kept() -> None:
    known = plans(scene(*queue(30.0), goal_m=300.0), np.array([1]))
    assert (known.open_s == NEVER_S).all()
    assert best_of(known) == pytest.approx(WISHED)


def test_a_change_is_not_planned_beyond_the_end_of_the_own_lane() -> None:
    others = [car(1, 0.0, 1, 27.0)]  # it is past soon, and then there is room
    late, never = (plans(scene(*others, ends=ends), np.array([1])) for ends in (700.0, 300.0))
    assert 0.0 < late.open_s[0, PRESENT] < NEVER_S
    assert 0.0 < late.left_m[0, PRESENT] < 300.0
    assert never.open_s[0, PRESENT] == NEVER_S
    assert never.left_m[0, PRESENT] == never.spare_m[0, PRESENT] == 0.0


def test_road_is_kept_for_the_lanes_that_are_to_be_crossed_after_the_next() -> None:
    one, two = (plans(scene(aim=aim, goal_m=500.0), np.array([1])).left_m[0, PRESENT] for aim in (1, 2))
    assert one == 300.0  # more is as good
    assert two == pytest.approx(500.0 - 15.0 - 300.0)


def test_the_room_to_spare_is_what_is_left_of_the_gap() -> None:
    near, far = (plans(scene(car(1, gap, 1, V)), np.array([1])).spare_m[0, PRESENT] for gap in (35.0, 42.0))
    assert far - near == pytest.approx(7.0, abs=1e-3)
    assert plans(scene(), np.array([1])).spare_m[0, PRESENT] == SPARE_MOST_M


def test_every_plan_is_described_in_numbers_of_about_one() -> None:
    known = plans(scene(car(1, 50.0, 1, V), ends=400.0), np.array([1]))
    plan = dict(zip(GAPS.names, described(known)[0, 0].tolist(), strict=True))
    assert plan == pytest.approx(
        {
            "open": known.open_s[0, 0] / 10.0,
            "never": 0.0,
            "lost": known.lost_m[0, 0] / 50.0,
            "turn": (WISHED - V) / 5.0,
            "up": (WISHED - V) / 5.0,
            "wished": 1.0,
            "present": 0.0,
            "left": known.left_m[0, 0] / 300.0,
            "spare": known.spare_m[0, 0] / 20.0,
            "ahead": 0.0,
            "behind": 0.0,
            "slower": 0.0,
        }
    )


def test_learnt_weights_count_before_a_lanes_end_and_those_by_hand_before_the_tasks() -> None:
    slowest = GAPS.in_order({"slower": -1.0})
    ours, by_hand = GapPolicy(RulePolicy(), slowest), GapPolicy(RulePolicy())
    ramp, task = scene(ends=400.0), scene()
    assert ours.logits(ramp)[0, MetaAction.SLOW_DOWN] > by_hand.logits(ramp)[0, MetaAction.SLOW_DOWN]
    np.testing.assert_array_equal(ours.logits(task), by_hand.logits(task))


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "No such file"),
        ("{", "truncated"),
        ('{"weights": {"open": "much"}}', "Expected `float`"),
        ('{"weights": {"open": 1.0}}', "it weighs open, not open, never"),
    ],
)
def test_a_file_that_holds_no_weights_is_refused_with_the_fix(tmp_path: Path, content: str | None, told: str) -> None:
    path = tmp_path / "plans.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=f"(?s){told}.*make gaps"):
        load_policy(f"gaps:{path}")


def test_a_gap_beside_the_ego_is_not_driven_past() -> None:
    others = [car(1, -60.0, 1, V), car(2, 48.0, 1, V), *[car(3 + k, 83.0 + 35.0 * k, 1, V) for k in range(4)]]
    x = scene(*others)
    assert best_of(plans(x, np.array([1]))) < WISHED
    assert GapPolicy(RulePolicy()).logits(x[0]).argmax() == MetaAction.RIGHT  # the mask says when


def test_many_scenes_are_planned_as_each_alone() -> None:
    several = np.concatenate([scene(*queue(gap)) for gap in (30.0, 60.0, 75.0, 90.0)])
    policy = GapPolicy(RulePolicy())
    together = policy.logits(several)
    for k, x in enumerate(several):
        np.testing.assert_allclose(policy.logits(x), together[k])


def test_the_base_is_asked_about_no_scene_that_a_plan_decides() -> None:
    asked: list[Array] = []

    class Base:
        def logits(self, x: Array) -> Array:
            asked.append(x)
            return rule_logits(x)

    calm, choice = scene(*queue(60.0), aim=0), scene(*queue(75.0))
    together = GapPolicy(Base()).logits(np.concatenate([choice, calm, choice]))
    np.testing.assert_array_equal(np.concatenate(asked), calm)
    np.testing.assert_array_equal(together[1], rule_logits(calm)[0])
    np.testing.assert_array_equal(together[0], GapPolicy(Base()).logits(choice[0]))
    assert len(asked) == 1


AT_M, SLACK_M = 500.0, 0.05
"""Where the ego is, and what single precision and rounded constants may differ by."""
Beside = tuple[float, float, float]
"""A car of the lane to be entered: the room between bumpers [m], negative behind the ego, its speed, its length."""
AHEAD = st.tuples(st.floats(1.6, 60.0), st.floats(0.0, 35.0), st.floats(4.0, 16.0))
BEHIND = st.tuples(st.floats(-60.0, 0.0, exclude_max=True), st.floats(0.0, 35.0), st.floats(4.0, 16.0))


def beside(mps: float, others: list[Beside], more_m: float = 0.0) -> list[list[float]]:
    """The ego in lane 0 and the others in lane 1, each `more_m` farther away from it."""
    rows = [car(0, AT_M, 0, mps)]
    for k, (gap, speed, length) in enumerate(others, 1):
        apart = abs(gap) + more_m + 0.5 * (length + 5.0)
        rows.append(car(k, AT_M + math.copysign(apart, gap), 1, speed, length_m=length))
    return rows


def plan_enters(mps: float, others: list[Beside], headway_s: float) -> bool:
    """Whether every plan has the change open at once."""
    x = features(beside(mps, others), 4.0, WISHED, headway_s, mps, False, 1e4, lane=0, aim=1, goal_left=1500.0)[None]
    now = plans(x, to_enter(x)).open_s[0, :SPEEDS] == 0.0
    assert len(set(now.tolist())) == 1
    return bool(now[0])


def mask_and_intent_enter(mps: float, others: list[Beside], headway_s: float, more_m: float) -> bool:
    """Whether mask and intent leave the change open now, were the others `more_m` farther away."""
    rows, near, reasons, vehicle = beside(mps, others, more_m), [0] * (3 * len(HIGHWAY)), [OPEN] * 6, [NOBODY] * 6
    cap = close_actions(rows, HIGHWAY, mps, 0, NOBODY, SIGHT_M, near, reasons, vehicle, SIM)
    narrow(reasons, rows, near, HIGHWAY, mps, 0, NOBODY, NOBODY, 1, WISHED, headway_s, cap)
    return reasons[MetaAction.RIGHT] == OPEN


@given(
    mps=st.floats(CREEP_MPS, 32.0),
    ahead=st.none() | AHEAD,
    behind=st.none() | BEHIND,
    farther=st.lists(AHEAD | BEHIND, max_size=4),
    headway_s=st.floats(0.3, 2.5),
)
def test_a_plan_calls_a_gap_open_where_mask_and_intent_do(
    mps: float, ahead: Beside | None, behind: Beside | None, farther: list[Beside], headway_s: float
) -> None:
    near = [other for other in (ahead, behind) if other is not None]
    if plan_enters(mps, near, headway_s):
        assert mask_and_intent_enter(mps, near, headway_s, SLACK_M)
    else:
        assert not mask_and_intent_enter(mps, near, headway_s, -SLACK_M)
    if plan_enters(mps, [*near, *farther], headway_s):  # it looks at every car of the lane, the mask at the nearest
        assert mask_and_intent_enter(mps, [*near, *farther], headway_s, SLACK_M)


def test_elsewhere_the_base_decides() -> None:
    x = scene(*queue(60.0), aim=0)
    np.testing.assert_array_equal(GapPolicy(RulePolicy()).logits(x), rule_logits(x))


def test_the_shipped_driver_asks_the_network_where_a_lane_is_borrowed_and_chooses_elsewhere() -> None:
    borrowed, in_lane, to_enter_one = scene(*queue(60.0), borrows=True), scene(aim=0), scene(*queue(75.0))
    ours, network = load_policy(), load_policy("network")
    np.testing.assert_array_equal(ours.logits(borrowed), network.logits(borrowed))
    for choice in (in_lane, to_enter_one):
        assert not np.array_equal(ours.logits(choice), network.logits(choice))
