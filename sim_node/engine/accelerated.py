"""highway-env's own environments, ticked by the compiled kernel: the same numbers, sooner.

Objects, rendering, wrappers and configuration are upstream's; only `_simulate` and the array behind the Kinematics
observation are replaced. What the kernel does not know (other vehicle types, curved lanes, routes) goes to upstream,
with one warning per environment class.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.envs.common.observation import KinematicObservation
from highway_env.vehicle.controller import MDPVehicle

from sim_node.engine.bridge import NO_VIEW, Bridge
from sim_node.engine.kernel import layout, tick
from sim_node.engine.kinematics import ArrayKinematics
from sim_node.engine.tables import UnsupportedError


class Accelerated:
    """Mix in before an `AbstractEnv`: `class Fast(Accelerated, HighwayEnv)`; or see `accelerate`."""

    _warned = False
    _bridge: Bridge | None = None

    def define_spaces(self: Any) -> None:
        """Upstream's, with the Kinematics observation from arrays."""
        super().define_spaces()  # type: ignore[misc]
        if type(self.observation_type) is KinematicObservation:
            self.observation_type = ArrayKinematics(self, **self.config["observation"])

    def _simulate(self: Any, action: Any = None) -> None:
        """`AbstractEnv._simulate` in one compiled call; frame by frame while a viewer shows every frame."""
        hz = self.config["simulation_frequency"]
        frames = int(hz // self.config["policy_frequency"])
        if self.steps % frames:  # the action would fall between two calls
            super()._simulate(action)  # type: ignore[misc]
            return
        if self._bridge is None:
            self._bridge = Bridge()
        bridge: Bridge = self._bridge
        told = _NO_ACTION
        if action is not None and not self.config["manual_control"]:
            if (
                type(self.action_type) is DiscreteMetaAction
                and self.road.vehicles[:1] == self.controlled_vehicles
                and (type(self.vehicle) is MDPVehicle)
            ):
                told = np.array([_META_ACTIONS[self.action_type.actions[int(action)]]])
            else:
                self.action_type.act(action)
        watched = self.viewer is not None and self.enable_auto_render
        per_call = 1 if watched else frames
        for frame in range(0, frames, per_call):
            try:
                bridge.read(self.road)
            except UnsupportedError as reason:
                self._give_up(reason)
                super()._simulate(None if told is _NO_ACTION else action)  # type: ignore[misc]
                return
            tick.advance(
                per_call,
                1 / hz,
                bridge.tables.roads,
                _CALLS,
                bridge.scratch,
                bridge.f,
                bridge.g,
                bridge.ego,
                NO_VIEW,
                told if frame == 0 else _NO_ACTION,
            )
            bridge.write(self.road)
            self.steps += per_call
            if watched and frame < frames - 1:
                self._automatic_rendering()
        self.enable_auto_render = False

    def _give_up(self: Any, reason: UnsupportedError) -> None:
        if not type(self)._warned:
            type(self)._warned = True
            warnings.warn(
                f"{type(self).__name__} runs at highway-env's speed: the engine does not know {reason}", stacklevel=2
            )


def accelerate(environment: type[AbstractEnv]) -> type[AbstractEnv]:
    """A subclass of `environment` that is ticked by the kernel; `environment` itself where it is that already."""
    if issubclass(environment, Accelerated):
        return environment
    return type(f"Accelerated{environment.__name__}", (Accelerated, environment), {"__module__": __name__})


_CALLS = layout.new_calls()
_META_ACTIONS = {name: number for number, name in DiscreteMetaAction.ACTIONS_ALL.items()}
_NO_ACTION = np.full(1, layout.NO_ACTION)
