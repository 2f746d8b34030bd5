"""The paper's case study, replayed: over at 1 s, beside at 3 s; asked home at 20 s, faster first, then home at 24 s.

On the paper's two-way road the follower is the car that has been passed: when the way home is asked for, it is 4 m
behind, and slower than the ego, for nobody else can be there. On a road of three lanes one way it is faster, as in the
paper: it has driven around what the ego has passed, and closes in at 26.4 m/s behind the ego's 24.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pytest
from msgspec import structs

from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policies.attention import load_attention
from schemas.driving.road import BEHIND_M
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import Directive, Event, MetaAction
from sim_node.config import SimConfig
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.highway import HIGHWAY
from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, straight

HZ = 15
pytestmark = pytest.mark.slow


def car(
    lane: int, start: Literal["ahead", "behind"], first_m: float, speed_mps: float, *, lane_changes: bool = False
) -> Flow:
    """One car; only when it considers a lane change is left to the seed."""
    return Flow(
        lane=lane,
        start=start,
        count=(1, 1),
        first_m=(first_m, first_m),
        gap_m=(0.0, 0.0),
        speed_mps=(speed_mps, speed_mps),
        lane_changes=lane_changes,
    )


FASTER_BEHIND = replace(
    HIGHWAY,
    name="faster-behind",
    lanes=tuple(LanePlan(pieces=straight(("a", "b"), 10_000.0, 4.0 * k), speed_limit_mps=28.0) for k in range(3)),
    ego=EgoPlan(lanes=(1,), x_m=(600.0, 600.0), speed_mps=(23.5, 23.5), speed_ceiling_mps=28.0),
    # The follower leaves the right lane for the slow car there, once the one that the ego has passed is behind it.
    flows=(car(1, "ahead", 70.0, 14.5), car(2, "behind", 123.0, 26.8, lane_changes=True), car(2, "ahead", 140.0, 22.0)),
    wish_lanes=(0, 1, 2),
    delta=(4.0, 4.0),
)


@dataclass(frozen=True)
class Case:
    """A road, and what the slow system asks for there."""

    scenario: str
    follower: int
    """The id of the car that the ego is to return before."""
    there: Directive
    """From 1 s on."""
    home_mps: float
    """With the request to return, the speed."""
    starts_home_mps: float
    """What the ego has reached by then."""
    asks: Callable[[float, float], bool]
    """(s, m): whether it asks home, at this time and with this gap to the follower."""
    first: Directive | None = None
    """Until then."""
    before: tuple[tuple[str, str | None], ...] = ()
    """Events until the way home is asked for, as `Replay.what` has them."""


TWO_WAY = Case(
    "two-way-case",
    1,
    Directive(
        epoch=1,
        stamp_ns=NS,
        id=1,
        command_id=1,
        scene_tick=HZ,
        manoeuvre="overtake",
        target_speed_mps=7.0,
        target_lane=0,
        ttl_s=60.0,
    ),
    home_mps=8.0,
    starts_home_mps=8.0,
    asks=lambda t, gap_m: gap_m > BEHIND_M,
)
ONE_WAY = Case(
    "faster-behind",
    2,
    Directive(
        epoch=1, stamp_ns=NS, id=1, command_id=1, scene_tick=HZ, target_speed_mps=24.0, target_lane=0, ttl_s=60.0
    ),
    home_mps=25.0,
    starts_home_mps=26.0,
    asks=lambda t, gap_m: t >= 20.0,
    first=Directive(epoch=1, stamp_ns=0, id=0, command_id=0, scene_tick=0, target_lane=1),
    before=(("fulfilled", None), ("fulfilled", None)),
)


@dataclass
class Replay:
    """One run, in seconds: when lanes were aimed for and reached, and what the follower did."""

    case: Case
    asked_s: float = float("nan")
    """When the slow system has asked to return."""
    aimed: list[tuple[float, int]] = field(default_factory=list)
    reached: list[tuple[float, int]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)
    speed_mps: list[float] = field(default_factory=list)
    follower_mps: list[float] = field(default_factory=list)

    def what(self) -> list[tuple[str, str | None]]:
        """Kind and reason of every event."""
        return [(e.kind, e.reason) for _, e in self.events]

    def ego_mps(self, at_s: float) -> float:
        """The ego's speed."""
        return self.speed_mps[round(at_s * HZ)]

    def closing_mps(self) -> float:
        """How much faster than the ego the follower is when the way home is asked for."""
        return self.follower_mps[round(self.asked_s * HZ)] - self.ego_mps(self.asked_s)

    def hardest_brake(self) -> float:
        """Of the follower [m/s2]."""
        return -float(np.diff(self.follower_mps).min()) * HZ


