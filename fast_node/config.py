"""The fast node's configuration."""

from __future__ import annotations

from schemas.runtime.process import NodeConfig


class FastConfig(NodeConfig, frozen=True, kw_only=True):
    """`policy`: a checkpoint's path (default: the shipped one); `budget_ms`: published with each action."""

    policy: str | None = None
    budget_ms: float = 20.0
    decision_ticks: int = 15
    default_headway_s: float = 1.5

    def __post_init__(self) -> None:
        if not 1.0 <= self.budget_ms <= 1000.0 / 15:
            raise ValueError(f"budget_ms must lie in 1..66.7, not {self.budget_ms}")
        if self.decision_ticks < 1:
            raise ValueError(f"decision_ticks must be at least 1, not {self.decision_ticks}")
