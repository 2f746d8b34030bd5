"""How a session joins the bus, and every zenoh setting that we make for it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from msgspec import Struct

ONE_POOL = "(rx:(handover:app),net:(handover:app),tx:(handover:app),acc:(handover:app),app:(worker_threads:1))"
"""All of zenoh's thread pools in one thread: fewer hand-overs within a tick. Only safe with rings, which never block
that thread, and we have nothing else."""


class Grant(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the links of some others may carry; those links are named in one way, or in none: then all are meant."""

    logins: tuple[str, ...] = ()
    """Who has linked to us and given the password of this name."""
    ids: tuple[str, ...] = ()
    """Whom we have linked to; no proof, but we know the socket that we have called."""
    certificates: tuple[str, ...] = ()
    """Who has shown a certificate with this common name."""
    puts: tuple[str, ...] = ()
    """Keys that these may put."""
    reads: tuple[str, ...] = ("**",)
    """Keys that these are told of, where they subscribe."""


class Tls(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Certificates for both ends of a link: PEM files. Whoever shows none of the same authority is refused."""

    ca: str
    cert: str
    key: str


class BusConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a session reaches the others. Endpoints as zenoh has them: `tcp/127.0.0.1:7447`, `unixsock-stream/PATH`."""

    mode: Literal["peer", "client", "router"] = "peer"
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    namespace: str = ""
    """Put before every key, so that several cars can share one bus: `car-7` makes it `car-7/fastslow/ego/...`."""
    low_latency: bool = False
    """Links to others who want it as well carry no priorities and no fragments: 25 % faster, but a message over some
    48 KB vanishes. Only for sessions whose every message is bounded; never for one that strangers send to."""
    id: str = ""
    """zenoh's id of this session, hexadecimal; "": drawn."""
    login: str = ""
    """Our name in `logins`, given with its password to whom we link to."""
    logins: str = ""
    """A file with a line `NAME:PASSWORD` for each who may link to us; "": everybody may."""
    grants: tuple[Grant, ...] = ()
    """What the others may say and hear; whoever is granted nothing, nothing. Empty: everybody everything."""
    most_hz: dict[str, float] = {}
    """Keys of which no link may bring more a second, evenly spaced; what comes sooner is dropped. zenoh does not say
    who has sent a message, so one who floods can be told from the others here alone."""
    tls: Tls | None = None
    for_strangers: bool = False
    """It listens where strangers come: an unfinished handshake, a long message and an idle link cost it little."""


STRANGERS_MESSAGE_BYTES = 65_536
STRANGERS_HANDSHAKE_MS = 2000
STRANGERS_PENDING = 512
"""Unfinished handshakes at a time; those beyond are hung up on."""


def zenoh_settings(config: BusConfig) -> dict[str, object]:
    """Every zenoh setting we make, by its configuration path; the reasons are in docs/performance.md.

    Raises OSError where `logins` cannot be read, ValueError where our own is not in it.
    """
    settings: dict[str, object] = {
        "mode": config.mode,
        "listen/endpoints": list(config.listen),
        "connect/endpoints": list(config.connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": 2000,
        "open/return_conditions/connect_scouted": False,
        "open/return_conditions/declares": True,
    }
    if config.id:
        settings["id"] = config.id
    if config.namespace:
        settings["namespace"] = config.namespace
    if config.low_latency:
        settings["transport/unicast/qos/enabled"] = False
        settings["transport/unicast/lowlatency"] = True
    if config.mode == "router":
        # Batches of 64 KB, made when needed: whoever reads at a low priority may be late without losing a message.
        settings["transport/link/tx/queue/size/data"] = 16
    if config.mode != "client":
        settings["connect/timeout_ms"] = -1  # keep trying, in the background
        settings["connect/exit_on_failure"] = False
        settings["connect/retry"] = {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 2}
    if config.for_strangers:
        settings["transport/link/rx/max_message_size"] = STRANGERS_MESSAGE_BYTES
        settings["transport/unicast/accept_timeout"] = STRANGERS_HANDSHAKE_MS
        settings["transport/unicast/accept_pending"] = STRANGERS_PENDING
    if config.most_hz:
        rules = [{"key_expr": _named(config, key), "freq": hz} for key, hz in config.most_hz.items()]
        settings["downsampling"] = [{"flows": ["ingress"], "messages": ["put"], "rules": rules}]
    return settings | _logins(config) | _tls(config.tls) | _access(config)


def _logins(config: BusConfig) -> dict[str, object]:
    settings: dict[str, object] = {}
    if config.logins and config.listen:
        settings["transport/auth/usrpwd/dictionary_file"] = config.logins
    if config.login:
        lines = Path(config.logins).read_text(encoding="ascii").splitlines()
        passwords = dict(line.split(":", 1) for line in lines)
        if config.login not in passwords:
            raise ValueError(f"{config.login} is not in {config.logins}")
        settings["transport/auth/usrpwd/user"] = config.login
        settings["transport/auth/usrpwd/password"] = passwords[config.login]
    return settings


def _tls(tls: Tls | None) -> dict[str, object]:
    if tls is None:
        return {}
    return {
        "transport/link/tls/root_ca_certificate": tls.ca,
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
        "transport/link/tls/listen_certificate": tls.cert,
        "transport/link/tls/listen_private_key": tls.key,
        "transport/link/tls/connect_certificate": tls.cert,
        "transport/link/tls/connect_private_key": tls.key,
    }


def _named(config: BusConfig, key: str) -> str:
    """A key as it is on the wire."""
    return f"{config.namespace}/{key}" if config.namespace else key


def _access(config: BusConfig) -> dict[str, object]:
    """zenoh's access control: what no rule allows is dropped on its way in or out, and nobody is told."""
    if not config.grants:
        return {}
    rules: list[dict[str, object]] = []
    subjects: list[dict[str, object]] = []
    policies: list[dict[str, object]] = []

    def rule(flow: str, message: str, keys: list[str], into: list[str]) -> None:
        if keys:
            into.append(f"{flow} {message} {len(rules)}")
            rules.append(
                {"id": into[-1], "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": keys}
            )

    for number, grant in enumerate(config.grants):
        granted: list[str] = []
        rule("ingress", "put", [_named(config, key) for key in grant.puts], granted)
        rule("egress", "put", [_named(config, key) for key in grant.reads], granted)
        rule("egress", "declare_subscriber", ["**"], granted)
        # Anybody may ask for anything: `**` asks for what one may read, too. What is told is decided above.
        rule("ingress", "declare_subscriber", ["**"], granted)
        who = {"usernames": grant.logins, "zids": grant.ids, "cert_common_names": grant.certificates}
        subjects.append({"id": f"links {number}", **{name: list(these) for name, these in who.items() if these}})
        policies.append({"rules": granted, "subjects": [f"links {number}"]})
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        }
    }
