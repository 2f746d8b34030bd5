"""Observation and intent to policy input: the paper's o_t^i = (o_t^env, y_des), one code path for training and driving.

Plain arithmetic on sequences: driving runs it as it is on lists, training compiles it with numba unchanged.
Axes: V vehicles in, N rows out (the ego first, then the nearest), F features.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.road import AGAINST_MPS, ID, LANE, LENGTH, VX, VY, X, Y

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
    "cap",
    "left_open",
    "right_open",
    "lane",
    "length",
    "opens",
    "ends",
    "aim_ends",
    "goal_left",
    "borrows",
)
"""dx/50, dy/4, dv/5 relative to the ego [m, m/s]; closing: 1/TTC [1/s]; y_des: intended minus own lateral position / 4
(for others 0: no prediction of their changes); v_des and set_point: minus own speed, / 5; headway [s] / 3; speed / 10;
changing: a lane change is under way; y_wished: whether any lane is intended (else y_des is 0); road_left: to the end of
the lane aimed for [m] / 100, at most 3; cap: the speed that is admitted now minus own speed, / 5; left_open,
right_open: whether a change to that side may begin; lane: intended lane minus the lane aimed for (0: none is intended),
for others their lane minus that one; length [m] / 10; opens, ends, aim_ends, goal_left: to where the lane aimed for may
be left, to its end, to that of the intended lane and to where the task ends [m], / 100, within 0..20; borrows: whether
the lane aimed for or the intended one is an oncoming one. Where no lane is intended, lane 0 stands for it in aim_ends
and borrows. For others, what is not said of them is 0."""
(
    PRESENCE,
    IS_EGO,
    DX,
    DY,
    DVX,
    DVY,
    ONCOMING,
    CLOSING,
    Y_DES,
    V_DES,
    HEADWAY,
    SET_POINT,
    SPEED,
    CHANGING,
    Y_WISHED,
    ROAD_LEFT,
    CAP,
    LEFT_OPEN,
    RIGHT_OPEN,
    LANE_OFF,
    LENGTH_10,
    OPENS,
    ENDS,
    AIM_ENDS,
    GOAL_LEFT,
    BORROWS,
) = range(len(FEATURES))


def layout_hash(features: int) -> str:
    """Of the layout that has the first `features` columns."""
    return hashlib.sha256(",".join((str(N_ROWS), *FEATURES[:features])).encode()).hexdigest()[:16]


LAYOUT_HASH = layout_hash(len(FEATURES))
LAYOUTS = {layout_hash(count): count for count in (19, len(FEATURES))}
"""How many columns a policy reads, by the layout that its checkpoint states: columns are only ever appended."""

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
    cap: float,
    left_open: bool,
    right_open: bool,
    lane: int,
    aim: int,
    opens: float,
    aim_ends: float,
    goal_left: float,
    borrows: bool,
    order: Any,
    out: Any,
) -> None:
    """Fill `out` (N, F), which comes zeroed, from rows (V, 9) in `ROW_COLUMNS` and the intent; absent vehicles stay
    zero rows.

    y_des [m] is nan where no lane is intended; v_des, set_point, cap (inf: none) [m/s]; headway [s]; road_left [m];
    lane: aimed for, aim: intended (`ANY_LANE`: none); opens, aim_ends, goal_left [m]: see `FEATURES`;
    order: (V,) working space of integers.
    """
    ego = rows[0]
    x, y, vx, vy = ego[X], ego[Y], ego[VX], ego[VY]
    count = 0
    for i in range(1, len(rows)):  # by distance along the road; the simulator sends them nearly so
        if rows[i][ID] < 0:
            continue
        away = abs(rows[i][X] - x)
        k = count
        while k > 0 and abs(rows[order[k - 1]][X] - x) > away:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        count += 1
    for k in range(1, min(count + 1, len(out))):
        o, row = out[k], rows[order[k - 1]]
        dx, dvx = row[X] - x, row[VX] - vx
        gap = max(abs(dx) - row[LENGTH], 1.0)
        closing = -dvx / gap if dx > 0.0 else dvx / gap
        o[PRESENCE] = 1.0
        o[DX] = min(max(dx / 50.0, -6.0), 6.0)
        o[DY] = min(max((row[Y] - y) / 4.0, -BOUND), BOUND)
        o[DVX] = min(max(dvx / 5.0, -10.0), 10.0)
        o[DVY] = min(max(row[VY] - vy, -BOUND), BOUND)
        o[ONCOMING] = 1.0 if row[VX] < AGAINST_MPS else 0.0
        o[CLOSING] = min(max(closing, -2.0), 2.0)
        o[SPEED] = min(max(row[VX] / 10.0, -BOUND), BOUND)
        o[LANE_OFF] = min(max(row[LANE] - lane, -BOUND), BOUND)
        o[LENGTH_10] = min(max(row[LENGTH] / 10.0, 0.0), BOUND)
    o = out[0]
    intended = math.isfinite(y_des)
    o[PRESENCE] = o[IS_EGO] = 1.0
    o[DVY] = min(max(vy, -BOUND), BOUND)
    o[Y_DES] = min(max((y_des - y) / 4.0, -BOUND), BOUND) if intended else 0.0
    o[V_DES] = min(max((v_des - vx) / 5.0, -4.0), 4.0)
    o[HEADWAY] = min(max(headway / 3.0, 0.0), BOUND)
    o[SET_POINT] = min(max((set_point - vx) / 5.0, -4.0), 4.0)
    o[SPEED] = min(max(vx / 10.0, -BOUND), BOUND)
    o[CHANGING] = 1.0 if changing else 0.0
    o[Y_WISHED] = 1.0 if intended else 0.0
    o[ROAD_LEFT] = min(max(road_left / 100.0, 0.0), 3.0)
    o[CAP] = min(max((cap - vx) / 5.0, -4.0), 4.0)
    o[LEFT_OPEN] = 1.0 if left_open else 0.0
    o[RIGHT_OPEN] = 1.0 if right_open else 0.0
    o[LANE_OFF] = aim - lane if intended else 0.0
    o[LENGTH_10] = min(max(ego[LENGTH] / 10.0, 0.0), BOUND)
    o[OPENS] = min(max(opens / 100.0, 0.0), BOUND)
    o[ENDS] = min(max(road_left / 100.0, 0.0), BOUND)
    o[AIM_ENDS] = min(max(aim_ends / 100.0, 0.0), BOUND)
    o[GOAL_LEFT] = min(max(goal_left / 100.0, 0.0), BOUND)
    o[BORROWS] = 1.0 if borrows else 0.0


def features(
    rows: Any,
    y_des: float,
    v_des: float,
    headway: float,
    set_point: float,
    changing: bool,
    road_left: float,
    cap: float = math.inf,
    left_open: bool = True,
    right_open: bool = True,
    lane: int = 0,
    aim: int = 0,
    opens: float = 0.0,
    aim_ends: float = math.inf,
    goal_left: float = math.inf,
    borrows: bool = False,
    n_rows: int = N_ROWS,
) -> Array:
    """`policy_input` as a new (n_rows, F) float32 array."""
    out = [[0.0] * len(FEATURES) for _ in range(n_rows)]
    policy_input(
        rows,
        y_des,
        v_des,
        headway,
        set_point,
        changing,
        road_left,
        cap,
        left_open,
        right_open,
        lane,
        aim,
        opens,
        aim_ends,
        goal_left,
        borrows,
        [0] * len(rows),
        out,
    )
    return np.array(out, np.float32)
