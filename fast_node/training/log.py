"""The figures of every update: a CSV file, TensorBoard's event files where that is installed, and W&B's on request."""

from __future__ import annotations

import csv
import importlib.util
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

LOGGED = {
    "charts/episodic_return": "episodic_return",
    "charts/episodic_length": "episodic_length",
    "charts/crash_rate": "crash_rate",
    "charts/learning_rate": "learning_rate",
    "charts/SPS": "SPS",
    "losses/policy_loss": "policy_loss",
    "losses/value_loss": "value_loss",
    "losses/entropy": "entropy",
    "losses/approx_kl": "approx_kl",
    "losses/clipfrac": "clipfrac",
    "losses/explained_variance": "explained_variance",
    "losses/updates": "updates",
}
"""CleanRL's names of our figures, and two names of our own: charts/crash_rate and losses/updates.

Return [1], length [decisions] and crash rate are means of the last 200 episodes.
"""
OF_BASELINES = {name: LOGGED[name] for name in ("charts/episodic_return", "charts/crash_rate", "charts/SPS")}
"""What is known of a learner that is not ours."""
PROJECT = "fastslow"

Log = Callable[[int, dict[str, float]], None]
"""Takes the decisions so far and the figures."""


@contextmanager
def logged(
    out: Path, done: int, names: Mapping[str, str] = LOGGED, track: Mapping[str, Any] | None = None
) -> Iterator[Log]:
    """Writes the figures of every update to a CSV file and, where tensorboard is installed, for it as well.

    What an interrupted run wrote after it was last saved, at `done` decisions, is dropped: it is done again.

    track: what a W&B run is to know of this one; None: no W&B run. Raises ImportError for that without extra `track`.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as open_ones:
        logs = [_csv(out.with_suffix(".progress.csv"), done, names, open_ones)]
        if importlib.util.find_spec("tensorboard"):
            logs.append(_tensorboard(out.with_suffix(".tensorboard"), done, names, open_ones))
        if track is not None:
            logs.append(_wandb(out, names, track, open_ones))

        def log(step: int, figures: dict[str, float]) -> None:
            for one in logs:
                one(step, figures)

        yield log


def _csv(path: Path, done: int, names: Mapping[str, str], open_ones: ExitStack) -> Log:
    kept = [line for line in path.read_text().splitlines()[1:] if int(line.split(",")[0]) <= done] if done else []
    file = open_ones.enter_context(path.open("w", newline=""))
    rows = csv.writer(file)
    rows.writerow(["global_step", *names])
    rows.writerows(line.split(",") for line in kept)

    def log(step: int, figures: dict[str, float]) -> None:
        rows.writerow([step, *(f"{figures[k]:.6g}" for k in names.values())])
        file.flush()

    return log


def _tensorboard(folder: Path, done: int, names: Mapping[str, str], open_ones: ExitStack) -> Log:
    from torch.utils.tensorboard import SummaryWriter

    board = SummaryWriter(str(folder), purge_step=done)
    open_ones.callback(board.close)

    def log(step: int, figures: dict[str, float]) -> None:
        for name, k in names.items():
            board.add_scalar(name, figures[k], step)

    return log


def _wandb(out: Path, names: Mapping[str, str], facts: Mapping[str, Any], open_ones: ExitStack) -> Log:
    """Offline unless WANDB_MODE says otherwise: no account, nothing leaves the machine until `wandb sync`."""
    os.environ.setdefault("WANDB_MODE", "offline")
    os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
    import wandb

    settings = wandb.Settings(silent=True, disable_git=True, disable_code=True, x_disable_stats=True)
    run = wandb.init(project=PROJECT, name=out.stem, dir=str(out.parent), config=dict(facts), settings=settings)
    open_ones.callback(run.finish)

    def log(step: int, figures: dict[str, float]) -> None:
        run.log({name: figures[k] for name, k in names.items()}, step=step)

    return log
