"""The fast node in lock step with the real simulator, and on its own when things fail."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deploy.lab.lockstep import overtake_at, run_episode
from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policies.load import load_policy
from fast_node.policies.rule import RulePolicy
from schemas.driving.road import HZ, VX, X
from schemas.runtime.clock import NS
from schemas.wire.messages import Directive, Event, MetaAction, Observation
from tests import scenes
from tests.scenes import TWO_WAY, Row, car


def observation(tick: int, *cars: Row, speed: float = 5.0, lane: int = 1, **fields: Any) -> Observation:
    """On the two-way road, the ego at x 500; a second is 15 ticks, by which all have gone on since tick 0."""
    rows = [row.copy() for row in (car(0, 500, lane, speed), *cars)]
    for row in rows:
        row[X] += row[VX] * tick / HZ
    return scenes.observation(*rows, tick=tick, **fields)


def directive(**fields: Any) -> Directive:
    """To overtake, unless `fields` say otherwise."""
    return scenes.directive(**{"manoeuvre": "overtake", "target_speed_mps": 8.0, **fields})


LEAD, PASSED, ONCOMING = car(1, 514, 1, 4), car(1, 480, 1, 4), car(2, 590, 0, -6)
CLOSE_AHEAD = car(1, 511, 1, 5)
AHEAD_AT_HOME, BEHIND_AT_HOME = car(1, 504, 1, 5), car(2, 491, 1, 5)
AWAY = {"lane": 0}
"""The ego in the lane to the left of them."""


@pytest.fixture
def node() -> FastNode:
    return FastNode(FastConfig(), RulePolicy())


def test_told_to_overtake_it_passes_the_slow_car_and_returns_without_a_collision():
    runs = [run_episode(seed, load_policy(), overtake_at(3.0), duration_s=60) for seed in range(1000, 1004)]
    assert not any(r.collided for r in runs)
    assert sum(r.passed for r in runs) >= 3


def test_told_nothing_it_stays_in_its_lane():
    run = run_episode(1000, load_policy(), lambda observation, now: None, duration_s=20)
    assert (set(run.lanes), run.collided) == ({1}, False)


def test_the_same_seed_drives_the_same_way():
    one, two = (run_episode(1001, load_policy(), overtake_at(3.0), duration_s=15) for _ in range(2))
    assert one.speeds == two.speeds


def test_a_policy_that_fails_is_answered_for_by_the_fallback(node, monkeypatch):
    monkeypatch.setattr(node._policy, "logits", lambda x: np.full(5, np.nan))
    action, _ = node.step(observation(0), None, 0)
    assert (action.source, action.meta_action, action.answers_tick) == ("fallback", MetaAction.CRUISE, 0)


def test_even_a_failing_mask_leaves_no_observation_unanswered(node, monkeypatch):
    monkeypatch.setattr("fast_node.node.close_actions", lambda *_: 1 / 0)
    action, _ = node.step(observation(5), None, 0)
    assert (action.source, action.meta_action, action.answers_tick) == ("fallback", MetaAction.SLOW_DOWN, 5)


def test_an_overtake_held_back_by_oncoming_traffic_is_reported_once_with_its_rule(node):
    events = [e for t in range(5) for e in node.step(observation(t, LEAD, ONCOMING), directive(), 0)[1]]
    assert [(e.kind, e.reason, e.vehicle, e.directive_id) for e in events] == [("delayed", "oncoming traffic", 2, 5)]


def test_a_delayed_overtake_is_reported_with_its_duration_when_it_is_carried_out():
    run = run_episode(1000, load_policy(), overtake_at(3.0), duration_s=35)
    held = [e for e in run.events if e.kind == "carried_out"]
    assert [(e.reason, e.since_tick, e.duration_s > 1) for e in held[:1]] == [("oncoming traffic", 45, True)]


def facts(event: Event) -> tuple[str, str | None, int, float]:
    """Kind, reason, since which tick, for how many seconds."""
    return event.kind, event.reason, event.since_tick, event.duration_s


def drive(node: FastNode, ticks: range, told: Directive, *cars: Row, **fields: Any) -> list[Event]:
    """What is reported while the same is seen for a while."""
    return [e for t in ticks for e in node.step(observation(t, *cars, **fields), told, t * NS // 15)[1]]


def test_a_delay_is_reported_with_its_rule_and_beginning_when_it_begins(node):
    assert [facts(e) for e in drive(node, range(7, 12), directive(), LEAD, ONCOMING)] == [
        ("delayed", "oncoming traffic", 7, 0.0)
    ]


def test_a_change_carried_out_after_a_delay_is_reported_with_the_rule_and_the_length_of_the_delay(node):
    drive(node, range(30), directive(), LEAD, ONCOMING)
    assert [facts(e) for e in drive(node, range(30, 60), directive(), LEAD)] == [
        ("carried_out", "oncoming traffic", 0, 3.0)  # a second after the car is seen for the last time
    ]


def test_an_expired_directive_is_reported_with_what_held_it_up_and_how_long_it_was_followed(node):
    assert [facts(e) for e in drive(node, range(10, 60), directive(ttl_s=3.0), LEAD, ONCOMING)][1:] == [
        ("expired", "oncoming traffic", 10, 36 / 15)
    ]


def test_a_fulfilled_directive_is_reported_with_what_held_it_up_and_how_long_it_took(node):
    drive(node, range(30), directive(), LEAD, ONCOMING)
    assert [facts(e) for e in drive(node, range(30, 31), directive(), PASSED)] == [
        ("fulfilled", "oncoming traffic", 0, 2.0)
    ]


def test_a_delay_whose_rule_changes_is_reported_once_for_each_rule_however_often_it_changes(node):
    home = directive(manoeuvre="cruise", target_lane=1, target_speed_mps=5.0)
    events = [
        e
        for t in range(0, 300, 60)
        for e in [
            *drive(node, range(t, t + 30), home, AHEAD_AT_HOME, **AWAY),
            *drive(node, range(t + 30, t + 60), home, BEHIND_AT_HOME, **AWAY),
        ]
    ]
    assert [facts(e) for e in events if e.kind == "delayed"] == [
        ("delayed", "front gap in lane", 0, 0.0),
        ("delayed", "rear gap in lane", 0, 3.0),  # a second after the car ahead is seen for the last time
    ]


def test_held_back_by_a_car_behind_it_is_reported_once_that_the_ego_accelerates_first(node):
    home = directive(manoeuvre="cruise", target_lane=1, target_speed_mps=5.0)
    events = drive(node, range(10), home, BEHIND_AT_HOME, **AWAY)
    assert [facts(e) for e in events if e.kind == "overridden"] == [("overridden", "rear gap in lane", 0, 0.0)]


def test_where_the_limit_is_wished_already_nothing_is_overridden_for_a_car_behind(node):
    home = directive(manoeuvre="cruise", target_lane=1, target_speed_mps=8.0)
    assert [e.kind for e in drive(node, range(10), home, BEHIND_AT_HOME, **AWAY)] == ["delayed"]


def test_it_accelerates_first_as_soon_as_a_car_behind_becomes_what_holds_it_back(node):
    home = directive(manoeuvre="cruise", target_lane=1, target_speed_mps=5.0)
    drive(node, range(5), home, AHEAD_AT_HOME, **AWAY)
    drive(node, range(5, 21), home, BEHIND_AT_HOME, **AWAY)  # until the other is believed to be gone
    action, _ = node.step(observation(21, BEHIND_AT_HOME, **AWAY), home, 21 * NS // 15)
    assert action.speed_goal_mps == TWO_WAY[1].speed_limit_mps


def test_a_wished_speed_that_a_car_ahead_does_not_allow_is_reported_once_after_a_second(node):
    faster = directive(manoeuvre="cruise", target_speed_mps=8.0)
    assert [facts(e) for e in drive(node, range(60), faster, CLOSE_AHEAD)] == [
        ("delayed", "speed above the gap's", 0, 1.0)
    ]


def test_a_wished_speed_that_nothing_forbids_is_not_reported_as_delayed(node):
    assert drive(node, range(60), directive(manoeuvre="cruise", target_speed_mps=8.0)) == []


def test_a_speed_that_only_the_wish_rules_out_is_not_reported_as_delayed(node):
    far_behind = directive(manoeuvre="cruise", target_speed_mps=8.0, headway_s=6.0)
    assert drive(node, range(60), far_behind, car(1, 525, 1, 5)) == []


def test_an_overtake_is_fulfilled_once_the_car_is_passed_and_the_ego_is_home(node):
    node.step(observation(0, LEAD), directive(), 0)
    _, events = node.step(observation(1, PASSED), directive(), 0)
    assert [e.kind for e in events] == ["fulfilled"]


def test_a_wish_for_a_lane_alone_is_fulfilled_at_any_speed(node):
    told = directive(manoeuvre="cruise", target_speed_mps=None, target_lane=1)
    _, events = node.step(observation(0, LEAD, speed=3.0), told, 0)
    assert [e.kind for e in events] == ["fulfilled"]


def test_a_directive_ends_with_its_time_to_live(node):
    node.step(observation(0, LEAD, ONCOMING), directive(ttl_s=1.0), 0)
    _, events = node.step(observation(30, LEAD, ONCOMING), directive(ttl_s=1.0), 2_000_000_000)
    assert "expired" in [e.kind for e in events]


def test_a_directive_of_another_world_is_ignored(node):
    action, events = node.step(observation(0, LEAD), directive(epoch=99), 0)
    assert (action.speed_goal_mps, events) == (5.0, [])


def test_the_mask_decides_whatever_the_directive_wants(node):
    action, _ = node.step(observation(0, car(1, 506, 1, 0), speed=8.0), directive(), 0)
    assert action.meta_action == MetaAction.EMERGENCY_BRAKE
