"""`python -m slow_node '{...}'`: the slow node's process. Its argument is a `SlowConfig` as JSON."""

from __future__ import annotations

import ctypes
import os
import sys

from schemas.runtime.process import load_config, run_node
from slow_node.config import SlowConfig

NAME = "slow"
M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8
"""Of glibc's malloc.h."""


def main() -> int:
    # Before NumPy loads: a second BLAS thread would compete with the fast loop for a core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    def run() -> None:
        config = load_config(SlowConfig, sys.argv[1:])
        _save_memory()
        from schemas.runtime.bus import BusError
        from schemas.runtime.process import ConfigError
        from slow_node.node import serve

        try:
            serve(config)
        except BusError as error:
            raise ConfigError(f"the bus cannot be reached: {error}") from None

    return run_node(NAME, run)


def _save_memory() -> None:
    """Some 10 MB less, if done before anything large is loaded.

    httpx does without its command line (6 MB) where that cannot be imported. glibc would keep freed arrays, and in
    every thread's own arena (5 MB).
    """
    sys.modules["httpx._main"] = None  # type: ignore[assignment]
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):
        libc.mallopt(M_MMAP_THRESHOLD, 1 << 20)
        libc.mallopt(M_ARENA_MAX, 1)


if __name__ == "__main__":
    sys.exit(main())
