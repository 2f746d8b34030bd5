"""The paper's case study, replayed: over at 1 s, beside at 3 s; asked home at 20 s, faster first, then home at 24 s.

The follower is the car that has been passed: whenever the way home is asked for, it is 4 m behind. It is slower than
the ego, not faster as in the paper: adding 1 m/s a second, the ego cannot gain the room that a faster one needs.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from msgspec import structs

from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policy import load_policy
from schemas.clock import NS
from schemas.codec import rows_of
from schemas.messages import Directive, Event, MetaAction
from schemas.wish import BEHIND_M
from sim_node.config import SimConfig
from sim_node.node import SimNode

HZ = 15
PASSED = 1
"""The car that is passed, and then follows; the only one in front."""


PASSING_MPS, HOME_MPS = 7.0, 8.0
"""The limits of the lane that is borrowed and of the ego's own, for which the slow system asks."""


@dataclass
class Replay:
    """One run of `two-way-case`, in seconds: when lanes were aimed for and reached, and what the follower did."""

    asked_s: float = float("nan")
    """When the slow system has asked to return."""
    aimed: list[tuple[float, int]] = field(default_factory=list)
    reached: list[tuple[float, int]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)
    speed_mps: list[float] = field(default_factory=list)
    follower_mps: list[float] = field(default_factory=list)

    def what(self) -> list[tuple[str, str, str]]:
        """Kind, rule and detail of every event."""
        return [(e.kind, e.rule, e.detail) for _, e in self.events]

    def ego_mps(self, at_s: float) -> float:
        """The ego's speed."""
        return self.speed_mps[round(at_s * HZ)]

    def hardest_brake(self) -> float:
        """Of the passed car [m/s2]."""
        return -float(np.diff(self.follower_mps).min()) * HZ


def replay(seed: int, *, obey: bool = False, duration_s: float = 30.0) -> Replay:
    """Drive as the slow system directs: overtake at 1 s; home, a tick after the car is passed.

    obey: go home when asked, whatever the mask says.
    """
    sim, fast = SimNode(SimConfig(scenario="two-way-case", seed=seed)), FastNode(FastConfig(), load_policy())
    sim.reset(1)
    seen, out = sim.observation(0), Replay()
    lane, changing = seen.target_lane, False
    go = Directive(epoch=1, stamp_ns=NS, id=1, command_id=1, scene_tick=HZ, manoeuvre="overtake",
                   target_speed_mps=PASSING_MPS, target_lane=0, ttl_s=60.0)
    for k in range(round(duration_s * HZ)):
        now_ns, t = k * NS // HZ, k / HZ
        action, events = fast.step(seen, go if t >= 1.0 else None, now_ns)
        if obey and t >= out.asked_s:
            action = structs.replace(action, meta_action=int(MetaAction.RIGHT))
        out.events += [(t, e) for e in events]
        rows = rows_of(seen)
        passed = rows[rows[:, 0] == PASSED][0]
        out.speed_mps.append(float(rows[0, 3]))
        out.follower_mps.append(float(passed[3]))
        if go.id == 1 and rows[0, 1] - passed[1] > passed[6] + BEHIND_M:
            go = structs.replace(go, id=2, stamp_ns=now_ns, target_lane=1, target_speed_mps=HOME_MPS)
            out.asked_s = t
        if seen.target_lane != lane:
            out.aimed.append((t, seen.target_lane))
        if changing and seen.previous_lane < 0:
            out.reached.append((t, seen.target_lane))
        lane, changing = seen.target_lane, seen.previous_lane >= 0
        seen = sim.step(action, now_ns)
    assert sim.metrics.collisions == 0
    return out


@pytest.fixture(scope="module", params=range(10))
def run(request: pytest.FixtureRequest) -> Replay:
    return replay(request.param)


def test_it_moves_over_at_one_second_and_is_beside_at_three(run: Replay) -> None:
    assert run.aimed[0] == (pytest.approx(1.0, abs=0.1), 0)
    assert run.reached[0] == (pytest.approx(3.0, abs=0.1), 0)


def test_asked_home_at_twenty_seconds_it_starts_at_twenty_two_and_is_home_at_twenty_four(run: Replay) -> None:
    assert run.asked_s == pytest.approx(20.0, abs=0.3)
    assert run.aimed[1:] == [(pytest.approx(22.3, abs=0.3), 1)]
    assert run.reached[1:] == [(pytest.approx(24.2, abs=0.3), 1)]


def test_the_car_that_it_returns_before_never_brakes_harder_than_two_metres_per_second_squared(run: Replay) -> None:
    assert run.hardest_brake() <= 2.0


def test_between_request_and_return_it_has_accelerated_from_the_passing_speed_to_the_limit(run: Replay) -> None:
    assert run.ego_mps(run.asked_s) == pytest.approx(PASSING_MPS, abs=0.1)
    assert run.ego_mps(run.aimed[1][0]) == pytest.approx(HOME_MPS, abs=0.2)


def test_the_request_is_delayed_overridden_by_accelerating_carried_out_and_fulfilled(run: Replay) -> None:
    rule = "rear gap in lane"
    assert run.what() == [("delayed", rule, ""), ("overridden", rule, "accelerates first"),
                          ("overridden", rule, "and now carried out"), ("fulfilled", rule, "")]


def test_the_delay_is_reported_with_its_length_when_it_ends(run: Replay) -> None:
    held = run.events[2][1]
    assert held.duration_s == pytest.approx(run.aimed[1][0] - run.asked_s, abs=0.1)


def test_obeying_the_request_at_once_would_make_the_follower_brake_harder() -> None:
    assert replay(0, obey=True).hardest_brake() > 3.0
