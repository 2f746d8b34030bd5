"""The embedded language model for those who need it alone, without the rest of the system."""

from __future__ import annotations

import time

from deploy.run.launch import Launched, answers, environment, launch, python_module
from deploy.run.processes import TCP_HOST
from slow_node.config import TOKEN

START_S = 30.0
POLL_S = 0.1


def embedded_server(
    port: int, threads: int, *, adapter: bool, weights: str = "", polite: bool = False
) -> Launched | None:
    """The embedded model, serving on this port of loopback; None if it did not start. Whoever starts it ends it.

    adapter, weights, polite: as `slow_node.llm.embedded.EmbeddedConfig` has them.
    """
    config = {
        "port": port,
        "threads": threads,
        "adapter": adapter and not weights,
        "weights": weights,
        "polite": polite,
    }
    argv = python_module("slow_node.llm.embedded", config)
    server = launch(
        "language model", argv, env=environment(TOKEN), own_session=False
    )  # it works for who starts it, on their share
    due, ready = time.monotonic() + START_S, False
    try:
        while not ready and time.monotonic() < due and server.exit_code() is None:
            time.sleep(POLL_S)
            ready = answers(f"http://{TCP_HOST}:{port}/health")
    finally:  # Ctrl-C included, which does not reach it
        if not ready:
            server.kill()
    return server if ready else None
