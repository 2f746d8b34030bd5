"""Observation and wish to policy input: the paper's o_t^i = (o_t^env, y_des), one code path for training and driving.

Axes: ... any leading batch axes, V vehicles in, N rows out (the ego first, then the nearest), F features.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

N_ROWS = 15
FEATURES = ("presence", "is_ego", "dx", "dy", "dvx", "dvy", "oncoming", "closing", "y_des", "v_des", "headway",
            "set_point", "speed", "changing", "y_wished", "road_left")
"""dx/50, dy/4, dv/5 relative to the ego [m, m/s]; closing: 1/TTC [1/s]; y_des: wished minus own lateral position / 4
(for others 0: no prediction of their changes); v_des and set_point: minus own speed, / 5; headway [s] / 3; speed / 10;
changing: a lane change is under way; y_wished: whether any lane is wished (else y_des is 0); road_left: to the end of
the lane aimed for [m] / 100, at most 3."""
LAYOUT_HASH = hashlib.sha256(",".join((str(N_ROWS), *FEATURES)).encode()).hexdigest()[:16]

BOUND = 20.0
"""No feature is larger than this, whatever a message says."""

Array = NDArray[np.float32]
Floats = NDArray[np.float64]


def policy_input(
    rows: Array, y_des: Floats, v_des: Floats, headway: Floats, set_point: Floats, changing: Floats, road_left: Floats,
    n_rows: int = N_ROWS,
) -> Array:
    """(..., V, 9) rows in `ROW_COLUMNS` and (...) wishes -> (..., n_rows, F) float32; absent vehicles are zero rows.

    y_des [m] is nan where no lane is wished; v_des, set_point [m/s]; headway [s]; changing 0 or 1; road_left [m].
    """
    ego = rows[..., :1, :]
    present = rows[..., 0] >= 0
    distance = np.where(present, np.abs(rows[..., 1] - ego[..., 1]), np.inf)
    distance[..., 0] = -1.0
    order = np.argsort(distance, axis=-1, kind="stable")[..., :n_rows]
    near = np.take_along_axis(rows, order[..., None], axis=-2)
    here = np.take_along_axis(present, order, axis=-1)
    out = np.zeros((*rows.shape[:-2], n_rows, len(FEATURES)), np.float32)
    dx = near[..., 1] - ego[..., 1]
    dvx = near[..., 3] - ego[..., 3]
    n = near.shape[-2]
    gap = np.maximum(np.abs(dx) - near[..., 6], 1.0)
    other = out[..., :n, :]
    other[..., 0] = 1.0
    other[..., 2] = np.clip(dx / 50.0, -6.0, 6.0)
    other[..., 3] = (near[..., 2] - ego[..., 2]) / 4.0
    other[..., 4] = np.clip(dvx / 5.0, -10.0, 10.0)
    other[..., 5] = near[..., 4] - ego[..., 4]
    other[..., 6] = near[..., 3] < -0.1
    other[..., 7] = np.clip(-dvx * np.sign(dx) / gap, -2.0, 2.0)
    other[..., 12] = near[..., 3] / 10.0
    out[..., :n, :] *= here[..., None]
    own = out[..., 0, :]
    wished = np.isfinite(y_des)
    own[..., 0] = own[..., 1] = 1.0
    own[..., 5] = rows[..., 0, 4]
    own[..., 8] = np.where(wished, y_des - rows[..., 0, 2], 0.0) / 4.0
    own[..., 9] = np.clip((v_des - rows[..., 0, 3]) / 5.0, -4.0, 4.0)
    own[..., 10] = headway / 3.0
    own[..., 11] = np.clip((set_point - rows[..., 0, 3]) / 5.0, -4.0, 4.0)
    own[..., 13] = changing
    own[..., 14] = wished
    own[..., 15] = np.clip(road_left / 100.0, 0.0, 3.0)
    return np.clip(out, -BOUND, BOUND, out=out)
