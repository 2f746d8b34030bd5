"""Many tasks that know nothing of each other, side by side: in processes of this machine, or on a Ray cluster.

A task is a function of a module and its arguments. What it does must not depend on where it runs: files are handed over
by value, and numerical libraries have one thread everywhere.
"""

from __future__ import annotations

import hashlib
import importlib.util
import multiprocessing
import os
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import deploy
import fast_node
import schemas
import sim_node
from schemas.runtime.process import ConfigError, die_with_parent

R = TypeVar("R")
LOCAL = "local"
"""The address of a cluster that is started on this machine for as long as it takes."""
RETRIES = 3
"""So often a task whose worker was lost is begun again, elsewhere if need be."""
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Farm:
    """Where tasks run."""

    jobs: int = 0
    """So many side by side, each in a process of its own; 0: one after the other, in this process."""
    ray: str | None = None
    """The address of a Ray cluster instead: `LOCAL`, "auto" for the one this machine belongs to, or HOST:PORT."""

    def run(self, call: Callable[..., R], tasks: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, R]]:
        """(place in `tasks`, result) of each, as they come. What a task raises is raised here; tasks that have not
        begun are given up then. Raises `ConfigError` for a cluster that is not there."""
        if not tasks:
            return iter(())
        if self.ray is not None:
            return _on_ray(call, tasks, self.ray)
        return _in_processes(call, tasks, self.jobs) if self.jobs else ((k, call(*t)) for k, t in enumerate(tasks))


def _in_processes(call: Callable[..., R], tasks: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[tuple[int, R]]:
    os.environ.update(_ONE_THREAD)  # read by the processes to come
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), initializer=_ends_quietly)
    try:
        running = {pool.submit(call, *task): place for place, task in enumerate(tasks)}
        for future in as_completed(running):
            yield running[future], future.result()
    except BrokenProcessPool:
        raise ConfigError(
            "a process was killed while it worked (is there too little memory?): take fewer --jobs; the same command "
            "goes on where it ended"
        ) from None
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _ends_quietly() -> None:
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _on_ray(call: Callable[..., R], tasks: Sequence[tuple[Any, ...]], address: str) -> Iterator[tuple[int, R]]:
    if importlib.util.find_spec("ray") is None:
        raise ConfigError("ray is missing: pip install 'fastslow[ray]'")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # or it warns of graphics cards
    if address == LOCAL:  # or it would listen at the machine's own address, whatever it is told
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    import ray

    joined = not ray.is_initialized()  # whoever has joined a cluster before stays in it
    if joined:
        _join(ray, address)
    try:
        remote = ray.remote(num_cpus=1, max_retries=RETRIES, runtime_env={"env_vars": _ONE_THREAD})(_as_here)
        here = (code_digest(), os.getcwd(), call)
        running = {remote.remote(*here, *task): place for place, task in enumerate(tasks)}
        while running:
            (done,), _ = ray.wait(list(running), num_returns=1)
            place = running.pop(done)
            try:
                yield place, ray.get(done)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None
            except ray.exceptions.RayError as error:
                first = str(error).strip().partition("\n")[0]
                raise ConfigError(f"task {place} was lost {1 + RETRIES} times on {address}: {first}") from None
    finally:
        if joined:
            ray.shutdown()


def _as_here(code: str, folder: str, call: Callable[..., R], *task: Any) -> R:
    """The task as it would run where it comes from: with the same code, and in the same folder, if there is one."""
    if code_digest() != code:
        raise ConfigError(f"{socket.gethostname()} has other code or weights of fastslow: install the same everywhere")
    with suppress(OSError):
        os.chdir(folder)
    return call(*task)


@cache
def code_digest() -> str:
    """Of all that drives and learns: source and weights."""
    digest = hashlib.sha256()
    for package in (schemas, sim_node, fast_node, deploy):
        (folder,) = package.__path__
        for path in sorted(Path(folder).rglob("*")):
            if path.suffix in (".py", ".safetensors", ".json", ".toml"):
                digest.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return digest.hexdigest()


def _join(ray: Any, address: str) -> None:
    quiet = {"log_to_driver": False, "logging_level": "ERROR"}
    if address == LOCAL:
        ray.init(address=LOCAL, include_dashboard=False, _node_ip_address="127.0.0.1", **quiet)
        return
    try:
        host, colon, port = address.rpartition(":")
        if colon:  # Ray itself would try for minutes
            socket.create_connection((host, int(port)), timeout=5.0).close()
        ray.init(address=address, **quiet)
    except (OSError, ValueError, RuntimeError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ConfigError(
            f"no Ray cluster at {address}: start one by `ray start --head`, or give --ray {LOCAL}: {first}"
        ) from None
