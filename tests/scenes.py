"""Scenes made by hand: roads, vehicles, and what the simulator would say of them. The one builder of the tests.

A vehicle is a row in the columns of `messages.ROW_COLUMNS`. SI units; lane 0 is the leftmost, and lane k lies at
y = 4 k m unless a road says otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.driving import road
from schemas.wire.messages import ROW_COLUMNS, Directive, Lane, Observation

LANE_M = 4.0
FAR_M = 1e4
Row = list[float]


def lane(
    number: int = 0,
    *,
    oncoming: bool = False,
    ramp: bool = False,
    start_m: float = 0.0,
    end_m: float = FAR_M,
    limit_mps: float = 20.0,
    opens_m: float = -1e9,
    y_m: float | None = None,
) -> Lane:
    """Lane `number` of a road; nobody changes out of it before `opens_m`."""
    return Lane(
        y_m=LANE_M * number if y_m is None else y_m,
        start_m=start_m,
        end_m=end_m,
        direction=-1 if oncoming else 1,
        speed_limit_mps=limit_mps,
        kind="oncoming" if oncoming else "ramp" if ramp else "main",
        change_from_m=opens_m,
    )


TWO_WAY = (lane(0, oncoming=True, end_m=3000.0, limit_mps=8.0), lane(1, end_m=3000.0, limit_mps=8.0))
HIGHWAY = tuple(lane(k, end_m=9000.0, limit_mps=28.0) for k in range(4))
MERGE = (
    lane(0, end_m=750.0, limit_mps=20.0),
    lane(1, end_m=750.0, limit_mps=20.0),
    lane(2, end_m=350.0, limit_mps=20.0, ramp=True, opens_m=230.0),
)
ROADWORKS = (lane(0, end_m=3000.0, limit_mps=14.0), lane(1, end_m=600.0, limit_mps=14.0))


def car(
    number: int,
    x_m: float,
    lane: int,
    speed_mps: float,
    y_m: float | None = None,
    *,
    vy_mps: float = 0.0,
    heading_rad: float = 0.0,
    length_m: float = 5.0,
) -> Row:
    """The row of a vehicle, in the middle of its lane unless `y_m` says otherwise; 0 is the ego's number."""
    row = [0.0] * len(ROW_COLUMNS)
    row[road.ID], row[road.X], row[road.Y] = float(number), x_m, LANE_M * lane if y_m is None else y_m
    row[road.VX], row[road.VY], row[road.HEADING] = speed_mps, vy_mps, heading_rad
    row[road.LENGTH], row[road.WIDTH], row[road.LANE] = length_m, 2.0, float(lane)
    return row


def observation(*rows: Row, lanes: tuple[Lane, ...] = TWO_WAY, **fields: Any) -> Observation:
    """What the simulator says of such a scene, the ego's row first: at its set-points unless `fields` say otherwise."""
    ego = rows[0]
    return Observation(
        **{
            "epoch": 1,
            "stamp_ns": 0,
            "tick": 0,
            "scenario": "by hand",
            "lanes": lanes,
            "rows": np.array(rows, np.float32).tobytes(),
            "target_lane": int(ego[road.LANE]),
            "target_speed_mps": ego[road.VX],
            **fields,
        }
    )


def directive(**fields: Any) -> Directive:
    """A directive of the slow node in answer to command 4."""
    return Directive(**{"epoch": 1, "stamp_ns": 0, "id": 5, "command_id": 4, "scene_tick": 0, **fields})
