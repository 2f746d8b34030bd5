"""From logits and the mask to one action: what the intent rules out, how fast is comfortable, when to decide.

Plain arithmetic on sequences: the node runs it as it is, evaluation in many scenes compiles it with numba unchanged.
"""

from __future__ import annotations

import math
from typing import Any

from fast_node.mask.lane_end import speed_before
from fast_node.mask.vocabulary import AHEAD, BRAKE, CRUISE, LEFT, NOT_WISHED, OPEN, RIGHT, SLOW_DOWN, SPEED_UP
from schemas.driving.intent import ends_soon
from schemas.driving.measures import SPEED_STEP_MPS
from schemas.driving.road import DT_S, LANE, LANE_END, LANE_OPENS, LANE_WAY, VX, X, gap_between, lane_ends
from schemas.wire.messages import POLICY_ACTIONS

SOURCES = ("policy", "policy", "masked", "coordination")
HELD, DECIDED, MASKED, WISHED = range(4)
"""Who settled it: the last decision holds; the policy; the mask or the intent against the policy."""

HOLD_OFF_TICKS = 45
"""A lane that was left, or a change that was given up, is not taken up again for these 3 s."""

ENTER_S, SOON_S = 1.0, 1.0
"""A lane is entered by choice with at least this headway, the wished one if that is less, this long after now."""
MUST_S = 5.0
"""So long before its lane ends the ego takes the gap that is safe."""

STANDSTILL_M = 2.5
FOLLOW_GAIN_PER_S = 0.25
"""How much slower than its leader, or faster, the ego is for each metre that the gap is off: near the wished gap."""
APPROACH_MPS2 = (1.0, 1.5, 2.2)
"""By style: what closing in on a leader is braked with, far from the wished gap."""
DROP_BACK_MPS = 2.5
"""How much slower than a leader the ego drives to regain the wished headway, at most."""
COMFORT_BRAKE_MPS2, COMFORT_JERK_MPS3 = (1.5, 2.0, 3.0), (1.0, 1.5, 2.5)
"""By style: comfort asks for no harder braking, and not sooner; the mask's cap does."""


def hold_off(left_lane: int, ticks: int, target_lane: int, previous_lane: int) -> tuple[int, int]:
    """What lane is not entered again, and for how many ticks, a tick later: the one that a change leaves, or that is
    left by giving the change up. `ticks` <= 0: none.

    target_lane, previous_lane: the executor's, seen at this tick.
    """
    if previous_lane >= 0:
        return previous_lane, HOLD_OFF_TICKS
    return left_lane, ticks - 1


def comfortable_mps(
    rows: Any, near: Any, lanes: Any, target_lane: int, accel: float, speed_mps: float, headway_s: float, style: int
) -> float:
    """The speed [m/s] that the intent (speed_mps, headway_s, style) comes down to now: behind a leader, on a ramp, and
    reached without hard braking. accel: the ego's last acceleration [m/s2]."""
    ego = rows[0]
    wished = speed_mps
    lead = int(near[3 * target_lane + AHEAD])
    if lead >= 0 and int(rows[lead][LANE]) == target_lane:
        lead_mps = max(rows[lead][VX], 0.0)
        spare = gap_between(ego, rows[lead]) - STANDSTILL_M - headway_s * lead_mps
        wished = min(wished, lead_mps + closing_mps(spare, APPROACH_MPS2[style]))
    if lane_ends(lanes, target_lane):  # whoever comes fast to where it opens only has to brake there
        wished = min(wished, speed_before(lanes, target_lane, max(ego[X], lanes[target_lane][LANE_OPENS])))
    v = float(ego[VX])
    return max(wished, v - COMFORT_BRAKE_MPS2[style], v + min(accel, 0.0) - COMFORT_JERK_MPS3[style] * DT_S)


def closing_mps(spare: float, brake: float) -> float:
    """How much faster than its leader [m/s] the ego may be, `spare` metres before it is as near as wished, if it is to
    brake with `brake` [m/s2] at most."""
    if spare <= 0.0:
        return max(FOLLOW_GAIN_PER_S * spare, -DROP_BACK_MPS)
    soft = brake / FOLLOW_GAIN_PER_S
    return math.sqrt(2.0 * brake * spare + soft * soft) - soft


