"""How much room a scene leaves between the ego and the cars of its lane when it begins, by RSS."""

from __future__ import annotations

from schemas.driving.measures import CAR_LENGTH_M, rss_same_direction_m

START_BRAKE_MPS2 = 6.0
"""What whoever is in front may brake with from the first tick on; an ego that follows is sure of `EGO_SURE_MPS2`."""
EGO_SURE_MPS2, EGO_REACTION_S = 5.0, 2.0 / 15.0
FOLLOWER_REACTION_S, FOLLOWER_ACCEL_MPS2 = 0.8, 0.5
"""Of RSS at the start: what the mask's preset "sim" assumes."""
START_ROOM_M = 1.0
"""The mask wants so much more room to a leader."""


def start_clearance_m(speed_mps: float, ego_mps: float, *, ahead: bool) -> float:
    """How far a car in the ego's lane must be away at the start, centre to centre, for the one behind to be able to
    stop behind the one in front, by RSS."""
    if ahead:
        gap = rss_same_direction_m(ego_mps, speed_mps, EGO_REACTION_S, 0.0, EGO_SURE_MPS2, START_BRAKE_MPS2)
    else:
        gap = rss_same_direction_m(
            speed_mps, ego_mps, FOLLOWER_REACTION_S, FOLLOWER_ACCEL_MPS2, START_BRAKE_MPS2, START_BRAKE_MPS2
        )
    return CAR_LENGTH_M + START_ROOM_M + gap
