"""The declared process table: what runs, with what configuration, and what its failure means."""

from __future__ import annotations

import errno
import json
import os
import shlex
import socket
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from platformdirs import user_data_path

from deploy.run.launch import KEY, SECRETS, python_module
from deploy.run.links import TCP_HOST as TCP_HOST
from deploy.run.links import DoorOptions, Links, carried, stand_ins_of
from schemas.runtime.bus_settings import Tls
from schemas.runtime.errors import ConfigError
from schemas.runtime.files import read_text_bounded
from schemas.runtime.realtime import Mode
from schemas.wire.text import plain
from slow_node.config import BUDGET_S, THOUGHTS, TOKEN, WISHES
from slow_node.llm.endpoint import where

DEFAULT_PORT = 7447
FOXGLOVE_PORT = 8765
"""Where Foxglove and Lichtblick look first."""
SIMS = ("highway-env", "sumo")
"""Whose drivers are in the other cars."""
NAMES = ("sim", "fast", "slow", "llm", "record")


@dataclass(frozen=True, kw_only=True)
class Process:
    """One row of the table: a child of the supervisor."""

    name: str
    argv: tuple[str, ...]
    critical: bool
    """Too many restarts of a critical process end the run; without another one the run goes on, degraded."""
    needs: tuple[str, ...] = ()
    """Started once these are ready; a critical one is waited for up to its `start_s`, another one `NEEDS_WAIT_S`."""
    heartbeat_s: float = 2.0
    """Once ready, a longer silence means that it hangs."""
    start_s: float = 30.0
    """The longest silence before the first heartbeat."""
    probe_url: str = ""
    """Where set, an HTTP 200 from here is this process's heartbeat, since it speaks no zenoh."""
    finishes: bool = False
    """Its exit with code 0 is the end of the run, not a failure."""
    nice: int = 0
    secrets: tuple[str, ...] = ()
    """The environment variables of `launch.SECRETS` that it needs."""


NEEDS_WAIT_S = 3.0
SLOW_START_S = 120.0
"""Where nothing is compiled yet, on a busy machine."""
SHUTDOWN_ORDER = ("slow", "fast", "sim", "llm", "record", "door")
"""Who thinks stops first; the car is driven until the road itself ends; all of it is recorded and told."""
RECORDING = "recording.mcap"
"""In the run's folder."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """The language model behind the slow node."""

    base_url: str
    name: str
    embedded: bool
    port: int = 0
    weights: str = ""
    """A GGUF file in the place of the shipped model."""
    budget_s: float = BUDGET_S
    max_tokens: int = 0
    """Of an answer, thoughts included; 0: as `slow_node.llm.model` has it."""

    @property
    def where(self) -> str:
        """For people: which model is asked where, and whether words leave the machine for it."""
        if self.embedded:
            return f"{self.name}, embedded (no word leaves this machine)"
        return where(self.base_url, self.name)


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """What a user may say about the language model; None: as the environment has it, or the default."""

    name: str | None = None
    base_url: str | None = None
    budget_s: float | None = None
    max_tokens: int | None = None
    embedded: bool = False
    """The embedded model, whatever endpoint the environment names."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What the passenger may choose about a run."""

    scenario: str = "two-way-natural"
    """A name, or the path of a scenario file."""
    sim: str = "highway-env"
    """Whose drivers are in the other cars, as `sim_node.config.SimConfig` has it."""
    seed: int = 0
    density: float = 1.0
    traffic: tuple[str, ...] = ()
    noise_m: float = 0.0
    noise_mps: float = 0.0
    dropout: float = 0.0
    """Traffic and perception, as `sim_node.config.SimConfig` has them."""
    duration_s: float | None = None
    port: int = DEFAULT_PORT
    """Where users come in on loopback, if `listen` is empty."""
    listen: str = ""
    """zenoh's endpoint where users come in from anywhere, with `tls`."""
    tls: Tls | None = None
    name: str = ""
    """Of this car, before every key that users see."""
    say: str | None = None
    say_at_s: float = 3.0
    as_json: bool = False
    without: tuple[str, ...] = ()
    realtime: Mode = "auto"
    policy: str = "fastslow"
    """What drives, always behind the mask: see `fast_node.policies.load.load_policy`."""
    trace: Path | None = None
    """A folder for the stamps of every tick of sim and fast."""
    cockpit_port: int | None = None
    """Where the page is served that shows the run, on loopback; None: there is none; 0: any free port."""
    foxglove: bool = False
    """Serve Foxglove and Lichtblick, on loopback."""
    record: Path | None = None
    """Where the recording goes; None: `RECORDING` in the run's folder."""
    model: ModelOptions = ModelOptions()
    record_max_mb: float = 300.0
    """For the recordings of all runs in that folder together; the oldest are removed."""
    logs_max_mb: float = 100.0
    """For the logs of all runs in that folder together when this one begins, likewise."""


