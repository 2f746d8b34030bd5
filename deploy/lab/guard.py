"""The safety mask as a guard of the gymnasium environments: `ScenarioEnv("merge", guard=safety_mask)`."""

from __future__ import annotations

from fast_node.mask import OPEN, PRESETS, close_actions, lane_table
from schemas.wire.messages import MetaAction
from sim_node.env import ScenarioEnv

_INSTEAD = (MetaAction.CRUISE, MetaAction.SLOW_DOWN, MetaAction.SPEED_UP, MetaAction.LEFT, MetaAction.RIGHT)


def safety_mask(env: ScenarioEnv, meta: int) -> int:
    """Caps the speed; the action itself if the mask leaves it open, else the mildest open one, else EMERGENCY_BRAKE."""
    ego, lanes = env.ego, lane_table(env.published_lanes())
    rule, vehicle = [0] * 6, [-1] * 6
    ego.speed_cap = close_actions(
        env.seen().tolist(),
        lanes,
        ego.target_speed,
        ego.target_lane,
        ego.previous_lane,
        env.scenario.sight_m,
        [0] * (3 * len(lanes)),
        rule,
        vehicle,
        PRESETS["sim"],
    )
    if rule[meta] == OPEN:
        return meta
    return next((int(a) for a in _INSTEAD if rule[a] == OPEN), int(MetaAction.EMERGENCY_BRAKE))
