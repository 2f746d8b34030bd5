"""A scenario as SUMO's files: its lanes as a network, its cars as vehicles with drivers of SUMO's.

SUMO's y grows to the left, it numbers lanes from the right, and a vehicle's position is its front; its x is ours.
Several scenes lie side by side in one network, `APART_M` from each other, so that nobody sees another scene's cars.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from schemas.driving.measures import CAR_LENGTH_M
from sim_node.scenarios import Scenario
from sim_node.scenarios.manners import CAR_LENGTH
from sim_node.scenarios.scenario import LanePlan, Piece, Spawn

MODELS = {"Krauss": 'sigma="0.5"', "EIDM": 'sigmaerror="0" sigmagap="0" sigmaleader="0"'}
"""The drivers of the other cars, as SUMO has them; one is drawn for each, both alike often. Krauss' imperfection is the
usual one. EIDM has no errors: SUMO draws those of all cars from one generator, so that a seed's episode would depend on
how many others are driven beside it."""
FASTEST_MPS = 60.0
"""The lanes' limit in SUMO: how fast a car drives is its own wish."""
BEND_M = 2.0
"""A bend is drawn with a point each so far."""
WIDTH_M = 2.0
LEAD_IN_M = 500.0
"""The lanes begin so much before the scenario's: some cars start there."""
APART_M = 1000.0
Edge = tuple[str, str]
Edges = dict[Edge, list[tuple[int, Piece]]]


def _pieces(plan: LanePlan) -> list[Piece]:
    first = plan.pieces[0]
    return [replace(first, start_m=first.start_m - LEAD_IN_M), *plan.pieces[1:]]


def _edge(plan: LanePlan, piece: Piece) -> Edge:
    return piece.edge if plan.direction > 0 else (piece.edge[1], piece.edge[0])


def edges(scenario: Scenario) -> Edges:
    """The lanes of each of SUMO's edges, from right to left as SUMO numbers them: (scenario's lane, its piece)."""
    table: Edges = {}
    for lane, plan in enumerate(scenario.lanes):
        for piece in _pieces(plan):
            table.setdefault(_edge(plan, piece), []).insert(0, (lane, piece))
    return table


def lanes_count(scenario: Scenario) -> int:
    """How many lanes one scene has in SUMO, whose every edge has its own."""
    return sum(map(len, edges(scenario).values()))


def name_of(scene: int, edge: Edge) -> str:
    """SUMO's name of an edge; a lane's has `_` and its number after it."""
    return f"{scene}.{edge[0]}-{edge[1]}"


def place_y(scene: int, y: float) -> float:
    """Our y of a scene in SUMO's network."""
    return -y - APART_M * scene


def _shape(scene: int, piece: Piece, direction: int) -> str:
    n = max(2, math.ceil((piece.end_m - piece.start_m) / BEND_M)) if piece.amplitude_m else 2
    points = []
    for x in np.linspace(piece.start_m, piece.end_m, n):
        y = piece.y_m + piece.amplitude_m * math.sin(piece.pulsation * (x - piece.start_m) + piece.phase)
        points.append(f"{x:.3f},{place_y(scene, y):.3f}")
    return " ".join(points[::direction])


def network(scenario: Scenario, scenes: int = 1) -> str:
    """The lanes as a network of SUMO's, without internal lanes. An oncoming lane is its neighbour's opposite."""
    return f'<net version="1.20">{"".join(part for k in range(scenes) for part in _scene(scenario, k))}</net>'


