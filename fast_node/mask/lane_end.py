"""Claim: the ego never drives over the end of a lane: it has left the lane before, or comes to rest in it.

Assumed: the ego brakes with `ego_brake` after `reaction_s`, and moves out of a lane at no less than walking pace.
"""

from __future__ import annotations

import math
from typing import Any

from fast_node.mask.vocabulary import LANE_ENDS, OPEN, SPEEDS, Situation, back_action, close
from schemas.driving.road import HZ, LANE_END, LANE_Y, VX, X, Y

STOP_M = 20.0
"""Without a change the ego comes to rest this far before the end: from there it can still steer out of the lane."""
END_BRAKE = 1.2
"""Braking for the end of a lane: gently, and so early, since a slow ego has time to find a gap."""
END_M = 4.0
"""Nothing of the lane is used beyond this before its end: half a car, and what may stand there."""
OUT_M = 2.3
"""Aside from the lane's centre line by this much the ego is out of the way of what stands at its end."""
OUT_S, OUT_S_PER_M, OUT_M_PER_M = 0.4, 0.45, 2.2
"""To move out takes this long, and this much longer or farther for every metre that is left sideways."""


def speed_before_end(s: Situation) -> float:
    """The highest speed [m/s] from which the ego still comes gently to rest before its lane ends."""
    return speed_before(s.lanes, s.lane, s.rows[0][X])


def speed_before(lanes: Any, lane: int, x: float) -> float:
    """The same for a car at `x` [m] in `lane`."""
    return math.sqrt(2.0 * END_BRAKE * max(lanes[lane][LANE_END] - x - STOP_M, 0.0))


def stop_before_end(s: Situation, reasons: Any, vehicle: Any) -> None:
    """Close everything but a change and the emergency brake where the lane's end is as near as the ego needs to stop,
    and the way back into a lane that ends where there is no room to stop in it."""
    p, ego = s.preset, s.rows[0]
    x, v = ego[X], ego[VX]
    stop = v * p.reaction_s + v * v / (2.0 * p.ego_brake)
    must_stop = s.lanes[s.lane][LANE_END] - x < END_M + stop
    if s.previous >= 0 and s.lanes[s.previous][LANE_END] < s.lanes[s.lane][LANE_END]:
        # Out of the lane that ends before its end? Else stop there while that is possible. No way back beyond that.
        left = OUT_M - abs(ego[Y] - s.lanes[s.previous][LANE_Y])
        room = s.lanes[s.previous][LANE_END] - END_M - x
        late = left > 0.0 and room < max(v * (OUT_S + OUT_S_PER_M * left), OUT_M_PER_M * left)
        must_stop = must_stop or (late and stop <= room < stop + v / HZ + 1.0)
        back = back_action(s)
        if reasons[back] == OPEN and room < stop + v:
            reasons[back] = LANE_ENDS
    if must_stop:
        for a in SPEEDS:
            close(reasons, vehicle, a, LANE_ENDS, -1)
