"""An OpenAI-compatible endpoint on loopback, for tests."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

SECRET = "a-key-that-stays-in-its-header"


class ScriptedModel:
    """An OpenAI-compatible server on loopback that answers with what `script` makes of the newest user turn."""

    def __init__(self, script: Callable[[str], str]) -> None:
        self.prompts: list[str] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                prompt = body["messages"][-1]["content"]
                outer.prompts.append(prompt)
                reply = json.dumps({"choices": [{"message": {"content": script(prompt)}}]}).encode()
                try:
                    self.send_response(200)
                    self.send_header("Content-Length", str(len(reply)))
                    self.end_headers()
                    self.wfile.write(reply)
                except OSError:
                    pass  # the caller has hung up: superseded

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()


@contextmanager
def model_of(kind: str, script: Callable[[str], str], at_least: int = 1) -> Iterator[dict[str, str]]:
    """What to set for the "embedded" model, or for an "endpoint", which must be asked `at_least` so often."""
    if kind == "embedded":
        yield {}
        return
    scripted = ScriptedModel(script)
    yield {"OPENAI_API_KEY": SECRET, "OPENAI_BASE_URL": scripted.url, "OPENAI_MODEL": "scripted"}
    assert len(scripted.prompts) >= at_least
    scripted.close()