def _scene(scenario: Scenario, scene: int) -> Iterator[str]:
    table = edges(scenario)
    names = {lane: f"{name_of(scene, e)}_{k}" for e, beside in table.items() for k, (lane, _) in enumerate(beside)}
    nodes: dict[str, tuple[float, float]] = {}
    incoming: dict[str, list[str]] = {}
    for edge, beside in table.items():
        name, lines = name_of(scene, edge), []
        for k, (lane, piece) in enumerate(beside):
            plan = scenario.lanes[lane]
            beside_us = [j for j in (lane - 1, lane + 1) if 0 <= j < len(scenario.lanes)]
            facing = [f'<neigh lane="{names[j]}"/>' for j in beside_us if scenario.lanes[j].direction != plan.direction]
            lines.append(
                f'<lane id="{name}_{k}" index="{k}" speed="{FASTEST_MPS}" length="{piece.end_m - piece.start_m:.3f}" '
                f'width="{plan.width_m}" shape="{_shape(scene, piece, plan.direction)}">'
                f"{''.join(facing)}</lane>"
            )
            begin, end = (piece.start_m, piece.end_m)[:: plan.direction]
            y = place_y(scene, piece.y_m)
            nodes[edge[0]], nodes[edge[1]] = (begin, y), (end, y)
            incoming.setdefault(edge[1], []).append(f"{name}_{k}")
        yield f'<edge id="{name}" from="{scene}.{edge[0]}" to="{scene}.{edge[1]}">{"".join(lines)}</edge>'
    for node, (x, y) in nodes.items():
        yield (
            f'<junction id="{scene}.{node}" type="unregulated" x="{x:.3f}" y="{y:.3f}" '
            f'incLanes="{" ".join(incoming.get(node, []))}" intLanes="" shape="{x:.3f},{y:.3f}"/>'
        )
    for lane, plan in enumerate(scenario.lanes):
        pieces = _pieces(plan)[:: plan.direction]
        for one, other in pairwise(pieces):
            first, second = _edge(plan, one), _edge(plan, other)
            yield (
                f'<connection from="{name_of(scene, first)}" to="{name_of(scene, second)}" '
                f'fromLane="{table[first].index((lane, one))}" toLane="{table[second].index((lane, other))}" '
                'dir="s" state="M"/>'
            )


def route(scenario: Scenario, table: Edges, lane: int, x: float) -> tuple[list[Edge], int, float]:
    """From x in a lane to the road's end: the edges, SUMO's number of the lane on the first, and the place there [m].

    A lane that ends is left for its neighbour. table: the scenario's `edges`.
    """
    plan = scenario.lanes[lane]
    pieces = _pieces(plan)[:: plan.direction]
    here = next(k for k, p in enumerate(pieces) if p.start_m <= x <= p.end_m)
    way = [_edge(plan, p) for p in pieces[here:]]
    number = table[way[0]].index((lane, pieces[here]))
    place = x - pieces[here].start_m if plan.direction > 0 else pieces[here].end_m - x
    last = plan.pieces[-1]
    for other in scenario.lanes:
        beside = any(p.edge == last.edge for p in other.pieces)
        if plan.direction > 0 and beside and other.pieces[-1].end_m > last.end_m:
            way += [_edge(other, p) for p in other.pieces if p.start_m >= last.end_m]
            break
    return way, number, place


def vehicles(scenario: Scenario, spawns: Sequence[Spawn], models: Sequence[Sequence[str]]) -> str:
    """The cars of a scene each, and each with a type of its own; the ego of scene k is "k.0".

    models: SUMO's car-following model of each. Who starts inside another's gap starts nevertheless, as it does
    elsewhere.
    """
    out, table = [], edges(scenario)
    for scene, spawn in enumerate(spawns):
        for i in range(len(spawn.x)):
            lane, length = int(spawn.lane[i]), float(spawn.manners[i][CAR_LENGTH]) if i else CAR_LENGTH_M
            way, number, place = route(scenario, table, lane, float(spawn.x[i]))
            model = models[scene][i]
            stays = "" if spawn.lane_changes[i] or i == 0 else ' lcStrategic="-1" lcSpeedGain="0" lcKeepRight="0"'
            out.append(
                f'<vType id="t{scene}.{i}" carFollowModel="{model}" {MODELS[model]} maxSpeed="{FASTEST_MPS}" '
                f'speedFactor="1" speedDev="0" length="{length}" width="{WIDTH_M}"{stays}/>'
                f'<vehicle id="{scene}.{i}" type="t{scene}.{i}" depart="0" departLane="{number}" '
                f'departPos="{place + 0.5 * length:.4f}" departSpeed="{float(spawn.speed[i]):.4f}" '
                f'insertionChecks="none"><route edges="{" ".join(name_of(scene, e) for e in way)}"/></vehicle>'
            )
    return f"<routes>{''.join(out)}</routes>"
