"""Scenes whose episodes have seeds and whose directives are drawn, or said: what all environments here are made of.

Axis: S scenes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.random import Generator
from numpy.typing import NDArray

from deploy.environments.config import Directive, EnvConfig, check_lane, convert
from deploy.environments.world import Bools, Ints, SeededWorld
from fast_node.training.rollout import Scenes
from schemas.driving.episode import REDIRECT_PER_S, Ending, ending
from schemas.driving.features import BOUND, FEATURES, N_ROWS, Array
from schemas.driving.intent import ANY_LANE
from schemas.driving.road import HZ, NOBODY, VX, VY, X, lead_id
from schemas.runtime.compiled import compiled
from schemas.wire.messages import POLICY_ACTIONS, MetaAction
from sim_node import executor
from sim_node.observe import senses
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import streams

NAMES = ", ".join(f"{int(a)} {a.name.lower().replace('_', ' ')}" for a in MetaAction if a < POLICY_ACTIONS)
DIRECTIVE = "directive"


def action_space() -> spaces.Discrete[np.int64]:
    """The five meta-actions, by number."""
    return spaces.Discrete(POLICY_ACTIONS)


def features_space(flat: bool) -> spaces.Box:
    """Of the policy's input, (15, 26) float32, or (390,)."""
    return spaces.Box(-BOUND, BOUND, (N_ROWS * len(FEATURES),) if flat else (N_ROWS, len(FEATURES)), np.float32)


_ACTIONS = action_space()


def _able_all(
    gates: Any, rows: Any, target_speed: Any, target_lane: Any, previous: Any, floor: float, ceiling: float, out: Any
) -> None:
    """Fill out (S, 5) with every scene's `executor.able`."""
    for s in range(len(rows)):
        x = rows[s, 0, X]
        executor.able(gates, target_speed[s], target_lane[s], previous[s], x, floor, ceiling, out[s])


_able = compiled(_able_all)


@dataclass(frozen=True)
class Step:
    """What a decision has led to, (S,) each."""

    earned: NDArray[np.float32]
    terminated: Bools
    truncated: Bools

    @property
    def ended(self) -> Bools:
        return self.terminated | self.truncated


