"""One tick as a picture: the road from above, the cars, what the ego does and why. No screen, no window.

Drawn from the messages alone (`Observation`, and where there are any `Action` and `Directive`), so that the gymnasium
environments, films of lock-step runs and films of recordings show the same. Axes: x to the right along the ego's
direction, y down, as in the road frame. Colours are the paper's: the ego green, the others blue.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
import pygame

from schemas.driving.road import HEADING, ID, LANE, LENGTH, VX, WIDTH, X, Y, is_oncoming
from schemas.wire.codec import rows_of
from schemas.wire.messages import Action, Directive, Lane, MetaAction, Observation

SIZE = (960, 360)
"""Pixels: width and height of a picture."""
SMOOTH = 2
"""Everything is drawn this much larger and scaled down: smooth edges."""
EGO_AT = 0.32
"""The ego's place along the picture, as a share of its width."""
VIEW_S, VIEW_M = 4.5, (60.0, 130.0)
"""So many seconds of driving at the limit are in view, within these bounds [m]."""
LABEL = (196, 204, 212)
SIGNAL_TICKS = 5
"""A turn signal is on for so many ticks, and off for as many."""
BRAKE_LIGHT_MPS2 = -0.5

Colour = tuple[int, int, int]
GRASS, ASPHALT, ONCOMING, EDGE, DASH = (22, 30, 27), (52, 57, 64), (66, 52, 54), (214, 219, 224), (150, 156, 163)
EGO, OTHER, GLASS, SHADOW = (52, 199, 123), (92, 148, 232), (18, 24, 32), (14, 18, 20)
AMBER, RED, WHITE, GREY, PANEL, CHIP = (
    (255, 179, 46),
    (255, 84, 72),
    (240, 243, 246),
    (148, 157, 166),
    (13, 17, 21),
    (38, 45, 52),
)
CHIPS = (
    (MetaAction.LEFT, "left"),
    (MetaAction.SLOW_DOWN, "slower"),
    (MetaAction.CRUISE, "hold"),
    (MetaAction.SPEED_UP, "faster"),
    (MetaAction.RIGHT, "right"),
)
SOURCES = {
    "policy": "the policy",
    "masked": "the mask, against the policy",
    "coordination": "the directive",
    "fallback": "the fallback rule",
}
HEAD_PX, FOOT_PX = 54, 74


@dataclass(frozen=True)
class _Frame:
    """Where metres lie in the picture."""

    scale: float
    x_m: float
    """The road's x at the left edge."""
    y_m: float
    """The road's y at the top edge."""

    def at(self, x: float, y: float) -> tuple[float, float]:
        return (x - self.x_m) * self.scale, (y - self.y_m) * self.scale


def picture(
    observation: Observation,
    action: Action | None = None,
    directive: Directive | None = None,
    said: str = "",
    note: str = "",
) -> NDArray[np.uint8]:
    """(height, width, 3) of one tick. `said`: the passenger's last words; `note`: what has become of them."""
    rows = rows_of(observation).astype(float).tolist()
    width, height = (side * SMOOTH for side in SIZE)
    canvas = pygame.Surface((width, height))
    frame = _frame_of(observation, rows, width, height)
    canvas.fill(GRASS)
    for index, lane in enumerate(observation.lanes):
        _lane(canvas, frame, observation.lanes, index, lane)
    blamed = {c.vehicle for c in action.closed} if action else set()
    if observation.target_lane != int(rows[0][LANE]) or observation.previous_lane >= 0:
        _ghost(canvas, frame, rows[0], observation.lanes[observation.target_lane])
    for row in rows[1:]:
        _car(canvas, frame, row, OTHER, blamed=int(row[ID]) in blamed)
        _label(canvas, frame, row)
    _car(canvas, frame, rows[0], EGO)
    _lights(canvas, frame, rows[0], observation, action)
    _head(canvas, rows, observation, directive, said, note)
    _foot(canvas, observation, action)
    small = pygame.transform.smoothscale(canvas, SIZE)
    return np.ascontiguousarray(pygame.surfarray.array3d(small).swapaxes(0, 1))


