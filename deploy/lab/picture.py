"""One way to draw: no window, one look for all pictures, and the file closed at the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LOOK = {
    "font.size": 9.0,
    "axes.titlesize": "medium",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": "small",
    "svg.fonttype": "path",
    "svg.hashsalt": "fastslow",
}
COLOURS = {"ours": "#d62f3f", "ppo": "#3b82c4", "dqn": "#2f9e62", "a2c": "#e08a1e", "idm": "#8a8f98", "rule": "#8f63c7"}
"""Of who drives. All are seen on white and on black, and told apart by the colour-blind beside one another."""
OTHERS = ("#5aa6b8", "#b5739d", "#a08a3c", "#6f7bd0")


def colour_of(agent: str, others: list[str]) -> str:
    """An agent's colour: its algorithm's, or the next free one for the `others`, in their order."""
    known = COLOURS.get(agent.split("-")[0].split(" ")[0])
    return known or OTHERS[others.index(agent) % len(OTHERS)]


@contextmanager
def picture(path: Path, rows: int = 1, columns: int = 1, *, dpi: int = 120, **more: Any) -> Iterator[tuple[Any, Any]]:
    """A figure and its (rows, columns) axes with light grids, written to `path` when the block has ended well.

    As PNG; as SVG, without a background, where `path` ends so. `more`: as `matplotlib.pyplot.subplots` takes it.
    Raises ImportError without matplotlib.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    svg = path.suffix == ".svg"
    with mpl.rc_context(LOOK):
        figure, axes = plt.subplots(rows, columns, squeeze=False, **{"layout": "tight", **more})
        try:
            for axis in axes.flat:
                axis.grid(alpha=0.3)
            yield figure, axes
            if svg:
                figure.savefig(path, format="svg", transparent=True, metadata={"Date": None})
            else:
                figure.savefig(path, dpi=dpi, format="png")
        finally:
            plt.close(figure)