def replay(case: Case, seed: int, *, obey: bool = False, duration_s: float = 30.0) -> Replay:
    """Drive as the slow system directs.

    obey: go home when asked, whatever the mask says.
    """
    sim, fast = SimNode(SimConfig(scenario=case.scenario, seed=seed)), FastNode(FastConfig(), load_attention())
    sim.reset(1)
    seen, out, go = sim.observation(0), Replay(case), case.there
    home, lane, changing = seen.target_lane, seen.target_lane, False
    for k in range(round(duration_s * HZ)):
        now_ns, t = k * NS // HZ, k / HZ
        rows = rows_of(seen)
        follower = rows[rows[:, 0] == case.follower][0]
        action, events = fast.step(seen, go if t >= 1.0 else case.first, now_ns)
        if obey and t >= out.asked_s and seen.target_lane != home:
            action = structs.replace(action, meta_action=int(MetaAction.RIGHT))
        out.events += [(t, e) for e in events]
        out.speed_mps.append(float(rows[0, 3]))
        out.follower_mps.append(float(np.hypot(follower[3], follower[4])))
        if go.id == 1 and case.asks(t, rows[0, 1] - follower[1] - follower[6]):
            go = structs.replace(go, id=2, stamp_ns=now_ns, target_lane=home, target_speed_mps=case.home_mps)
            out.asked_s = t
        if seen.target_lane != lane:
            out.aimed.append((t, seen.target_lane))
        if changing and seen.previous_lane < 0:
            out.reached.append((t, seen.target_lane))
        lane, changing = seen.target_lane, seen.previous_lane >= 0
        seen = sim.step(action, now_ns)
    assert sim.metrics.collisions == 0
    return out


@pytest.fixture(scope="module", autouse=True)
def road() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SCENARIOS, FASTER_BEHIND.name, FASTER_BEHIND)
        yield


@pytest.fixture(
    scope="module",
    params=[(case, seed) for case in (TWO_WAY, ONE_WAY) for seed in range(10)],
    ids=lambda p: f"{p[0].scenario}-{p[1]}",
)
def run(request: pytest.FixtureRequest) -> Replay:
    return replay(*request.param)


def test_it_moves_over_at_one_second_and_is_beside_at_three(run: Replay) -> None:
    assert run.aimed[0] == (pytest.approx(1.0, abs=0.1), 0)
    assert run.reached[0] == (pytest.approx(3.0, abs=0.1), 0)


def test_asked_home_at_twenty_seconds_it_starts_at_twenty_two_and_is_home_at_twenty_four(run: Replay) -> None:
    assert run.asked_s == pytest.approx(20.0, abs=0.5)
    assert run.aimed[1:] == [(pytest.approx(22.4, abs=0.5), 1)]
    assert run.reached[1:] == [(pytest.approx(24.2, abs=0.5), 1)]


def test_on_the_road_of_one_way_the_follower_is_faster_than_the_ego_when_the_way_home_is_asked_for() -> None:
    assert replay(ONE_WAY, 0).closing_mps() > 2.0


def test_the_car_that_it_returns_before_never_brakes_harder_than_two_metres_per_second_squared(run: Replay) -> None:
    assert run.hardest_brake() <= 2.0


def test_between_request_and_return_it_accelerates_beyond_the_speed_that_it_had(run: Replay) -> None:
    assert run.ego_mps(run.asked_s) == pytest.approx(run.case.there.target_speed_mps, abs=0.2)
    assert run.ego_mps(run.aimed[1][0]) == pytest.approx(run.case.starts_home_mps, abs=0.4)


def test_the_request_is_delayed_overridden_by_accelerating_carried_out_and_fulfilled(run: Replay) -> None:
    rule = "rear gap in lane"
    assert run.what() == [
        *run.case.before,
        ("delayed", rule),
        ("overridden", rule),
        ("carried_out", rule),
        ("fulfilled", rule),
    ]


def test_the_delay_is_reported_with_its_length_when_it_ends(run: Replay) -> None:
    asked, *_, (ended_s, held), _ = run.events[len(run.case.before) :]
    assert asked[0] == pytest.approx(run.asked_s, abs=0.1)
    assert held.duration_s == pytest.approx(ended_s - asked[0], abs=0.01)
    assert run.aimed[1][0] == pytest.approx(ended_s, abs=0.1)


@pytest.mark.parametrize(("case", "brakes_mps2"), [(TWO_WAY, 3.0), (ONE_WAY, 2.0)], ids=["two-way", "one-way"])
def test_obeying_the_request_at_once_would_make_the_follower_brake_harder(case: Case, brakes_mps2: float) -> None:
    assert replay(case, 0, obey=True).hardest_brake() > brakes_mps2
