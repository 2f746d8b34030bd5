"""The fast node's configuration."""

from __future__ import annotations

from schemas.driving.road import DECISION_TICKS, HZ
from schemas.runtime.process import NodeConfig


class FastConfig(NodeConfig, frozen=True, kw_only=True):
    """`policy`: what drives, as `policies.load.load_policy` takes it; `budget_ms`: published with each action, and how
    long a policy of a stranger may think about a tick; `decision_ticks`: from one decision to the next."""

    policy: str = "fastslow"
    budget_ms: float = 20.0
    decision_ticks: int = DECISION_TICKS
    default_headway_s: float = 1.5

    def __post_init__(self) -> None:
        if not 1.0 <= self.budget_ms <= 1000.0 / HZ:
            raise ValueError(f"budget_ms must lie in 1..66.7, not {self.budget_ms}")
        if self.decision_ticks < 1:
            raise ValueError(f"decision_ticks must be at least 1, not {self.decision_ticks}")
