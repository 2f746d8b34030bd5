"""One way to draw: no window, one size of text and line for all pictures, and the file closed at the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def picture(path: Path, rows: int = 1, columns: int = 1, *, dpi: int = 120, **more: Any) -> Iterator[tuple[Any, Any]]:
    """A figure and its (rows, columns) axes with light grids, written to `path` as PNG when the block has ended well.

    `more`: as `matplotlib.pyplot.subplots` takes it. Raises ImportError without matplotlib.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(rows, columns, squeeze=False, **{"layout": "tight", **more})
    try:
        for axis in axes.flat:
            axis.grid(alpha=0.3)
        yield figure, axes
        figure.savefig(path, dpi=dpi, format="png")
    finally:
        plt.close(figure)
