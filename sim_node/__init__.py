"""The simulator: roads, the ego's executor, and the process that ticks them at 15 Hz.

Importing the package registers the gymnasium environments (`sim_node:FastSlow-highway-v0`, one per scenario).
"""

from __future__ import annotations

import gymnasium

import sim_node.without_tables  # noqa: F401 - before the scenarios, which import highway-env
from sim_node.scenarios import SCENARIOS

for _name in SCENARIOS:
    if (_id := f"FastSlow-{_name}-v0") not in gymnasium.registry:
        gymnasium.register(id=_id, entry_point="sim_node.env:ScenarioEnv", kwargs={"scenario": _name})
