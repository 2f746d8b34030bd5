"""The slow and the fast node mean the same by the lane to go on in, on every road."""

from __future__ import annotations

import msgspec
import pytest

from fast_node.coordination import Coordination
from schemas.driving.road import lane_table
from schemas.wire.codec import rows_of
from sim_node.config import SimConfig
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS
from slow_node.planning.scene import encode_scene
from tests.scenes import directive


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_slow_nodes_scene_and_the_fast_nodes_intent_agree_on_the_home_lane(scenario: str) -> None:
    sim = SimNode(SimConfig(scenario=scenario))
    sim.reset(1)
    seen = sim.observation(0)
    for lane in range(len(seen.lanes)):
        rows = rows_of(seen).copy()
        rows[0, -1] = lane
        there = msgspec.structs.replace(seen, rows=rows.tobytes(), target_lane=lane)
        stop = directive(manoeuvre="stop")  # whoever is to stop goes home for it
        intent, _ = Coordination(1.5).intent(there, rows.tolist(), lane_table(there.lanes), stop, 0)
        assert encode_scene(there).home_lane == intent.lane, (scenario, lane)
