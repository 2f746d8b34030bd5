"""The node, whatever comes in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.config import FastConfig
from fast_node.mask import OPEN, PRESETS, lane_table
from fast_node.node import FastNode
from fast_node.policies.rule import RulePolicy
from fast_node.tracks import Tracks
from schemas.wire.codec import rows_of
from schemas.wire.messages import Directive, Manoeuvre, MetaAction, Observation, Style
from tests.mask_scenes import ROADS, ROADS_BY_HAND, SIGHT_M, Scene, judge, presets, scenes
from tests.scenes import car, observation

directives = st.none() | st.builds(
    Directive,
    epoch=st.sampled_from([1, 1, 1, 9]),
    stamp_ns=st.just(0),
    id=st.integers(0, 9),
    command_id=st.integers(0, 3),
    scene_tick=st.just(0),
    manoeuvre=st.sampled_from(get_args(Manoeuvre)),
    target_lane=st.none() | st.integers(-1, 5),
    relative_lane=st.sampled_from([None, "left", "right"]),
    target_speed_mps=st.none() | st.floats(-5, 60),
    headway_s=st.none() | st.floats(0, 6),
    style=st.sampled_from(get_args(Style)),
    ttl_s=st.sampled_from([0.0, 1.0, 30.0]),
)

BROKEN = [(math.nan,) * 5, (math.inf, 0.0, 0.0, 0.0, 0.0), (0.0, 1.0), ()]
"""Logits of a policy that fails."""


def seen_at(tick: int, scene: Scene) -> Observation:
    road = next(name for name, table in ROADS.items() if table is scene.lanes)
    return observation(
        *scene.rows,
        lanes=ROADS_BY_HAND[road],
        tick=tick,
        target_lane=scene.lane,
        target_speed_mps=scene.target_speed,
        previous_lane=scene.previous,
        sight_m=SIGHT_M,
    )


class Failing:
    """A policy, but for the ticks at which it has something else to say."""

    def __init__(self) -> None:
        self._policy = RulePolicy()
        self.instead: Sequence[float] | None = None

    def logits(self, x):
        return self._policy.logits(x) if self.instead is None else np.array(self.instead)


@pytest.fixture(scope="module")
def failing() -> Failing:
    return Failing()


@settings(max_examples=400, deadline=None)
@given(
    presets,
    st.lists(
        st.tuples(
            scenes(),
            directives,
            st.none() | st.sampled_from(BROKEN) | st.tuples(*[st.floats(-5, 5)] * 5),
            st.integers(1, 20),
            st.integers(0, 40),
        ),
        min_size=1,
        max_size=3,
    ),
)
def test_whatever_state_directive_and_policy_the_node_does_what_the_mask_leaves_open_of_its_tracks(
    failing, preset, ticks
):
    node, tracks, tick = FastNode(FastConfig(), failing, PRESETS[preset]), Tracks(), 0
    for scene, directive, instead, passed, now_s in ticks:
        failing.instead, tick = instead, tick + passed
        seen = seen_at(tick, scene)
        action, _ = node.step(seen, directive, now_s * 10**9)
        reasons, _ = judge(
            tracks.follow(seen, rows_of(seen).tolist(), lane_table(seen.lanes)),
            lane_table(seen.lanes),
            scene.target_speed,
            scene.lane,
            scene.previous,
            PRESETS[preset],
        )
        nothing_open = all(r != OPEN for r in reasons[:5])
        assert reasons[action.meta_action] == OPEN, action
        assert (action.meta_action == MetaAction.EMERGENCY_BRAKE) == nothing_open, action
        assert action.source != "fallback" or instead in BROKEN, action


class Asked:
    """A policy that keeps the ticks at which it was asked, and fails at some."""

    def __init__(self, *fails_at: int) -> None:
        self.now, self._fails_at = 0, fails_at
        self.ticks: list[int] = []

    def logits(self, x):
        self.ticks.append(self.now)
        if self.now in self._fails_at:
            raise ValueError
        return RulePolicy().logits(x) + np.float32(0.01 * self.now)


def drive(policy: Asked, ticks: int, *, stateless: bool) -> list[Any]:
    """The node's actions on an open road."""
    node = FastNode(FastConfig(), policy, stateless=stateless)
    actions = []
    for policy.now in range(ticks):
        actions.append(node.step(observation(car(0, 100.0, 1, 20.0), tick=policy.now), None, 0)[0])
    return actions


def test_a_policy_that_remembers_nothing_is_asked_where_a_decision_is_due_and_its_answer_stands_until_the_next() -> (
    None
):
    policy = Asked()
    actions = drive(policy, 11, stateless=True)
    assert policy.ticks == [0, 5, 10]
    assert len({action.probabilities for action in actions[:5]}) == 1
    assert [a.meta_action for a in actions] == [a.meta_action for a in drive(Asked(), 11, stateless=False)]


def test_a_policy_that_may_remember_is_asked_at_every_tick() -> None:
    policy = Asked()
    drive(policy, 11, stateless=False)
    assert policy.ticks == list(range(11))


def test_a_policy_that_fails_is_asked_again_at_the_next_tick() -> None:
    policy = Asked(5, 6)
    actions = drive(policy, 12, stateless=True)
    assert policy.ticks == [0, 5, 6, 7]
    assert [a.source == "fallback" for a in actions] == [tick in (5, 6) for tick in range(12)]


def test_the_rehearsal_before_a_decision_asks_the_policy_and_no_other_does() -> None:
    policy = Asked()
    node = FastNode(FastConfig(), RulePolicy(), stateless=True)
    rehearser = FastNode(FastConfig(), policy, stateless=True)
    for policy.now in range(12):
        seen = observation(car(0, 100.0, 1, 20.0), tick=policy.now)
        node.step(seen, None, 0)
        rehearser.rehearse(node, seen, None)
    assert policy.ticks == [0, 4, 9]  # the first one is of a new world
