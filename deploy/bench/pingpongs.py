"""Ping-pongs over several transports beside each other, all of which take orders from the benchmark.

Any of them may die or never come up. That ends neither the benchmark nor the others.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any

from deploy.bench.deployed_system import Deployment
from deploy.bench.progress import MeasurementError
from deploy.bench.transports import EndConfig, Transport, socket_of
from deploy.run.launch import Launched, children, environment, python_module, temporary_folder
from deploy.run.processes import free_port
from schemas.runtime.realtime import Mode

PATIENCE_S = 20.0
"""An end that is silent for longer hangs."""


def dora_command() -> str | None:
    """Where dora-rs-cli is, if anywhere."""
    return shutil.which("dora", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")


def _trouble(parts: Sequence[Launched]) -> str:
    """What is wrong with an end of a ping-pong. One that ends with code 0 only follows the other, which says more."""
    ended = [part for part in parts if part.exit_code() is not None]
    failed = [part for part in ended if part.exit_code()]
    if failed or len(ended) == len(parts):
        return (failed or ended)[0].trouble()
    return ""


@dataclass
class _PingPong:
    orders: Connection
    parts: Sequence[Launched]
    trouble: Callable[[], str]

    def wait(self, patience_s: float, meanwhile: Callable[[], None]) -> Any:
        """The next thing that the near end says. Raises `MeasurementError`."""
        deadline = time.monotonic() + patience_s
        while not self.orders.poll(0.02):
            meanwhile()
            self.check()
            if time.monotonic() > deadline:
                raise MeasurementError(f"it did not answer for {patience_s:g} s{self.parts[-1].last_line()}")
        try:
            return self.orders.recv()
        except (EOFError, OSError):
            until = time.monotonic() + 1.0
            while time.monotonic() < until:  # the connection ends before the process does
                self.check()
                time.sleep(0.01)
            raise MeasurementError(f"its near end closed the connection{self.parts[-1].last_line()}") from None

    def check(self) -> None:
        """Raises `MeasurementError` if one of its processes has ended."""
        why = self.trouble() or _trouble(self.parts)
        if why:
            raise MeasurementError(why)


class PingPongs:
    """Participants, by transport, that take orders. One that does not start, dies or hangs is dropped, and `lost` says
    why; the others go on."""

    def __init__(
        self,
        folder: Path,
        peers: Sequence[Transport],
        sent: int,
        answered: int,
        realtime: Mode,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._folder, self._wanted, self._sizes, self._realtime = folder, tuple(peers), (sent, answered), realtime
        self._patience_s = patience_s
        self._live: dict[str, _PingPong] = {}
        self.scheduling: dict[str, str] = {}
        self.lost: dict[str, str] = {}

    def __enter__(self) -> PingPongs:
        with ExitStack() as stack:
            self._stack = stack
            self._sockets = stack.enter_context(temporary_folder())
            self._start = stack.enter_context(children())
            stack.callback(self._dismiss)
            for transport in self._wanted:
                self._add(transport)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are left."""
        return tuple(self._live)

    def parts(self, name: str) -> dict[str, int]:
        """The process ids of a participant, by what they are."""
        return {part.name: part.pid for part in self._live[name].parts}

    def order(self, name: str, *order: object) -> None:
        """Tell a participant what to do next."""
        try:
            self._live[name].orders.send(order)
        except OSError:  # it has ended; `reply` finds out how
            pass

    def reply(self, name: str, meanwhile: Callable[[], None] = lambda: None) -> tuple[list[int], ...] | None:
        """What it measured (see `deploy.bench.pingpong_end`), or None if it is lost. Calls `meanwhile` often."""
        if name not in self._live:
            return None
        try:
            took: tuple[list[int], ...] = self._live[name].wait(self._patience_s, meanwhile)
            return took
        except MeasurementError as lost:
            self.lose(name, str(lost))
            return None

    def check(self) -> None:
        """Drop those whose processes have ended."""
        for name, peer in [*self._live.items()]:
            try:
                peer.check()
            except MeasurementError as lost:
                self.lose(name, str(lost))

    def lose(self, name: str, why: str) -> None:
        """Go on without a participant, for this reason."""
        peer = self._live.pop(name, None)
        if peer is not None:
            peer.orders.close()
            for part in peer.parts:
                part.signal(signal.SIGKILL)
        self.lost[name] = why

    def join_ours(self, system: Deployment, seen: bytes) -> None:
        """Add the real fast node of `system`, with recorded observations sent to it in the simulator's place."""
        recorded = self._folder / "observation.bin"
        recorded.write_bytes(seen)
        self._meet(
            "ours",
            system.sockets,
            lambda: system.lost,
            lambda: [
                self._end(
                    "ours",
                    "near end",
                    EndConfig(
                        transport="ours",
                        near=True,
                        folder=str(system.sockets),
                        bus=system.links.peer("sim", "fast"),
                        observation=str(recorded),
                        realtime=self._realtime,
                    ),
                )
            ],
        )

    def _add(self, transport: Transport) -> None:
        sockets, port = self._sockets / transport, free_port()
        sockets.mkdir()
        far, near = (
            EndConfig(
                transport=transport,
                near=near,
                folder=str(sockets),
                port=port,
                sent_bytes=self._sizes[0],
                answered_bytes=self._sizes[1],
                realtime=self._realtime,
            )
            for near in (False, True)
        )
        self._meet(
            transport,
            sockets,
            lambda: "",
            lambda: (
                [self._dora(sockets, far, near)]
                if transport == "dora"
                else [self._end(transport, "far end", far), self._end(transport, "near end", near)]
            ),
        )

    def _end(self, transport: str, name: str, config: EndConfig) -> Launched:
        argv = python_module("deploy.bench.pingpong_end", config)
        return self._start(name, argv, self._folder / f"{transport}-{name[:-4]}.log")

    def _dora(self, folder: Path, far: EndConfig, near: EndConfig) -> Launched:
        def node(name: str, other: str, config: EndConfig) -> dict[str, object]:
            launcher = folder / f"{name}.py"
            launcher.write_text(
                "import sys\nsys.argv[1:] = [" + repr(_json(config)) + "]\nfrom deploy.bench import pingpong_end\n"
                "try:\n    pingpong_end.main()\nexcept (EOFError, KeyboardInterrupt):\n    pass\n",
                encoding="utf-8",
            )
            return {"id": name, "path": str(launcher), "inputs": {"in": f"{other}/out"}, "outputs": ["out"]}

        flow = folder / "flow.yml"
        flow.write_text(json.dumps({"nodes": [node("near", "far", near), node("far", "near", far)]}), encoding="utf-8")
        env = environment()
        env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env.get('PATH', '')}"
        argv = (dora_command() or "dora", "run", str(flow))
        return self._start("dataflow", argv, self._folder / "dora.log", env=env)

    def _meet(self, name: str, sockets: Path, trouble: Callable[[], str], start: Callable[[], list[Launched]]) -> None:
        """Start a participant and wait until its near end has come and is ready."""
        listener = self._stack.enter_context(Listener(socket_of(str(sockets), "orders")))
        met: list[Connection] = []

        def accept() -> None:
            try:
                met.append(listener.accept())
            except OSError:  # given up, and closed
                pass

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        parts = start()
        deadline = time.monotonic() + self._patience_s
        while not met:
            thread.join(0.02)
            why = trouble() or _trouble(parts)
            if not why and time.monotonic() > deadline:
                why = f"it did not come up within {self._patience_s:g} s{parts[-1].last_line()}"
            if why and not met:
                for part in parts:
                    part.signal(signal.SIGKILL)
                self.lost[name] = why
                return
        peer = self._live[name] = _PingPong(met[0], parts, trouble)
        try:
            _, self.scheduling[name] = peer.wait(self._patience_s, lambda: None)
            peer.wait(self._patience_s, lambda: None)
        except MeasurementError as lost:
            self.lose(name, str(lost))

    def _dismiss(self) -> None:
        for peer in self._live.values():
            try:
                peer.orders.send(None)
                peer.orders.close()
            except OSError:
                pass


def _json(config: EndConfig) -> str:
    return json.dumps(config)
