"""The budget is a gate: which action a tick applies, and what becomes of those that come too late."""

from __future__ import annotations

import time
from typing import Any

import pytest

from schemas.runtime.local_bus import LocalBus
from schemas.runtime.process import Trace
from schemas.wire import topics
from schemas.wire.messages import Action, MetaAction
from sim_node.__main__ import Answers
from sim_node.config import SimConfig
from sim_node.gate import Gate
from sim_node.node import HOLD_TICKS, SimNode

MS = 1_000_000


def answer(tick: int = 4, epoch: int = 7, meta: int = MetaAction.SPEED_UP, budget_ms: int = 0) -> Action:
    return Action(
        epoch=epoch, stamp_ns=0, answers_tick=tick, meta_action=meta, source="policy", budget_ns=budget_ms * MS
    )


def asked(budget_ms: int = 20) -> Gate:
    """A gate whose observation of tick 4 in world 7 was published at 100 ms."""
    gate = Gate(budget_ms * MS)
    gate.open(7, 4, 100 * MS)
    return gate


def test_an_answer_within_the_budget_is_applied_and_its_age_is_until_then() -> None:
    gate, action = asked(), answer()
    gate.arrived(action, 120 * MS)
    assert gate.close(121 * MS) is action
    assert (gate.missed, [*gate.round_trips_ns], [*gate.ages_ns]) == (0, [20 * MS], [21 * MS])


def test_an_answer_after_the_budget_is_a_miss_and_is_not_used_but_its_round_trip_counts() -> None:
    gate = asked()
    gate.arrived(answer(), 120 * MS + 1)
    assert gate.close(120 * MS) is None
    assert (gate.missed, [*gate.round_trips_ns], [*gate.ages_ns]) == (1, [20 * MS + 1], [])


def test_an_answer_after_the_gate_was_closed_changes_nothing_more() -> None:
    gate = asked()
    assert gate.close(120 * MS) is None
    gate.arrived(answer(), 119 * MS)  # stamped in time, but handed over too late
    gate.open(7, 5, 167 * MS)
    assert gate.close(187 * MS) is None
    assert (gate.missed, [*gate.round_trips_ns]) == (2, [19 * MS])


@pytest.mark.parametrize(("own_ms", "stated_ms", "in_time"), [(20, 10, False), (10, 20, False), (20, 0, True)])
def test_the_smaller_of_the_two_budgets_counts(own_ms: int, stated_ms: int, in_time: bool) -> None:
    gate = asked(own_ms)
    gate.arrived(answer(budget_ms=stated_ms), 115 * MS)
    assert (gate.close(116 * MS) is not None) == in_time


@pytest.mark.parametrize("other", [{"tick": 3}, {"tick": 5}, {"epoch": 6}, {"meta": 9}])
def test_what_answers_another_observation_or_is_no_action_neither_passes_nor_stands_in_the_way(
    other: dict[str, Any],
) -> None:
    gate, right = asked(), answer()
    gate.arrived(answer(**other), 101 * MS)
    gate.arrived(right, 102 * MS)
    assert gate.close(103 * MS) is right


def test_of_two_answers_the_first_counts_even_if_it_stated_a_budget_that_is_over() -> None:
    gate, first = asked(), answer()
    gate.arrived(first, 101 * MS)
    gate.arrived(answer(meta=MetaAction.LEFT), 102 * MS)
    assert gate.close(103 * MS) is first
    gate = asked()
    gate.arrived(answer(budget_ms=1), 102 * MS)
    gate.arrived(answer(), 103 * MS)
    assert gate.close(103 * MS) is None


def test_what_the_fast_node_cannot_have_meant_is_counted_as_stray_and_what_comes_late_is_not() -> None:
    gate = asked()
    for action in (answer(), answer(), answer(epoch=8), answer(epoch=6), answer(tick=5), answer(tick=3)):
        gate.arrived(action, 110 * MS)
    gate.open(7, 5, 167 * MS)
    gate.arrived(answer(tick=5, meta=9), 170 * MS)
    assert gate.strays == 5


def test_a_gap_in_the_answers_holds_two_ticks_then_brakes_until_the_next_answer() -> None:
    node = SimNode(SimConfig(scenario="highway", seed=3))
    node.reset(7)

    def step(answered: bool) -> tuple[float, int, int]:
        action = answer(node.tick, meta=MetaAction.CRUISE) if answered else None
        seen = node.step(action, 0)
        return seen.target_speed_mps, node.metrics.holds, node.metrics.failsafes

    before, _, _ = step(True)
    for k in range(1, HOLD_TICKS + 1):
        assert step(False) == (before, k, 0)
    slower, holds, failsafes = step(False)
    assert slower < before
    assert (holds, failsafes) == (HOLD_TICKS, 1)
    assert step(True) == (slower, HOLD_TICKS, 1)
    assert step(False) == (slower, HOLD_TICKS + 1, 1)


@pytest.mark.parametrize("late", [answer(3), answer(5), answer(4, epoch=6)])
def test_a_node_steps_without_an_action_that_answers_another_observation(late: Action) -> None:
    node = SimNode(SimConfig(scenario="highway", seed=3))
    node.reset(7)
    for tick in range(4):
        node.step(answer(tick, meta=MetaAction.CRUISE), 0)
    seen = node.step(late, 0)
    assert (seen.applied_tick, node.metrics.answered, node.metrics.holds) == (3, 4, 1)


class Stalled:
    """A subscription whose messages come when they are put; `wait` blocks for good."""

    def __init__(self) -> None:
        self._bus = LocalBus()
        self._ring = self._bus.subscribe(topics.ACTION)

    def put(self, action: Action) -> None:
        self._bus.publish(topics.ACTION, action)

    def poll(self, until_ns: int) -> Action | None:
        return self._ring.poll(until_ns)

    def wait(self) -> Action:
        raise EOFError("no more")


@pytest.mark.parametrize("poll", [False, True])
def test_the_wait_ends_with_the_budget_where_nobody_answers(poll: bool) -> None:
    gate = Gate(5 * MS)
    answers = Answers(Stalled(), gate, Trace(""), poll)  # type: ignore[arg-type]
    node = SimNode(SimConfig(scenario="highway", seed=3))
    node.reset(7)
    for k in (1, 2):
        answers.expect(node.observation(time.monotonic_ns()), 0)
        assert answers.wait() is None
        assert gate.missed == k
