"""The figures of every update: a CSV file and, where tensorboard is installed, its event files."""

from __future__ import annotations

import contextlib
import csv
import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path

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


@contextlib.contextmanager
def logged(out: Path, done: int) -> Iterator[Callable[[int, dict[str, float]], None]]:
    """Writes the figures of every update to a CSV file and, where tensorboard is installed, for it as well.

    What an interrupted run wrote after it was last saved, at `done` decisions, is dropped: it is done again.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    path = out.with_suffix(".progress.csv")
    kept = [line for line in path.read_text().splitlines()[1:] if int(line.split(",")[0]) <= done] if done else []
    board = None
    if importlib.util.find_spec("tensorboard"):
        from torch.utils.tensorboard import SummaryWriter

        board = SummaryWriter(str(out.with_suffix(".tensorboard")), purge_step=done)
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["global_step", *LOGGED])
        rows.writerows(line.split(",") for line in kept)

        def log(step: int, figures: dict[str, float]) -> None:
            rows.writerow([step, *(f"{figures[k]:.6g}" for k in LOGGED.values())])
            file.flush()
            if board is not None:
                for name, k in LOGGED.items():
                    board.add_scalar(name, figures[k], step)

        try:
            yield log
        finally:
            if board is not None:
                board.close()