def _frame_of(observation: Observation, rows: list[list[float]], width: int, height: int) -> _Frame:
    limit = observation.lanes[min(observation.target_lane, len(observation.lanes) - 1)].speed_limit_mps
    scale = width / min(max(VIEW_S * limit, VIEW_M[0]), VIEW_M[1])
    middle = 0.5 * (min(b.y_m for b in observation.lanes) + max(b.y_m for b in observation.lanes))
    room = (height - (HEAD_PX + FOOT_PX) * SMOOTH) / scale
    return _Frame(scale, rows[0][X] - EGO_AT * width / scale, middle - 0.5 * room - HEAD_PX * SMOOTH / scale)


def _lane(canvas: pygame.Surface, frame: _Frame, lanes: tuple[Lane, ...], index: int, lane: Lane) -> None:
    """One lane's asphalt, its right border, and, where it ends before the road, what closes it."""
    left, top = frame.at(lane.start_m, lane.y_m - 0.5 * lane.width_m)
    right, bottom = frame.at(lane.end_m, lane.y_m + 0.5 * lane.width_m)
    left, right = max(left, -10.0), min(right, canvas.get_width() + 10.0)
    if right <= left:
        return
    pygame.draw.rect(canvas, ONCOMING if lane.direction < 0 else ASPHALT, (left, top, right - left, bottom - top))
    thick = 3 * SMOOTH
    if index == 0 or lanes[index - 1].end_m < lane.end_m:
        pygame.draw.rect(canvas, EDGE, (left, top - thick / 2, right - left, thick))
    last = index + 1 == len(lanes)
    if last or lanes[index + 1].start_m > frame.x_m:
        pygame.draw.rect(canvas, EDGE, (left, bottom - thick / 2, right - left, thick))
    if not last:
        below = lanes[index + 1]
        beyond = min(frame.at(below.end_m, 0.0)[0], right)
        if beyond < right:
            pygame.draw.rect(canvas, EDGE, (max(beyond, left), bottom - thick / 2, right - max(beyond, left), thick))
        _dashes(canvas, frame, bottom, left, beyond, solid=below.direction != lane.direction)
    if lane.end_m < road_end_m(lanes):
        _barrier(canvas, frame, lane)


def road_end_m(lanes: tuple[Lane, ...]) -> float:
    """Where the longest lane ends [m]."""
    return max(lane.end_m for lane in lanes)


def _dashes(canvas: pygame.Surface, frame: _Frame, y: float, left: float, right: float, *, solid: bool) -> None:
    """The line between two lanes: 3 m on, 6 m off, fixed to the road; double and yellow between directions."""
    thick = max(2 * SMOOTH, 2)
    if solid:
        for shift in (-2 * SMOOTH, 2 * SMOOTH):
            pygame.draw.rect(canvas, AMBER, (left, y + shift - thick / 2, max(right - left, 0.0), thick))
        return
    pygame.draw.rect(canvas, ASPHALT, (left, y - thick, max(right - left, 0.0), 2 * thick))
    x = math.floor((frame.x_m + left / frame.scale) / 9.0) * 9.0
    while (start := frame.at(x, 0.0)[0]) < right:
        stop = min(frame.at(x + 3.0, 0.0)[0], right)
        if stop > left:
            pygame.draw.rect(canvas, DASH, (max(start, left), y - thick / 2, stop - max(start, left), thick))
        x += 9.0


def _barrier(canvas: pygame.Surface, frame: _Frame, lane: Lane) -> None:
    """Red and white boards across the end of a lane."""
    x, top = frame.at(lane.end_m, lane.y_m - 0.5 * lane.width_m)
    height = lane.width_m * frame.scale
    for k in range(6):
        colour = RED if k % 2 == 0 else WHITE
        pygame.draw.rect(canvas, colour, (x, top + k * height / 6, 1.2 * frame.scale, height / 6 + 1))