def narrow(
    reasons: Any,
    rows: Any,
    near: Any,
    lanes: Any,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    left_lane: int,
    lane: int,
    speed_mps: float,
    headway_s: float,
    cap_mps: float,
) -> None:
    """Close in `reasons` (6,), of what is safe, what the intent (lane, speed_mps, headway_s) rules out; something
    milder than braking stays open.

    rows, near, lanes and the set-points: as `mask.close_actions` has them. left_lane: not entered again yet (see
    `hold_off`), or -1; cap_mps: the speed that is admitted now.
    """
    ours = lanes[target_lane][LANE_WAY] > 0
    if previous_lane >= 0:
        if ours:  # what has begun is given up where the mask leaves nothing else
            close_unless_last(reasons, LEFT if previous_lane < target_lane else RIGHT)
    else:
        if reasons[LEFT] == OPEN and lanes[target_lane - 1][LANE_WAY] < 0 and lane != target_lane - 1:
            close_unless_last(reasons, LEFT)  # an oncoming lane is not borrowed unasked
        if ours and left_lane >= 0 and not lane_ends(lanes, target_lane):
            if left_lane == target_lane - 1:
                close_unless_last(reasons, LEFT)
            elif left_lane == target_lane + 1:
                close_unless_last(reasons, RIGHT)
        if ours:
            for side, aim in ((LEFT, target_lane - 1), (RIGHT, target_lane + 1)):
                if 0 <= aim < len(lanes) and not worth_entering(rows, near, lanes, target_lane, aim, headway_s):
                    close_unless_last(reasons, side)
        if go_there(reasons, lanes, target_lane, lane):
            return
        if ours and lane >= 0 and not lane_ends(lanes, target_lane):
            if lane >= target_lane:
                close_unless_last(reasons, LEFT)
            if lane <= target_lane:
                close_unless_last(reasons, RIGHT)
    if target_speed >= speed_mps or target_speed + SPEED_STEP_MPS > cap_mps:
        close_unless_last(reasons, SPEED_UP)


def worth_entering(rows: Any, near: Any, lanes: Any, lane: int, aim: int, headway_s: float) -> bool:
    """Whether lane `aim` goes on long enough, and leaves the ego room enough behind the next car there, unless its own
    lane ends soon."""
    ego, lead = rows[0], int(near[3 * aim + AHEAD])
    x, v = ego[X], ego[VX]
    if ends_soon(lanes, aim, x, v):
        return False
    if lead < 0 or (lane_ends(lanes, lane) and lanes[lane][LANE_END] - x < MUST_S * v):
        return True
    soon = gap_between(ego, rows[lead]) + SOON_S * (rows[lead][VX] - v)
    return bool(soon >= min(headway_s, ENTER_S) * v)


def close_unless_last(reasons: Any, action: int) -> None:
    """Close `action` for the intent, if the policy has another one."""
    if reasons[action] != OPEN:
        return
    for a in range(POLICY_ACTIONS):
        if a != action and reasons[a] == OPEN:
            reasons[action] = NOT_WISHED
            return


def go_there(reasons: Any, lanes: Any, target_lane: int, lane: int) -> bool:
    """Leave nothing open but the change towards the intended lane, if that is open and leads to a lane that does not
    end before the road does. Returns whether it is so."""
    if lane < 0 or lane == target_lane:
        return False
    side, aim = (LEFT, target_lane - 1) if lane < target_lane else (RIGHT, target_lane + 1)
    if reasons[side] != OPEN or lane_ends(lanes, aim):
        return False
    for a in range(POLICY_ACTIONS):
        if a != side and reasons[a] == OPEN:
            reasons[a] = NOT_WISHED
    return True


def choose(logits: Any, reasons: Any, due: bool, held: int) -> tuple[int, int]:
    """(meta-action, who settled it) from five logits and the reasons (6,) that close actions, `narrow` included.

    due: a decision is to be made; otherwise `held`, what the last one asks for meanwhile, goes on where it is open, and
    else what is nearest to it: the speed holds, falls, rises, and at last the lane is changed.
    """
    if not due:
        for a in (held, CRUISE, SLOW_DOWN, SPEED_UP, RIGHT, LEFT):
            if reasons[a] == OPEN:
                return a, HELD if a in (held, CRUISE) else WISHED if reasons[CRUISE] == NOT_WISHED else MASKED
        return BRAKE, MASKED
    wanted = 0
    best = -1
    for a in range(POLICY_ACTIONS):
        if logits[a] > logits[wanted]:
            wanted = a
        if reasons[a] == OPEN and (best < 0 or logits[a] > logits[best]):
            best = a
    if best < 0:
        return BRAKE, MASKED
    if best == wanted:
        return best, DECIDED
    return best, WISHED if reasons[wanted] == NOT_WISHED else MASKED
