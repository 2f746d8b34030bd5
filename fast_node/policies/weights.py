"""What is known of a plan, weighed: names, weights by hand, and learnt ones in a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from schemas.driving.features import Array
from schemas.runtime.process import ConfigError

CHECKPOINTS = Path(__file__).parents[1] / "checkpoints"


class _File(Struct, frozen=True):
    weights: dict[str, float]


@dataclass(frozen=True)
class Described:
    """What is known of a plan, by name; a plan costs the sum of it, weighed. D: names."""

    names: tuple[str, ...]
    by_hand: dict[str, float]
    """The weights that are not 0."""
    shipped: Path
    """The weights that were learnt."""
    command: str
    """Writes such a file."""

    def in_order(self, weights: dict[str, float]) -> Array:
        """(D,) weights in the order of `names`; those that are left out are 0."""
        return np.array([weights.get(name, 0.0) for name in self.names], np.float32)

    def read(self, path: Path | None = None) -> Array:
        """(D,) the weights in a file of `fast_node.training.plan_weights`; None: the shipped ones. Raises
        `ConfigError`."""
        path = path or self.shipped
        try:
            found = msgspec.json.decode(path.read_bytes(), type=_File).weights
            if set(found) != set(self.names):
                raise ValueError(f"it weighs {', '.join(found)}, not {', '.join(self.names)}")
        except (OSError, ValueError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise ConfigError(f"{path} holds no weights of plans: {why}; `{self.command}` writes such a file") from None
        return self.in_order(found)
