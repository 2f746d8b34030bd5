"""How the processes of one run reach each other, and what each link may carry.

Their sockets lie in a folder that only this user may enter. Who links to another gives its name and a password of this
run; whom one has called oneself is known by its socket. Each end lets in only what the other may say.
"""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from schemas.runtime.bus import BusConfig
from schemas.runtime.bus_settings import Grant, Tls
from schemas.runtime.errors import ConfigError
from schemas.wire.roles import NODES, ROLES, Role, Topics, own
from schemas.wire.topics import COMMAND, CONTROL

TCP_HOST = "127.0.0.1"
WORDS_HZ = 10.0
"""Of one user at the door: half of what the door carries, so that one alone leaves room for the others."""
_DIRECT = ("sim", "fast", "slow")
"""These link to each other; all others meet at the supervisor's router."""


@dataclass(frozen=True, kw_only=True)
class DoorOptions:
    """Where users come in, and who they are."""

    listen: str
    """zenoh's endpoint: `tcp/127.0.0.1:7447`, or `tls/0.0.0.0:7447` with `tls`."""
    tls: Tls | None = None
    """With certificates, whose common names are roles; without, everybody is a passenger."""
    name: str = ""
    """Of this car, before every key outside."""

    @property
    def address(self) -> tuple[str, int]:
        """(host, port) of `listen`."""
        host, _, port = self.listen.partition("/")[2].rpartition(":")
        return host.strip("[]"), int(port)


_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9a-fA-F:]+\]|[^/:\[\]]+):(\d{1,5})")
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


def endpoint(text: str, tls: Tls | None, option: str) -> str:
    """An endpoint as a user wrote it, of this computer or with certificates. Raises `ConfigError`, naming the fix."""
    found = _ENDPOINT.fullmatch(text)
    if found is None or not 0 < int(found[3]) < 65536:
        raise ConfigError(f"{option} {text!r} is no endpoint: it must look like tls/0.0.0.0:7447 or tcp/127.0.0.1:7447")
    if found[1] == "tls" and tls is None:
        raise ConfigError(
            f"{option} {text} needs --cert (deploy/secure/authority.sh makes certificates to try it with)"
        )
    if found[1] == "tcp" and tls is not None:
        raise ConfigError(f"{option} {text} shows no certificate: write tls/ for tcp/, or leave --cert out")
    if found[1] == "tcp" and found[2] not in (TCP_HOST, "localhost", "[::1]"):
        raise ConfigError(f"{option} {text} would be open to everybody: use tls/... with --cert")
    return text


def car_name(name: str) -> str:
    """A car's name, which becomes part of its keys. Raises `ConfigError`."""
    if name and not _NAME.fullmatch(name):
        raise ConfigError(f"--name {name!r}: letters, digits, - and _ only, at most 40")
    return name


def stand_ins_of(left_out: Collection[str]) -> tuple[str, ...]:
    """The nodes that others may stand in for: those that do not run."""
    return tuple(name for name in _DIRECT if name in left_out)


def roles_of(door: DoorOptions, left_out: Collection[str] = ()) -> dict[str, Role]:
    """What those may who come through the door, by the common name of their certificate ("": whoever comes).

    left_out: our nodes that do not run. Others may stand in for these, and for no other.
    """
    stand_ins = stand_ins_of(left_out)
    if door.tls is not None:
        return {name: ROLES[name] for name in ("passenger", "operator", "recorder", *stand_ins)}
    roles = [ROLES[name] for name in ("passenger", *stand_ins)]
    return {"": Role(puts=_together(role.puts for role in roles), reads=_together(role.reads for role in roles))}


def carried(door: DoorOptions, left_out: Collection[str] = ()) -> tuple[Topics, Topics]:
    """(in, out): the topics that pass a door."""
    roles = roles_of(door, left_out).values()
    return _together(role.puts for role in roles), _together(role.reads for role in roles)


def _together(some: Iterable[Topics]) -> Topics:
    """Each topic once."""
    return tuple({topic.name: topic for topics in some for topic in topics}.values())


@dataclass(frozen=True)
class Links:
    """The links of one run, in `folder`, which is there and is this user's alone."""

    folder: Path
    door: DoorOptions | None = None
    left_out: frozenset[str] = frozenset()
    ids: dict[str, str] = field(default_factory=lambda: {name: f"f{secrets.token_hex(15)}" for name in NODES})

    @property
    def logins(self) -> Path:
        return self.folder / "logins"

    def write_logins(self) -> None:
        """A password for each process, for the time of this run."""
        with open(os.open(self.logins, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="ascii") as file:
            file.writelines(f"{name}:{secrets.token_hex(16)}\n" for name in NODES)

    def socket(self, name: str) -> str:
        return f"unixsock-stream/{self.folder / name}.sock"

    def may_put(self, name: str) -> tuple[str, ...]:
        """The keys that a process of ours may put."""
        lets_in = carried(self.door, self.left_out)[0] if name == "door" and self.door else ()
        return own(*_together((NODES[name], lets_in)))

    def supervisor(self) -> BusConfig:
        """Of the router at which all meet."""
        grants = tuple(Grant(logins=(name,), puts=self.may_put(name)) for name in NODES)
        return BusConfig(
            mode="router",
            listen=(self.socket("bus"),),
            id=self.ids["supervisor"],
            logins=str(self.logins),
            grants=grants,
        )

    def peer(self, name: str, *called: str) -> BusConfig:
        """Of a node that links to the supervisor and to those that are `called`, and may be called by the others."""
        # The router brings what those may say who are not linked to this node directly.
        brought = tuple({key: None for other in NODES if other not in _DIRECT for key in self.may_put(other)})
        grants = [Grant(ids=(self.ids["supervisor"],), puts=brought)]
        for other in _DIRECT:
            if other != name:
                who: dict[str, Any] = {"ids": (self.ids[other],)} if other in called else {"logins": (other,)}
                grants.append(Grant(puts=self.may_put(other), **who))
        return BusConfig(
            listen=(self.socket(name),),
            connect=tuple(map(self.socket, ("bus", *called))),
            # A thought or a recording may be long: links to the router and to slow stay ordinary.
            low_latency=name in ("sim", "fast"),
            id=self.ids[name],
            login=name,
            logins=str(self.logins),
            grants=tuple(grants),
        )

    def client(self, name: str) -> BusConfig:
        """Of a process that links to the supervisor alone."""
        connect = (self.socket("bus"),)
        return BusConfig(mode="client", connect=connect, login=name, logins=str(self.logins))

    def outside(self) -> BusConfig:
        """Of the router where users come."""
        assert self.door is not None
        grants = tuple(
            Grant(certificates=(name,) if name else (), puts=own(*role.puts), reads=own(*role.reads))
            for name, role in roles_of(self.door, self.left_out).items()
        )
        return BusConfig(
            mode="router",
            listen=(self.door.listen,),
            namespace=self.door.name,
            tls=self.door.tls,
            grants=grants,
            most_hz={topic.key: WORDS_HZ for topic in (COMMAND, CONTROL)},
            for_strangers=True,
        )
