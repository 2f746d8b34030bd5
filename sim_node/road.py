"""A scenario's lanes: as highway-env's graph, and where they lie beside a point."""

from __future__ import annotations

import math

from highway_env.road.lane import LineType, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from schemas.wire.messages import Lane
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import LEFT_ROAD_M, Piece, centre_line


class LaneMap:
    """Where a scenario's lanes lie; asked at every tick for every vehicle."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._pieces = scenario.pieces().tolist()
        self._ends = [(plan.pieces[0].start_m, plan.pieces[-1].end_m) for plan in scenario.lanes]
        curved = any(len({p.y_m for p in plan.pieces}) > 1 for plan in scenario.lanes)
        self._straight = None if curved else scenario.lanes_at(0.0)

    def lane_at(self, x_m: float, y_m: float) -> int:
        """Index of the lane whose centre line is nearest, among those that exist at `x_m`."""
        best, nearest = 0, math.inf
        for lane, (start, end) in enumerate(self._ends):
            away = abs(self.centre(lane, x_m)[0] - y_m)
            if away < nearest and start <= x_m <= end:
                best, nearest = lane, away
        return best

    def centre(self, lane: int, x_m: float) -> tuple[float, float]:
        """The centre of `lane` at `x_m` and its heading there (rad)."""
        return centre_line(self._pieces, lane, x_m)

    def published(self, x_m: float) -> tuple[Lane, ...]:
        """The lanes as they are published to an ego at `x_m`."""
        return self._scenario.lanes_at(x_m) if self._straight is None else self._straight


def has_left(scenario: Scenario, vehicle: Vehicle) -> bool:
    """Whether a vehicle is so near to the end of its road that it counts as gone."""
    x = vehicle.position[0]
    if math.cos(vehicle.heading) > 0:
        return not x < scenario.road_end_m - LEFT_ROAD_M
    return not x > LEFT_ROAD_M


def network(scenario: Scenario) -> RoadNetwork:
    """The scenario's lanes as highway-env's graph; an oncoming lane is on the map in both directions."""
    solid, striped, none = LineType.CONTINUOUS_LINE, LineType.STRIPED, LineType.NONE
    net = RoadNetwork()
    last = len(scenario.lanes) - 1
    for k, plan in enumerate(scenario.lanes):
        limit, width = plan.speed_limit_mps, plan.width_m
        for piece in plan.pieces:
            alone = not any(p.edge == piece.edge for j, o in enumerate(scenario.lanes) for p in o.pieces if j != k)
            lines = (solid if k == 0 or alone else striped, solid if k == last or alone else none)
            forbidden = plan.kind == "ramp" or piece.end_m <= plan.change_from_m
            ends = [piece.start_m, piece.y_m], [piece.end_m, piece.y_m]
            if piece.amplitude_m:
                lane = SineLane(*ends, piece.amplitude_m, piece.pulsation, piece.phase, width, lines, forbidden, limit)
            else:
                lane = StraightLane(*ends, width, lines, forbidden, limit)
            net.add_lane(*piece.edge, lane)
            if plan.direction < 0:
                back = StraightLane(ends[1], ends[0], width, (none, none), forbidden, limit)
                net.add_lane(piece.edge[1], piece.edge[0], back)
    return net


def lane_index(scenario: Scenario, lane: int, x_m: float) -> tuple[str, str, int]:
    """highway-env's index of the piece of `lane` at `x_m`."""
    plan = scenario.lanes[lane]
    piece: Piece = next((p for p in reversed(plan.pieces) if x_m >= p.start_m), plan.pieces[0])
    if plan.direction < 0:
        edge = (piece.edge[1], piece.edge[0])
        same = [k for k, o in enumerate(scenario.lanes) if o.direction < 0]
    else:
        edge = piece.edge
        same = [k for k, o in enumerate(scenario.lanes) if any(p.edge == piece.edge for p in o.pieces)]
    return (*edge, same.index(lane))
