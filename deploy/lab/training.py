"""`fastslow train`: puts the batched worlds of the simulator and the learner of the fast system together."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from deploy.lab.episodes import directed, overtake_on, task_of
from fast_node.mask import PRESETS
from fast_node.policies.mlp import LEARNERS
from fast_node.training.mixed import Mixed
from fast_node.training.rollout import Scenes
from sim_node.engine.batched import Batched
from sim_node.observe import senses
from sim_node.scenarios import SCENARIOS, Scenario

SCENES = 64
"""In all; shared among the scenarios."""
BASELINE_SCENES = {"ppo": 64, "a2c": 16, "dqn": 16, "maskable-ppo": 64}
"""The same for each baseline."""


class HurriedScenes(Scenes):
    """Scenes whose passenger is in a hurry all along, and wishes to overtake one car after the other."""

    def _direct(self, which: NDArray[np.bool_]) -> None:
        super()._direct(which & (self.age == 0))

    def decide(
        self, action: NDArray[np.int64], *, redirect: bool = True
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
        result = super().decide(action, redirect=redirect)
        if (self.pass_id >= 0).any():
            overtake_on(self)
            self.look()
        return result


def scenes_of(
    scenario: Scenario,
    scenes: int,
    world_seed: int,
    wish_seed: int,
    *,
    hurried: bool = False,
    masked: bool = True,
    obeyed: bool | None = None,
    preset: str = "sim",
    noise_m: float = 0.0,
    noise_mps: float = 0.0,
    dropout: float = 0.0,
) -> Scenes:
    """Scenes to learn or to be measured in: with random directives, or in a hurry; behind the mask, or not; where a
    wish closes what is against it (as the mask does, by default), or not; seen as they are, or as
    `sim_node.observe.perceived` has it."""
    task, kind = task_of(scenario, preset), Scenes
    if hurried:
        task, kind = replace(task, draw=partial(directed, "hurry", scenario)), HurriedScenes
    sense = senses(range(world_seed, world_seed + scenes), noise_m, noise_mps, dropout)
    world = Batched(scenario, scenes, world_seed)
    return kind(world, task, wish_seed, masked=masked, obeyed=obeyed, sense=sense)


def mixed_scenes(
    scenarios: Sequence[str],
    seed: int,
    *,
    scenes: int = SCENES,
    after: int = 0,
    hurried: bool = False,
    masked: bool = True,
    obeyed: bool | None = None,
    preset: str = "sim",
) -> Mixed:
    """What a run with this seed learns in; `after` so many decisions it has other worlds than before.

    Raises ValueError for an unknown scenario or preset of the mask.
    """
    if preset not in PRESETS:
        raise ValueError(f"{preset}: choose from {', '.join(PRESETS)}")
    unknown = sorted(set(scenarios) - set(SCENARIOS))
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: choose from {', '.join(SCENARIOS)}")
    each, fresh = max(scenes // len(scenarios), 1), 10**8 * after
    return Mixed(
        [
            scenes_of(
                SCENARIOS[name],
                each,
                10_000_000 + 1000 * seed + k + fresh,
                1000 * seed + k + fresh,
                hurried=hurried,
                masked=masked,
                obeyed=obeyed,
                preset=preset,
            )
            for k, name in enumerate(scenarios)
        ]
    )


def train_baseline(
    algorithm: str,
    out: Path,
    scenarios: Sequence[str],
    steps: int,
    seed: int,
    *,
    bare: bool = False,
    changes: Mapping[str, Any] | None = None,
    track: bool = False,
) -> dict[str, float]:
    """Train one of `LEARNERS` in the place of our policy; `bare`: without mask and directive, always in a hurry.

    changes: of its settings, by their names in stable-baselines3, and "scenes". track: keep a W&B run, too. Raises
    ImportError without extra `train`, ValueError for an unknown algorithm, scenario or setting.
    """
    if algorithm not in LEARNERS:
        raise ValueError(f"{algorithm}: choose from ours, taught, {', '.join(LEARNERS)}")
    if bare and algorithm == "maskable-ppo":
        raise ValueError("maskable-ppo learns by what the mask closes: leave --bare out, or take ppo")
    from fast_node.training import baselines
    from fast_node.training.log import OF_BASELINES, logged

    scenes_n, changed = _split(changes, BASELINE_SCENES[algorithm], algorithm, baselines.known_settings(algorithm))
    scenes = mixed_scenes(scenarios, seed, scenes=scenes_n, hurried=bare, masked=not bare)
    facts = {"algorithm": algorithm, "scenarios": list(scenarios), "seed": seed, "steps": steps, **changed}
    with _progress_bar() as bar:
        task = bar.add_task(f"{algorithm} learning", total=steps)
        return baselines.learn(
            algorithm,
            scenes,
            out,
            variant="bare" if bare else "masked",
            steps=steps,
            seed=seed,
            changes=changed,
            watch=lambda done, _: bar.update(task, completed=done),
            logs=logged(out, 0, OF_BASELINES, facts if track else None),
        )


def _split(
    changes: Mapping[str, Any] | None, scenes: int, algorithm: str, known: Sequence[str]
) -> tuple[int, dict[str, Any]]:
    """How many scenes there are, and the settings of the learner. Raises ValueError for an unknown name."""
    changed = dict(changes or {})
    if unknown := sorted(set(changed) - {"scenes", *known}):
        raise ValueError(f"{algorithm} has no setting {unknown[0]!r}: choose from {', '.join(('scenes', *known))}")
    scenes = changed.pop("scenes", scenes)
    if not (isinstance(scenes, int) and 1 <= scenes <= 4096):
        raise ValueError(f"scenes {scenes!r} is not a whole number within 1..4096")
    return scenes, changed


def _progress_bar() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(file=sys.stderr))


def train_policy(
    out: Path,
    scenarios: Sequence[str],
    steps: int,
    seed: int,
    *,
    lr: float | None = None,
    resume: bool = False,
    start: Path | None = None,
    preset: str = "sim",
    changes: Mapping[str, Any] | None = None,
    track: bool = False,
) -> dict[str, float]:
    """Train one policy on these scenarios and export it, with a progress bar on stderr.

    lr: the learning rate that falls to a tenth, by default the paper's; changes: of `LearnerConfig`, and "scenes";
    track: keep a W&B run, too. `resume` goes on where an interrupted run to the same `out` was last saved, in new
    worlds; `start` begins with the network of another run. Raises ImportError without extra `train`, ValueError for an
    unknown scenario, preset or setting, `ConfigError` where there is nothing to go on from.
    """
    from fast_node.training.learner import LearnerConfig
    from fast_node.training.train import saved_state, train

    names = [field.name for field in fields(LearnerConfig)]
    scenes_n, changed = _split(changes, SCENES, "ours", names)
    config = msgspec.convert({**({} if lr is None else {"lr": lr}), **changed}, LearnerConfig)
    begin = None if start is None else saved_state(start)
    after = saved_state(out, resumable=True)["steps"] if resume else 0
    scenes = mixed_scenes(scenarios, seed, scenes=scenes_n, after=after, preset=preset)
    with _progress_bar() as bar:
        task = bar.add_task("learning", total=steps, completed=after)

        def progress(done: int, figures: dict[str, float]) -> None:
            text = f"return {figures['episodic_return']:.2f} crashes {figures['crash_rate']:.1%}"
            bar.update(task, completed=done, description=text)

        return train(
            scenes,
            out,
            steps=steps,
            seed=seed,
            progress=progress,
            config=config,
            resume=resume,
            start=begin,
            track=track,
        )
