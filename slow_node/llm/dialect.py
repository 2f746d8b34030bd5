"""What a server is asked, and how to ask it otherwise after it has refused: servers differ in what they take."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

Chat = list[dict[str, str]]
"""Messages, each with a role and a content."""
FORMATS = ("json_schema", "json_object", "text")
"""Answer formats, strongest first; "text" is asked for by saying nothing."""
TEXT = len(FORMATS) - 1
_ABOUT_FORMAT = re.compile(r"response_format|json|schema|grammar|structured|guided", re.IGNORECASE)


@dataclass(frozen=True)
class Change:
    """What to ask otherwise: fields of a `Dialect`."""

    fields: dict[str, Any]
    named: bool
    """The server said so, in words."""


@dataclass(frozen=True)
class Dialect:
    """One way to ask. It begins with what most servers take."""

    tokens: str = "max_tokens"
    """The bound's name; models that think are given it as `max_completion_tokens`."""
    temperature: bool = True
    """Whether 0 is asked for; models that think take their own only."""
    format: int = 0
    """The strongest of `FORMATS` to ask for."""

    def body(
        self, model: str, chat: Chat, schema: dict[str, Any] | None, max_tokens: int, *, odds: bool = False
    ) -> dict[str, Any]:
        """The request. odds: with the probabilities of the answer's tokens."""
        return {
            "model": model,
            "messages": chat,
            self.tokens: max_tokens,
            **({"temperature": 0} if self.temperature else {}),
            **({"logprobs": True, "top_logprobs": 1} if odds else {}),
            **self._answer_format(schema),
        }

    def changed(self, sentence: str) -> Change | None:
        """What to ask otherwise after HTTP 400 or 422 with this sentence; None: there is nothing left to change."""
        if "max_completion_tokens" in sentence and self.tokens == "max_tokens":
            return Change({"tokens": "max_completion_tokens"}, named=True)
        if "temperature" in sentence and self.temperature:
            return Change({"temperature": False}, named=True)
        if self.format < TEXT:
            return Change({"format": self.format + 1}, named=bool(_ABOUT_FORMAT.search(sentence)))
        if self.temperature and self.tokens == "max_tokens" and not sentence:
            return Change({"temperature": False, "tokens": "max_completion_tokens"}, named=False)
        return None

    def _answer_format(self, schema: dict[str, Any] | None) -> dict[str, Any]:
        name = FORMATS[self.format] if schema else "text"
        if name == "text":
            return {}
        if name == "json_object":
            return {"response_format": {"type": "json_object"}}
        # Strict servers want every property required. The embedded model's short schema leaves slots out, each of
        # which would take it another tenth of a second to write; its server keeps to a schema without being told to.
        strict = len((schema or {}).get("required", ())) == len((schema or {}).get("properties", ()))
        return {
            "response_format": {
                "type": "json_schema",
                "json_schema": {"name": "answer", "strict": strict, "schema": schema},
            }
        }


class Learnt:
    """The dialect that a server was found to take. What its sentence named is believed at once; what was guessed after
    an error without words, which may have passed by itself, once it was found twice in a row."""

    def __init__(self) -> None:
        self.dialect = Dialect()
        self._guess: Dialect | None = None

    def took(self, sure: Dialect, used: Dialect) -> None:
        """An answer came to `used`; `sure` is what of it the server has named."""
        if used in (sure, self._guess):
            self.dialect, self._guess = used, None
        else:
            self.dialect, self._guess = sure, used

    def weaker(self) -> Dialect:
        """The dialect after HTTP 5xx to a schema: some servers break over one."""
        return replace(self.dialect, format=1) if self.dialect.format == 0 else self.dialect
