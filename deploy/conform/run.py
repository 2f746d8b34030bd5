"""`fastslow conform`: a router for somebody's node, the node if a command starts it, and the verdict."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from deploy.conform import driver_drive, driver_duties, simulator_drive, simulator_duties
from deploy.conform.verdict import Duty, all_hold, as_data, table
from deploy.run.launch import children
from deploy.run.processes import TCP_HOST, free_port
from schemas.runtime.bus import BusConfig, BusError, open_bus
from schemas.runtime.process import CONFIG, FAILED, OK, TRY_AGAIN, UNAVAILABLE
from sim_node.config import SimConfig

Role = Literal["sim", "driver"]
PORT = "{port}"
"""Of a command: the router's port goes here."""


def conform(
    role: Role,
    command: Sequence[str],
    *,
    port: int,
    wait_s: float,
    budget_ms: float,
    scenario: str,
    seed: int,
    as_json: bool,
) -> int:
    """Try a node and print a line per duty; the exit code, 0 only if all hold.

    command: starts the node, with the router's port for `PORT`; empty: it comes by itself. wait_s: for its first
    message. budget_ms: the simulator's; scenario, seed: what a driver is shown.
    """
    port = port or free_port()
    try:
        config = SimConfig(scenario=scenario, seed=seed)
    except ValueError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    with ExitStack() as stack:
        try:
            bus = stack.enter_context(open_bus(BusConfig(mode="router", listen=(f"tcp/{TCP_HOST}:{port}",))))
        except BusError as error:
            print(f"fastslow: cannot listen on {TCP_HOST}:{port}: {error}; choose another with --port", file=sys.stderr)
            return TRY_AGAIN
        node = None
        if command:
            start = stack.enter_context(children())
            log = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fastslow-"))) / "node.log"
            words = [word.replace(PORT, str(port)) for word in command]
            try:
                node = start(role, words, log, env=dict(os.environ))
            except OSError as error:
                print(f"fastslow: cannot start {words[0]}: {error.strerror}", file=sys.stderr)
                return CONFIG
        else:
            print(f"fastslow: waiting for a {role} on tcp/{TCP_HOST}:{port}", file=sys.stderr)
        budget_ns = round(budget_ms * 1e6)

        def alive() -> bool:
            return node is None or node.exit_code() is None

        found: list[Duty]
        if role == "sim":
            drive = simulator_drive.drive(bus, budget_ns, wait_s, alive)
            came, found = bool(drive.steps or drive.faults), simulator_duties.duties(drive)
        else:
            showing = driver_drive.show(bus, budget_ns, wait_s, config, alive)
            came, found = showing.came, driver_duties.duties(showing)
        trouble = node.trouble() if node is not None else ""
    if not came:
        heard = trouble or f"nobody has spoken within {wait_s:g} s"
        print(f"fastslow: no message of a {role} came: {heard}", file=sys.stderr)
        return UNAVAILABLE
    if trouble:
        print(f"fastslow: {trouble}", file=sys.stderr)
    print(json.dumps(as_data(role, found)) if as_json else table(found))
    return OK if all_hold(found) else FAILED
