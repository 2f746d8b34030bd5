"""HTTP to a chat server: every answer bounded in size, and every fault of ours, the network's or the server's an error
with a sentence, never an exception of a library."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import httpx

from schemas.wire.text import plain
from slow_node.llm.answer import ModelAnswerError
from slow_node.llm.endpoint import checked_key, is_azure, is_loopback
from slow_node.llm.errors import ModelError, ModelRefusedError, ModelUnreachableError

MAX_BODY_BYTES = 1_000_000
"""An answer of ours has some thousands; a model that thinks, some ten thousands. Headers are bounded by httpx."""
_SETTINGS = "check ALL_PROXY, HTTPS_PROXY, NO_PROXY and SSL_CERT_FILE"


@dataclass(frozen=True)
class Response:
    """An HTTP answer, read to its end."""

    status: int
    content: bytes
    retry_after: str = ""
    location: str = ""


class Transport:
    """One server. Its client is made by the first request, so that what is wrong with its settings is that one's error.

    `key` goes into a header and nowhere else.
    """

    def __init__(self, base_url: str, key: str) -> None:
        self._base_url, self._key = base_url, key
        self._client: httpx.AsyncClient | None = None

    async def close(self) -> None:
        if self._client is not None:
            await self._client.aclose()
            self._client = None

    async def post(self, route: str, body: dict[str, Any]) -> Response:
        """POST a JSON object. Raises `ModelError`."""
        return await self._asked("POST", route, body)

    async def get(self, route: str) -> Response:
        """GET. Raises `ModelError`."""
        return await self._asked("GET", route, None)

    async def _asked(self, method: str, route: str, body: dict[str, Any] | None) -> Response:
        client = self._client or self._new_client()
        self._client = client
        try:
            async with client.stream(method, _url(self._base_url, route), json=body) as response:
                return Response(
                    response.status_code,
                    await _read(response),
                    response.headers.get("retry-after", "")[:100],
                    response.headers.get("location", "")[:300],
                )
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            said = plain(str(error), 160)
            host = urlsplit(self._base_url).netloc
            raise ModelUnreachableError(
                f"the model cannot be reached at {host}: {type(error).__name__}{f', {said}' if said else ''}"
            ) from None

    def _new_client(self) -> httpx.AsyncClient:
        try:
            key = checked_key(self._key, "the key")
        except ValueError as error:
            raise ModelRefusedError(str(error)) from None
        try:
            headers = {"accept-encoding": "identity", "user-agent": "fastslow"}
            if key:
                headers["authorization"] = f"Bearer {key}"
                if is_azure(self._base_url):
                    headers["api-key"] = key
            # trust_env off: a proxy variable must not carry a loopback call out of the machine.
            return httpx.AsyncClient(headers=headers, timeout=None, trust_env=not is_loopback(self._base_url))
        except (ImportError, ValueError, OSError, httpx.InvalidURL) as error:
            raise ModelRefusedError(
                f"the network's settings cannot be used ({_SETTINGS}): {plain(str(error), 120)}"
            ) from None


def _url(base_url: str, route: str) -> str:
    parts = urlsplit(base_url)
    return urlunsplit(parts._replace(path=f"{parts.path.rstrip('/')}/{route}"))


async def _read(response: httpx.Response) -> bytes:
    """The body, inflated if it has to be. Raises `ModelError` as soon as it is longer than `MAX_BODY_BYTES`."""
    encoding = response.headers.get("content-encoding", "identity").strip().lower()
    inflate = zlib.decompressobj(wbits=47) if encoding in ("gzip", "x-gzip", "deflate") else None
    if inflate is None and encoding not in ("", "identity"):
        raise ModelAnswerError(f"the model's server answered in the encoding {plain(encoding, 20)}, not asked for")
    body = bytearray()
    try:
        async for chunk in response.aiter_raw():
            body += inflate.decompress(chunk, MAX_BODY_BYTES + 1 - len(body)) if inflate else chunk
            if len(body) > MAX_BODY_BYTES:
                raise _too_long()
    except zlib.error:
        raise ModelAnswerError("the model's server sent a broken gzip body", again=True) from None
    return bytes(body)


def _too_long() -> ModelError:
    return ModelAnswerError(f"the model's server sent more than {MAX_BODY_BYTES // 1000} kB: that is no chat answer")
