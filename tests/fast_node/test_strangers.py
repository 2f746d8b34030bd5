"""What a stranger may send to the fast node: it answers every observation that can be read, and no directive that
claims to be of the future shuts out those to come."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fast_node.config import FastConfig
from fast_node.mask import PRESETS
from fast_node.node import FastNode
from fast_node.policies import outsider
from fast_node.policies.outsider import TRUSTED_AGAIN, WatchedPolicy
from fast_node.policies.rule import RulePolicy
from schemas.driving.features import Array
from schemas.runtime.clock import NS
from schemas.wire.codec import decode, encode
from schemas.wire.messages import Directive
from schemas.wire.topics import OBSERVATION
from tests.scenes import HIGHWAY, MERGE, TWO_WAY, car, observation

NOW_NS = 3600 * NS
cars = st.builds(
    car,
    st.integers(-3, 60),
    st.floats(-1e4, 1e4, width=32),
    st.integers(0, 1),
    st.floats(-60.0, 60.0, width=32),
    st.floats(-100.0, 100.0, width=32),
    vy_mps=st.floats(-20.0, 20.0, width=32),
    heading_rad=st.floats(-4.0, 4.0, width=32),
    length_m=st.floats(0.0, 30.0, width=32),
)
egos = cars.map(lambda row: [abs(row[0]), *row[1:]])


def fresh() -> FastNode:
    return FastNode(FastConfig(), RulePolicy(), PRESETS["sim"])


@settings(deadline=None)
@given(
    ego=egos,
    others=st.lists(cars, max_size=12),
    lanes=st.sampled_from([TWO_WAY, HIGHWAY, MERGE]),
    target=st.integers(0, 1),
    previous=st.integers(-1, 1),
    speed=st.floats(-200.0, 200.0),
)
def test_every_observation_that_can_be_read_is_answered_behind_the_mask(
    ego: list[float], others: list[list[float]], lanes: Any, target: int, previous: int, speed: float
) -> None:
    node = fresh()
    for tick in range(2):
        seen = observation(
            ego, *others, lanes=lanes, tick=tick, target_lane=target, previous_lane=previous, target_speed_mps=speed
        )
        action, _ = node.step(decode(OBSERVATION, encode(seen)), None, NOW_NS)
        assert (action.answers_tick, action.why.partition(":")[0] in ("IndexError", "ValueError")) == (tick, False)
    assert node.counts["fallback"] == 0


def directive(number: int, stamp_ns: int, ttl_s: float = 30.0) -> Directive:
    return Directive(
        epoch=1, stamp_ns=stamp_ns, id=number, command_id=1, scene_tick=0, target_speed_mps=5.0, ttl_s=ttl_s
    )


@pytest.mark.parametrize(
    "forged", [directive(2**63 - 1, NOW_NS), directive(NOW_NS // 1000 + 10**9, NOW_NS), directive(7, NOW_NS + 60 * NS)]
)
def test_a_directive_out_of_the_future_is_not_followed_and_shuts_nobody_out(forged: Directive) -> None:
    node = fresh()
    seen = observation(car(0, 100.0, 1, 6.0), epoch=1, target_speed_mps=6.0)
    assert node.step(seen, forged, NOW_NS)[0].speed_goal_mps == 6.0
    assert node.step(seen, directive(NOW_NS // 1000, NOW_NS), NOW_NS)[0].speed_goal_mps == 5.0


def test_no_directive_is_pending_for_more_than_a_minute() -> None:
    node = fresh()
    seen = observation(car(0, 100.0, 1, 6.0), epoch=1, target_speed_mps=6.0)
    for_ever = directive(1, NOW_NS, ttl_s=1e300)
    assert not node.step(seen, for_ever, NOW_NS + 59 * NS)[1]
    assert [e.kind for e in node.step(seen, for_ever, NOW_NS + 61 * NS)[1]] == ["expired"]


@pytest.fixture
def takes(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Lets so many seconds pass on the clock that a policy is watched by."""
    now_s = [0.0]
    monkeypatch.setattr(outsider, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    def pass_by(seconds: float) -> None:
        now_s[0] += seconds

    return pass_by


def test_a_policy_that_was_slow_once_is_asked_directly_again_after_five_seconds_in_time(
    takes: Callable[[float], None],
) -> None:
    threads: list[str] = []

    class Hiccup:
        def logits(self, x: Array) -> Array:
            threads.append(threading.current_thread().name)
            takes(0.0 if len(threads) > 1 else 11.0)
            return np.zeros(5, np.float32)

    policy, x = WatchedPolicy(Hiccup(), 10.0), np.zeros((15, 26), np.float32)
    for _ in range(TRUSTED_AGAIN + 2):
        policy.logits(x)
    assert threads[1:-1] == ["policy"] * TRUSTED_AGAIN
    assert threads[-1] == threads[0] != "policy"


def test_a_policy_that_turns_slow_costs_one_tick_and_then_the_rule_answers_in_time(
    takes: Callable[[float], None],
) -> None:
    release, asked = threading.Event(), itertools.count()

    class Tiring:
        def logits(self, x: Array) -> Array:
            turn = next(asked)
            if turn == 1:
                takes(0.05)
            elif turn > 1:
                release.wait(10.0)
            return np.zeros(5, np.float32)

    policy, x = WatchedPolicy(Tiring(), 0.02), np.zeros((15, 26), np.float32)
    policy.logits(x)
    policy.logits(x)  # the slow one is noticed
    try:
        for why in ("did not answer", "still busy"):
            with pytest.raises(TimeoutError, match=why):
                policy.logits(x)
    finally:
        release.set()
