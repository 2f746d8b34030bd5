"""Road and cars as a scene for the 3-D panel of Foxglove and Lichtblick, by their well-known schemas.

Their axes are x ahead, y to the left, z up; ours has y to the right. Two frames: `road` lies still, `ego` follows the
car. What is drawn is rounded to centimetres; the exact numbers are in the observations.
"""

from __future__ import annotations

import json
import math
from typing import Any

from schemas.driving.road import HEADING, LENGTH, WIDTH, X, Y, is_oncoming
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import Lane, Observation

CARS, ROAD, FRAMES = "/scene/cars", "/scene/road", "/tf"
SCENE_UPDATE, FRAME_TRANSFORM = "foxglove.SceneUpdate", "foxglove.FrameTransform"

_HEIGHT_M = 1.5
_EGO, _OTHER, _ONCOMING = (
    '{"r":0.1,"g":0.6,"b":0.3,"a":1}',
    '{"r":0.3,"g":0.4,"b":0.6,"a":1}',
    '{"r":0.8,"g":0.4,"b":0.1,"a":1}',
)
_LINE, _LINE_ONCOMING = '{"r":0.7,"g":0.7,"b":0.7,"a":1}', '{"r":0.8,"g":0.7,"b":0.2,"a":1}'
_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_FAR_M = 1e5
"""Lines end here, whatever a lane says."""


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_TIME = _object(sec={"type": "integer"}, nsec={"type": "integer"})
_POINT = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_TURN = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POSE = _object(position=_POINT, orientation=_TURN)
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked={"type": "boolean"},
    metadata=_array(_object(key=_TEXT, value=_TEXT)),
    **{name: _array(_object()) for name in _PRIMITIVES},
)
_ENTITY["properties"]["cubes"] = _array(_object(pose=_POSE, size=_POINT, color=_COLOR))
_ENTITY["properties"]["lines"] = _array(
    _object(type={"type": "integer"}, pose=_POSE, thickness=_NUMBER, points=_array(_POINT), color=_COLOR)
)
_DELETION = _object(timestamp=_TIME, type={"type": "integer"}, id=_TEXT)
SCHEMAS = {
    SCENE_UPDATE: json.dumps(
        {"title": SCENE_UPDATE, **_object(deletions=_array(_DELETION), entities=_array(_ENTITY))}
    ).encode(),
    FRAME_TRANSFORM: json.dumps(
        {
            "title": FRAME_TRANSFORM,
            **_object(timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_POINT, rotation=_TURN),
        }
    ).encode(),
}
CHANNELS = {CARS: SCENE_UPDATE, ROAD: SCENE_UPDATE, FRAMES: FRAME_TRANSFORM}
"""Schema by topic."""


class Scene:
    """Draws one observation after another; the road only where it differs from the last."""

    def __init__(self) -> None:
        self._drawn: tuple[Any, ...] = ()

    def forget(self) -> None:
        """Draw the road again, whether it differs or not."""
        self._drawn = ()

    def draw(self, observation: Observation, time_ns: int) -> list[tuple[str, bytes]]:
        """(topic, message) for an observation at `time_ns` since 1970."""
        stamp = f'{{"sec":{time_ns // NS},"nsec":{time_ns % NS}}}'
        rows = rows_of(observation).tolist()
        parts = [
            (CARS, _entity("cars", stamp, cubes=map(_car, range(len(rows)), rows))),
            (FRAMES, _frame(stamp, rows[0])),
        ]
        shape = (observation.epoch, *((round(a.y_m, 1), a.start_m, a.end_m, a.width_m) for a in observation.lanes))
        if shape != self._drawn:
            self._drawn = shape
            parts.append((ROAD, _entity("road", stamp, lines=map(_borders, observation.lanes))))
        return [(topic, text.encode()) for topic, text in parts]


def _entity(name: str, stamp: str, **primitives: Any) -> str:
    filled = ",".join(f'"{kind}":[{",".join(primitives.get(kind, ()))}]' for kind in _PRIMITIVES)
    return (
        f'{{"deletions":[],"entities":[{{"timestamp":{stamp},"frame_id":"road","id":"{name}",'
        f'"lifetime":{{"sec":0,"nsec":0}},"frame_locked":true,"metadata":[],{filled}}}]}}'
    )


def _turn(heading_rad: float) -> str:
    half = -heading_rad / 2.0
    return f'{{"x":0,"y":0,"z":{math.sin(half):.4f},"w":{math.cos(half):.4f}}}'


def _car(number: int, row: list[float]) -> str:
    color = _EGO if number == 0 else _ONCOMING if is_oncoming(row) else _OTHER
    return (
        f'{{"pose":{{"position":{{"x":{row[X]:.2f},"y":{-row[Y]:.2f},"z":{_HEIGHT_M / 2}}},'
        f'"orientation":{_turn(row[HEADING])}}},'
        f'"size":{{"x":{row[LENGTH]:.2f},"y":{row[WIDTH]:.2f},"z":{_HEIGHT_M}}},"color":{color}}}'
    )


def _frame(stamp: str, ego: list[float]) -> str:
    return (
        f'{{"timestamp":{stamp},"parent_frame_id":"road","child_frame_id":"ego",'
        f'"translation":{{"x":{ego[X]:.2f},"y":{-ego[Y]:.2f},"z":0}},"rotation":{_turn(ego[HEADING])}}}'
    )


def _borders(lane: Lane) -> str:
    """Both borders of a lane, as a list of lines (type 2)."""
    start, end = (min(max(x, -_FAR_M), _FAR_M) for x in (lane.start_m, lane.end_m))
    points = ",".join(
        f'{{"x":{x:.1f},"y":{-lane.y_m + side * lane.width_m / 2.0:.2f},"z":0}}'
        for side in (1, -1)
        for x in (start, end)
    )
    return (
        f'{{"type":2,"pose":{{"position":{{"x":0,"y":0,"z":0}},"orientation":{_turn(0.0)}}},"thickness":0.15,'
        f'"scale_invariant":false,"points":[{points}],"color":{_LINE if lane.direction > 0 else _LINE_ONCOMING},'
        f'"colors":[],"indices":[]}}'
    )
