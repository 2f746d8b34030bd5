"""`fastslow train`: puts the batched worlds of the simulator and the learner of the fast system together."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

SCENES = 64
"""In all; shared among the scenarios."""


def train_policy(out: Path, scenarios: Sequence[str], steps: int, seed: int) -> dict[str, float]:
    """Train one policy on these scenarios and export it, with a progress bar on stderr.

    Raises ImportError without extra `train` and ValueError for an unknown scenario.
    """
    from deploy.evaluate import task_of
    from fast_node.training.rollout import Mixed, Scenes
    from fast_node.training.train import train
    from sim_node.engine.batched import Batched
    from sim_node.scenarios import SCENARIOS

    unknown = sorted(set(scenarios) - set(SCENARIOS))
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: choose from {', '.join(SCENARIOS)}")
    each = max(SCENES // len(scenarios), 1)
    parts = [
        Scenes(Batched(SCENARIOS[name], each, 10_000_000 + 1000 * seed + k), task_of(SCENARIOS[name]),
               1000 * seed + k)
        for k, name in enumerate(scenarios)
    ]
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=sys.stderr)) as bar:
        task = bar.add_task("learning", total=steps)

        def progress(done: int, figures: dict[str, float]) -> None:
            text = f"return {figures['episodic_return']:.2f} crashes {figures['crash_rate']:.1%}"
            bar.update(task, completed=done, description=text)

        return train(Mixed(parts), out, steps=steps, seed=seed, progress=progress)
