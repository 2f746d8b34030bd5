"""Loads: what else keeps the machine busy while something is measured."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import httpx

from deploy.bench.deployed_system import START_S
from deploy.bench.progress import MeasurementError
from deploy.run.launch import GRACE_S, children, environment, model_token
from deploy.run.processes import Model

Load = Literal["none", "cpu", "llm", "watched"]
LOADS: tuple[Load, ...] = ("none", "cpu", "llm", "watched")
BY_ITSELF: tuple[Load, ...] = ("none", "cpu", "llm")
"""What is measured where nobody chooses. `watched`: with the recorder, and the cockpit with a page."""
HOG = """
import numpy as np
from schemas.runtime.process import die_with_parent
die_with_parent()
a = np.ones((1200, 1200), np.float32)
while True: a @ a
"""
PAGE = """
import sys
from websockets.sync.client import connect
from schemas.runtime.process import die_with_parent
die_with_parent()
with connect(sys.argv[1], open_timeout=60) as page:
    while True:
        page.recv()
        page.send('{"seen":1}')
"""
"""Takes every frame, as a browser's page does; what a browser draws is not in it."""


@contextmanager
def loaded(
    load: Load, model: Model, folder: Path, meanwhile: Callable[[], None] = lambda: None, page: str = ""
) -> Iterator[dict[str, float]]:
    """Keeps the machine busy for the time of the block; yields what was done, complete at its end. `page`: where the
    cockpit's pages connect.

    Raises `MeasurementError` if the load cannot be started, and at the end of the block if it did not last.
    """
    did: dict[str, float] = {}
    if load == "cpu":
        cores = str(os.cpu_count() or 1)
        did["threads"] = int(cores)
        with children() as start:
            hog = start(
                "matrix product",
                (sys.executable, "-c", HOG),
                folder / "load.log",
                env={**environment(), "OPENBLAS_NUM_THREADS": cores},
            )
            yield did
            if why := hog.trouble():
                raise MeasurementError(f"load cpu: {why}")
    elif load == "watched":
        with children() as start:
            watcher = start("page", (sys.executable, "-c", PAGE, page), folder / "load.log", env=environment())
            yield did
            if why := watcher.trouble():
                raise MeasurementError(f"load watched: {why}")
    elif load == "llm":
        with asking(model, did, meanwhile):
            yield did
    else:
        yield did


@contextmanager
def asking(model: Model, did: dict[str, float], meanwhile: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Has a served language model answer without pause, from its first word to the end of the block.

    Puts into `did`, at the end, the answers that were completed, the tokens that were written and the seconds it took;
    calls `meanwhile` while it waits. Raises `MeasurementError` if the first word does not come, and at the end of the
    block if a request failed or no answer grew during it: then the load was not what it is called.
    """
    stop, asked = threading.Event(), _Asked()
    asker = threading.Thread(target=_ask, args=(model, stop, asked), daemon=True)
    asker.start()
    deadline = time.monotonic() + START_S
    try:
        while not asked.tokens:
            if time.monotonic() > deadline:
                raise MeasurementError(f"the language model does not answer: {asked.failure or 'it is too slow'}")
            meanwhile()
            time.sleep(0.02)
        first, began = replace(asked), time.monotonic()
        yield
        last, seconds = replace(asked), time.monotonic() - began
        if last.failures > first.failures:
            raise MeasurementError(
                f"the language model failed {last.failures - first.failures} requests, the last one with: "
                f"{last.failure}"
            )
        if last.tokens == first.tokens:
            raise MeasurementError(f"the language model wrote nothing for {seconds:.0f} s")
        did.update(answers=last.answers - first.answers, tokens=last.tokens - first.tokens, seconds=round(seconds, 1))
    finally:
        stop.set()
        asker.join(GRACE_S)


@dataclass
class _Asked:
    """What has become of the requests so far."""

    answers: int = 0
    tokens: int = 0
    failures: int = 0
    failure: str = ""


def _ask(model: Model, stop: threading.Event, asked: _Asked) -> None:
    body = {
        "model": model.name,
        "max_tokens": 64,
        "stream": True,
        "messages": [{"role": "user", "content": "Tell me how to drive on a country road, in detail."}],
    }
    # A connection each: llama.cpp's server closes one that has streamed, and the next request would find it closed.
    alone = httpx.Limits(max_keepalive_connections=0)
    shown = {"authorization": f"Bearer {model_token()}"} if model.embedded else {}
    with httpx.Client(base_url=model.base_url, headers=shown, timeout=120.0, trust_env=False, limits=alone) as client:
        while not stop.is_set():
            try:
                with client.stream("POST", "/chat/completions", json=body) as reply:
                    for line in reply.raise_for_status().iter_lines():
                        asked.tokens += '"content":"' in line  # a token each
                        if stop.is_set():
                            return
                asked.answers += 1
            except httpx.HTTPError as error:
                asked.failure = str(error) or type(error).__name__
                asked.failures += 1
                stop.wait(0.5)
