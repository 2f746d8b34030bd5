"""`fastslow bench sim`: our two engines beside stock highway-env and, where it is installed, EnvPool, in one run.

Every variant drives highway-v0 from the same seeds with the same random actions, on through crashes, and starts
anew after `EPISODE_S`; resets are not counted. They take turns, so that a machine whose speed drifts does so for all.

* stock, accelerated: one environment, `step` with observation, reward and info.
* batched: `SCENES` scenes in one call, ticks only (at 1 decision a second the others' observations do not count much:
  compare there).
* envpool: its own highway-v0 with as many vehicles, `SCENES` scenes in one call on one thread, with observation and
  reward; its own traffic, so no state to compare, and a crash starts an episode anew.

* training: `Scenes` of our highway (about 24 cars) behind the mask: a decision has its observation, reward, metrics and
  resets.

With `load`, the embedded language model answers without pause on the same machine meanwhile.
`*_per_cpu_s` are of one core's time (`process_time`); `p50_ms` and `p99_ms` are the wall time of one decision, of
`batched` and `envpool` for all their scenes.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deploy.bench.loads import asking
from deploy.bench.progress import MeasurementError
from deploy.run.model_server import embedded_server
from deploy.run.processes import Model, free_port
from schemas.runtime.process import ConfigError

if TYPE_CHECKING:
    from sim_node.engine.batched import BatchedRoads

SCHEMA = "fastslow.bench.sim/1"
HZ = 15
EPISODE_S = 20
SCENES = 64
VEHICLES = (20, 50)
POLICY_HZ = (15, 5, 1)
VARIANTS = ("batched", "accelerated", "stock", "envpool", "training")
LOADS = ("none", "llm")
ACTIONS = 5
OURS = 24
"""Cars on our highway, in the mean."""
PARITY_S = 4.0


class Engine(Protocol):
    """Something that makes one decision at a time; `scenes` of them at once."""

    scenes: int

    def reset(self, episode: int) -> None: ...

    def decide(self, action: NDArray[np.int64]) -> None: ...


class _Environment:
    scenes = 1

    def __init__(self, kind: type[Any], vehicles: int, policy_hz: int) -> None:
        self._env = kind({"vehicles_count": vehicles, "policy_frequency": policy_hz})

    def reset(self, episode: int) -> None:
        self._env.reset(seed=episode)

    def decide(self, action: NDArray[np.int64]) -> None:
        self._env.step(int(action[0]))


class _Batched:
    def __init__(self, kind: type[Any], vehicles: int, policy_hz: int, scenes: int) -> None:
        self.scenes, self._ticks = scenes, HZ // policy_hz
        self._env = kind({"vehicles_count": vehicles})
        self._worlds: dict[int, BatchedRoads] = {}

    def reset(self, episode: int) -> None:
        from sim_node.engine.batched import BatchedRoads

        if episode not in self._worlds:  # upstream takes its time to spawn
            roads = []
            for k in range(self.scenes):
                self._env.reset(seed=episode * self.scenes + k)
                roads.append(self._env.road)
            self._worlds[episode] = BatchedRoads(roads)
        self._world = deepcopy(self._worlds[episode])

    def decide(self, action: NDArray[np.int64]) -> None:
        self._world.tick(action, self._ticks)


class _EnvPool:
    def __init__(self, vehicles: int, policy_hz: int, scenes: int) -> None:
        import envpool  # type: ignore[import-not-found]

        self.scenes = scenes
        self._env = envpool.make_gymnasium(
            "Highway-v0",
            num_envs=scenes,
            num_threads=1,
            vehicles_count=vehicles,
            policy_frequency=policy_hz,
            simulation_frequency=HZ,
            duration=EPISODE_S,
            max_episode_steps=EPISODE_S * policy_hz,
        )

    def reset(self, episode: int) -> None:
        self._env.reset()

    def decide(self, action: NDArray[np.int64]) -> None:
        self._env.step(action.astype(np.int32))


class _Training:
    """What learns at this rate, with everything that it costs but the network."""

    def __init__(self, scenes: int, policy_hz: int) -> None:
        from deploy.lab.episodes import task_of
        from fast_node.training.rollout import Scenes
        from sim_node.engine.batched import Batched
        from sim_node.metrics import Recorder
        from sim_node.scenarios import SCENARIOS

        self.scenes = scenes
        scenario = SCENARIOS["highway"]
        self._world = Batched(scenario, scenes, 1)
        self._scenes = Scenes(self._world, task_of(scenario), 1, HZ // policy_hz)
        self._recorder = Recorder(scenario, scenes, policy_hz)
        self._all = np.ones(scenes, np.bool_)

    def reset(self, episode: int) -> None:
        """Scenes reset themselves within `decide`."""

    def decide(self, action: NDArray[np.int64]) -> None:
        world = self._world
        self._scenes.observe()
        _, terminated, truncated = self._scenes.decide(action)
        self._recorder.tick(world.rows, world.accel, world.target_lane, world.previous_lane, world.crashed, self._all)
        if (ended := terminated | truncated).any():
            self._scenes.reset(ended)
            self._recorder.restart(ended)


@contextmanager
def _loaded(load: str) -> Iterator[None]:
    """Keep the embedded language model answering for the time of the block; "none": nothing.

    Raises ConfigError where the model does not start.
    """
    if load == "none":
        yield
        return
    port = free_port()
    server = embedded_server(port, 1, adapter=True, polite=True)
    if server is None:
        raise ConfigError("the embedded language model did not start: `fastslow doctor` says what is missing")
    try:
        with asking(Model(base_url=f"http://127.0.0.1:{port}/v1", name="embedded", embedded=True, port=port), {}):
            yield
    except MeasurementError as lost:
        raise ConfigError(str(lost)) from None
    finally:
        server.kill()


@dataclass
class _Account:
    engine: Engine
    cpu_s: float = 0.0
    decisions: int = 0
    wall_ms: list[float] = field(default_factory=list)

    def take_turn(self, episode: int, actions: NDArray[np.int64], cpu_s: float) -> None:
        """Decide until this much CPU time is used, or the episode is over."""
        self.engine.reset(episode)
        used = 0.0
        for action in actions:
            wall, cpu = time.perf_counter(), time.process_time()
            self.engine.decide(action[: self.engine.scenes])
            took = time.process_time() - cpu
            self.wall_ms.append(1000.0 * (time.perf_counter() - wall))
            used += took
            self.decisions += self.engine.scenes
            if used >= cpu_s:
                break
        self.cpu_s += used


def variants() -> tuple[str, ...]:
    """Those that can run here."""
    return tuple(v for v in VARIANTS if v != "envpool" or importlib.util.find_spec("envpool") is not None)


def _accounts(names: Sequence[str], vehicles: int, policy_hz: int, scenes: int) -> dict[str, _Account]:
    from sim_node.engine.accelerated import accelerate
    from sim_node.engine.parity import stock_class

    kind = stock_class("highway-v0")
    makers: dict[str, Callable[[], Engine]] = {
        "batched": lambda: _Batched(kind, vehicles, policy_hz, scenes),
        "accelerated": lambda: _Environment(accelerate(kind), vehicles, policy_hz),
        "stock": lambda: _Environment(kind, vehicles, policy_hz),
        "envpool": lambda: _EnvPool(vehicles, policy_hz, scenes),
        "training": lambda: _Training(scenes, policy_hz),
    }
    return {name: _Account(makers[name]()) for name in names}


def _differences(vehicles: int, names: Sequence[str]) -> dict[str, float | None]:
    from sim_node.engine.parity import compare

    found: dict[str, float | None] = {
        f.variant: f.state for f in compare(f"highway-v0, {vehicles} vehicles", 0, PARITY_S)
    }
    return {name: 0.0 if name == "stock" else found.get(name) for name in names}


def bench_sim(
    *,
    seconds: float = 6.0,
    turns: int = 4,
    vehicles: Sequence[int] = VEHICLES,
    policy_hz: Sequence[int] = POLICY_HZ,
    names: Sequence[str] | None = None,
    scenes: int = SCENES,
    load: str = "none",
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """{"schema", "rows"}; a row per variant, number of vehicles and decision rate.

    seconds: CPU time of each variant in each setting, in `turns` turns; names: of `variants()`, all by default;
    scenes: of the batched engine. Raises ValueError for a rate that does not divide 15, an unknown variant or other
    numbers of vehicles than 20 and 50.
    """
    chosen = tuple(names) if names is not None else variants()
    if unknown := sorted(set(chosen) - set(variants())):
        raise ValueError(f"{', '.join(unknown)}: choose from {', '.join(variants())}")
    if load not in LOADS:
        raise ValueError(f"load {load!r}: choose from {', '.join(LOADS)}")
    if set(vehicles) - set(VEHICLES):
        raise ValueError(f"vehicles {sorted(set(vehicles) - set(VEHICLES))}: choose from {VEHICLES}")
    if wrong := [hz for hz in policy_hz if hz < 1 or HZ % hz]:
        raise ValueError(f"policy_hz {wrong[0]} does not divide {HZ}")
    rows = []
    with _loaded(load):
        for count in vehicles:
            differences = _differences(count, chosen)
            here = tuple(n for n in chosen if n != "training" or count == min(vehicles))
            for hz in policy_hz:
                progress(f"{count} vehicles, {hz} decisions a second")
                rows += list(_measure(here, count, hz, seconds, turns, scenes, differences))
    return {"schema": SCHEMA, "load": load, "rows": rows}


def _measure(
    names: Sequence[str],
    vehicles: int,
    hz: int,
    seconds: float,
    turns: int,
    scenes: int,
    differences: dict[str, float | None],
) -> Iterator[dict[str, Any]]:
    accounts = _accounts(names, vehicles, hz, scenes)
    rng = np.random.default_rng(0)
    warm = np.ones((2, scenes), np.int64)
    for account in accounts.values():  # compiles, and fills caches
        account.take_turn(0, warm, seconds)
        account.cpu_s, account.decisions, account.wall_ms = 0.0, 0, []
    for turn in range(turns):
        actions = rng.integers(0, ACTIONS, (EPISODE_S * hz, scenes))
        for account in accounts.values():
            share = seconds * (turn + 1) / turns
            while account.cpu_s < share:
                account.take_turn(turn, actions, share - account.cpu_s)
    for name, account in accounts.items():
        per_s = account.decisions / account.cpu_s
        p50, p99 = np.percentile(account.wall_ms, (50, 99))
        yield {
            "variant": name,
            "scenario": "highway" if name == "training" else "highway-v0",
            "vehicles": OURS if name == "training" else vehicles,
            "policy_hz": hz,
            "ticks_per_cpu_s": per_s * HZ / hz,
            "decisions_per_cpu_s": per_s,
            "p50_ms": float(p50),
            "p99_ms": float(p99),
            "max_state_difference": differences[name],
        }


def table(result: dict[str, Any]) -> str:
    """The rows as plain text, with each variant's speed as a multiple of stock highway-env's."""
    stock = {(r["vehicles"], r["policy_hz"]): r["ticks_per_cpu_s"] for r in result["rows"] if r["variant"] == "stock"}
    lines = [
        f"{'vehicles':>8}{'Hz':>4}  {'variant':<12}{'ticks/CPU s':>13}{'x stock':>9}{'decisions':>11}{'p50 ms':>9}"
        f"{'p99 ms':>9}{'max |difference|':>18}"
    ]
    for r in result["rows"]:
        base = stock.get((r["vehicles"], r["policy_hz"]))
        times = f"{r['ticks_per_cpu_s'] / base:.0f}" if base else "-"
        apart = "-" if r["max_state_difference"] is None else f"{r['max_state_difference']:g}"
        lines.append(
            f"{r['vehicles']:>8}{r['policy_hz']:>4}  {r['variant']:<12}{r['ticks_per_cpu_s']:>13,.0f}{times:>9}"
            f"{r['decisions_per_cpu_s']:>11,.0f}{r['p50_ms']:>9.2f}{r['p99_ms']:>9.2f}{apart:>18}"
        )
    return "\n".join(lines)
