"""A road with another number of lanes."""

from __future__ import annotations

from dataclasses import replace

from sim_node.scenarios.scenario import Scenario

MOST = 8


def with_lanes(scenario: Scenario, lanes: int) -> Scenario:
    """The same road with so many lanes side by side, each with the traffic that the road has per lane.

    Raises ValueError for a road that is not made of equal lanes from end to end, and unless 1 <= lanes <= 8.
    """
    first, *others = scenario.lanes
    width = first.width_m
    equal = [
        replace(first, pieces=tuple(replace(piece, y_m=piece.y_m + k * width) for piece in first.pieces))
        for k in range(max(lanes, len(scenario.lanes)))
    ]
    made_here = type(scenario) is Scenario and all(isinstance(flow.lane, str) for flow in scenario.flows)
    if not others or tuple(equal[: len(scenario.lanes)]) != scenario.lanes or not made_here:
        raise ValueError(f"road {scenario.name!r} has the lanes that it has: another number is for highway roads")
    if not 1 <= lanes <= MOST:
        raise ValueError(f"lanes {lanes} is not within 1..{MOST}")
    every = tuple(range(lanes))
    return replace(scenario, lanes=tuple(equal[:lanes]), ego=replace(scenario.ego, lanes=every), wish_lanes=every)
