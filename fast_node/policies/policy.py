"""The seam: what a policy is to the node that drives and to the scenes that evaluate. Nobody knows its concrete class.

Axes: ... any batch axes, N vehicle rows (`features.N_ROWS`, the ego first), F features (`features.FEATURES`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from schemas.driving.features import Array


class Policy(Protocol):
    """Anything with this one method can drive. It always drives behind the mask."""

    def logits(self, x: Array) -> Array:
        """(..., N, F) policy input -> (..., 5) preferences over SLOW_DOWN, CRUISE, SPEED_UP, LEFT and RIGHT.

        The open action with the largest preference is taken. Called where a decision is due, three times a second; a
        policy that may remember, at every tick.
        """
        ...


@dataclass
class NamedPolicy:
    """A policy with what the seam knows about it. It is itself a policy."""

    name: str
    policy: Policy
    mask_preset: str = "sim"
    """The preset of the mask that it was trained behind."""
    stateless: bool = True
    """Whether asking it once more changes nothing and costs little. Only such a policy takes part in rehearsals, is not
    asked in between its decisions, and is asked without a deadline."""
    sidecar: Mapping[str, object] = field(default_factory=dict)
    """What its training depended on; empty where it was not trained here."""

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        return self.policy.logits(x)
