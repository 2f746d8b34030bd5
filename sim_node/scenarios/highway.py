"""Four-lane highway with a slow car ahead: the paper's scenario (a)."""

from __future__ import annotations

from dataclasses import replace

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Range, Scenario, Success, straight

LENGTH_M = 10_000.0


def lanes(limit_mps: float) -> tuple[LanePlan, ...]:
    """Four lanes side by side, 4 m apart."""
    return tuple(
        LanePlan(pieces=straight(("a", "b"), LENGTH_M, 4.0 * k), speed_limit_mps=limit_mps) for k in range(4))


def flows(speed_mps: Range, slow_mps: Range) -> tuple[Flow, ...]:
    """20 to 28 cars, a third of them behind: whoever stays in lane ends on the bumper of the first, slow one."""
    gaps: dict[str, Range] = {"gap_m": (10.0, 10.0), "gap_s": (2.5, 5.5)}
    eager = 1.0 / 0.9
    return (
        Flow(lane="ego", count=(1, 1), start="ahead", first_m=(25.0, 50.0), speed_mps=slow_mps, **gaps),
        Flow(lane="ego", count=(3, 4), start="ahead", first_m=(90.0, 140.0), speed_mps=speed_mps, eagerness=eager,
             **gaps),
        Flow(lane="ego", count=(1, 2), start="behind", first_m=(30.0, 60.0), speed_mps=speed_mps, eagerness=eager,
             not_faster_than_ego=True, **gaps),
        Flow(lane="others", count=(4, 5), start="ahead", first_m=(0.0, 50.0), speed_mps=speed_mps, eagerness=eager,
             **gaps),
        Flow(lane="others", count=(1, 2), start="behind", first_m=(25.0, 70.0), speed_mps=speed_mps, eagerness=eager,
             **gaps),
    )


HIGHWAY = Scenario(
    name="highway",
    description="four lanes, 20 to 28 cars, a slow one ahead",
    lanes=lanes(28.0),
    ego=EgoPlan(lanes=(0, 1, 2, 3), x_m=(600.0, 600.0), speed_mps=(22.0, 25.0), speed_ceiling_mps=28.0),
    flows=flows((19.8, 25.2), (19.5, 21.0)),
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
