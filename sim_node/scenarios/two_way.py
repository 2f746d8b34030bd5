"""Two-way road: slow leads ahead, oncoming traffic in the lane to borrow: the paper's scenario (c)."""

from __future__ import annotations

from dataclasses import replace

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Range, Scenario, Success, straight


def lanes(length_m: float, limit_mps: float) -> tuple[LanePlan, ...]:
    """One lane each way; the left one is oncoming."""
    return (
        LanePlan(pieces=straight(("a", "b"), length_m, 0.0), speed_limit_mps=limit_mps, direction=-1, kind="oncoming"),
        LanePlan(pieces=straight(("a", "b"), length_m, 4.0), speed_limit_mps=limit_mps),
    )


def flow(
    lane: int,
    start: str,
    count: tuple[int, int],
    first_m: Range,
    gap_m: Range,
    speed_mps: Range,
    not_faster_than_ego: bool = False,
) -> Flow:
    """Cars that keep their lane and start with the speed they want."""
    return Flow(
        lane=lane,
        count=count,
        start=start,  # type: ignore[arg-type]
        first_m=first_m,
        gap_m=gap_m,
        speed_mps=speed_mps,
        not_faster_than_ego=not_faster_than_ego,
        lane_changes=False,
    )


TWO_WAY = Scenario(
    name="two-way",
    description="one lane each way, slow leads, oncoming traffic",
    lanes=lanes(3000.0, 8.0),
    # Far enough in that an oncoming car stays on the road for more than an episode.
    ego=EgoPlan(lanes=(1,), x_m=(400.0, 400.0), speed_mps=(5.0, 7.0), speed_ceiling_mps=8.0),
    flows=(
        flow(1, "ahead", (1, 2), (18.0, 30.0), (25.0, 45.0), (3.8, 4.8)),
        flow(1, "behind", (1, 1), (20.0, 40.0), (0.0, 0.0), (5.0, 7.0), not_faster_than_ego=True),
        flow(0, "ahead", (1, 2), (60.0, 140.0), (100.0, 200.0), (5.0, 7.0)),
    ),
    success=Success(pass_first_lead=True),
    end_x_m=2800.0,
    duration_s=60.0,
    sight_m=250.0,
)

NATURAL = replace(
    TWO_WAY,
    name="two-way-natural",
    speed_set="natural",
    starts_clear=True,
    lanes=lanes(5000.0, 25.0),
    ego=EgoPlan(lanes=(1,), x_m=(1500.0, 1500.0), speed_mps=(14.0, 18.0), speed_ceiling_mps=25.0),
    flows=(
        flow(1, "ahead", (1, 2), (50.0, 80.0), (120.0, 200.0), (11.0, 15.0)),
        flow(1, "behind", (1, 1), (50.0, 80.0), (0.0, 0.0), (18.0, 22.0), not_faster_than_ego=True),
        flow(0, "ahead", (1, 4), (150.0, 400.0), (100.0, 400.0), (18.0, 23.0)),
    ),
    end_x_m=4800.0,
    sight_m=600.0,
)

CASE = replace(
    TWO_WAY,
    name="two-way-case",
    description="the paper's case study: a clear oncoming lane, a lead that a hurried ego has passed after 20 s",
    # The lane to borrow has the lower limit: on the way home there is speed to gain.
    lanes=(*lanes(3000.0, 7.0)[:1], *lanes(3000.0, 8.0)[1:]),
    ego=EgoPlan(lanes=(1,), x_m=(400.0, 400.0), speed_mps=(4.8, 5.0), speed_ceiling_mps=8.0),
    flows=(
        flow(1, "ahead", (1, 1), (38.4, 39.0), (0.0, 0.0), (4.18, 4.22)),
        flow(1, "behind", (1, 1), (25.0, 35.0), (0.0, 0.0), (4.5, 5.0), not_faster_than_ego=True),
    ),
    sight_m=400.0,
)

SCENARIOS = (TWO_WAY, NATURAL, CASE)
