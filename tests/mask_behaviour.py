"""Many seeded scenes, and a digest of what mask and choice make of them: behaviour, not spelling."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fast_node.choice import choose, comfortable_mps, narrow
from fast_node.mask import PRESETS, Preset, close_actions
from schemas.driving.road import LANE_LIMIT, LANE_WAY, LANE_Y, X, lane_table
from tests import scenes
from tests.scenes import car

SIGHT_M = 250.0
ROADS = {
    "two-way": lane_table(scenes.TWO_WAY),
    "highway": lane_table(scenes.HIGHWAY),
    "ramp": lane_table(scenes.MERGE),
    "roadworks": lane_table(scenes.ROADWORKS),
}
EGO_X_M = {"two-way": (400.0, 600.0), "highway": (400.0, 600.0), "ramp": (180.0, 349.0), "roadworks": (450.0, 599.0)}
N_SCENES = 20_000


class Scene(NamedTuple):
    """All that mask and choice read, but for the preset."""

    lanes: list[tuple[float, ...]]
    rows: list[list[float]]
    target_speed: float
    lane: int
    previous: int
    intent: tuple[int, float, float]
    """Lane, speed, headway."""
    logits: list[float]
    due: bool
    held: int
    """What the last decision asks for meanwhile."""
    left_lane: int
    accel: float
    style: int


def draw(count: int = N_SCENES, seed: int = 7) -> Iterator[Scene]:
    """Scenes in which every claim has its say: cars are drawn around the ego, most of them near it."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return low + (high - low) * float(rng.random())

    def one_of(n: int) -> int:
        return int(rng.random() * n)

    names = sorted(ROADS)
    for k in range(count):
        name = names[k % len(names)]
        lanes = ROADS[name]
        aim = one_of(len(lanes))
        beside = [n for n in (aim - 1, aim + 1) if 0 <= n < len(lanes)]
        previous = beside[one_of(len(beside))] if rng.random() < 0.4 else -1
        top = lanes[aim][LANE_LIMIT]
        start_y = lanes[aim if previous < 0 else previous][LANE_Y]
        y = start_y + (lanes[aim][LANE_Y] - start_y) * between(0.0, 1.0) + between(-0.2, 0.2)
        speed = top * between(0.0, 1.2)
        changing = previous >= 0
        ego = car(
            0,
            between(*EGO_X_M[name]),
            nearest_lane(lanes, y),
            speed,
            y,
            vy_mps=between(-1.5, 1.5) if changing else 0.0,
            heading_rad=between(-0.2, 0.2) if changing else 0.0,
        )
        rows = [ego]
        for number in range(11, 11 + one_of(8)):
            lane = min(max(aim + one_of(5) - 2, 0), len(lanes) - 1) if rng.random() < 0.7 else one_of(len(lanes))
            oncoming = lanes[lane][LANE_WAY] < 0 and rng.random() < 0.8
            reach = (12.0, 40.0, 120.0, 250.0)[one_of(4)]
            pace = min(max(speed + between(-8.0, 8.0), 0.0), 1.3 * top) if rng.random() < 0.8 else 0.0
            drift = between(-2.0, 2.0) if rng.random() < 0.3 else 0.0
            askew = between(-0.6, 0.6) if rng.random() < 0.15 else 0.0
            aside = lanes[lane][LANE_Y] + (between(-2.4, 2.4) if rng.random() < 0.4 else 0.0)
            rows.append(
                car(
                    -1 if rng.random() < 0.05 else number,
                    ego[X] + between(-reach, reach),
                    nearest_lane(lanes, aside),
                    -pace if oncoming else pace,
                    aside,
                    vy_mps=drift,
                    heading_rad=askew,
                    length_m=12.0 if rng.random() < 0.1 else 5.0,
                )
            )
        if rng.random() < 0.3:  # tracks, in doubt
            far = [(0.0, 0.0, 0.0, 0.0)] + [(6.0, 0.6, 3.0, 1.0)] * (len(rows) - 1)
            rows = [[*row, *(between(0.0, most) for most in off)] for row, off in zip(rows, far, strict=True)]
        rows = np.array(rows, np.float32).tolist()  # as they come over the bus
        target = speed if rng.random() < 0.5 else top * between(0.0, 1.2)
        intent = (one_of(len(lanes) + 1) - 1, top * between(0.0, 1.1), between(0.5, 3.0))
        left_lane = aim + one_of(3) - 1 if rng.random() < 0.3 else -1
        yield Scene(
            lanes,
            rows,
            target,
            aim,
            previous,
            intent,
            [between(-1.0, 1.0) for _ in range(5)],
            rng.random() < 0.5,
            one_of(3),
            left_lane if 0 <= left_lane < len(lanes) else -1,
            between(-4.0, 2.0),
            one_of(3),
        )


def nearest_lane(lanes: list[tuple[float, ...]], y: float) -> int:
    """Index of the lane whose centre line is nearest to `y` [m]."""
    return min(range(len(lanes)), key=lambda k: abs(lanes[k][LANE_Y] - y))


def judged(scene: Scene, preset: Preset) -> tuple[int, ...]:
    """What mask and choice make of a scene: the speed caps in mm/s, without and with the intent's (-1: none), the
    reason and the vehicle of each action, the same with the intent's, the meta-action and who settled it."""
    reasons, vehicle, near = [0] * 6, [-1] * 6, [0] * (3 * len(scene.lanes))
    rows, lanes, lane = scene.rows, scene.lanes, scene.lane
    admitted = close_actions(
        rows, lanes, scene.target_speed, lane, scene.previous, SIGHT_M, near, reasons, vehicle, preset
    )
    safe = list(reasons)
    wished_lane, speed, headway = scene.intent
    cap = min(admitted, comfortable_mps(rows, near, lanes, lane, scene.accel, speed, headway, scene.style))
    narrow(
        reasons,
        rows,
        near,
        lanes,
        scene.target_speed,
        lane,
        scene.previous,
        scene.left_lane,
        wished_lane,
        speed,
        headway,
        cap,
    )
    caps = [round(1000 * c) if math.isfinite(c) else -1 for c in (admitted, cap)]
    return (*caps, *safe, *vehicle, *reasons, *choose(scene.logits, reasons, scene.due, scene.held))


def digest(count: int = N_SCENES) -> str:
    """Of `judged` over all scenes with every preset."""
    found = hashlib.sha256()
    for scene in draw(count):
        for name in sorted(PRESETS):
            found.update(np.array(judged(scene, PRESETS[name]), np.int64).tobytes())
    return found.hexdigest()[:16]
