"""The slow node's thinking without the node: a thinker, and the embedded model's process where it may ask it."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from typing import Literal

from deploy.run.launch import Launched
from deploy.run.model_server import embedded_server
from deploy.run.processes import choose_model
from slow_node.config import SlowConfig
from slow_node.node import build_thinker
from slow_node.thinking import Thinker

Ask = Literal["auto", "always", "unsure", "never"]
"""When a thinker asks the language model."""


@contextlib.contextmanager
def running_thinker(
    *,
    ask: Ask = "auto",
    k: int = 4,
    reader: bool = True,
    empty_bank: bool = False,
    threads: int = 1,
    adapter: bool = True,
    memory_path: str = "",
    budget_s: float = 8.0,
) -> Iterator[Thinker]:
    """A thinker and, where it may ask it, the embedded model's process. Raises `ConfigError`."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that the model ends with us
    model = choose_model()
    server: Launched | None = None
    try:
        if model.embedded and ask != "never":
            server = embedded_server(model.port, threads, adapter=adapter)
            if server is None:
                print("fastslow: the embedded model did not start; the reader answers alone", file=sys.stderr)
                ask = "never"
        thinker, memory, _ = build_thinker(
            SlowConfig(
                base_url=model.base_url,
                model=model.name,
                embedded=model.embedded,
                memory_path=memory_path,
                ask=ask,
                k=k,
                reader=reader,
                seeds=not empty_bank,
                adapter=adapter,
                budget_s=budget_s,
            )
        )
        try:
            yield thinker
        finally:
            memory.close()
    finally:
        if server is not None:
            server.end()
        signal.signal(signal.SIGTERM, before)
