"""One training run and what it measures.

A cell is one training run of one algorithm on one road with one seed. Its learning curve is the mean return, without
discount, of the greedy policy over `CURVE_SCENES` fixed scenes that no training run draws, the passenger in a hurry
and one decision a second; the reward is everybody's. Then it drives evaluation seeds at 15 Hz. Baselines come `bare`,
as published, and `masked`, or with the parts of that: see `fast_node.training.baselines`.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy.lab.episodes import FIRST_SEED, Logits, by_the_tick, load, record, task_of
from deploy.lab.files import brought, put
from deploy.lab.training import BASELINE_SCENES, SCENES, mixed_scenes, scenes_of
from fast_node.mask import VERSION as MASK_VERSION
from fast_node.policies.load import load_policy
from fast_node.policies.mlp import LEARNERS, PARTS, VARIANTS, masked, told
from fast_node.policies.policy import NamedPolicy
from fast_node.training.rollout import Driver, Fleet
from schemas.driving.features import LAYOUT_HASH
from sim_node.engine.batched import Batched
from sim_node.results import summarise
from sim_node.scenarios import SCENARIOS

ALGORITHMS = ("ours", *LEARNERS)
MASKED_ONLY = ("ours", "maskable-ppo")
"""They learn by what the mask closes."""
ROADS = ("highway", "merge", "two-way")
SEEDS, STEPS, EPISODES = (0, 1, 2, 3, 4), 100_000, 100
CURVE_EVERY, CURVE_SCENES, CURVE_SEED = 10_000, 64, 9_000_000
FIGURES = (
    "success",
    "ego_fault_collisions",
    "struck_collisions",
    "avg_speed",
    "max_speed",
    "min_speed",
    "accel_var",
    "min_ttc_mean",
    "override_share",
)


@dataclass(frozen=True)
class Cell:
    """One training run: what, where, and how much of it."""

    algorithm: str
    variant: str
    scenario: str
    seed: int
    steps: int
    episodes: int
    trial: str = ""
    """Settings of a baseline that are tried, by name; "": those chosen."""

    @property
    def name(self) -> str:
        return "-".join(filter(None, (self.scenario, self.algorithm, self.variant, str(self.seed), self.trial)))

    @property
    def masked(self) -> bool:
        return masked(self.variant)

    @property
    def obeyed(self) -> bool:
        """Whether a wish closes what is against it."""
        return masked(self.variant) and told(self.variant)


def cells_of(
    algorithms: Sequence[str],
    scenarios: Sequence[str],
    seeds: Sequence[int],
    steps: int,
    episodes: int = EPISODES,
    variants: Sequence[str] = VARIANTS,
) -> list[Cell]:
    """The matrix, one seed of everything after the other. Raises ValueError for unknown names."""
    for what, names, known in (
        ("algorithm", algorithms, ALGORITHMS),
        ("scenario", scenarios, tuple(SCENARIOS)),
        ("variant", variants, VARIANTS + PARTS),
    ):
        for name in names:
            if name not in known:
                raise ValueError(f"{what} {name!r} is not one of: {', '.join(known)}")
    return [
        Cell(algorithm, variant, scenario, seed, steps, episodes)
        for seed in seeds
        for scenario in scenarios
        for algorithm in algorithms
        for variant in (("masked",) if algorithm in MASKED_ONLY else variants)
    ]


def run_cell(cell: Cell, folder: Path) -> dict[str, Any]:
    """Train, measure and write one cell: its policy and, last and at once, `<name>.result.json`."""
    began = time.process_time()
    ours, out = cell.algorithm == "ours", folder / f"{cell.name}.safetensors"
    at_once = SCENES if ours else BASELINE_SCENES[cell.algorithm]
    scenes = mixed_scenes(
        [cell.scenario],
        cell.seed,
        scenes=at_once,
        hurried=not told(cell.variant),
        masked=cell.masked,
        obeyed=cell.obeyed,
    )
    curve: list[tuple[int, float]] = []

    def watch(done: int, logits: Logits) -> None:
        due = CURVE_EVERY * len(curve)
        if due < cell.steps and done > due - at_once:  # the last moment that is not after it
            curve.append((done, curve_return(cell, logits)))

    if ours:
        from fast_node.training.train import train

        train(scenes, out, steps=cell.steps, seed=cell.seed, progress=lambda *_: None, watch=watch)
        out.with_suffix(".train.pt").unlink()  # a cell that was interrupted starts again
    else:
        from fast_node.training.baselines import learn

        learn(
            cell.algorithm,
            scenes,
            out,
            variant=cell.variant,
            steps=cell.steps,
            seed=cell.seed,
            trial=cell.trial,
            watch=watch,
        )
    policy = load_policy(str(out.absolute()))
    curve.append((int(str(policy.sidecar["steps"])), curve_return(cell, policy.logits)))
    result = {
        **_identity(cell),
        "curve": curve,
        **measured(cell, policy),
        "cpu_s": round(time.process_time() - began, 1),
    }
    path = _result_path(cell, folder)
    path.with_suffix(".new").write_text(json.dumps(result))
    os.replace(path.with_suffix(".new"), path)
    return result


def run_away(cell: Cell) -> tuple[dict[str, Any], dict[str, bytes]]:
    """`run_cell` where the study's folder may not be at hand: its result, and its files by name."""
    with tempfile.TemporaryDirectory(prefix="fastslow-cell-") as name:
        return run_cell(cell, Path(name)), brought(Path(name))


