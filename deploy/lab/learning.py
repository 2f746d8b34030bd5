"""One training, by any learner, here or on another machine."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deploy.lab.farm import Farm
from deploy.lab.files import brought, put
from deploy.lab.teaching import teach_policy
from deploy.lab.training import train_baseline, train_policy


@dataclass(frozen=True, kw_only=True)
class Training:
    """Who learns what."""

    algorithm: str
    """ours, taught, or a baseline."""
    scenarios: tuple[str, ...]
    steps: int
    seed: int
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Of the learner's settings."""
    bare: bool = False
    """Of a baseline."""
    ours: Mapping[str, Any] = field(default_factory=dict)
    """What `train_policy` alone takes."""
    track: bool = False

    def run(self, out: Path) -> dict[str, float]:
        """Train, and export to `out`. The figures of the last update. Raises as the learners do."""
        place = (out, self.scenarios, self.steps, self.seed)
        if self.algorithm == "taught":
            return teach_policy(*place)
        if self.algorithm == "ours":
            return train_policy(*place, **self.ours, changes=self.changes, track=self.track)
        return train_baseline(self.algorithm, *place, bare=self.bare, changes=self.changes, track=self.track)


def run_away(training: Training, name: str) -> tuple[dict[str, float], dict[str, bytes]]:
    """The figures of a training, and its files by name."""
    with tempfile.TemporaryDirectory(prefix="fastslow-training-") as folder:
        figures = training.run(Path(folder) / name)
        return figures, brought(Path(folder))


def run_on(farm: Farm, training: Training, out: Path) -> dict[str, float]:
    """The figures of a training on another machine; its files are brought to `out` and beside it."""
    ((_, (figures, files)),) = farm.run(run_away, [(training, out.name)])
    put(files, out.parent, last=out.name)
    return figures
