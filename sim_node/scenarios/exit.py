"""An exit that must be reached from the fast lane through slower, denser ones: judgement gets there, not speed."""

from __future__ import annotations

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Piece, Range, Scenario, Success

LENGTH_M = 2500.0
EXIT_M = 1100.0


def lane(y_m: float) -> LanePlan:
    """One of three lanes to the end of the road."""
    return LanePlan(speed_limit_mps=30.0, pieces=(Piece(edge=("a", "b"), start_m=0.0, end_m=LENGTH_M, y_m=y_m),))


def stream(k: int, count: tuple[int, int], first_m: Range, gap_s: Range, speed_mps: Range) -> Flow:
    """Cars one behind the other in lane `k`, that stay in it."""
    return Flow(
        lane=k,
        count=count,
        start="at",
        first_m=first_m,
        gap_m=(8.0, 8.0),
        gap_s=gap_s,
        speed_mps=speed_mps,
        lane_changes=False,
    )


EXIT = Scenario(
    name="exit",
    description="from the fast lane to an exit, through two slower, denser lanes",
    lanes=(lane(0.0), lane(4.0), lane(8.0)),
    ego=EgoPlan(lanes=(0,), x_m=(200.0, 240.0), speed_mps=(26.0, 28.0), speed_ceiling_mps=30.0),
    flows=(
        stream(0, (1, 2), (330.0, 380.0), (2.0, 4.0), (26.0, 28.0)),
        stream(1, (9, 11), (20.0, 60.0), (1.6, 4.4), (23.5, 24.5)),
        stream(2, (10, 11), (20.0, 60.0), (1.6, 4.6), (20.5, 21.5)),
    ),
    success=Success(reach_x_m=EXIT_M, reach_lanes=(2,)),
    end_x_m=EXIT_M + 10.0,
    speed_set="natural",
    starts_clear=True,
    duration_s=60.0,
    wish_lanes=(2,),
)

SCENARIOS = (EXIT,)
