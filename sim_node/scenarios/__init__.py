"""The scenarios by name. A module in this package with a `SCENARIOS` tuple is all that a new one takes."""

from __future__ import annotations

import importlib
import pkgutil

from sim_node.scenarios.scenario import Scenario


def _found() -> dict[str, Scenario]:
    table: dict[str, Scenario] = {}
    for module in pkgutil.iter_modules(__path__):
        for scenario in getattr(importlib.import_module(f"{__name__}.{module.name}"), "SCENARIOS", ()):
            if scenario.name in table:
                raise ValueError(f"two scenarios are called {scenario.name!r}: rename the one in {module.name}.py")
            table[scenario.name] = scenario
    return table


SCENARIOS: dict[str, Scenario] = _found()
__all__ = ["SCENARIOS", "Scenario"]
