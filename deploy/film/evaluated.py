"""Films of evaluated episodes: of each row of a table the first, and the one with the lowest ride score."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

from deploy.film.writer import Picture, write_film
from deploy.lab.episodes import Step, published
from fast_node.choice import SOURCES
from fast_node.mask import OPEN
from fast_node.training.rollout import Driver, Fleet
from schemas.driving.road import HZ, NOBODY
from schemas.wire.messages import POLICY_ACTIONS, Action, Closure, Directive, Observation, Reason
from sim_node.drawing import picture
from sim_node.engine.batched import Batched
from sim_node.metrics import Settled
from sim_node.results import EpisodeResult

SUFFIX = ".mp4"
END_S = 1.0
"""How long the last picture stays."""
_REASONS = tuple(Reason)
"""By the mask's number less one."""


@dataclass(frozen=True)
class Shot:
    """One tick of an episode."""

    observation: Observation
    directive: Directive | None
    action: Action | None
    """None: nobody decided, or the episode is over."""


class Camera:
    """Looks on while a fleet is driven (a `deploy.lab.episodes.Watch`), and keeps what some of its scenes show."""

    def __init__(self, scenes: Sequence[int], told_tick: int = 0) -> None:
        """`told_tick`: when the directive comes."""
        self.shots: dict[int, list[Shot]] = {scene: [] for scene in scenes}
        self._running, self._told_tick = set(scenes), told_tick

    def __call__(self, fleet: Fleet, driver: Driver | None, step: Step) -> Step:
        def watched(tick: int) -> Settled | None:
            seen = {scene: _seen(fleet, scene, tick) for scene in self._running}
            settled = step(tick)
            over = fleet.over()
            for scene, observation in seen.items():
                directive = _directive(fleet, scene) if tick >= self._told_tick else None
                action = None if driver is None else _action(driver, scene, tick)
                self.shots[scene].append(Shot(observation, directive, action))
                if over[scene]:
                    self.shots[scene].append(Shot(_seen(fleet, scene, tick + 1), directive, None))
                    self._running.discard(scene)
            return settled

        return watched

    def pictures(self, scene: int, note: str) -> Iterator[Picture]:
        """Of one scene, with a word beside the directive."""
        for shot in self.shots[scene]:
            end = ", collision" if shot.observation.crashed else ""
            drawn = picture(shot.observation, shot.action, shot.directive, note=note + end)
            yield drawn
        yield from repeat(drawn, round(END_S * HZ) - 1)


def _seen(fleet: Fleet, scene: int, tick: int) -> Observation:
    world = fleet.world
    assert isinstance(world, Batched)
    return published(
        world.scenario,
        tick,
        world.rows[scene],
        acceleration_mps2=float(world.accel[scene]),
        target_speed_mps=float(world.target_speed[scene]),
        target_lane=int(world.target_lane[scene]),
        previous_lane=int(world.previous_lane[scene]),
        crashed=bool(world.crashed[scene]),
    )


def _directive(fleet: Fleet, scene: int) -> Directive:
    lane = int(fleet.wish[scene])
    return Directive(
        epoch=0,
        stamp_ns=0,
        id=0,
        command_id=0,
        scene_tick=0,
        manoeuvre="cruise" if fleet.pass_id[scene] == NOBODY else "overtake",
        target_lane=lane if lane >= 0 else None,
        target_speed_mps=float(fleet.v_des[scene]),
        headway_s=float(fleet.headway[scene]),
    )


def _action(driver: Driver, scene: int, tick: int) -> Action:
    reasons, vehicle = driver.fleet.rule[scene], driver.fleet.vehicle[scene]
    closed = [a for a in range(POLICY_ACTIONS) if reasons[a] != OPEN]
    return Action(
        epoch=0,
        stamp_ns=0,
        answers_tick=tick,
        meta_action=int(driver.meta[scene]),
        source=SOURCES[driver.by[scene]],  # type: ignore[arg-type]
        closed=tuple(Closure(action=a, reason=_REASONS[reasons[a] - 1], vehicle=int(vehicle[a])) for a in closed),
    )


def film_row(
    folder: Path, place: Mapping[str, Any], results: Sequence[EpisodeResult], again: Callable[..., list[EpisodeResult]]
) -> list[Path]:
    """Drive a row's episodes once more, and film two of them into `folder`: see `deploy.lab.evaluate.Film`."""
    worst = min(range(len(results)), key=lambda k: results[k].ride_score)
    scenes = dict.fromkeys((0, worst))
    camera = Camera(list(scenes), round(place["directive_at_s"] * HZ))
    again(watch=camera)
    paths = []
    for scene in scenes:
        seed, score = place["first_seed"] + scene, results[scene].ride_score
        which = [name for name, one in (("first", 0), ("worst", worst)) if one == scene]
        wish = "" if place["wish_mps"] is None else f"{place['wish_mps']:g}mps"
        name = "-".join(filter(None, (place["scenario"], place["agent"], wish, *which, str(seed))))
        paths.append(folder / f"{re.sub(r'[^A-Za-z0-9_.-]+', '-', name).strip('-')}{SUFFIX}")
        note = f"seed {seed}, ride score {score:.0f}: the {' and '.join(which)} of {len(results)}"
        write_film(paths[-1], camera.pictures(scene, note))
    return paths
