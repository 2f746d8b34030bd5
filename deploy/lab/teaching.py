"""`fastslow train --algorithm taught`: a teacher tries things out in copies of the scenes, and a policy learns from
it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from deploy.lab.episodes import directed, task_of
from fast_node.policies.attention import load_attention
from fast_node.policies.rule import RulePolicy, rule_logits
from fast_node.training.foresight import PLANS, Foresight
from fast_node.training.rollout import Scenes
from sim_node.engine.batched import Batched
from sim_node.scenarios import SCENARIOS, Scenario
from sim_node.scenarios.scenario import draw_wish

if TYPE_CHECKING:
    from fast_node.training.teach import Lessons

SCENES = 20
ROUNDS = 3
"""In the first the rule drives where the teacher does not, then the pupil."""
LED = (1.0, 0.5, 0.3)
"""Share of its situations in which the teacher acts, too, by round."""
HURRY = 0.6
"""Share of the directives that are a hurry; the others are random."""


def _wish(scenario: Scenario, rng: np.random.Generator, rows: Any, home: int) -> tuple[int, int, float, float]:
    if rng.random() < HURRY:
        return directed("hurry", scenario, rng, rows, home)
    return draw_wish(scenario, rng, rows, home)


def lesson(name: str, round_: int, seed: int, decisions: int, pupil: Path | None) -> Lessons:
    """What the teacher does on one road in one round; decisions: of each scene."""
    from fast_node.training.teach import lessons_of

    scenario = SCENARIOS[name]
    task = replace(task_of(scenario), draw=partial(_wish, scenario))
    at = 20_000_000 + 100_000 * seed + 1000 * round_ + sorted(SCENARIOS).index(name)
    scenes = Scenes(Batched(scenario, SCENES, at), task, at)
    copies = Scenes(Batched(scenario, SCENES * len(PLANS), at), task, at)
    driver = RulePolicy() if pupil is None else load_attention(pupil)
    return lessons_of(scenes, Foresight(scenes, copies, rule_logits), driver, decisions, at, LED[round_])


def teach_policy(out: Path, scenarios: Sequence[str], steps: int, seed: int, *, jobs: int = 2) -> dict[str, float]:
    """Learn a policy from the teacher: about `steps` situations in all. Exports it to `out`, and beside it the state
    that `train --start` begins with. Raises ImportError without extra `train`, ValueError for an unknown scenario."""
    import torch

    from fast_node.training.network import ActorCritic
    from fast_node.training.teach import Lessons, learn
    from fast_node.training.train import HEADS, LAYERS, WIDTH, export, sidecar_of

    unknown = sorted(set(scenarios) - set(SCENARIOS))
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: choose from {', '.join(SCENARIOS)}")
    decisions = max(steps // (ROUNDS * len(scenarios) * SCENES), 1)
    torch.manual_seed(seed)
    net = ActorCritic(WIDTH, HEADS, LAYERS)
    lessons: list[Lessons] = []
    loss = float("nan")
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with (
        Progress(*columns, console=Console(file=sys.stderr)) as bar,
        ProcessPoolExecutor(min(jobs, os.cpu_count() or 1)) as pool,
    ):
        shown = bar.add_task("being taught", total=ROUNDS * len(scenarios))
        for round_ in range(ROUNDS):
            pupil = out if round_ else None
            given = [pool.submit(lesson, name, round_, seed, decisions, pupil) for name in scenarios]
            for future in given:
                lessons.append(future.result())
                bar.advance(shown)
            torch.manual_seed(seed)
            net = ActorCritic(WIDTH, HEADS, LAYERS)
            loss = learn(net, Lessons.together(lessons), epochs=12, lr=1e-3, seed=seed)
            bar.update(shown, description=f"being taught, loss {loss:.3f}")
            run = {"scenarios": list(scenarios), "seed": seed, **sidecar_of("sim")}
            taught = sum(len(one.action) for one in lessons)
            export(net, out, {"algorithm": "ours", "steps": taught, "taught": taught, **run})
            torch.save({"run": run, "steps": taught, "net": net.state_dict()}, out.with_suffix(".train.pt"))
    return {"loss": loss, "situations": float(sum(len(one.action) for one in lessons))}
