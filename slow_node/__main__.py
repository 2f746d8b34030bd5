"""`python -m slow_node '{...}'`: the slow node's process. Its argument is a `SlowConfig` as JSON."""

from __future__ import annotations

import os
import sys

from schemas.process import load_config, run_node
from slow_node.config import SlowConfig

NAME = "slow"


def main() -> int:
    # Before NumPy loads: a second BLAS thread would compete with the fast loop for a core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    def run() -> None:
        config = load_config(SlowConfig, sys.argv[1:])
        from schemas.bus import BusError
        from schemas.process import ConfigError
        from slow_node.node import serve

        try:
            serve(config)
        except BusError as error:
            raise ConfigError(f"the bus cannot be reached: {error}") from None

    return run_node(NAME, run)


if __name__ == "__main__":
    sys.exit(main())
