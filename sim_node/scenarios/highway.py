"""Four-lane highway with a slow car ahead: the paper's scenario (a)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Range, Scenario, Success, straight

LENGTH_M = 10_000.0


def lanes(limit_mps: float) -> tuple[LanePlan, ...]:
    """Four lanes side by side, 4 m apart."""
    return tuple(
        LanePlan(pieces=straight(("a", "b"), LENGTH_M, 4.0 * k), speed_limit_mps=limit_mps) for k in range(4))


def flow(lane: Literal["ego", "others"], start: Literal["ahead", "behind"], count: tuple[int, int], first_m: Range,
         speed_mps: Range, eagerness: float = 1.0 / 0.9) -> Flow:
    """Cars 70 to 150 m apart that would like to go a ninth faster than they start."""
    return Flow(lane=lane, start=start, count=count, first_m=first_m, gap_m=(10.0, 10.0), gap_s=(2.5, 5.5),
                speed_mps=speed_mps, eagerness=eagerness, not_faster_than_ego=lane == "ego" and start == "behind")


def flows(speed_mps: Range, slow_mps: Range) -> tuple[Flow, ...]:
    """20 to 28 cars, a third of them behind: whoever stays in lane ends on the bumper of the first, slow one."""
    return (
        flow("ego", "ahead", (1, 1), (25.0, 50.0), slow_mps, eagerness=1.0),
        flow("ego", "ahead", (3, 4), (90.0, 140.0), speed_mps),
        flow("ego", "behind", (1, 2), (30.0, 60.0), speed_mps),
        flow("others", "ahead", (4, 5), (0.0, 50.0), speed_mps),
        flow("others", "behind", (1, 2), (25.0, 70.0), speed_mps),
    )


HIGHWAY = Scenario(
    name="highway",
    description="four lanes, 20 to 28 cars, a slow one ahead",
    lanes=lanes(28.0),
    ego=EgoPlan(lanes=(0, 1, 2, 3), x_m=(600.0, 600.0), speed_mps=(22.0, 25.0), speed_ceiling_mps=28.0),
    flows=flows((21.6, 25.2), (19.5, 21.0)),
    success=Success(mean_speed_mps=20.0),
    end_x_m=LENGTH_M - 1000.0,
    wish_lanes=(0, 1, 2, 3),
)

NATURAL = replace(
    HIGHWAY,
    name="highway-natural",
    speed_set="natural",
    lanes=lanes(33.0),
    ego=EgoPlan(lanes=(0, 1, 2, 3), x_m=(600.0, 600.0), speed_mps=(24.0, 29.0), speed_ceiling_mps=33.0),
    flows=flows((18.0, 29.7), (17.0, 20.0)),
    success=Success(mean_speed_mps=22.0),
)

SCENARIOS = (HIGHWAY, NATURAL)
