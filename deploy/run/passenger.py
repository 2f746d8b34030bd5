"""The user's side of a running system: say something to it, and ask how it is. Both join as zenoh clients."""

from __future__ import annotations

import json
import secrets
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec

from deploy.run.certificates import certificates
from deploy.run.links import TCP_HOST, car_name, endpoint
from deploy.run.status import mode_of
from schemas.runtime.bus import BusConfig, BusError, open_bus
from schemas.runtime.bus_settings import Tls
from schemas.runtime.clock import NS
from schemas.runtime.process import FAILED, OK, UNAVAILABLE, USAGE, ConfigError
from schemas.wire import topics
from schemas.wire.codec import Fault
from schemas.wire.messages import Command, Reply, Status
from schemas.wire.text import plain

_POLL_S = 0.01
_BAD = ("refused", "failed", "expired", "superseded", "cancelled")
_LAST = (*_BAD, "fulfilled")
_STATUS_WAIT_S = 1.0
"""Five heartbeats of every node."""
_SILENT_S = 2.0
"""A node that has not been heard of for longer is told to be silent."""
CLEAR = "\x1b[H\x1b[2J"
"""Of a terminal: the next text takes the place of the last."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Which car is meant, and who we are to it."""

    port: int
    """On loopback, if `connect` is empty."""
    connect: str = ""
    tls: Tls | None = None
    name: str = ""

    @property
    def where(self) -> str:
        """For people."""
        return self.connect or f"{TCP_HOST}:{self.port}"

    def client(self) -> BusConfig:
        """Raises `ConfigError` for what is no endpoint."""
        at = endpoint(self.connect, self.tls, "--connect") if self.connect else f"tcp/{TCP_HOST}:{self.port}"
        return BusConfig(mode="client", connect=(at,), tls=self.tls, namespace=car_name(self.name))


def reach(port: int, connect: str | None, cert: str | None, key: str | None, ca: str | None, name: str | None) -> Reach:
    """From what a user has said. Raises `ConfigError`, naming the fix."""
    tls = certificates(cert, key, ca, listens=False)
    if tls is not None and not connect:
        raise ConfigError("--cert needs --connect tls/HOST:PORT")
    found = Reach(port=port, connect=connect or "", tls=tls, name=name or "")
    found.client()
    return found


def _nobody(car: Reach) -> int:
    fix = "start it with: fastslow run" if not car.connect else "is it there, and is this certificate of its authority?"
    print(f"fastslow: nobody is there on {car.where}; {fix}", file=sys.stderr)
    return UNAVAILABLE


def say(text: str, *, car: Reach, wait: bool, timeout_s: float, as_json: bool) -> int:
    """Publish a command and print the replies to it, until it is issued or, with `wait`, until its outcome."""
    out = sys.stderr if as_json else sys.stdout
    command = Command(epoch=0, stamp_ns=time.monotonic_ns(), id=secrets.randbits(48), text=text, source="say")
    replies: list[Reply] = []
    try:
        with open_bus(car.client()) as bus:
            incoming = bus.subscribe(topics.REPLY)
            try:
                bus.publish(topics.COMMAND, command)
            except (Fault, UnicodeEncodeError) as error:
                print(f"fastslow: this cannot be said: {error}", file=sys.stderr)
                return USAGE
            deadline = time.monotonic() + timeout_s
            while time.monotonic() < deadline and not _done(replies, wait):
                for reply in incoming.take():
                    if reply.command_id == command.id:
                        replies.append(reply)
                        print("".join(_words(reply)), file=out, flush=True)
                time.sleep(_POLL_S)
    except BusError:
        return _nobody(car)
    if as_json:
        print(
            json.dumps(
                {
                    "schema": "fastslow.say/1",
                    "id": command.id,
                    "text": text,
                    "outcome": replies[-1].outcome if replies else "unanswered",
                    "replies": [
                        {
                            "outcome": r.outcome,
                            "say": r.say,
                            "why": r.why,
                            "directive_id": r.directive_id,
                            "waits_for": r.waits_for,
                            "verdict": r.verdict,
                            "after_s": round((r.stamp_ns - command.stamp_ns) / 1e9, 3),
                        }
                        for r in replies
                    ],
                }
            )
        )
    if not replies:
        print(
            f"fastslow: no answer within {timeout_s:g} s; is the slow node running? Try: fastslow status",
            file=sys.stderr,
        )
        return UNAVAILABLE
    if not _done(replies, wait):
        print(f"fastslow: nothing more within {timeout_s:g} s (give it longer with --timeout)", file=sys.stderr)
        return FAILED
    return FAILED if replies[-1].outcome in _BAD else OK


def _done(replies: list[Reply], wait: bool) -> bool:
    return any(
        reply.outcome in _LAST or ((reply.outcome == "issued" or bool(reply.waits_for)) and not wait)
        for reply in replies
    )


def _words(reply: Reply) -> Iterator[str]:
    yield reply.outcome
    if reply.say:
        yield f": {plain(reply.say)}"
    if reply.why:
        yield f" ({plain(reply.why)})"
    if reply.verdict:
        yield f" [language model: {reply.verdict}]"


def _short(value: float) -> str:
    return f"{value:.0f}" if value.is_integer() or abs(value) >= 100.0 else f"{value:.3g}"


def status(*, car: Reach, as_json: bool, watch: bool = False) -> int:
    """Print the newest heartbeat of every node; with `watch` again each second, until Ctrl-C or until all are gone."""
    nodes: dict[str, Status] = {}
    clear = watch and not as_json and sys.stdout.isatty()
    try:
        with open_bus(car.client()) as bus:
            heartbeats = bus.subscribe(topics.STATUS)
            while True:
                deadline, heard = time.monotonic() + _STATUS_WAIT_S, 0
                while time.monotonic() < deadline:
                    for heartbeat in heartbeats.take():
                        nodes[heartbeat.node], heard = heartbeat, heard + 1
                    time.sleep(_POLL_S)
                if not heard:
                    print(f"fastslow: no node is alive behind {car.where}", file=sys.stderr)
                    return UNAVAILABLE
                newest = [nodes[name] for name in sorted(nodes)]
                said = _as_json(newest) if as_json else "\n".join(map(_line, newest))
                print(f"{CLEAR if clear else ''}{said}", flush=True)
                if not watch:
                    return OK
    except BusError:
        return _nobody(car)


def _as_json(newest: list[Status]) -> str:
    fields = ("node", "pid", "state", "epoch", "metrics", "detail", "mode", "mode_why", "mode_since_ns")
    rows = [{name: getattr(heartbeat, name) for name in fields} for heartbeat in newest]
    return msgspec.json.encode({"schema": "fastslow.status/1", "nodes": rows}).decode()


def _line(heartbeat: Status) -> str:
    now_ns = time.monotonic_ns()
    silent_s = (now_ns - heartbeat.stamp_ns) / NS
    gone = f"  silent for {silent_s:.0f} s" if silent_s > _SILENT_S else ""
    mode = f"  {mode_of(heartbeat, now_ns)}" if heartbeat.mode else ""
    detail = f"  {plain(heartbeat.detail)}" if heartbeat.detail else ""
    metrics = " ".join(f"{name} {_short(value)}" for name, value in heartbeat.metrics.items())
    return f"{plain(heartbeat.node):<6} {heartbeat.state:<9} pid {heartbeat.pid:<8}{plain(metrics)}{gone}{mode}{detail}"
