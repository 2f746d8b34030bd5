"""`fastslow train`: puts the batched world of the simulator and the learner of the fast system together."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

SCENES = 64


def train_two_way(out: Path, steps: int, seed: int) -> dict[str, float]:
    """Train and export the two-way policy, with a progress bar on stderr. Raises ImportError without extra `train`."""
    from fast_node.training.train import train
    from sim_node.engine.batched import LANES, BatchedTwoWay

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=sys.stderr)) as bar:
        task = bar.add_task("compiling", total=steps)

        def progress(done: int, figures: dict[str, float]) -> None:
            text = f"return {figures['episodic_return']:.2f} crashes {figures['crash_rate']:.1%}"
            bar.update(task, completed=done, description=text)

        return train(BatchedTwoWay(SCENES, seed), LANES, out, steps=steps, seed=seed, progress=progress)
