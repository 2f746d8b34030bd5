"""A recorded tick on the axes of a figure: the road from above, true to scale. Colours are the films'."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.driving.road import HEADING, ID, LANE, LENGTH, VX, WIDTH, X, Y, is_oncoming
from schemas.wire.codec import rows_of
from schemas.wire.messages import Observation
from sim_node.drawing import AMBER, EGO, OTHER, RED, VIEW_M, VIEW_S, Colour

BEHIND = 0.34
"""How much of the view lies behind the ego."""
MARGIN_M = 1.0
"""Beside the road."""


def shade(colour: Colour) -> tuple[float, ...]:
    """As matplotlib has it."""
    return tuple(part / 255 for part in colour)


View = tuple[float, float, float, float]
"""What is shown of a tick [m]: from x, to x, top y, bottom y."""


def view(observation: Observation) -> View:
    """As much as a driver looks at."""
    ego = rows_of(observation)[0]
    limit = observation.lanes[min(int(ego[LANE]), len(observation.lanes) - 1)].speed_limit_mps
    wide = min(max(VIEW_S * limit, VIEW_M[0]), VIEW_M[1])
    top = min(lane.y_m - 0.5 * lane.width_m for lane in observation.lanes) - MARGIN_M
    bottom = max(lane.y_m + 0.5 * lane.width_m for lane in observation.lanes) + MARGIN_M
    left = float(ego[X]) - BEHIND * wide
    return left, left + wide, top, bottom


def draw_road(
    axis: Any, observation: Observation, blamed: frozenset[int] = frozenset(), seen: View | None = None
) -> None:
    """Lanes, cars with their speeds, where the ego means to be; red edges around `blamed` cars. `seen`: what of it."""
    left, right, top, bottom = seen or view(observation)
    axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axis.grid(visible=False)
    axis.set_axis_off()
    for index, lane in enumerate(observation.lanes):
        _lane(axis, observation, index, max(lane.start_m, left), min(lane.end_m, right))
    rows = rows_of(observation)
    ego = rows[0]
    if observation.target_lane != int(ego[LANE]) or observation.previous_lane >= 0:
        aim = ego.copy()
        aim[X], aim[Y], aim[HEADING] = (
            ego[X] + max(1.2 * ego[VX], 1.4 * ego[LENGTH]), observation.lanes[observation.target_lane].y_m, 0.0
        )  # fmt: skip
        _box(axis, aim, facecolor="none", edgecolor=shade(EGO), linestyle="--", linewidth=1.0)
    for row in rows[1:]:
        edge = {"edgecolor": shade(RED), "linewidth": 1.6} if int(row[ID]) in blamed else {}
        if left - 3 < row[X] < right + 3:
            _box(axis, row, facecolor=shade(OTHER), **edge)
            _speed(axis, row)
    _box(axis, ego, facecolor=shade(EGO))


def _lane(axis: Any, observation: Observation, index: int, start: float, end: float) -> None:
    if end <= start:
        return
    lanes, lane = observation.lanes, observation.lanes[index]
    top, bottom = lane.y_m - 0.5 * lane.width_m, lane.y_m + 0.5 * lane.width_m
    ground = shade(AMBER) if lane.direction < 0 else "#7f868f"
    axis.fill_between([start, end], top, bottom, color=ground, alpha=0.2, linewidth=0)
    if index == 0:
        axis.plot([start, end], [top, top], color="black", linewidth=0.9, solid_capstyle="butt")
    below = lanes[index + 1] if index + 1 < len(lanes) else None
    shared = start if below is None else min(max(below.end_m, start), end)
    if below is not None and shared > start:
        if below.direction != lane.direction:
            axis.plot([start, shared], [bottom, bottom], color=shade(AMBER), linewidth=1.6)
        else:
            _dashes(axis, start, shared, bottom)
    if shared < end:
        axis.plot([shared, end], [bottom, bottom], color="black", linewidth=0.9, solid_capstyle="butt")


def _dashes(axis: Any, start: float, end: float, y: float) -> None:
    """The line between two lanes: 3 m on and 6 m off, fixed to the road."""
    marks = np.arange(math.floor(start / 9.0) * 9.0, end, 9.0)
    axis.hlines(
        np.full(len(marks), y),
        np.clip(marks, start, end),
        np.clip(marks + 3.0, start, end),
        color="black",
        linewidth=0.7,
    )


def _box(axis: Any, row: Any, **look: Any) -> None:
    from matplotlib.patches import Polygon

    cos, sin = math.cos(row[HEADING]), math.sin(row[HEADING])
    half_l, half_w = 0.5 * row[LENGTH], 0.5 * row[WIDTH]
    corners = [
        (row[X] + a * half_l * cos - b * half_w * sin, row[Y] + a * half_l * sin + b * half_w * cos)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    axis.add_patch(Polygon(corners, **{"edgecolor": "none", "linewidth": 0.0, "zorder": 3, **look}))


def _speed(axis: Any, row: Any) -> None:
    way = -1.0 if is_oncoming(row) else 1.0
    axis.text(
        row[X] - way * (0.5 * row[LENGTH] + 0.6),
        row[Y],
        f"{abs(row[VX]):.0f}",
        ha="right" if way > 0 else "left",
        va="center",
        fontsize=6.5,
        clip_on=True,
    )
