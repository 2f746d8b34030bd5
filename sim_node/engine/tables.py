"""highway-env's road network as arrays: L lanes in the order in which upstream walks its graph."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

LaneIndex = tuple[str, str, int]

X0, Y0, WAY, LENGTH, HEADING, WIDTH, LIMIT, AMPLITUDE, PULSATION, PHASE, FORBIDDEN = range(11)
"""Columns of `Roads.lanes`. WAY: +1 along x, -1 against it; LIMIT: nan without one; AMPLITUDE: 0 on straight lanes."""
FIRST, COUNT, LINKS, LINKS_END, NEXT, NEXT_END = range(6)
"""Columns of `Roads.graph`: first lane and number of lanes of its edge, its slices of `links` and of `nexts`."""
LINK_LANE, LINK_OFFSET = range(2)
"""Columns of `Roads.links`."""


class UnsupportedError(Exception):
    """The engine does not know this; upstream does."""


class Roads(NamedTuple):
    """What the kernel reads of a network."""

    lanes: NDArray[np.float64]
    """(L, 11) geometry and rules, SI units; see the column names."""
    graph: NDArray[np.int64]
    """(L, 6) structure; see the column names."""
    links: NDArray[np.float64]
    """(K, 2) where neighbours on a lane are searched: the lane, the offset of its longitudinal coordinate in m."""
    nexts: NDArray[np.int64]
    """(E, 2) the edges that follow a lane: FIRST lane and COUNT of lanes."""


class Tables(NamedTuple):
    """`Roads` and the way back to upstream's names."""

    roads: Roads
    indices: list[LaneIndex]
    lanes: list[Any]
    number: dict[LaneIndex, int]


def read(network: RoadNetwork, connected: bool) -> Tables:
    """The tables of `network`; connected: as `Road.neighbour_vehicles_connected_lanes`.

    Raises UnsupportedError for lanes that are neither straight nor sine, or that do not run along the x axis.
    """
    indices = list(network.lanes_dict())
    number = {index: k for k, index in enumerate(indices)}
    lanes = [network.get_lane(index) for index in indices]
    geometry = np.zeros((len(lanes), 11))
    graph = np.zeros((len(lanes), 6), np.int64)
    links: list[tuple[int, float]] = []
    nexts: list[tuple[int, int]] = []
    for k, ((start, end, i), lane) in enumerate(zip(indices, lanes, strict=True)):
        if type(lane) not in (StraightLane, SineLane):
            raise UnsupportedError(f"lanes of type {type(lane).__name__}")
        if lane.direction[1] != 0.0:
            raise UnsupportedError("lanes that do not run along the x axis")
        sine = (lane.amplitude, lane.pulsation, lane.phase) if isinstance(lane, SineLane) else (0.0, 0.0, 0.0)
        limit = np.nan if lane.speed_limit is None else lane.speed_limit
        geometry[k] = (
            *lane.start,
            lane.direction[0],
            lane.length,
            lane.heading,
            lane.width,
            limit,
            *sine,
            lane.forbidden,
        )
        row = graph[k]
        row[FIRST], row[COUNT] = number[start, end, 0], len(network.graph[start][end])
        row[LINKS] = len(links)
        links.append((k, 0.0))
        if connected:  # as Road.neighbour_vehicles, in its order
            for to, after in network.graph.get(end, {}).items():
                links.append((number[end, to, i if i < len(after) else 0], lane.length))
            for origin, edges in network.graph.items():
                if start in edges:
                    before = number[origin, start, i if i < len(edges[start]) else 0]
                    links.append((before, -lanes[before].length))
        row[LINKS_END] = len(links)
        row[NEXT] = len(nexts)
        nexts += [(number[end, to, 0], len(after)) for to, after in network.graph.get(end, {}).items()]
        row[NEXT_END] = len(nexts)
    roads = Roads(geometry, graph, np.array(links), np.array(nexts, np.int64).reshape(-1, 2))
    return Tables(roads, indices, lanes, number)
