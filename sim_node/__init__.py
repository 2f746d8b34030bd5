"""The simulator: the road, the ego's executor, and the process that ticks them at 15 Hz.

Importing the package registers the gymnasium environment `FastSlow-two-way-v0`; highway-env is loaded when it is made.
"""

from __future__ import annotations

import gymnasium

ENV_ID = "FastSlow-two-way-v0"

if ENV_ID not in gymnasium.registry:
    gymnasium.register(id=ENV_ID, entry_point="sim_node.env:TwoWayEnv")