def free_port() -> int:
    """A loopback TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind((TCP_HOST, 0))
        port: int = probe.getsockname()[1]
        return port


def is_free(host: str, port: int) -> bool:
    """Whether nobody listens there now. Raises `ConfigError` where this user cannot listen there at all."""
    at = f"[{host}]:{port}" if ":" in host else f"{plain(host, 100)}:{port}"
    try:
        family, kind, proto, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, proto) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (socket.gaierror, UnicodeError):  # UnicodeError: a name that is too long, or has an empty part
        raise ConfigError(f"cannot listen on {at}: there is no host of that name; check it") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return False
        if host == TCP_HOST and error.errno == errno.EADDRNOTAVAIL:  # the loopback has none; `run` says how to mend it
            raise
        fix = {
            errno.EADDRNOTAVAIL: "give an address of this computer, or 0.0.0.0 for all of them",
            errno.EACCES: "choose a port above 1023",
        }.get(error.errno or 0, "give another address")
        raise ConfigError(f"cannot listen on {at}: {error.strerror}; {fix}") from None
    return True


def free_port_from(port: int) -> int:
    """`port` if nobody listens there now, else any free one."""
    return port if port and is_free(TCP_HOST, port) else free_port()


def road_of(spec: str) -> dict[str, Any]:
    """The fields of `SimConfig` that name a road, for a name or the path of a scenario file, whose text is read here.

    Raises `ConfigError` where there is no such file; the simulator says what is wrong with a text, or a name.
    """
    path = Path(spec)
    if path.suffix != ".toml":
        return {"scenario": spec}
    return {"scenario": path.name, "scenario_toml": read_text_bounded(path)}


def data_folder() -> Path:
    """Where what outlives a run is kept: `FASTSLOW_DATA`, or the platform's data folder."""
    chosen = os.environ.get("FASTSLOW_DATA")
    return Path(chosen) if chosen else user_data_path("fastslow", appauthor=False)


def door_of(options: RunOptions) -> DoorOptions:
    """Where users come in."""
    return DoorOptions(listen=options.listen or f"tcp/{TCP_HOST}:{options.port}", tls=options.tls, name=options.name)


def speak_to(options: RunOptions) -> str:
    """What `fastslow say` must be told to reach this run, or nothing."""
    if options.listen:
        return f" --connect {options.listen.partition('/')[0]}/HOST:{door_of(options).address[1]} --cert FILE" + (
            f" --name {options.name}" if options.name else ""
        )
    return "" if options.port == DEFAULT_PORT else f" --port {options.port}"


def links_of(options: RunOptions, folder: Path) -> Links:
    """The links of a run, whose sockets lie in `folder`."""
    return Links(folder, door_of(options), frozenset(options.without))


def process_table(options: RunOptions, model: Model, links: Links, folder: Path | None = None) -> tuple[Process, ...]:
    """The table of one run, in the order in which the processes are started. `folder`: the run's; None: no recorder."""

    def critical(name: str, *others: str) -> dict[str, object]:
        return {
            "bus": links.peer(name, *others),
            "realtime": options.realtime,
            "trace": str((options.trace / f"{name}.trace").absolute()) if options.trace else "",
        }

    sim: dict[str, object] = {
        **critical("sim", "fast"),
        **road_of(options.scenario),
        "sim": options.sim,
        "seed": options.seed,
        "density": options.density,
        "traffic": options.traffic,
        "noise_m": options.noise_m,
        "noise_mps": options.noise_mps,
        "dropout": options.dropout,
    }
    fast = {**critical("fast"), "policy": options.policy}
    if options.duration_s is not None:
        sim["duration_s"] = options.duration_s
    slow: dict[str, object] = {
        "bus": links.peer("slow", "sim", "fast"),
        **_asks(model),
        "memory_path": str(data_folder() / "memory.sqlite"),
        "thoughts_path": str((folder / THOUGHTS).absolute()) if folder else "",
        "wishes_path": str((folder / WISHES).absolute()) if folder else "",
    }
    table = [
        Process(name="fast", argv=python_module("fast_node", fast), critical=True),
        # The road begins once somebody is there to answer its first tick; hence it is the simulator that links to the
        # fast node, whose socket is there already, and not the other way round, after a retry.
        Process(
            name="sim",
            argv=python_module("sim_node", sim),
            critical=True,
            needs=("fast", "record"),
            finishes=True,
            start_s=SLOW_START_S,
        ),
        Process(name="slow", argv=python_module("slow_node", slow), critical=False, secrets=_secrets(model)),
    ]
    if model.embedded:
        table.insert(0, _embedded(model))
    if options.cockpit_port is not None:
        table.append(_page("cockpit", "deploy.cockpit", options.cockpit_port, links))
    if options.foxglove:
        table.append(_page("foxglove", "deploy.record.live", FOXGLOVE_PORT, links))
    if folder is not None:
        told = {"sim": sim, "fast": fast, "slow": slow}
        table.insert(0, _recorder(options, links, folder, told))
    if links.door is not None:
        table.insert(0, door_process(links))
    return tuple(process for process in table if process.name not in options.without)


