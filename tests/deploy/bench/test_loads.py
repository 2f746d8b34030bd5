"""The language model as a load on the machine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from deploy.bench.loads import asking
from deploy.bench.progress import MeasurementError
from deploy.run import processes
from tests.waiting import PATIENCE_S, until


class Model(BaseHTTPRequestHandler):
    """A language model's server that answers as `answer` does."""

    answer: Callable[[Model], object]

    def do_POST(self) -> None:
        self.answer()  # type: ignore[call-arg, misc]

    def words(self, n: int) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(n * b'data: {"choices":[{"delta":{"content":"a"}}]}\n\n')

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def asked(answer: Callable[[Model], object]) -> Iterator[dict[str, float]]:
    """Such a server, asked without pause; what it did is complete at the end of the block."""
    did: dict[str, float] = {}
    handler = type("Handler", (Model,), {"answer": answer})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            with asking(
                processes.Model(
                    base_url=f"http://127.0.0.1:{server.server_port}", name="m", embedded=True, port=server.server_port
                ),
                did,
            ):
                yield did
        finally:
            server.shutdown()


def test_the_load_counts_what_the_model_wrote_during_the_block() -> None:
    n = 0

    def answer(model: Model) -> None:
        nonlocal n
        n += 1
        model.words(7)

    with asked(answer) as did:
        before = n
        until(lambda: n >= before + 3, "the model was not asked again")
    assert did["answers"] >= 2
    assert did["tokens"] >= 2 * 7


def test_a_model_that_falls_silent_is_no_load() -> None:
    silent, end = threading.Event(), threading.Event()

    def answer(model: Model) -> None:
        model.words(1)
        silent.set()
        end.wait(PATIENCE_S)

    with pytest.raises(MeasurementError, match="the language model wrote nothing"), asked(answer):
        silent.wait(PATIENCE_S)
    end.set()


def test_a_model_that_fails_is_no_load() -> None:
    fails, failed = threading.Event(), threading.Semaphore(0)

    def answer(model: Model) -> None:
        if fails.is_set():
            model.send_error(500)
            failed.release()
        else:
            model.words(7)

    def until_two_have_failed() -> None:
        fails.set()
        for _ in range(2):
            assert failed.acquire(timeout=PATIENCE_S)

    with pytest.raises(MeasurementError, match=r"failed \d requests, the last one with: .*500"), asked(answer):
        until_two_have_failed()
