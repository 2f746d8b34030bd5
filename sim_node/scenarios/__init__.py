"""The scenarios by name."""

from __future__ import annotations

from sim_node.scenarios.two_way import TWO_WAY, TwoWay

Scenario = TwoWay

SCENARIOS: dict[str, Scenario] = {TWO_WAY.name: TWO_WAY}
