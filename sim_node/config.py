"""The simulator's configuration."""

from __future__ import annotations

import math
from typing import Literal

from schemas.driving.road import HZ
from schemas.runtime.process import NodeConfig
from sim_node.scenario_file import scenario_of
from sim_node.scenarios import SCENARIOS, Scenario


class SimConfig(NodeConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `python -m sim_node` takes."""

    scenario: str = "two-way"
    """A road's name, or that of a file whose text is `scenario_toml`."""
    scenario_toml: str = ""
    """The text, not the path: so a recording has all of the road, whatever becomes of the file."""
    sim: Literal["highway-env", "sumo"] = "highway-env"
    """Whose drivers are in the other cars."""
    seed: int = 0
    """Of the first episode; each further episode takes the next one."""
    duration_s: float | None = None
    """Stop by itself after this long; None: run until told to stop."""
    hz: int = HZ
    """Ticks per second; the contract's deadlines and the trained weights are for 15."""
    density: float = 1.0
    """Times the scenario's own."""
    traffic: tuple[str, ...] = ()
    """Other traffic, as `Scenario.varied` takes it."""
    noise_m: float = 0.0
    """Standard deviation of the error in the others' positions."""
    noise_mps: float = 0.0
    """Standard deviation of the error in the others' speeds."""
    dropout: float = 0.0
    """Chance that another car is missing from an observation."""
    budget_ms: float = 20.0
    """From an observation's publication: an action that comes later is not used. One may state a shorter budget."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed {self.seed} is negative")
        if self.duration_s is not None and not (self.duration_s > 0 and math.isfinite(self.duration_s)):
            raise ValueError(f"duration_s {self.duration_s} is not a positive number")
        if not (self.noise_m >= 0 and self.noise_mps >= 0 and 0 <= self.dropout < 1):
            raise ValueError("noise_m and noise_mps must not be negative, and dropout must be within 0..1")
        if not 1 <= self.hz <= 100:
            raise ValueError(f"hz {self.hz} is not within 1..100")
        if not 0 < self.budget_ms < 1000.0 / self.hz:
            raise ValueError(f"budget_ms {self.budget_ms} is not within 0..{1000.0 / self.hz:.1f}, one tick")
        self.road()

    def road(self) -> Scenario:
        """The scenario with this configuration's traffic. Raises ValueError where there is none."""
        if self.scenario_toml:
            scenario = scenario_of(self.scenario, self.scenario_toml)
        elif self.scenario in SCENARIOS:
            scenario = SCENARIOS[self.scenario]
        else:
            raise ValueError(f"scenario {self.scenario!r} is not one of: {', '.join(SCENARIOS)}")
        return scenario.varied(self.traffic, self.density)