def keep(cell: Cell, files: dict[str, bytes], folder: Path) -> None:
    """Write the files of `run_away`, the result last."""
    put(files, folder, last=_result_path(cell, folder).name)


def _identity(cell: Cell) -> dict[str, Any]:
    # Of the mask without it, too: whom it takes to be ahead decides about the reward's headway and time to collision.
    return {**asdict(cell), "layout_hash": LAYOUT_HASH, "mask": MASK_VERSION, "learner": learner_of(cell)}


def learner_of(cell: Cell) -> dict[str, Any]:
    """The settings of who learns, as the sidecars have them."""
    if cell.algorithm == "ours":
        from fast_node.training.learner import LearnerConfig

        return asdict(LearnerConfig())
    from fast_node.training.baselines import settings_of

    return settings_of(cell.algorithm, cell.trial)


def _result_path(cell: Cell, folder: Path) -> Path:
    return folder / f"{cell.name}.result.json"


def finished(cell: Cell, folder: Path) -> dict[str, Any] | None:
    """The result of a cell that ran with these very settings and this code's features and mask; else None."""
    path = _result_path(cell, folder)
    if not path.exists():
        return None
    result: dict[str, Any] = json.loads(path.read_text())
    return result if _identity(cell).items() <= result.items() else None


def curve_return(cell: Cell, logits: Logits) -> float:
    """Mean return of one episode in each of the fixed scenes, greedy."""
    scenes = scenes_of(
        SCENARIOS[cell.scenario],
        CURVE_SCENES,
        CURVE_SEED,
        CURVE_SEED,
        hurried=True,
        masked=cell.masked,
        obeyed=cell.obeyed,
    )
    returns, running = np.zeros(CURVE_SCENES), np.ones(CURVE_SCENES, np.bool_)
    while running.any():
        preferred = np.where(scenes.open(), logits(scenes.observe()), -np.inf)
        reward, terminated, truncated = scenes.decide(preferred.argmax(-1))
        returns[running] += reward[running]
        running &= ~(terminated | truncated)
    return float(returns.mean())


def measured(cell: Cell, policy: NamedPolicy) -> dict[str, Any]:
    """One episode at 15 Hz per evaluation seed, the passenger in a hurry: the table's figures.

    Behind the mask everybody drives as the fast node does. Without it they decide once a second, as they have learnt
    to, and hold in between.
    """
    scenario, n = SCENARIOS[cell.scenario], cell.episodes
    world = Batched(scenario, n, 0)
    fleet = Fleet(world, task_of(scenario), masked=cell.masked, obeyed=cell.obeyed)
    for i in range(n):
        load(fleet, scenario, i, FIRST_SEED + i, "hurry")
    step = by_the_tick(Driver(fleet, policy.logits, stateless=policy.stateless))
    summary = summarise(record(fleet, scenario, step))
    return {k: summary[k] for k in FIGURES}
