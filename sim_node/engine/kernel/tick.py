"""The kernel's entries, compiled: advance every scene, settle one, show what somebody else has moved."""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.runtime.compiled import compiled
from sim_node.engine.kernel.collisions import collide
from sim_node.engine.kernel.drivers import act
from sim_node.engine.kernel.ego import begin, finish, publish, set_controls
from sim_node.engine.kernel.lanes import closest_lane
from sim_node.engine.kernel.layout import (
    ABSENT,
    ANGLE,
    CRASHED,
    EXECUTOR,
    KIND,
    LANE,
    MDP,
    NO_ACTION,
    OBSTACLE,
    SPEED,
    TARGET_SPEED,
    Calls,
    Ego,
    Scratch,
    View,
    X,
    Y,
)
from sim_node.engine.kernel.motion import directions, step
from sim_node.engine.tables import Roads
from sim_node.scenarios.scenario import centre_line


def _advance(
    ticks: int,
    dt: float,
    roads: Roads,
    calls: Calls,
    scratch: Scratch,
    f: Any,
    g: Any,
    ego: Ego,
    view: View,
    action: Any,
) -> None:
    """Advance every scene by `ticks` ticks of `dt` s, in place.

    f (S, FLOATS, V); g (S, INTS, V); action (S,): carried out at the first tick, `NO_ACTION` leaves the set-points.
    """
    for scene in range(f.shape[0]):
        f_s, g_s = f[scene], g[scene]
        directions(calls, scratch, f_s)
        for tick in range(ticks):
            if ego.freezes and g_s[CRASHED, 0]:
                break
            if tick == 0 and action[scene] != NO_ACTION:
                begin(calls, roads, ego, f_s, g_s, scene, action[scene])
            if g_s[KIND, 0] != MDP:
                f_s[TARGET_SPEED, 0] = ego.target_speed[scene]
            before = f_s[SPEED, 0]
            if g_s[KIND, 0] == EXECUTOR:
                set_controls(ego, f_s, scene, dt)
            act(calls, roads, scratch, f_s, g_s)
            step(calls, roads, scratch, f_s, g_s, dt)
            directions(calls, scratch, f_s)
            collide(calls, scratch, f_s, g_s, dt)
            finish(ego, view, f_s, g_s, scene, before, dt)
            if view.rows.shape[0] > 0:
                publish(ego, view, scratch, f_s, g_s, scene)


def _settle(
    roads: Roads, calls: Calls, scratch: Scratch, f: Any, g: Any, ego: Ego, view: View, scene: int, lane: Any, way: Any
) -> None:
    """Put the vehicles of one scene, of which x is known, on their lanes' centre lines, and publish them.

    lane (V,) of the scenario; way (V,) +1 or -1.
    """
    f_s, g_s = f[scene], g[scene]
    for i in range(f_s.shape[1]):
        if g_s[KIND, i] != ABSENT:
            f_s[Y, i], heading = centre_line(ego.pieces, lane[i], f_s[X, i])
            if g_s[KIND, i] == OBSTACLE:
                heading = 0.0
            f_s[ANGLE, i] = heading if way[i] > 0 else heading + np.pi
            g_s[LANE, i] = closest_lane(calls, roads, f_s[X, i], f_s[Y, i], f_s[ANGLE, i])
    directions(calls, scratch, f_s)
    publish(ego, view, scratch, f_s, g_s, scene)


def _show(calls: Calls, scratch: Scratch, f: Any, g: Any, ego: Ego, view: View) -> None:
    """Of every scene whose cars somebody else has moved: who touches the ego, and the rows."""
    for scene in range(f.shape[0]):
        f_s, g_s = f[scene], g[scene]
        directions(calls, scratch, f_s)
        if not (ego.freezes and g_s[CRASHED, 0]):
            collide(calls, scratch, f_s, g_s, 0.0)
            ego.crashed[scene] = g_s[CRASHED, 0] != 0
        publish(ego, view, scratch, f_s, g_s, scene)


advance = compiled(_advance, inline=True, error_model="numpy", _nrt=False)
settle = compiled(_settle, inline=True, error_model="numpy", _nrt=False)
show = compiled(_show, inline=True, error_model="numpy", _nrt=False)
