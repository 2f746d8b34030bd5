"""The table of contents: every claim of the mask in turn, over one situation."""

from __future__ import annotations

from typing import Any

from fast_node.mask.changing import change_lanes, settle_change
from fast_node.mask.gaps import keep_below, keep_gaps, slow_firmly
from fast_node.mask.lane_end import speed_before_end, stop_before_end
from fast_node.mask.neighbours import survey
from fast_node.mask.passing import settle_pass
from fast_node.mask.vocabulary import LANE_ENDS, OPEN, SPEED_FOR_GAP, Preset, Situation
from schemas.driving.road import ID
from schemas.wire.messages import POLICY_ACTIONS


def close_actions(
    rows: Any,
    lanes: Any,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    sight: float,
    near: Any,
    reasons: Any,
    vehicle: Any,
    p: Preset,
) -> float:
    """Write the reason that closes each action (`OPEN`: none) and the vehicle's id; return the speed cap [m/s]: the
    highest speed that the cars ahead and the lane's end admit now, whatever the action (inf: they do not matter).

    rows: (V, 9) as `ROW_COLUMNS`, ego first, id < 0 for an absent vehicle; lanes: (L, 8) as `lane_table`; sight [m];
    near: (3 L,) output of `survey`; reasons, vehicle: (6,) outputs. EMERGENCY_BRAKE is always open. Vehicle -1 beside a
    reason: none that is seen, but the road itself, the change under way, or a car assumed beyond sight.
    """
    for a in range(len(reasons)):
        reasons[a], vehicle[a] = OPEN, -1
    road_end = survey(rows, lanes, near)
    s = Situation(rows, lanes, near, target_speed, target_lane, previous_lane, sight, road_end, p)
    change_lanes(s, reasons, vehicle)
    ceiling, lead = keep_gaps(s, reasons, vehicle)
    cap = min(ceiling, speed_before_end(s))
    if cap < ceiling:
        keep_below(s, cap, LANE_ENDS, -1, reasons, vehicle)
    else:
        keep_below(s, cap, SPEED_FOR_GAP, lead, reasons, vehicle)
    stop_before_end(s, reasons, vehicle)
    settle_change(s, reasons, vehicle)
    settle_pass(s, reasons, vehicle)
    for a in range(POLICY_ACTIONS):  # from row indices to ids
        if vehicle[a] >= 0:
            vehicle[a] = int(rows[int(vehicle[a])][ID])
    return slow_firmly(s, cap, reasons)
