"""Right on-ramp onto a two-lane highway: the paper's scenario (b), from the ramp, and a variant from the highway."""

from __future__ import annotations

import math
from dataclasses import replace

from sim_node.scenarios.scenario import EgoPlan, Flow, LanePlan, Piece, Range, Scenario, Success

AMPLITUDE_M = 3.25
"""The ramp swings in by twice this, as in highway-env's merge."""


def lanes(
    before_m: float, converge_m: float, parallel_m: float, after_m: float, limit_mps: float
) -> tuple[LanePlan, ...]:
    """Two through lanes and a ramp: straight, a half sine, then beside the highway until it ends."""
    opens, ends = before_m + converge_m, before_m + converge_m + parallel_m
    through = tuple(
        LanePlan(
            speed_limit_mps=limit_mps,
            pieces=(
                Piece(edge=("a", "b"), start_m=0.0, end_m=opens, y_m=y),
                Piece(edge=("b", "c"), start_m=opens, end_m=ends, y_m=y),
                Piece(edge=("c", "d"), start_m=ends, end_m=ends + after_m, y_m=y),
            ),
        )
        for y in (0.0, 4.0)
    )
    ramp = LanePlan(
        speed_limit_mps=limit_mps,
        kind="ramp",
        change_from_m=opens,
        pieces=(
            Piece(edge=("j", "k"), start_m=0.0, end_m=before_m, y_m=8.0 + 2 * AMPLITUDE_M),
            Piece(
                edge=("k", "b"),
                start_m=before_m,
                end_m=opens,
                y_m=8.0 + AMPLITUDE_M,
                amplitude_m=AMPLITUDE_M,
                pulsation=math.pi / converge_m,
                phase=math.pi / 2,
            ),
            Piece(edge=("b", "c"), start_m=opens, end_m=ends, y_m=8.0),
        ),
    )
    return (*through, ramp)


def through_traffic(lane: int, speed_mps: Range, target_mps: Range) -> Flow:
    """2 to 4 cars on one lane of the highway."""
    return Flow(
        lane=lane,
        count=(2, 4),
        start="at",
        first_m=(0.0, 25.0),
        gap_m=(8.0, 8.0),
        gap_s=(1.2, 3.0),
        speed_mps=speed_mps,
        target_mps=target_mps,
    )


def slow(lane: int, at_m: Range, speed_mps: Range, probability: float = 1.0) -> Flow:
    """One that keeps its lane and its speed: merging is not done with reaching the highway."""
    return Flow(
        lane=lane,
        count=(1, 1),
        start="at",
        first_m=at_m,
        gap_m=(0.0, 0.0),
        speed_mps=speed_mps,
        lane_changes=False,
        probability=probability,
    )


def stream(lane: int, count: tuple[int, int], gap_s: Range, speed_mps: Range) -> Flow:
    """Cars one behind the other, from far behind the ego on, that keep their lane."""
    return Flow(
        lane=lane,
        count=count,
        start="at",
        first_m=(-320.0, -300.0),
        gap_m=(7.0, 7.0),
        gap_s=gap_s,
        speed_mps=speed_mps,
        lane_changes=False,
    )


MERGE = Scenario(
    name="merge",
    description="from an on-ramp that ends onto a two-lane highway",
    lanes=lanes(150.0, 80.0, 120.0, 400.0, 20.0),
    ego=EgoPlan(lanes=(2,), x_m=(20.0, 60.0), speed_mps=(14.0, 17.0), speed_ceiling_mps=20.0),
    flows=(
        Flow(
            lane=2,
            count=(1, 1),
            start="ahead",
            first_m=(30.0, 50.0),
            gap_m=(0.0, 0.0),
            speed_mps=(13.5, 17.5),
            target_mps=(14.0, 18.0),
            probability=0.5,
        ),
        slow(0, (120.0, 150.0), (10.0, 11.0)),
        through_traffic(0, (13.5, 17.5), (14.0, 18.0)),
        through_traffic(1, (13.5, 17.5), (14.0, 18.0)),
    ),
    success=Success(reach_x_m=410.0, reach_lanes=(0, 1)),
    end_x_m=700.0,
    wish_lanes=(0, 1),
    obstacles=((2, 350.0),),
    connected_lanes=True,
)

NATURAL = replace(
    MERGE,
    name="merge-natural",
    speed_set="natural",
    starts_clear=True,
    lanes=lanes(200.0, 120.0, 220.0, 600.0, 30.0),
    ego=EgoPlan(lanes=(2,), x_m=(20.0, 60.0), speed_mps=(18.0, 22.0), speed_ceiling_mps=30.0),
    flows=(
        Flow(
            lane=2,
            count=(1, 1),
            start="ahead",
            first_m=(40.0, 70.0),
            gap_m=(0.0, 0.0),
            speed_mps=(18.0, 22.0),
            target_mps=(20.0, 25.0),
            probability=0.5,
        ),
        slow(0, (200.0, 240.0), (12.0, 14.0)),
        through_traffic(0, (21.0, 28.0), (21.0, 28.0)),
        through_traffic(1, (21.0, 28.0), (21.0, 28.0)),
    ),
    success=Success(reach_x_m=600.0, reach_lanes=(0, 1)),
    end_x_m=1050.0,
    obstacles=((2, 540.0),),
)

MAIN = replace(
    MERGE,
    name="merge-main",
    description="on the highway beside an on-ramp whose cars must come in, behind a slow car",
    ego=EgoPlan(lanes=(0, 1), x_m=(60.0, 80.0), speed_mps=(15.0, 17.0), speed_ceiling_mps=20.0),
    flows=(
        Flow(lane="ego", count=(1, 1), start="ahead", first_m=(25.0, 40.0), gap_m=(0.0, 0.0), speed_mps=(11.0, 13.0)),
        Flow(
            lane="ego",
            count=(1, 2),
            start="behind",
            first_m=(25.0, 35.0),
            gap_m=(20.0, 30.0),
            speed_mps=(13.5, 17.5),
            not_faster_than_ego=True,
        ),
        slow(0, (160.0, 180.0), (10.0, 11.0), probability=0.6),
        slow(1, (160.0, 180.0), (10.0, 11.0), probability=0.6),
        Flow(
            lane=2,
            count=(1, 2),
            start="at",
            first_m=(30.0, 90.0),
            gap_m=(25.0, 40.0),
            speed_mps=(13.5, 17.5),
            target_mps=(14.0, 18.0),
        ),
    ),
    success=Success(reach_x_m=410.0, reach_lanes=(0, 1), mean_speed_mps=10.0),
)

DENSE = replace(
    NATURAL,
    name="merge-dense",
    description="from an on-ramp into a continuous stream, in which a gap must be chosen early and its speed matched",
    lanes=lanes(200.0, 120.0, 110.0, 600.0, 25.0),
    ego=EgoPlan(lanes=(2,), x_m=(20.0, 60.0), speed_mps=(18.0, 22.0), speed_ceiling_mps=25.0),
    flows=(stream(0, (11, 14), (1.4, 2.6), (21.0, 22.5)), stream(1, (18, 20), (0.9, 1.7), (19.0, 21.0))),
    success=Success(reach_x_m=490.0, reach_lanes=(0, 1)),
    end_x_m=1050.0,
    obstacles=((2, 430.0),),
)

SCENARIOS = (MERGE, NATURAL, MAIN, DENSE)
