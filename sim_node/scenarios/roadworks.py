"""Three lanes of which the right one ends at roadworks: a scenario is one file like this, and nothing else."""

from __future__ import annotations

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Piece, Scenario, Success

LENGTH_M = 1500.0
WORKS_M = 500.0


def through(y_m: float) -> LanePlan:
    """A lane that passes the roadworks."""
    return LanePlan(
        speed_limit_mps=20.0,
        pieces=(
            Piece(edge=("a", "b"), start_m=0.0, end_m=WORKS_M, y_m=y_m),
            Piece(edge=("b", "c"), start_m=WORKS_M, end_m=LENGTH_M, y_m=y_m),
        ),
    )


ROADWORKS = Scenario(
    name="roadworks",
    description="three lanes, the right one ends at roadworks",
    lanes=(
        through(0.0),
        through(4.0),
        LanePlan(speed_limit_mps=20.0, pieces=(Piece(edge=("a", "b"), start_m=0.0, end_m=WORKS_M, y_m=8.0),)),
    ),
    ego=EgoPlan(lanes=(2,), x_m=(100.0, 140.0), speed_mps=(13.0, 16.0), speed_ceiling_mps=20.0),
    flows=(
        Flow(
            lane=0,
            count=(1, 1),
            start="at",
            first_m=(220.0, 260.0),
            gap_m=(0.0, 0.0),
            speed_mps=(9.0, 10.5),
            lane_changes=False,
        ),
        *(
            Flow(
                lane=lane,
                count=(3, 5),
                start="at",
                first_m=(30.0, 60.0),
                gap_m=(8.0, 8.0),
                gap_s=(1.0, 2.5),
                speed_mps=(12.0, 16.0),
                target_mps=(13.0, 18.0),
            )
            for lane in (0, 1)
        ),
    ),
    success=Success(reach_x_m=WORKS_M + 100.0, reach_lanes=(0, 1)),
    end_x_m=LENGTH_M - 100.0,
    wish_lanes=(0, 1),
    obstacles=((2, WORKS_M),),
    connected_lanes=True,
)

SCENARIOS = (ROADWORKS,)
