"""The web server: the page's files, one websocket per page, health and metrics. Everything that comes in is bounded
and suspected."""

from __future__ import annotations

import asyncio
import ipaddress
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from deploy.cockpit.health import ailments, exposition
from deploy.cockpit.hub import Hub, Page
from deploy.cockpit.sources import Refused
from schemas.wire.topics import MAX_COMMAND_CHARS

WEB = Path(__file__).parent / "web"
MAX_PAGES = 8
MAX_IN_BYTES = 4096
"""Of a message from a page."""
SEND_S = 10.0
"""A page that has not taken a message after this long is let go."""
ASKS, ASKS_PER_S = 20.0, 5.0
"""A page may say and order this much at once, and this much per second for ever."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}


class Ask(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a page sends: `seen` for each message that it has received, and now and then a wish."""

    seen: int = 0
    say: str | None = None
    do: str | None = None
    value: int | float | dict[str, int | float | str] | None = None


class Guard:
    """Refuses who names another host than this one (DNS rebinding) or comes from a page of another origin."""

    def __init__(self, app: ASGIApp, writable: bool) -> None:
        self._app, self._writable = app, writable

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if not _is_ours(headers, self._writable):
            if scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": "another host or origin"})
                return
            await PlainTextResponse("This host or origin is refused.", 403, HEADERS)(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        await self._app(scope, receive, guarded)


def _is_ours(headers: Headers, loopback: bool) -> bool:
    """The Host is an address, or `localhost`: no name that somebody else's DNS could point here; on loopback it is a
    loopback address. An Origin, which every browser sends along with a websocket, is the same place."""
    host = headers.get("host", "")
    try:
        name = urlsplit(f"//{host}").hostname or ""
        if name != "localhost":
            address = ipaddress.ip_address(name)
            if loopback and not address.is_loopback:
                return False
    except ValueError:
        return False
    origin = headers.get("origin")
    return origin is None or origin == f"http://{host}"


class Allowance:
    """A bucket of `ASKS` that refills with `ASKS_PER_S`."""

    def __init__(self, now_s: float) -> None:
        self._left, self._at_s = ASKS, now_s

    def take(self, now_s: float) -> bool:
        self._left = min(ASKS, self._left + (now_s - self._at_s) * ASKS_PER_S)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Pages:
    """The websocket endpoint."""

    def __init__(self, hub: Hub, writable: bool) -> None:
        self._hub, self._writable = hub, writable

    async def serve(self, socket: WebSocket) -> None:
        """One page, from its coming to its going."""
        if len(self._hub.pages) >= MAX_PAGES:
            await socket.close(1013, "too many pages")
            return
        await socket.accept()
        page = Page()
        self._hub.pages.add(page)
        page.wake.set()
        sending = asyncio.create_task(self._send(socket, page))
        try:
            await self._receive(socket, page)
        except (WebSocketDisconnect, RuntimeError):  # the latter: it was closed while we were asking
            pass
        finally:
            self._hub.pages.discard(page)
            sending.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await sending

    async def _send(self, socket: WebSocket, page: Page) -> None:
        try:
            while True:
                await page.wake.wait()
                page.wake.clear()
                payload = self._hub.message_for(page)
                if payload is not None:
                    await asyncio.wait_for(socket.send_text(payload.decode()), SEND_S)
        except TimeoutError:
            self._hub.pages.discard(page)
            with suppress(Exception):
                await asyncio.wait_for(socket.close(1008, "too slow"), 1.0)
        except (WebSocketDisconnect, RuntimeError):
            return

    async def _receive(self, socket: WebSocket, page: Page) -> None:
        loop = asyncio.get_running_loop()
        allowance = Allowance(loop.time())
        while True:
            try:
                ask = msgspec.json.decode(await socket.receive_text(), type=Ask)
            except (msgspec.DecodeError, KeyError):
                await socket.close(1003, "not understood")
                return
            if ask.seen:
                page.confirm()
            if ask.say is None and ask.do is None:
                continue
            if not allowance.take(loop.time()):
                await socket.send_json({"refused": "Too much at once: wait a moment."})
                continue
            try:
                self._obey(ask)
            except Refused as refusal:
                await socket.send_json({"refused": str(refusal)})

    def _obey(self, ask: Ask) -> None:
        if not self._writable:
            raise Refused("This page is read-only: it is served beyond this computer.")
        if ask.say is not None:
            text = ask.say.strip()
            if not text:
                raise Refused("Say something first.")
            if len(text) > MAX_COMMAND_CHARS:
                raise Refused(f"{len(text)} characters are too many; {MAX_COMMAND_CHARS} is the most.")
            self._hub.source.say(text)
        if ask.do is not None:
            self._hub.source.control(ask.do, ask.value)


def application(hub: Hub, *, writable: bool) -> ASGIApp:
    """The whole site."""

    async def index(_: Any) -> FileResponse:
        return FileResponse(WEB / "index.html")

    async def healthz(_: Any) -> PlainTextResponse:
        wrong = ailments(hub.picture.heartbeats, hub.source.now_ns())
        return PlainTextResponse("\n".join(wrong) or "ok", 503 if wrong else 200)

    async def metrics(_: Any) -> Response:
        body = exposition(hub.picture.heartbeats, hub.source.now_ns())
        return Response(body, media_type=CONTENT_TYPE_PLAIN_0_0_4)

    site = Starlette(
        routes=[
            Route("/", index),
            Route("/healthz", healthz),
            Route("/metrics", metrics),
            WebSocketRoute("/live", Pages(hub, writable).serve),
            Mount("/", StaticFiles(directory=WEB)),
        ]
    )
    return Guard(site, writable)
