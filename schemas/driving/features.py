"""Observation and wish to policy input: the paper's o_t^i = (o_t^env, y_des), one code path for training and driving.

Plain arithmetic on sequences: driving runs it as it is on lists, training compiles it with numba unchanged.
Axes: V vehicles in, N rows out (the ego first, then the nearest), F features.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

N_ROWS = 15
FEATURES = (
    "presence",
    "is_ego",
    "dx",
    "dy",
    "dvx",
    "dvy",
    "oncoming",
    "closing",
    "y_des",
    "v_des",
    "headway",
    "set_point",
    "speed",
    "changing",
    "y_wished",
    "road_left",
)
"""dx/50, dy/4, dv/5 relative to the ego [m, m/s]; closing: 1/TTC [1/s]; y_des: wished minus own lateral position / 4
(for others 0: no prediction of their changes); v_des and set_point: minus own speed, / 5; headway [s] / 3; speed / 10;
changing: a lane change is under way; y_wished: whether any lane is wished (else y_des is 0); road_left: to the end of
the lane aimed for [m] / 100, at most 3."""
LAYOUT_HASH = hashlib.sha256(",".join((str(N_ROWS), *FEATURES)).encode()).hexdigest()[:16]

Array = NDArray[np.float32]
BOUND = 20.0
"""No feature is larger than this, whatever a message says."""


def policy_input(
    rows: Any,
    y_des: float,
    v_des: float,
    headway: float,
    set_point: float,
    changing: bool,
    road_left: float,
    order: Any,
    out: Any,
) -> None:
    """Fill `out` (N, F) from rows (V, 9) in `ROW_COLUMNS` and the wish; absent vehicles are zero rows.

    y_des [m] is nan where no lane is wished; v_des, set_point [m/s]; headway [s]; road_left [m]; order: (V,) working
    space of integers.
    """
    ego = rows[0]
    x, y, vx, vy = ego[1], ego[2], ego[3], ego[4]
    count = 0
    for i in range(1, len(rows)):  # by distance along the road; the simulator sends them nearly so
        if rows[i][0] < 0:
            continue
        away = abs(rows[i][1] - x)
        k = count
        while k > 0 and abs(rows[order[k - 1]][1] - x) > away:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        count += 1
    for k in range(len(out)):
        o = out[k]
        for f in range(len(o)):
            o[f] = 0.0
        if k == 0 or k > count:
            continue
        row = rows[order[k - 1]]
        dx, dvx = row[1] - x, row[3] - vx
        gap = max(abs(dx) - row[6], 1.0)
        closing = -dvx / gap if dx > 0.0 else dvx / gap
        o[0] = 1.0
        o[2] = min(max(dx / 50.0, -6.0), 6.0)
        o[3] = min(max((row[2] - y) / 4.0, -BOUND), BOUND)
        o[4] = min(max(dvx / 5.0, -10.0), 10.0)
        o[5] = min(max(row[4] - vy, -BOUND), BOUND)
        o[6] = 1.0 if row[3] < -0.1 else 0.0
        o[7] = min(max(closing, -2.0), 2.0)
        o[12] = min(max(row[3] / 10.0, -BOUND), BOUND)
    o = out[0]
    wished = math.isfinite(y_des)
    o[0] = o[1] = 1.0
    o[5] = min(max(vy, -BOUND), BOUND)
    o[8] = min(max((y_des - y) / 4.0, -BOUND), BOUND) if wished else 0.0
    o[9] = min(max((v_des - vx) / 5.0, -4.0), 4.0)
    o[10] = min(max(headway / 3.0, 0.0), BOUND)
    o[11] = min(max((set_point - vx) / 5.0, -4.0), 4.0)
    o[12] = min(max(vx / 10.0, -BOUND), BOUND)
    o[13] = 1.0 if changing else 0.0
    o[14] = 1.0 if wished else 0.0
    o[15] = min(max(road_left / 100.0, 0.0), 3.0)


def features(
    rows: Any,
    y_des: float,
    v_des: float,
    headway: float,
    set_point: float,
    changing: bool,
    road_left: float,
    n_rows: int = N_ROWS,
) -> Array:
    """`policy_input` as a new (n_rows, F) float32 array."""
    out = [[0.0] * len(FEATURES) for _ in range(n_rows)]
    policy_input(rows, y_des, v_des, headway, set_point, changing, road_left, [0] * len(rows), out)
    return np.array(out, np.float32)
