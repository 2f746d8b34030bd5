"""Why a language model has not answered. `str()` says it in one line, with the server's own sentence where it sent one,
and never with the key in it."""

from __future__ import annotations

import math

SETTLED = ("insufficient_quota", "billing_hard_limit_reached")
"""Codes of an overload (HTTP 429) that no waiting ends."""
_FIXES = {
    401: "check OPENAI_API_KEY",
    402: "the account has no credit left",
    403: "check OPENAI_API_KEY and what it may use",
    404: "check the base URL and the model's name",
    413: "the prompt is too long for it",
}


class ModelError(Exception):
    """No answer."""

    again = False
    """Another try may help."""
    retry_after_s = 0.0
    """Not before this pause, as the server asks."""


class ModelTimeoutError(ModelError):
    """The budget ended first."""


class ModelUnreachableError(ModelError):
    """No connection, or a server that is overloaded or broken."""

    again = True

    def __init__(self, why: str, status: int = 0, retry_after_s: float = 0.0) -> None:
        super().__init__(why)
        self.status = status
        """The HTTP status; 0: none came."""
        self.retry_after_s = retry_after_s


class ModelRefusedError(ModelError):
    """The server will not do it: a wrong key, an unknown model; or what we were told cannot be asked at all."""


def http_error(status: int, sentence: str = "", code: str = "", retry_after: str = "") -> ModelError:
    """The error for an HTTP answer that is none. sentence, code: the server's own; retry_after: the header."""
    fix = _FIXES.get(status, "")
    why = f"the model's server answered HTTP {status}{f' ({fix})' if fix else ''}{f': {sentence}' if sentence else ''}"
    if (status in (408, 425, 429) or status >= 500) and code not in SETTLED:
        return ModelUnreachableError(why, status, _seconds(retry_after))
    return ModelRefusedError(why)


def _seconds(header: str) -> float:
    """The header's delay; its date form is not worth a parser, our own pause stands in for it."""
    try:
        delay = float(header or 0.0)
    except ValueError:
        return 0.0
    return min(max(delay, 0.0), 3600.0) if math.isfinite(delay) else 0.0
