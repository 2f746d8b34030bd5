"""The slow node's interpreter without the node, and the embedded model's process where it may ask it."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Literal

from deploy.run.launch import Launched, model_token
from deploy.run.model_choice import choose_model
from deploy.run.model_server import embedded_server
from deploy.run.processes import ModelOptions
from schemas.runtime.process import ConfigError
from slow_node.config import SlowConfig
from slow_node.interpreter import Interpreter
from slow_node.llm.model import ChatModel
from slow_node.node import build_interpreter

Ask = Literal["auto", "always", "unsure", "never"]
"""When an interpreter asks the language model."""


@contextlib.contextmanager
def running_interpreter(
    *,
    ask: Ask = "auto",
    k: int = 4,
    parser: bool = True,
    empty_bank: bool = False,
    threads: int = 1,
    adapter: bool = True,
    memory_path: str = "",
    model: ModelOptions | None = None,
    needs_model: bool = False,
    scene: bool = True,
    chat_model: Callable[..., ChatModel] = ChatModel,
) -> Iterator[Interpreter]:
    """An interpreter and, where it may ask it, the embedded model's process. Raises `ConfigError`.

    needs_model: an error, rather than the reader alone, where the embedded model does not start.
    scene: whether the model is told of it. chat_model: makes the client of the model's server.
    """
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that the model ends with us
    chosen = choose_model(model)
    if not chosen.embedded and ask != "never":
        print(f"fastslow: asks {chosen.where}", file=sys.stderr)
    server: Launched | None = None
    try:
        if chosen.embedded and ask != "never":
            server = embedded_server(chosen.port, threads, adapter=adapter, weights=chosen.weights)
            if server is None and needs_model:
                raise ConfigError("the embedded model did not start: see `fastslow doctor`, or run it again")
            if server is None:
                print("fastslow: the embedded model did not start; the intent parser answers alone", file=sys.stderr)
                ask = "never"
        interpreter, memory, _ = build_interpreter(
            SlowConfig(
                base_url=chosen.base_url,
                model=chosen.name,
                embedded=chosen.embedded,
                budget_s=chosen.budget_s,
                max_tokens=chosen.max_tokens,
                memory_path=memory_path,
                ask=ask,
                k=k,
                parser=parser,
                shipped_examples=not empty_bank,
                adapter=adapter and not chosen.weights,
            ),
            scene=scene,
            chat_model=chat_model,
            key=model_token() if server is not None else None,
        )
        try:
            yield interpreter
        finally:
            memory.close()
    finally:
        if server is not None:
            server.end()
        signal.signal(signal.SIGTERM, before)