def _corners(frame: _Frame, row: list[float], grow: float = 0.0) -> list[tuple[float, float]]:
    half_l, half_w = 0.5 * row[LENGTH] + grow, 0.5 * row[WIDTH] + grow
    cos, sin = math.cos(row[HEADING]), math.sin(row[HEADING])
    return [
        frame.at(row[X] + a * half_l * cos - b * half_w * sin, row[Y] + a * half_l * sin + b * half_w * cos)
        for a, b in ((1, -1), (1, 1), (-1, 1), (-1, -1))
    ]


def _on_car(frame: _Frame, row: list[float], along: float, across: float) -> tuple[float, float]:
    """A place on a car: shares of its half length (front +1) and half width (right +1)."""
    cos, sin = math.cos(row[HEADING]), math.sin(row[HEADING])
    dx, dy = 0.5 * along * row[LENGTH], 0.5 * across * row[WIDTH]
    return frame.at(row[X] + dx * cos - dy * sin, row[Y] + dx * sin + dy * cos)


def _car(canvas: pygame.Surface, frame: _Frame, row: list[float], colour: Colour, *, blamed: bool = False) -> None:
    if blamed:
        pygame.draw.polygon(canvas, RED, _corners(frame, row, 0.45))
    pygame.draw.polygon(canvas, SHADOW, _corners(frame, row, 0.12))
    pygame.draw.polygon(canvas, colour, _corners(frame, row))
    front = 1.0 if not is_oncoming(row) or abs(row[HEADING]) > 1.0 else -1.0
    for near, far in ((0.18, 0.5), (-0.72, -0.5)):
        pygame.draw.polygon(
            canvas,
            GLASS,
            [
                _on_car(frame, row, front * near, -0.78),
                _on_car(frame, row, front * far, -0.66),
                _on_car(frame, row, front * far, 0.66),
                _on_car(frame, row, front * near, 0.78),
            ],
        )


def _ghost(canvas: pygame.Surface, frame: _Frame, ego: list[float], lane: Lane) -> None:
    """Where the ego means to be: an outline in the lane that it steers for."""
    aim = list(ego)
    aim[X], aim[Y], aim[HEADING] = ego[X] + max(1.2 * ego[VX], ego[LENGTH]), lane.y_m, 0.0
    pygame.draw.aalines(canvas, EGO, True, _corners(frame, aim))
    pygame.draw.polygon(canvas, EGO, _corners(frame, aim), width=2 * SMOOTH)
    pygame.draw.line(canvas, EGO, _on_car(frame, ego, 1.0, 0.0), _on_car(frame, aim, -1.0, 0.0), width=SMOOTH)


def _lights(
    canvas: pygame.Surface, frame: _Frame, ego: list[float], observation: Observation, action: Action | None
) -> None:
    braking = observation.acceleration_mps2 < BRAKE_LIGHT_MPS2 or (
        action is not None and action.meta_action == MetaAction.EMERGENCY_BRAKE
    )
    radius = 0.28 * frame.scale
    if braking:
        for side in (-0.75, 0.75):
            pygame.draw.circle(canvas, RED, _on_car(frame, ego, -0.97, side), 1.4 * radius)
    change = observation.target_lane - (observation.previous_lane if observation.previous_lane >= 0 else int(ego[LANE]))
    if change and observation.tick // SIGNAL_TICKS % 2 == 0:
        for along in (-0.92, 0.92):
            pygame.draw.circle(canvas, AMBER, _on_car(frame, ego, along, math.copysign(0.95, change)), radius * 1.3)


@cache
def _font(size: int) -> pygame.font.Font:
    pygame.font.init()
    return pygame.font.Font(None, size * SMOOTH)


def _text(
    canvas: pygame.Surface, text: str, x: float, y: float, size: int = 19, colour: Colour = WHITE, align: str = "left"
) -> float:
    """Write at (x, y), the text's left, right or centre and its middle; returns its width. Unscaled pixels."""
    drawn = _font(size).render(text, True, colour)
    w, h = drawn.get_size()
    shift = {"left": 0.0, "right": float(w), "center": 0.5 * w}[align]
    canvas.blit(drawn, (x * SMOOTH - shift, y * SMOOTH - 0.5 * h))
    return w / SMOOTH