def _asks(model: Model) -> dict[str, object]:
    """What the slow node is told of the model."""
    return {
        "base_url": model.base_url,
        "model": model.name,
        "api_key_env": "" if model.embedded else KEY,
        "embedded": model.embedded,
        "adapter": not model.weights,
        "budget_s": model.budget_s,
        "max_tokens": model.max_tokens,
    }


def _secrets(model: Model) -> tuple[str, ...]:
    """Those that the slow node needs: one model's, not the other's, and the collector's."""
    return (TOKEN if model.embedded else KEY, *(name for name in SECRETS if name.startswith("OTEL_")))


def _embedded(model: Model) -> Process:
    """Its HTTP thread shares the processor with the inference, at a low priority: slow is not dead."""
    return Process(
        name="llm",
        argv=python_module(
            "slow_node.llm.embedded",
            {"port": model.port, "threads": 1, "weights": model.weights, "adapter": not model.weights},
        ),
        critical=False,
        probe_url=f"http://{TCP_HOST}:{model.port}/health",
        heartbeat_s=10.0,
        start_s=SLOW_START_S,
        nice=10,
        secrets=(TOKEN,),
    )


def door_process(links: Links) -> Process:
    """Its row. It takes less of the processor than the others, unless a node that drives is behind it."""
    assert links.door is not None
    inward, outward = carried(links.door, links.left_out)
    polite = not {"sim", "fast"} & links.left_out
    config = {
        "bus": links.client("door"),
        "outside": links.outside(),
        "inward": [topic.name for topic in inward],
        "outward": [topic.name for topic in outward],
        "stand_ins": stand_ins_of(links.left_out),
        "polite": polite,
    }
    return _aside("door", "deploy.door", config, nice=10 if polite else 0)


def _aside(name: str, module: str, config: Mapping[str, object], nice: int = 10) -> Process:
    """The row of a process beside the loop. It has what the others leave of the processor: slow is not dead."""
    return Process(
        name=name, argv=python_module(module, config), critical=False, heartbeat_s=30.0, start_s=SLOW_START_S, nice=nice
    )


def _page(name: str, module: str, port: int, links: Links) -> Process:
    """Of what shows the car: the cockpit for a browser, the other for Foxglove and Lichtblick."""
    # The port is the same after a restart, so that open pages find it again.
    return _aside(name, module, {"bus": links.client(name), "port": free_port_from(port)})


def _recorder(options: RunOptions, links: Links, folder: Path, told: dict[str, dict[str, object]]) -> Process:
    """Its file says what the others were told, but for what is of this host alone."""
    here = ("bus", "realtime", "trace", "memory_path", "thoughts_path", "wishes_path", "base_url", "api_key_env")
    about = {
        "scenario": options.scenario,
        "seed": str(options.seed),
        "options": shlex.join(sys.argv[1:]),
        **{name: json.dumps({k: v for k, v in config.items() if k not in here}) for name, config in told.items()},
    }
    config = {
        "bus": links.client("record"),
        "path": str((options.record or folder / RECORDING).absolute()),
        "folder": str(folder.parent.absolute()),
        "max_mb": options.record_max_mb,
        "policy": options.policy,
        "about": about,
    }
    return _aside("record", "deploy.record", config, nice=0)  # it runs when nobody else wants to, as it arranges itself


def listener_of(port: int) -> str | None:
    """Who listens on a TCP port of this host, as `process PID (command line)`; None if that cannot be found out."""
    try:
        sockets = (s for s in psutil.net_connections("tcp") if s.status == psutil.CONN_LISTEN)
        pid = next((s.pid for s in sockets if s.laddr and s.laddr.port == port and s.pid is not None), None)
        return f"process {pid} ({' '.join(psutil.Process(pid).cmdline())[:120]})" if pid is not None else None
    except psutil.Error:  # it has ended meanwhile, or is somebody else's
        return None
