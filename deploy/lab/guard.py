"""The safety mask as a guard of the gymnasium environments: `ScenarioEnv("merge", guard=safety_mask)`."""

from __future__ import annotations

import numpy as np

from fast_node.mask import OPEN, PRESETS, close_actions, lane_table
from schemas.driving.episode import replaced
from sim_node.env import ScenarioEnv


def safety_mask(env: ScenarioEnv, meta: int) -> int:
    """Caps the speed; the action itself if the mask leaves it open, else the mildest open one, else EMERGENCY_BRAKE."""
    ego, lanes = env.ego, lane_table(env.published_lanes())
    reasons, vehicle = [0] * 6, [-1] * 6
    ego.speed_cap = close_actions(
        env.seen().tolist(),
        lanes,
        ego.target_speed,
        ego.target_lane,
        ego.previous_lane,
        env.scenario.sight_m,
        [0] * (3 * len(lanes)),
        reasons,
        vehicle,
        PRESETS["sim"],
    )
    return int(replaced(np.array([meta]), np.array([reasons]) == OPEN)[0])
