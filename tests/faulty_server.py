"""A chat server on loopback that misbehaves as told, for tests."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

SLOWER = '{"reasoning":"less","outcome":"directive","speed":"slower"}'


def answer(content: object = SLOWER, **message: object) -> tuple[int, dict[str, str], bytes]:
    """A good HTTP answer of a chat server, with its count of tokens."""
    body = {
        "choices": [{"message": {"content": content, **message}}],
        "usage": {"prompt_tokens": 7, "completion_tokens": 3},
    }
    return 200, {}, json.dumps(body).encode()


class FaultyServer:
    """Answers its n-th request with the n-th step (the last one for ever): an HTTP answer, a function of the request
    that makes one, or a named misbehaviour. Keeps connections open, as HTTP/1.1 does."""

    def __init__(self, *steps: object, models: tuple[str, ...] | None = None) -> None:
        """models: what it says it serves; None: it does not list them."""
        self.bodies: list[dict[str, Any]] = []
        self.paths: list[str] = []
        self.headers: list[dict[str, str]] = []
        self.connections = 0
        self.hung_up = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def setup(self) -> None:
                outer.connections += 1
                super().setup()

            def do_POST(self) -> None:
                outer.bodies.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
                outer.paths.append(self.path)
                outer.headers.append({name.lower(): value for name, value in self.headers.items()})
                step = steps[min(len(outer.bodies), len(steps)) - 1]
                try:
                    self._play(step(outer.bodies[-1]) if callable(step) else step)
                except OSError:
                    self.close_connection = True

            def do_GET(self) -> None:
                listed = {"object": "list", "data": [{"id": name} for name in models or ()]}
                self._play((404, {}, b"") if models is None else (200, {}, json.dumps(listed).encode()))

            def _play(self, step: object) -> None:
                self.close_connection = isinstance(step, str)
                if step == "hang":
                    self.connection.settimeout(20.0)
                    if self.connection.recv(1) == b"":
                        outer.hung_up.set()
                elif step == "disconnect":
                    self.wfile.write(b'HTTP/1.1 200 OK\r\nContent-Length: 500\r\n\r\n{"choices": [{')
                elif step == "drip":
                    self._drip()
                elif step == "endless":
                    self._endless()
                else:
                    assert isinstance(step, tuple)
                    status, headers, body = step
                    self.send_response(status)
                    for name, value in {**headers, "Content-Length": str(len(body))}.items():
                        self.send_header(name, value)
                    self.end_headers()
                    self.wfile.write(body)

            def _drip(self) -> None:
                """A byte now and then, each sooner than any timeout between two bytes."""
                self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 5000\r\n\r\n")
                try:
                    for _ in range(400):
                        self.wfile.write(b" ")
                        time.sleep(0.05)
                except OSError:
                    outer.hung_up.set()

            def _endless(self) -> None:
                """A body without an end, as fast as it is read."""
                self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n")
                while True:
                    self.wfile.write(b"[" * 65536)

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    @property
    def formats(self) -> list[str | None]:
        """The answer format that each request asked for."""
        return [body.get("response_format", {}).get("type") for body in self.bodies]

    def __enter__(self) -> FaultyServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.shutdown()
        self.server.server_close()
