"""What stands of the passenger's wishes, and the car that one of them is about: the memory of the coordination."""

from __future__ import annotations

import math
from dataclasses import dataclass

from schemas.driving.intent import NORMAL, PASS_SIGHT_M, PASS_SIGHT_S, STYLES, ends_soon
from schemas.driving.road import ID, LANE_RAMP, LANE_WAY, NOBODY, VX, X, gap_between, has_passed, lead_id
from schemas.wire.messages import Directive

Rows = list[list[float]]
"""(V, 9): `ROW_COLUMNS`, the ego first."""
Lanes = list[tuple[float, ...]]
"""(L, 8): `schemas.driving.road.lane_table`."""

STANDING_MPS = 0.5
"""Who wishes for less speed than this wishes to stand."""
LOST_S = 1.0
"""The car to overtake is gone once it has not been seen for this long."""


@dataclass
class Standing:
    """What is wished, each part until another wish replaces it."""

    usual_mps: float
    """The speed without words."""
    speed_mps: float
    """inf: as fast as is allowed."""
    headway_s: float | None = None
    """None: the one of the style."""
    style: int = NORMAL
    lane: int | None = None
    """None: no lane is wished."""
    stopped: bool = False
    """To stop, or to go on standing; the speed is then what it is to be after that."""

    def take(self, directive: Directive) -> None:
        """Let a directive replace what it names.

        A cruise that names nothing is "normal again": all is as without words. A stop keeps the speed for afterwards;
        whatever else is wished then moves the car again, with that speed, or up to the limit where there was none. A
        lane stands until another lane, a speed, a stop or an overtake is wished: not until a gap is. The style "normal"
        is named only where a speed or a headway is: a lane alone leaves the style. The lane and the style of an
        overtake, and the style of a stop, belong to the manoeuvre, and end with it.
        """
        lane, speed, headway = directive.target_lane, directive.target_speed_mps, directive.headway_s
        speed = None if speed is None or math.isnan(speed) else speed
        headway = headway if headway is not None and 0.0 < headway < math.inf else None
        if headway is not None:
            self.headway_s = headway
        if directive.manoeuvre == "stop" or (speed is not None and speed < STANDING_MPS):
            self.stopped, self.lane = True, None
            return
        self.stopped = False
        names_nothing = lane is None and speed is None and headway is None and directive.style == "normal"
        if directive.manoeuvre == "cruise" and names_nothing:
            self.speed_mps, self.headway_s, self.style, self.lane = self.usual_mps, None, NORMAL, None
        if speed is not None:
            self.speed_mps = speed
        elif directive.manoeuvre == "overtake" or self.speed_mps < STANDING_MPS:
            self.speed_mps = math.inf
        if directive.manoeuvre == "overtake":
            self.lane = None
            return
        if lane is not None or speed is not None:
            self.lane = lane
        if directive.style != "normal" or speed is not None or headway is not None:
            self.style = STYLES[directive.style]


@dataclass
class Overtaken:
    """The car to overtake: the one ahead, near or far; whoever comes next where there is none yet."""

    seen_tick: int
    id: int = NOBODY
    passed: bool = False
    moved_over: bool = False
    """On a one-way road: the ego has been in the lane that was named to pass in."""
    behind: bool = False
    """Its centre was behind the ego's when it was seen last."""

    def look(self, rows: Rows, lane: int | None, tick: int, hz: int) -> None:
        """Find it, or another one in `lane` (None: no other). One that is not seen for a moment is waited for; one that
        is gone for good was passed if it was behind."""
        car = next((row for row in rows[1:] if self.id >= 0 and int(row[ID]) == self.id), None)
        if car is not None:
            self.seen_tick, self.passed, self.behind = tick, has_passed(rows[0], car), car[X] < rows[0][X]
        elif self.id >= 0 and tick - self.seen_tick < LOST_S * hz:
            return
        elif self.behind:
            self.passed = True
        else:
            self.id, self.seen_tick = NOBODY if lane is None else lead_id(rows, lane), tick

    def is_near(self, rows: Rows) -> bool:
        """Whether it, if it is there, is near enough to move over for it."""
        reach = max(PASS_SIGHT_M, PASS_SIGHT_S * rows[0][VX])
        return all(gap_between(rows[0], row) < reach for row in rows[1:] if int(row[ID]) == self.id)


def says_the_same(one: Directive, other: Directive) -> bool:
    """Whether two directives ask for the same; a cruise that holds a gap for the same as what has driven to it."""
    if "overtake" in (one.manoeuvre, other.manoeuvre):
        return one.manoeuvre == other.manoeuvre
    names = ("target_lane", "target_speed_mps", "headway_s", "style")
    return all(getattr(one, name) == getattr(other, name) for name in names)


def two_way(lanes: Lanes, home: int) -> bool:
    """Whether the lane to overtake in is an oncoming one."""
    return home > 0 and lanes[home - 1][LANE_WAY] < 0


def returns(directive: Directive, lanes: Lanes, home: int) -> bool:
    """Whether an overtake is the second half of one: the way home from the oncoming lane."""
    return directive.manoeuvre == "overtake" and directive.target_lane == home and two_way(lanes, home)


def goes_on(lanes: Lanes, lane: int, ego: list[float]) -> bool:
    """Whether a lane makes sense to be wished: it is there, of our direction, no ramp, and does not end soon."""
    if not 0 <= lane < len(lanes) or lanes[lane][LANE_WAY] < 0 or lanes[lane][LANE_RAMP]:
        return False
    return not ends_soon(lanes, lane, ego[X], ego[VX])
