"""`fastslow evaluate`: agents on scenarios over seeds that training never saw, many scenes at once, at 15 Hz."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from deploy.lab.agents import LANGUAGE, USE_OURS, trained_as
from deploy.lab.episodes import FIRST_SEED, Directive
from deploy.lab.farm import Farm
from deploy.lab.orders import BEST
from deploy.lab.paired import Episode, episode_of
from deploy.lab.rows import Cell, Kept, driven
from deploy.lab.statistics import wilson95
from schemas.runtime.process import ConfigError
from sim_node.results import EpisodeResult, summarise
from sim_node.scenario_file import find_scenario

SCHEMA = "fastslow.evaluate/1"
Film = Callable[[Mapping[str, Any], Sequence[EpisodeResult], Callable[..., list[EpisodeResult]]], None]
"""What films some of a row's episodes: who drove where, what came of each, and how to drive all of them once more,
with a `watch` as `deploy.lab.agents.drive` takes it."""


def evaluate_all(
    agents: Sequence[str] | None,
    scenarios: Sequence[str],
    episodes: int,
    *,
    policies: Sequence[str] = (),
    first_seed: int = FIRST_SEED,
    checkpoint: Path | None = None,
    directive: Directive = "hurry",
    directive_at_s: float = 0.0,
    mask_preset: str | None = None,
    density: float = 1.0,
    traffic: Sequence[str] = (),
    wishes_mps: Sequence[float | None] = (None,),
    noise_m: float = 0.0,
    noise_mps: float = 0.0,
    dropout: float = 0.0,
    sim: str = "highway-env",
    progress: Callable[[str], None] = lambda _: None,
    each: list[Episode] | None = None,
    film: Film | None = None,
    farm: Farm | None = None,
    kept: Kept | None = None,
) -> dict[str, Any]:
    """A row per scenario, agent and wished speed [m/s] (None: as the directive has it), over the seeds from
    `first_seed`; per scenario the seeds that nobody survived. The result's own `wish_mps` is None for several wishes.

    `scenarios`: names or files, as `find_scenario` takes them. `directive_at_s`, `mask_preset`: see `drive`. `density`:
    times each scenario's own. `traffic`: as `Scenario.varied` takes it.

    `policies`, as `load_policy` takes them, drive behind the mask and are agents under these names. Without agents and
    policies the one whose policy is in `checkpoint` drives, or ours. Raises `ConfigError` for a checkpoint that none
    of the agents uses, and as `drive` does, which noise_m, noise_mps, dropout and sim are for. Every episode is
    appended to `each`. `film` is called for every row. Raises ValueError for one of a driver of `LANGUAGE`, whose
    model is not asked the same twice. `farm`: where the rows are driven (None: here, one after the other); `kept`: what
    has been driven before, and where it is kept.
    """
    own = trained_as(checkpoint) if checkpoint else "ours"
    if agents is None:
        agents = [] if policies and not checkpoint else [own]
    if checkpoint and not set(agents) & {own, *(USE_OURS if own == "ours" else ())}:
        raise ConfigError(f"{checkpoint.name} drives as {own}, not as {', '.join(agents)}: choose --agent {own}")
    seeds = range(first_seed, first_seed + episodes)
    conditions: dict[str, Any] = {
        "directive_at_s": directive_at_s,
        "mask_preset": mask_preset,
        "noise_m": noise_m,
        "noise_mps": noise_mps,
        "dropout": dropout,
        "sim": sim,
    }
    for agent in agents:
        if agent in LANGUAGE:
            _refuse_for_language(agent, conditions, film is not None)
    drivers = [*((agent, False) for agent in agents), *((spec, True) for spec in policies)]
    cells = [
        Cell(
            agent=agent,
            is_policy=is_policy,
            scenario=scenario.varied(traffic, density),
            seeds=seeds,
            wish_mps=wish_mps,
            directive=directive,
            checkpoint=None if is_policy or agent == BEST else checkpoint,
            conditions=conditions,
        )
        for scenario in [find_scenario(spec) for spec in scenarios]
        for (agent, is_policy), wish_mps in itertools.product(drivers, wishes_mps)
    ]
    rows, died = [], {cell.scenario.name: set(range(episodes)) for cell in cells}
    for cell, (results, more) in zip(cells, driven(cells, farm or Farm(), kept or Kept(None), progress), strict=True):
        if film is not None:
            film({**cell.place, "first_seed": first_seed, "directive_at_s": directive_at_s}, results, cell.again(more))
        if each is not None:
            each += [episode_of(cell.place, seed, r) for seed, r in zip(seeds, results, strict=True)]
        died[cell.scenario.name] &= {i for i, r in enumerate(results) if r.collided}
        rows.append(
            {
                "agent": cell.agent,
                "scenario": cell.scenario.name,
                "speed_set": cell.scenario.speed_set,
                "wish_mps": cell.wish_mps,
                "first_seed": first_seed,
                "density": density,
                "traffic": list(traffic),
                **conditions,
                "success_ci95": wilson95(sum(r.success for r in results), episodes),
                **_numbers(summarise(results)),
                **more,
            }
        )
    return {
        "schema": SCHEMA,
        "directive": directive,
        "wish_mps": wishes_mps[0] if len(wishes_mps) == 1 else None,
        "rows": rows,
        "unsurvived": {name: sorted(first_seed + i for i in those) for name, those in died.items()},
    }


def _refuse_for_language(agent: str, conditions: dict[str, Any], filmed: bool) -> None:
    """Raise ValueError for what a driver of `LANGUAGE` does not know."""
    if conditions["directive_at_s"] or conditions["mask_preset"]:
        raise ValueError(f"{agent} has its directive from the start, and no mask")
    if conditions["noise_m"] or conditions["noise_mps"] or conditions["dropout"]:
        raise ValueError(f"{agent} sees everything as it is: leave noise and dropout out")
    if conditions["sim"] != "highway-env":
        raise ValueError(f"{agent} drives in highway-env only: leave --sim out")
    if filmed:
        raise ValueError(f"{agent} drives otherwise each time: leave --video out")


def _numbers(metrics: dict[str, float]) -> dict[str, float | None]:
    """With None for what is not a number, as JSON has it."""
    return {name: None if math.isnan(value) else value for name, value in metrics.items()}