def _label(canvas: pygame.Surface, frame: _Frame, row: list[float]) -> None:
    """A car's speed [m/s], behind it."""
    way = -1.0 if is_oncoming(row) else 1.0
    x, y = frame.at(row[X] - way * (0.5 * row[LENGTH] + 0.4), row[Y])
    if 0.0 < x < canvas.get_width():
        _text(
            canvas, f"{abs(row[VX]):.0f}", x / SMOOTH - 2 * way, y / SMOOTH, 16, LABEL, "right" if way > 0 else "left"
        )


def _head(
    canvas: pygame.Surface,
    rows: list[list[float]],
    observation: Observation,
    directive: Directive | None,
    said: str,
    note: str,
) -> None:
    """Speed and set-point; what was said and what it means now."""
    pygame.draw.rect(canvas, PANEL, (0, 0, canvas.get_width(), HEAD_PX * SMOOTH))
    speed = math.hypot(rows[0][VX], rows[0][VX + 1])
    limit = observation.lanes[min(int(rows[0][LANE]), len(observation.lanes) - 1)].speed_limit_mps
    end = 20 + _text(canvas, f"{speed:.1f}", 18, 28, 44)
    _text(canvas, "m/s", end + 6, 21, 16, GREY)
    _text(canvas, f"set {observation.target_speed_mps:.0f}, limit {limit:.0f}", end + 6, 36, 16, GREY)
    if said:
        _text(canvas, f"\u201c{said}\u201d" if len(said) < 70 else f"\u201c{said[:67]}...\u201d", 230, 18, 20)
    y = 38 if said else 28
    end = 230 + _text(canvas, meaning(directive), 230, y, 17, EGO if directive else GREY)
    _text(canvas, note, end + 18, y, 17, AMBER)
    _text(
        canvas,
        f"{observation.scenario}   {observation.tick / observation.hz:.1f} s",
        SIZE[0] - 18,
        28,
        18,
        GREY,
        "right",
    )


def meaning(directive: Directive | None) -> str:
    """A directive in a few words."""
    if directive is None:
        return "no directive"
    parts = [str(directive.manoeuvre)]
    if directive.target_lane is not None:
        parts.append(f"lane {directive.target_lane}")
    if directive.target_speed_mps is not None:
        parts.append(f"{directive.target_speed_mps:.0f} m/s")
    if directive.headway_s is not None:
        parts.append(f"{directive.headway_s:.1f} s behind")
    return ", ".join(parts)


def _foot(canvas: pygame.Surface, observation: Observation, action: Action | None) -> None:
    """The five actions: the one taken, those closed and why; who decided."""
    top = SIZE[1] - FOOT_PX
    pygame.draw.rect(canvas, PANEL, (0, top * SMOOTH, canvas.get_width(), FOOT_PX * SMOOTH))
    if action is None:
        return
    closed = {c.action: c for c in action.closed}
    wide, gap = 150, 12
    for k, (meta, name) in enumerate(CHIPS):
        x, y = 18 + k * (wide + gap), top + 10
        taken = action.meta_action == meta
        colour = EGO if taken else CHIP
        pygame.draw.rect(canvas, colour, (x * SMOOTH, y * SMOOTH, wide * SMOOTH, 30 * SMOOTH), border_radius=8 * SMOOTH)
        shut = meta in closed and not taken
        _text(canvas, name, x + wide / 2, y + 15, 20, PANEL if taken else RED if shut else WHITE, "center")
        if shut:
            why = closed[int(meta)]
            _text(
                canvas,
                f"{why.reason}{f' ({why.vehicle})' if why.vehicle >= 0 else ''}",
                x + wide / 2,
                y + 46,
                15,
                GREY,
                "center",
            )
    brake = action.meta_action == MetaAction.EMERGENCY_BRAKE
    who, _, against = ("EMERGENCY BRAKE" if brake else SOURCES.get(action.source, action.source)).partition(", ")
    _text(canvas, who, SIZE[0] - 18, top + 25, 17, RED if brake else GREY, "right")
    _text(canvas, against, SIZE[0] - 18, top + 46, 15, GREY, "right")
