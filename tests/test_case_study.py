"""The paper's case study, replayed: over at 1 s, beside by 3 s; asked home at 20 s, home once the follower allows."""

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
from sim_node.config import SimConfig
from sim_node.node import SimNode

HZ = 15
PASSED = 1
"""The car that is passed, and then follows; the only one in front."""


@dataclass
class Replay:
    """One run of `two-way-case`, in seconds: when lanes were aimed for and reached, and what the follower did."""

    aimed: list[tuple[float, int]] = field(default_factory=list)
    reached: list[tuple[float, int]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)
    speed_mps: list[float] = field(default_factory=list)
    follower_mps: list[float] = field(default_factory=list)

    def delayed_s(self) -> float:
        """When the way home was first held up by the car behind."""
        return next(t for t, e in self.events if e.kind == "delayed" and e.rule == "rear gap in lane")

    def hardest_brake(self) -> float:
        """Of the passed car [m/s2]."""
        return -float(np.diff(self.follower_mps).min()) * HZ


def replay(seed: int, speed_mps: float, *, obey_at_s: float | None = None, duration_s: float = 30.0) -> Replay:
    """Drive with an overtake directive at 1 s. `obey_at_s`: go home then, whatever the mask says."""
    sim, fast = SimNode(SimConfig(scenario="two-way-case", seed=seed)), FastNode(FastConfig(), load_policy())
    sim.reset(1)
    seen, out = sim.observation(0), Replay()
    lane, changing = seen.target_lane, False
    for k in range(round(duration_s * HZ)):
        now_ns, t = k * NS // HZ, k / HZ
        told = Directive(epoch=1, stamp_ns=NS, id=1, command_id=1, scene_tick=HZ, manoeuvre="overtake",
                         target_speed_mps=speed_mps, ttl_s=60.0) if t >= 1.0 else None
        action, events = fast.step(seen, told, now_ns)
        if obey_at_s is not None and t >= obey_at_s:
            action = structs.replace(action, meta_action=int(MetaAction.RIGHT))
        out.events += [(t, e) for e in events]
        rows = rows_of(seen)
        out.speed_mps.append(float(rows[0, 3]))
        out.follower_mps.append(float(rows[rows[:, 0] == PASSED][0, 3]))
        if seen.target_lane != lane:
            out.aimed.append((t, seen.target_lane))
        if changing and seen.previous_lane < 0:
            out.reached.append((t, seen.target_lane))
        lane, changing = seen.target_lane, seen.previous_lane >= 0
        seen = sim.step(action, now_ns)
    assert sim.metrics.collisions == 0
    return out


@pytest.mark.parametrize("seed", range(10))
def test_over_at_one_second_beside_by_three_asked_home_at_twenty_and_going_there_at_twenty_three(seed: int) -> None:
    run = replay(seed, 8.0)
    (left, _), (right, _) = run.aimed
    assert 1.0 <= left <= 1.2
    assert run.reached[0][0] <= 3.3
    assert run.delayed_s() == pytest.approx(20.0, abs=1.0)
    assert right == pytest.approx(23.0, abs=1.2)
    assert run.hardest_brake() <= 2.05


def test_obeying_the_request_at_once_would_make_the_follower_brake_harder() -> None:
    asked = replay(0, 8.0).delayed_s()
    assert replay(0, 8.0, obey_at_s=asked).hardest_brake() > 3.0


def test_it_accelerates_first_where_the_limit_allows_and_changes_then() -> None:
    run = replay(0, 7.0, duration_s=45.0)
    asked, (right, _) = run.delayed_s(), run.aimed[1]
    assert run.speed_mps[round(asked * HZ)] == pytest.approx(7.0, abs=0.2)
    assert run.speed_mps[round(right * HZ)] == pytest.approx(8.0, abs=0.2)
    assert run.hardest_brake() <= 2.05
    assert [e.kind for _, e in run.events][-2:] == ["overridden", "fulfilled"]
