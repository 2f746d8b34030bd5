"""The fast node's configuration."""

from __future__ import annotations

from fast_node.mask import PRESETS
from schemas.process import NodeConfig


class FastConfig(NodeConfig, frozen=True, kw_only=True):
    """`policy`: a checkpoint's path (default: the shipped one); `budget_ms`: published with each action;
    `mask_preset`: what the mask assumes of others (`mask.PRESETS`), which the policy must have been trained behind."""

    policy: str | None = None
    budget_ms: float = 20.0
    decision_ticks: int = 15
    default_headway_s: float = 1.5
    mask_preset: str = "sim"

    def __post_init__(self) -> None:
        if not 1.0 <= self.budget_ms <= 1000.0 / 15:
            raise ValueError(f"budget_ms must lie in 1..66.7, not {self.budget_ms}")
        if self.mask_preset not in PRESETS:
            raise ValueError(f"mask_preset {self.mask_preset!r} is not one of: {', '.join(PRESETS)}")
        if self.decision_ticks < 1:
            raise ValueError(f"decision_ticks must be at least 1, not {self.decision_ticks}")
