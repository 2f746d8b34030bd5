"""`python -m sim_node.engine.parity`: the engine beside highway-env, tick by tick, to the last bit.

Every run starts both from the same seed, sends both the same random actions and goes on through crashes. The figures
are maxima of |difference|: state (positions, headings, speeds, targets, lanes, timers, controls, impacts, crashes of
everything on the road), observation, reward; flags counts decisions whose terminated or truncated differ.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import highway_env  # noqa: F401  registers the environments
import numpy as np
from gymnasium.envs.registration import registry
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road
from highway_env.utils import class_from_path
from numpy.typing import NDArray

from schemas.driving.episode import held
from schemas.driving.road import HZ, ID
from schemas.wire.messages import MetaAction
from sim_node.engine import bridge
from sim_node.engine.accelerated import accelerate
from sim_node.engine.batched import Batched, BatchedRoads
from sim_node.engine.kernel import layout
from sim_node.env import ScenarioEnv
from sim_node.observe import rows
from sim_node.scenarios import SCENARIOS, Scenario
from sim_node.scenarios.manners import VARIED
from sim_node.scenarios.scenario import streams

DECISION_HZ = 5
TICKS = HZ // DECISION_HZ
STOCK: dict[str, tuple[str, dict[str, Any]]] = {
    "highway-v0, 20 vehicles": ("highway-v0", {"vehicles_count": 20}),
    "highway-v0, 50 vehicles": ("highway-v0", {"vehicles_count": 50}),
    "merge-v1": ("merge-v1", {}),
    "two-way-v0, stock ego": ("two-way-v0", {}),
}
OURS: dict[str, Scenario] = {
    **SCENARIOS,
    **{f"{name}, varied": SCENARIOS[name].varied(list(VARIED)) for name in ("highway", "merge", "two-way-natural")},
}
"""Our scenarios, and some of them with trucks, sudden braking, sway, other drivers and narrow lanes at once."""
ROAD_END_M = {"two-way-v0": 770.0}
"""Beyond this upstream divides by zero (`TwoWayEnv._rewards`); the comparison stops before."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What one or several runs showed."""

    case: str
    variant: str
    runs: int = 1
    ticks: int = 0
    crashes: int = 0
    """Vehicles that had crashed by the end."""
    state: float = 0.0
    observation: float = 0.0
    reward: float = 0.0
    flags: int = 0

    @property
    def identical(self) -> bool:
        """Whether nothing differed."""
        return self.state == self.observation == self.reward == self.flags == 0

    def __add__(self, other: Figures) -> Figures:
        return replace(
            self,
            runs=self.runs + other.runs,
            ticks=self.ticks + other.ticks,
            crashes=self.crashes + other.crashes,
            state=_worst(self.state, other.state),
            observation=_worst(self.observation, other.observation),
            reward=_worst(self.reward, other.reward),
            flags=self.flags + other.flags,
        )


def cases() -> list[str]:
    """Stock environments, then our scenarios."""
    return [*STOCK, *OURS]


def compare(case: str, seed: int, seconds: float) -> list[Figures]:
    """One run of `case`: the accelerated and the batched variant against upstream."""
    return _compare_stock(case, seed, seconds) if case in STOCK else _compare_ours(case, seed, seconds)


def stock_class(name: str) -> type[AbstractEnv]:
    """The class behind one of highway-env's gymnasium ids."""
    entry = registry[name].entry_point
    if not isinstance(entry, str):
        raise ValueError(f"{name!r} has no class behind it")
    found: type[AbstractEnv] = class_from_path(entry.replace(":", "."))
    return found


def _compare_stock(case: str, seed: int, seconds: float) -> list[Figures]:
    name, config = STOCK[case]
    kind = stock_class(name)
    slow = kind({**config, "policy_frequency": DECISION_HZ})
    fast = accelerate(kind)({**config, "policy_frequency": DECISION_HZ})
    worst_observation = _gap(slow.reset(seed=seed)[0], fast.reset(seed=seed)[0])
    many = BatchedRoads([slow.road])
    rng = np.random.default_rng(seed)
    state = batched = reward = 0.0
    flags = ticks = 0
    for _ in range(round(seconds * DECISION_HZ)):
        action = int(rng.integers(slow.action_space.n))
        theirs, ours = slow.step(action), fast.step(action)
        many.tick(np.array([action]), TICKS)
        ticks += TICKS
        theirs_f, theirs_g = _state(slow.road)
        state = _worst(state, _differ((theirs_f, theirs_g), _state(fast.road)))
        batched = _worst(batched, _differ((theirs_f, theirs_g), (_clean(many.f[0], many.g[0]), many.g[0])))
        worst_observation = _worst(worst_observation, _gap(theirs[0], ours[0]))
        reward = _worst(reward, abs(float(theirs[1]) - float(ours[1])))
        flags += theirs[2:4] != ours[2:4]
        if slow.vehicle.position[0] > ROAD_END_M.get(name, np.inf):
            break
    of: dict[str, Any] = {"case": case, "ticks": ticks, "crashes": sum(bool(v.crashed) for v in slow.road.vehicles)}
    return [
        Figures(**of, variant="accelerated", state=state, observation=worst_observation, reward=reward, flags=flags),
        Figures(**of, variant="batched", state=batched),
    ]


