"""`fastslow evaluate`: agents on scenarios over seeds that training never saw, many scenes at once, at 15 Hz."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from deploy.lab.agents import LANGUAGE, USE_OURS, Agent, behind_the_mask, drive, trained_as
from deploy.lab.episodes import FIRST_SEED, Directive
from deploy.lab.language_driver import drive_dilu, memory, running_model
from deploy.lab.orders import BEST, best_order
from deploy.lab.paired import Episode, episode_of
from deploy.lab.statistics import wilson95
from schemas.runtime.process import ConfigError
from sim_node.results import EpisodeResult, summarise
from sim_node.scenario_file import find_scenario
from sim_node.scenarios import Scenario

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
    progress: Callable[[str], None] = lambda _: None,
    each: list[Episode] | None = None,
    film: Film | None = None,
) -> dict[str, Any]:
    """A row per scenario, agent and wished speed [m/s] (None: as the directive has it), over the seeds from
    `first_seed`; per scenario the seeds that nobody survived. The result's own `wish_mps` is None for several wishes.

    `scenarios`: names or files, as `find_scenario` takes them. `directive_at_s`, `mask_preset`: see `drive`. `density`:
    times each scenario's own. `traffic`: as `Scenario.varied` takes it.

    `policies`, as `load_policy` takes them, drive behind the mask and are agents under these names. Without agents and
    policies the one whose policy is in `checkpoint` drives, or ours. Raises `ConfigError` for a checkpoint that none
    of the agents uses, and as `drive` does, which noise_m, noise_mps and dropout are for. Every episode is appended to
    `each`. `film` is called for every row. Raises ValueError for one of a driver of `LANGUAGE`, whose model is not
    asked the same twice.
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
    }
    for agent in agents:
        if agent in LANGUAGE:
            _refuse_for_language(agent, conditions, film is not None)
    rows, unsurvived = [], {}
    for scenario in [find_scenario(spec) for spec in scenarios]:
        name = scenario.name
        road = scenario.varied(traffic, density)
        died = set(range(episodes))
        drivers = [*((agent, False) for agent in agents), *((spec, True) for spec in policies)]
        for (agent, is_policy), wish_mps in itertools.product(drivers, wishes_mps):
            place = {"scenario": name, "agent": agent, "wish_mps": wish_mps, "directive": directive}
            progress(f"{agent} on {name}" + ("" if wish_mps is None else f", {wish_mps:g} m/s wished"))
            more: dict[str, Any] = {}
            if agent in LANGUAGE and not is_policy:
                results, more["llm"] = _drive_language(agent, road, seeds, directive, wish_mps)
            else:
                who: str | Agent = behind_the_mask(agent) if is_policy else agent
                if agent == BEST:
                    more["order"] = best_order(road, wish_mps=wish_mps, directive=directive, **conditions)
                    who = behind_the_mask(more["order"])
                again = partial(
                    drive,
                    who,
                    road,
                    seeds,
                    checkpoint=None if is_policy or agent == BEST else checkpoint,
                    wish_mps=wish_mps,
                    directive=directive,
                    **conditions,
                )
                results = again()
                if film is not None:
                    film({**place, "first_seed": first_seed, "directive_at_s": directive_at_s}, results, again)
            if each is not None:
                each += [episode_of(place, seed, r) for seed, r in zip(seeds, results, strict=True)]
            died &= {i for i, r in enumerate(results) if r.collided}
            rows.append(
                {
                    "agent": agent,
                    "scenario": name,
                    "speed_set": scenario.speed_set,
                    "wish_mps": wish_mps,
                    "first_seed": first_seed,
                    "density": density,
                    "traffic": list(traffic),
                    **conditions,
                    "success_ci95": wilson95(sum(r.success for r in results), episodes),
                    **_numbers(summarise(results)),
                    **more,
                }
            )
        unsurvived[name] = sorted(first_seed + i for i in died)
    return {
        "schema": SCHEMA,
        "directive": directive,
        "wish_mps": wishes_mps[0] if len(wishes_mps) == 1 else None,
        "rows": rows,
        "unsurvived": unsurvived,
    }


def _refuse_for_language(agent: str, conditions: dict[str, Any], filmed: bool) -> None:
    """Raise ValueError for what a driver of `LANGUAGE` does not know."""
    if conditions["directive_at_s"] or conditions["mask_preset"]:
        raise ValueError(f"{agent} has its directive from the start, and no mask")
    if conditions["noise_m"] or conditions["noise_mps"] or conditions["dropout"]:
        raise ValueError(f"{agent} sees everything as it is: leave noise and dropout out")
    if filmed:
        raise ValueError(f"{agent} drives otherwise each time: leave --video out")


def _drive_language(
    agent: str, scenario: Scenario, seeds: Sequence[int], directive: Directive, wish_mps: float | None
) -> tuple[list[EpisodeResult], dict[str, Any]]:
    """The episodes of a driver of `LANGUAGE`, and what its model did."""
    if directive != "hurry" or wish_mps is not None:
        raise ValueError(f"{agent} knows no directive but hurry, and no other speed to wish for")
    with running_model() as ask:
        results, metrics = drive_dilu(scenario, seeds, paused=agent == "dilu-paused", ask=ask, bank=memory())
    return results, metrics.summary()


def _numbers(metrics: dict[str, float]) -> dict[str, float | None]:
    """With None for what is not a number, as JSON has it."""
    return {name: None if math.isnan(value) else value for name, value in metrics.items()}
