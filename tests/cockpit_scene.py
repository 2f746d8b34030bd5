"""Messages of a small two-way road, for the cockpit's tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.runtime.clock import NS
from schemas.wire.messages import Action, Closure, Directive, Event, Lane, Observation

LANES = (
    Lane(y_m=0.0, start_m=0.0, end_m=3000.0, direction=-1, kind="oncoming", speed_limit_mps=8.0),
    Lane(y_m=4.0, start_m=0.0, end_m=3000.0, speed_limit_mps=8.0),
)


def seen(tick: int = 0, *others: tuple[float, ...], epoch: int = 1, **more: Any) -> Observation:
    """The ego at x = 400 m in lane 1 with 6 m/s; others: (id, x, vx, lane)."""
    rows = [(0, 400.0, 4.0, 6.0, 0.0, 0.0, 5.0, 2.0, 1), *((i, x, 4.0 * k, v, 0, 0, 5, 2, k) for i, x, v, k in others)]
    fields: dict[str, Any] = {
        "epoch": epoch, "stamp_ns": 10 * NS + tick * NS // 15, "tick": tick, "scenario": "two-way", "lanes": LANES,
        "rows": np.array(rows, "<f4").tobytes(), "target_lane": 1, "target_speed_mps": 6.0,
    }  # fmt: skip
    return Observation(**(fields | more))


def directive(**more: Any) -> Directive:
    fields: dict[str, Any] = {
        "epoch": 1, "stamp_ns": 10 * NS, "id": 7, "command_id": 3, "scene_tick": 0, "manoeuvre": "overtake",
        "target_lane": 0, "ttl_s": 30.0,
    }  # fmt: skip
    return Directive(**(fields | more))


def event(kind: str, **more: Any) -> Event:
    return Event(epoch=1, stamp_ns=11 * NS, kind=kind, node="fast", tick=15, directive_id=7, **more)  # type: ignore[arg-type]


def action(*closed: Closure, tick: int = 0, stamp_ns: int = 10 * NS + 400_000) -> Action:
    return Action(epoch=1, stamp_ns=stamp_ns, answers_tick=tick, meta_action=1, source="policy", closed=closed)
