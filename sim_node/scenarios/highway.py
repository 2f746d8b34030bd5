"""Four-lane highway with a slow car ahead: the paper's scenario (a)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Range, Scenario, Success, straight

LENGTH_M = 10_000.0


def lanes(limit_mps: float) -> tuple[LanePlan, ...]:
    """Four lanes side by side, 4 m apart."""
    return tuple(LanePlan(pieces=straight(("a", "b"), LENGTH_M, 4.0 * k), speed_limit_mps=limit_mps) for k in range(4))


def flow(
    lane: Literal["ego", "others"],
    start: Literal["ahead", "behind"],
    count: tuple[int, int],
    first_m: Range,
    speed_mps: Range,
) -> Flow:
    """Cars 75 to 160 m apart that would like to go a ninth faster than they start."""
    return Flow(
        lane=lane,
        start=start,
        count=count,
        first_m=first_m,
        gap_m=(10.0, 10.0),
        gap_s=(3.0, 6.0),
        speed_mps=speed_mps,
        eagerness=1.0 / 0.9,
        not_faster_than_ego=lane == "ego" and start == "behind",
    )


def slow(lane: Literal["ego", "others"], first_m: Range, speed_mps: Range, probability: float = 1.0) -> Flow:
    """One that keeps its lane and its speed, as a truck does."""
    return Flow(
        lane=lane,
        start="ahead",
        count=(1, 1),
        first_m=first_m,
        gap_m=(0.0, 0.0),
        speed_mps=speed_mps,
        lane_changes=False,
        probability=probability,
    )


def flows(speed_mps: Range, slow_mps: Range) -> tuple[Flow, ...]:
    """20 to 28 cars, a quarter of them behind; the first ahead is slow, in the ego's lane and in half of the others."""
    return (
        slow("ego", (25.0, 50.0), slow_mps),
        flow("ego", "ahead", (3, 4), (90.0, 140.0), speed_mps),
        flow("ego", "behind", (1, 2), (30.0, 60.0), speed_mps),
        slow("others", (40.0, 110.0), slow_mps, probability=0.5),
        flow("others", "ahead", (4, 4), (130.0, 190.0), speed_mps),
        flow("others", "behind", (1, 2), (40.0, 100.0), speed_mps),
    )


HIGHWAY = Scenario(
    name="highway",
    description="four lanes, 20 to 28 cars, a slow one ahead",
    lanes=lanes(28.0),
    ego=EgoPlan(lanes=(0, 1, 2, 3), x_m=(600.0, 600.0), speed_mps=(23.5, 25.5), speed_ceiling_mps=28.0),
    flows=flows((21.6, 25.2), (21.0, 22.0)),
    success=Success(mean_speed_mps=20.0),
    end_x_m=LENGTH_M - 1000.0,
    wish_lanes=(0, 1, 2, 3),
)

NATURAL = replace(
    HIGHWAY,
    name="highway-natural",
    speed_set="natural",
    starts_clear=True,
    lanes=lanes(33.0),
    ego=EgoPlan(lanes=(0, 1, 2, 3), x_m=(600.0, 600.0), speed_mps=(24.0, 29.0), speed_ceiling_mps=33.0),
    flows=flows((18.0, 29.7), (18.0, 21.0)),
    success=Success(mean_speed_mps=18.0),  # in one scene of eight all four lanes have a lead of 18 to 21 m/s
)

SCENARIOS = (HIGHWAY, NATURAL)