def _compare_ours(case: str, seed: int, seconds: float) -> list[Figures]:
    scenario = OURS[case]
    plain = type("Plain", (ScenarioEnv,), {"_simulate": AbstractEnv._simulate})
    goals: list[float] = []

    def note_goal(env: ScenarioEnv, meta: int) -> int:
        goals.append(env.intent.speed_mps)
        return meta

    slow = plain(scenario, decision_hz=DECISION_HZ, duration_s=None, guard=note_goal)
    fast = accelerate(ScenarioEnv)(scenario, decision_hz=DECISION_HZ, duration_s=None)
    worst_observation = _gap(slow.reset(seed=seed)[0], fast.reset(seed=seed)[0])
    many = Batched(scenario, 1, 0)
    many.load(0, scenario.spawn(streams(seed)[0]))
    many.keep_going()
    rng = np.random.default_rng(seed)
    state = batched = reward = batched_rows = 0.0
    flags = ticks = 0
    for _ in range(round(seconds * DECISION_HZ)):
        # Mostly holding: random actions alone would never finish a lane change.
        action = int(rng.integers(len(MetaAction))) if rng.random() < 0.3 else int(MetaAction.CRUISE)
        goals.clear()
        theirs, ours = slow.step(action), fast.step(action)
        for k, goal in enumerate(goals):
            many.tick(np.array([action if k == 0 else held(action)]), np.array([goal]))
        ticks += len(goals)
        reference = _state(slow.road)
        state = _worst(state, _differ(reference, _state(fast.road)))
        state = _worst(state, _gap(_set_points(slow.ego), _set_points(fast.ego)))
        floats, ints = many.state(0)
        batched = _worst(batched, _differ(reference, (_clean(floats, ints), ints)))
        batched = _worst(
            batched,
            _gap(
                _set_points(slow.ego), [many.target_speed[0], many.target_lane[0], many.previous_lane[0], many.accel[0]]
            ),
        )
        seen = many.rows[0][many.rows[0, :, ID] >= 0]
        table = rows(slow.road, slow.ego, scenario.sight_m, slow.lane_map, len(seen))
        batched_rows = _worst(batched_rows, _gap(table[np.argsort(table[:, ID])], seen))
        worst_observation = _worst(worst_observation, _gap(theirs[0], ours[0]))
        reward = _worst(reward, abs(float(theirs[1]) - float(ours[1])))
        flags += theirs[2:4] != ours[2:4]
        if slow.ego.position[0] > scenario.end_x_m:
            break
    of: dict[str, Any] = {"case": case, "ticks": ticks, "crashes": sum(bool(v.crashed) for v in slow.road.vehicles)}
    return [
        Figures(**of, variant="accelerated", state=state, observation=worst_observation, reward=reward, flags=flags),
        Figures(**of, variant="batched", state=batched, observation=batched_rows),
    ]


def _set_points(ego: Any) -> list[float]:
    return [float(ego.target_speed), ego.target_lane, ego.previous_lane, float(ego.acceleration)]


State = tuple[NDArray[np.float64], NDArray[np.int64]]


def _state(road: Road) -> State:
    """The state of a road as the kernel's arrays, with the controls of the last tick."""
    reader = bridge.Bridge()
    reader.read(road)
    f, g = reader.f[0], reader.g[0]
    for i, v in enumerate(road.vehicles):
        f[layout.STEERING, i], f[layout.ACCEL, i] = v.action["steering"], v.action["acceleration"]
    return _clean(f, g), g


def _clean(f: NDArray[np.float64], g: NDArray[np.int64]) -> NDArray[np.float64]:
    """Without impacts that are none."""
    return np.where(
        (np.arange(len(f))[:, None] >= layout.PUSH_X)
        & (np.arange(len(f))[:, None] <= layout.PUSH_Y)
        & (g[layout.PUSHED] == 0),
        0.0,
        f,
    )


def _differ(a: State, b: State) -> float:
    if a[1].shape != b[1].shape:
        return np.inf
    return _worst(_gap(a[0], b[0]), _gap(a[1], b[1]))


def _gap(a: Any, b: Any) -> float:
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if x.shape != y.shape:
        return np.inf
    return float(np.max(np.where(x == y, 0.0, np.abs(x - y)), initial=0.0))


def _worst(a: float, b: float) -> float:
    return float(np.maximum(a, b))  # nan wins


def _run(job: tuple[str, int, float]) -> list[Figures]:
    return compare(*job)


def run(names: Iterable[str], seeds: int, seconds: float, processes: int) -> Iterator[tuple[int, int, list[Figures]]]:
    """(runs done, runs in all, the figures of one) as they come in."""
    jobs = [(name, seed, seconds) for name in names for seed in range(seeds)]
    with ProcessPoolExecutor(processes) as pool:
        for done, figures in enumerate(pool.map(_run, jobs), 1):
            yield done, len(jobs), figures


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m sim_node.engine.parity", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="3 seeds x 10 s instead of 20 x 40 s")
    parser.add_argument("--case", action="append", choices=cases(), help="only this one; may be repeated")
    parser.add_argument("--processes", type=int, default=2, help="default: 2")
    options = parser.parse_args()
    seeds, seconds = (3, 10.0) if options.quick else (20, 40.0)
    totals: dict[tuple[str, str], Figures] = {}
    for done, of, figures in run(options.case or cases(), seeds, seconds, options.processes):
        for one in figures:
            key = (one.case, one.variant)
            totals[key] = totals[key] + one if key in totals else one
        print(f"\r{done}/{of} {figures[0].case:<32}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(
        f"{'case':<26}{'variant':<13}{'runs':>5}{'ticks':>8}{'crashed':>9}{'state':>10}{'observed':>10}{'reward':>10}"
        f"{'flags':>7}"
    )
    for f in totals.values():
        print(
            f"{f.case:<26}{f.variant:<13}{f.runs:>5}{f.ticks:>8}{f.crashes:>9}{f.state:>10.3g}{f.observation:>10.3g}"
            f"{f.reward:>10.3g}{f.flags:>7}"
        )
    return 0 if all(f.identical for f in totals.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
