"""The environments' ids: `fastslow/Highway-v0`, one per scenario."""

from __future__ import annotations

import gymnasium

from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.stock import KINDS

NAMESPACE = "fastslow"


def id_of(scenario: str) -> str:
    """`merge-natural` is `fastslow/MergeNatural-v0`; highway-env's own `merge-v0` is `fastslow/StockMerge-v0`."""
    words = (["stock"] if scenario in KINDS else []) + scenario.removesuffix("-v0").split("-")
    return f"{NAMESPACE}/{''.join(word.capitalize() for word in words)}-v0"


ENVIRONMENTS = {id_of(name): name for name in SCENARIOS}
"""Every id and its scenario."""


def register() -> None:
    """Make them known to `gymnasium.make` and `make_vec`; again does nothing."""
    for name, scenario in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="deploy.environments.single:DrivingEnv",
                vector_entry_point="deploy.environments.vector:DrivingVectorEnv",
                kwargs={"scenario": scenario},
            )
