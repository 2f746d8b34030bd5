"""A language model whose answers are kept by prompt: the same question is asked once, in this run and the next."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from deploy.lab.files import whole_lines
from schemas.wire.text import json_line
from slow_node.llm.adapter import ADAPTER
from slow_node.llm.answer import Answer
from slow_node.llm.dialect import Chat
from slow_node.llm.model import Call, ChatModel

_ROW = b'{"key": '
"""How a line of the file begins."""


def _kept(line: bytes) -> tuple[str, dict[str, Any]]:
    row = json.loads(line)
    return row["key"], row


class CachedModel(ChatModel):
    """Keeps what is answered in a file of JSON lines; what fails is asked anew."""

    def __init__(self, *args: Any, path: Path, salt: str = "", **options: Any) -> None:
        """salt: what else an answer depends on, such as the adapter's digest.

        Raises `ConfigError` for a file that holds something else.
        """
        super().__init__(*args, **options)
        self._path, self._salt = path, salt
        self._known: dict[str, dict[str, Any]] = dict(whole_lines(path, _ROW, _kept))

    async def complete(
        self, chat: Chat, schema: dict[str, Any] | None, budget_s: float, calls: list[Call] | None = None
    ) -> str:
        asked = json.dumps([self.name, self._salt, chat, schema], ensure_ascii=False)
        key = hashlib.sha256(asked.encode()).hexdigest()[:32]
        if key not in self._known:
            mine: list[Call] = []
            text = await super().complete(chat, schema, budget_s, mine)
            answer = mine[-1].answer
            row: dict[str, Any] = {"key": key, "text": text, "probability": answer.probability if answer else None}
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json_line(row) + "\n")
            self._known[key] = row
        kept = self._known[key]
        if calls is not None:
            calls.append(Call(0.0, 0.0, "json_schema", Answer(kept["text"], probability=kept["probability"])))
        return str(kept["text"])


def kept_in(path: Path) -> Callable[..., CachedModel]:
    """Makes models whose answers are kept in a file, those with another adapter of the embedded model apart."""
    salt = hashlib.sha256(ADAPTER.read_bytes()).hexdigest()[:16] if ADAPTER.exists() else ""
    return partial(CachedModel, path=path, salt=salt)