class Episodes(Scenes):
    """Scenes that are what their seeds say: traffic, directives and the sensor's errors, whatever the others do."""

    world: SeededWorld

    def __init__(self, world: SeededWorld, scenario: Scenario, config: EnvConfig) -> None:
        scenes = len(world.rows)
        self._scenario, self._config = scenario, config
        self._seeds = np.zeros(scenes, np.int64)
        self._wishes: list[Generator] = [np.random.default_rng(0)] * scenes
        self._directives: list[Directive | None] = [config.directive] * scenes
        self._gates = scenario.gates()
        self._senses = senses(range(scenes), config.noise_m, config.noise_mps, config.dropout)
        self.happened = np.zeros(scenes, np.int64)
        """(S,) `Ending` of the last decision, time included."""
        masked = config.mask is not None
        super().__init__(
            world,
            config.task(scenario),
            0,
            config.ticks,
            masked=masked,
            obeyed=masked and config.obey,
            sense=self._senses,
        )

    def begin(self, which: Bools, seeds: Ints, directive: Directive | None = None) -> None:
        """Start the episodes `seeds` (S,) in the scenes `which` (S,), with this directive or the configuration's."""
        self._seeds[which] = seeds[which]
        for scene in np.flatnonzero(which):
            self._directives[scene] = directive or self._config.directive
        self.reset(which)

    def reset(self, which: Bools) -> None:
        """The episodes of these scenes from their start."""
        self.world.begin(which, self._seeds)
        for scene in np.flatnonzero(which):
            seed = int(self._seeds[scene])
            self._wishes[scene] = streams(seed)[1]
            if self._senses is not None:
                self._senses.begin(int(scene), seed)
        self._tracks.forget(which)
        self.left[which], self.age[which], self.returns[which], self.happened[which] = 0, 0, 0.0, 0
        self._direct(which)
        self.look()

    def direct(self, scene: int, directive: Directive) -> None:
        """Set the directive of a scene from now on."""
        self._directives[scene] = directive
        which = np.zeros(len(self.wish), np.bool_)
        which[scene] = True
        self._direct(which)
        self.look()

    def _direct(self, which: Bools) -> None:
        for s in np.flatnonzero(which):
            rows, home, said = self.world.rows[s], int(self.world.target_lane[s]), self._directives[s]
            if said is None:
                told = self.task.draw(self._wishes[s], rows, home)
            else:
                speed = self._scenario.ego.speed_ceiling_mps if said.speed_mps is None else said.speed_mps
                lane = ANY_LANE if said.lane is None else said.lane
                told = (
                    (home, lead_id(rows, home), speed, said.headway_s)
                    if said.overtake
                    else (lane, NOBODY, speed, said.headway_s)
                )
            self.told_lane[s], self.pass_id[s], self.v_des[s], self.headway[s] = told

    def advance(self, action: Ints) -> Step:
        """One decision; now and then another directive follows, where it is not said."""
        done = Step(*self.decide(action, redirect=False))
        chance = REDIRECT_PER_S * self._config.ticks / HZ
        again = np.zeros(len(action), np.bool_)
        for s in np.flatnonzero(~done.ended):
            again[s] = self._directives[s] is None and self._wishes[s].random() < chance
        if again.any():
            self._direct(again)
            self.look()
        over = ending(self.world.crashed, self.world.rows[:, 0], self.task.goal)
        self.happened = np.where(done.truncated & (over == Ending.NONE), int(Ending.TIME), over)
        return done

    def seen(self) -> Array:
        """(S, 15, 26) the policy's input, or (S, 390) as the configuration has it."""
        x = self.observe()
        return x.reshape(len(x), -1) if self._config.flat else x

    def usable(self) -> Bools:
        """(S, 5) what may be chosen: what mask and directive leave open; without a mask, what does anything at all.

        Where nothing is open the ego brakes, whatever is chosen, so all five are.
        """
        if self.masked:
            is_open = self.open()
            return np.asarray(is_open | ~is_open.any(-1, keepdims=True))
        w, bounds = self.world, self._scenario.ego
        out = np.zeros((len(w.rows), POLICY_ACTIONS), np.bool_)
        _able(
            self._gates,
            w.rows,
            w.target_speed,
            w.target_lane,
            w.previous_lane,
            float(bounds.speed_floor_mps),
            float(bounds.speed_ceiling_mps),
            out,
        )
        return out

    def told(self) -> dict[str, Any]:
        """`info`, with (S, ...) of each: see `docs/gymnasium.md`."""
        w = self.world
        return {
            "action_mask": self.usable().astype(np.int8),
            "speed": np.hypot(w.rows[:, 0, VX], w.rows[:, 0, VY]).astype(np.float64),
            "crashed": w.crashed.copy(),
            "ending": self.happened.copy(),
            "intent": {"lane": self.wish.copy(), "speed_mps": self.v_des.copy(), "headway_s": self.headway.copy()},
        }


def action_of(action: Any) -> int:
    """The action as a number. Raises ValueError for what is none of the five."""
    if not _ACTIONS.contains(action):
        raise ValueError(f"action {action!r} is not one of: {NAMES}")
    return int(action)


def directive_of(options: Mapping[str, Any] | None, scenario: Scenario) -> Directive | None:
    """What `reset(options={"directive": {...}})` says. Raises ValueError by name for everything else."""
    for name in options or {}:
        if name != DIRECTIVE:
            raise ValueError(f"no option {name!r}: reset takes {DIRECTIVE!r}")
    said = (options or {}).get(DIRECTIVE)
    if said is None:
        return None
    directive: Directive = convert(said, Directive)
    check_lane(scenario, directive)
    return directive


def one_of(told: Mapping[str, Any], scene: int) -> dict[str, Any]:
    """A single scene's `info`."""
    return {
        name: one_of(value, scene)
        if isinstance(value, dict)
        else (value[scene].copy() if value.ndim > 1 else value[scene].item())
        for name, value in told.items()
    }
