"""Observation and wish to policy input: the paper's o_t^i = (o_t^env, y_dis), one code path for training and driving.

Axes: ... any leading batch axes, V vehicles in, N rows out (the ego first, then the nearest), F features.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

N_ROWS = 15
FEATURES = ("presence", "is_ego", "dx", "dy", "dvx", "dvy", "oncoming", "closing", "y_des", "v_des", "headway",
            "set_point", "speed", "changing")
"""dx/50, dy/4, dv/5 relative to the ego [m, m/s]; closing: 1/TTC [1/s]; y_des: wished minus own lateral position / 4
(for others 0: no prediction of their changes); v_des and set_point: minus own speed, / 5;
headway [s] / 3; speed / 10."""
LAYOUT_HASH = hashlib.sha256(",".join((str(N_ROWS), *FEATURES)).encode()).hexdigest()[:16]

Array = NDArray[np.float32]


def policy_input(
    rows: Array, y_des: NDArray[np.float64], v_des: NDArray[np.float64], headway: NDArray[np.float64],
    set_point: NDArray[np.float64], changing: NDArray[np.float64],
) -> Array:
    """(..., V, 9) rows in `ROW_COLUMNS` and (...) wishes -> (..., N_ROWS, F) float32; absent vehicles are zero rows."""
    ego = rows[..., :1, :]
    dx = rows[..., 1] - ego[..., 1]
    present = (rows[..., 0] >= 0) & (np.abs(dx) < 200.0)
    distance = np.where(present, np.abs(dx), np.inf)
    distance[..., 0] = -1.0
    order = np.argsort(distance, axis=-1, kind="stable")[..., :N_ROWS]
    near = np.take_along_axis(rows, order[..., None], axis=-2)
    here = np.take_along_axis(present, order, axis=-1)
    out = np.zeros((*rows.shape[:-2], N_ROWS, len(FEATURES)), np.float32)
    dx = near[..., 1] - ego[..., 1]
    dvx = near[..., 3] - ego[..., 3]
    n = near.shape[-2]
    gap = np.maximum(np.abs(dx) - near[..., 6], 1.0)
    other = out[..., :n, :]
    other[..., 0] = 1.0
    other[..., 2] = np.clip(dx / 50.0, -4.0, 4.0)
    other[..., 3] = (near[..., 2] - ego[..., 2]) / 4.0
    other[..., 4] = np.clip(dvx / 5.0, -4.0, 4.0)
    other[..., 5] = near[..., 4] - ego[..., 4]
    other[..., 6] = near[..., 3] < -0.1
    other[..., 7] = np.clip(-dvx * np.sign(dx) / gap, -2.0, 2.0)
    other[..., 12] = near[..., 3] / 10.0
    out[..., :n, :] *= here[..., None]
    own = out[..., 0, :]
    own[..., 0] = own[..., 1] = 1.0
    own[..., 5] = rows[..., 0, 4]
    own[..., 8] = (y_des - rows[..., 0, 2]) / 4.0
    own[..., 9] = np.clip((v_des - rows[..., 0, 3]) / 5.0, -4.0, 4.0)
    own[..., 10] = headway / 3.0
    own[..., 11] = np.clip((set_point - rows[..., 0, 3]) / 5.0, -4.0, 4.0)
    own[..., 13] = changing
    return out
