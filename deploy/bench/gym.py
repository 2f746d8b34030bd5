"""`fastslow bench gym`: our vector environment beside the sync and async ones of ours and of stock highway-env.

One task for all: highway-env's `highway-v0` (four lanes, 50 cars as upstream makes them), 15 ticks a second, random
actions, resets included. Ours has its own ego, features, reward and, but for `bare`, the safety mask; stock has its
Kinematics observation and its reward. The variants take turns, so that a machine whose speed drifts does so for all;
a ratio is of the same turn.

* vector, vector bare: `make_vec`, the batched engine, with the safety mask and without.
* sync, async: Gymnasium's vectors of our single environment.
* stock sync, stock async: the same of highway-env's.
* parallel: four cars on one road by PettingZoo's API, decisions of cars.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
import psutil
from numpy.typing import NDArray

from schemas.driving.road import HZ

SCHEMA = "fastslow.bench.gym/1"
ROAD, STOCK = "fastslow/StockHighway-v0", "highway-v0"
CARS = 4
DURATION_S = 40


class Many(Protocol):
    """What makes `size` decisions in one step."""

    size: int

    def step(self) -> None: ...

    def close(self) -> None: ...


class _Vector:
    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        self._env, self.size, self._rng = env, env.num_envs, np.random.default_rng(0)
        env.reset(seed=0)

    def step(self) -> None:
        self._env.step(self._rng.integers(0, 5, self.size))

    def close(self) -> None:
        self._env.close()


class _Parallel:
    def __init__(self, decision_hz: int) -> None:
        from deploy.environments.parallel import DrivingParallelEnv

        self._env = DrivingParallelEnv("highway-v0", CARS, decision_hz=decision_hz)
        self.size, self._rng = CARS, np.random.default_rng(0)
        self._env.reset(seed=0)

    def step(self) -> None:
        if not self._env.agents:
            self._env.reset()
        self._env.step({car: int(self._rng.integers(5)) for car in self._env.agents})

    def close(self) -> None:
        self._env.close()


def _makers(envs: int, decision_hz: int) -> dict[str, Callable[[], Many]]:
    import highway_env  # noqa: F401 - registers highway-v0

    import deploy.environments.register as ours

    ours.register()
    stock: dict[str, Any] = {"config": {"policy_frequency": decision_hz, "duration": DURATION_S}}
    mine: dict[str, Any] = {"decision_hz": decision_hz, "duration_s": float(DURATION_S)}

    def of(name: str, mode: str | None, settings: Mapping[str, Any]) -> Callable[[], Many]:
        return lambda: _Vector(gymnasium.make_vec(name, num_envs=envs, vectorization_mode=mode, **settings))

    return {
        "vector": of(ROAD, None, mine),
        "vector bare": of(ROAD, None, {**mine, "mask": None}),
        "sync": of(ROAD, "sync", mine),
        "async": of(ROAD, "async", mine),
        "stock sync": of(STOCK, "sync", stock),
        "stock async": of(STOCK, "async", stock),
        "parallel": lambda: _Parallel(decision_hz),
    }


VARIANTS = ("vector", "vector bare", "sync", "async", "stock sync", "stock async", "parallel")


class _Account:
    """A variant, the processes that it has started, and its rates turn by turn."""

    def __init__(self, make: Callable[[], Many]) -> None:
        before = set(psutil.Process().children(recursive=True))
        self.many = make()
        self.many.step()  # compiles, and fills caches
        self._workers = [p for p in psutil.Process().children(recursive=True) if p not in before]
        self.per_s: list[float] = []
        self.per_cpu_s: list[float] = []

    def take_turn(self, seconds: float) -> None:
        """Decide for so many seconds of all cores' time."""
        before, began, steps, used = self._cpu_s(), time.perf_counter(), 0, 0.0
        while used < seconds:
            self.many.step()
            steps += 1
            used = self._cpu_s() - before
        self.per_s.append(steps * self.many.size / (time.perf_counter() - began))
        self.per_cpu_s.append(steps * self.many.size / used)

    def _cpu_s(self) -> float:
        workers = (worker.cpu_times() for worker in self._workers)
        return time.process_time() + sum(t.user + t.system for t in workers)


def bench_gym(
    *,
    envs: int = 16,
    decision_hz: int = 3,
    seconds: float = 2.0,
    turns: int = 5,
    names: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """{"schema", "envs", "decision_hz", "turns", "rows"}; a row per variant: decisions per second of the wall's clock
    and of all cores' time, and how many times as many the first variant makes (median, least and most of the turns).

    seconds: of all cores' time, for a variant's turn. Raises ValueError for an unknown variant, or a rate that does not
    divide 15.
    """
    chosen = tuple(names or VARIANTS)
    if unknown := sorted(set(chosen) - set(VARIANTS)):
        raise ValueError(f"{', '.join(unknown)}: choose from {', '.join(VARIANTS)}")
    if decision_hz < 1 or HZ % decision_hz:
        raise ValueError(f"decision_hz {decision_hz} does not divide {HZ}")
    makers = _makers(envs, decision_hz)
    accounts: dict[str, _Account] = {}
    try:
        for name in chosen:
            progress(f"starting {name}")
            accounts[name] = _Account(makers[name])
        for turn in range(turns):
            progress(f"turn {turn + 1} of {turns}")
            for account in accounts.values():
                account.take_turn(seconds)
    finally:
        for account in accounts.values():
            account.many.close()
    first = accounts[chosen[0]]
    return {
        "schema": SCHEMA,
        "envs": envs,
        "decision_hz": decision_hz,
        "turns": turns,
        "seconds": seconds,
        "rows": [
            {
                "variant": name,
                "decisions_per_s": float(np.median(account.per_s)),
                "decisions_per_cpu_s": float(np.median(account.per_cpu_s)),
                "first_is_times": _ratio(first.per_s, account.per_s),
                "first_is_times_per_cpu_s": _ratio(first.per_cpu_s, account.per_cpu_s),
            }
            for name, account in accounts.items()
        ],
    }


def _ratio(first: Sequence[float], other: Sequence[float]) -> list[float]:
    """Median, least and most."""
    times: NDArray[np.float64] = np.array(first) / np.array(other)
    return [float(np.median(times)), float(times.min()), float(times.max())]


def table(result: Mapping[str, Any]) -> str:
    """The rows as plain text."""
    first = result["rows"][0]["variant"]
    lines = [
        f"{result['envs']} environments, {result['decision_hz']} decisions a second, {result['turns']} turns",
        f"{'variant':<14}{'decisions/s':>13}{'per CPU s':>12}   {first + ' is ... times as fast':<34}per CPU s",
    ]
    for row in result["rows"]:
        wall, cpu = (
            "{:.1f} ({:.1f} to {:.1f})".format(*row[name]) for name in ("first_is_times", "first_is_times_per_cpu_s")
        )
        lines.append(
            f"{row['variant']:<14}{row['decisions_per_s']:>13,.0f}{row['decisions_per_cpu_s']:>12,.0f}"
            f"   {wall:<34}{cpu}"
        )
    return "\n".join(lines)
