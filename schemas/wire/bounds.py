"""What the numbers of a message may be: whatever its sender is, a reader meets none that it cannot reckon with.

A message that keeps its type and breaks a bound is refused by `codec.decode` like one that is no message at all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import msgspec

from schemas.wire.messages import ROW_COLUMNS, ROW_LAYOUT, Action, Directive, Message, MetaAction, Observation

LANES_MAX = 16
FAR_M = 1e6
"""Nothing is farther away than this."""
FAST_MPS = 200.0
TTL_MAX_S = 60.0
"""No directive is pending for longer, whatever it says."""
AHEAD_NS = 1_000_000_000
"""A stamp may be so much later than the reader's clock: two clocks of one host agree, but reading them takes time."""
_WIDTH, _ID, _LANE = len(ROW_COLUMNS), ROW_COLUMNS.index("id"), ROW_COLUMNS.index("lane")


class OutOfBoundsError(ValueError):
    """A number that a message must not have; `str()` names it in one line."""


def check(message: Message) -> None:
    """Raises `OutOfBoundsError` for a number that is not finite, or out of the range that its meaning allows."""
    if isinstance(message, Observation):
        _check_observation(message)
    elif isinstance(message, Action):
        _check_action(message)
    else:
        for name, number in _floats(msgspec.structs.asdict(message)):
            if not math.isfinite(number):
                raise OutOfBoundsError(f"{name} is {number}")
        if isinstance(message, Directive):
            _check_directive(message)


def _within(name: str, number: float | None, least: float, most: float) -> None:
    if number is not None and not least <= number <= most:  # nan is within nothing
        raise OutOfBoundsError(f"{name} {number:g} is not within {least:g}..{most:g}")


def _floats(fields: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Every float in a message, however deep, with the name of its field."""
    for name, value in fields.items():
        if isinstance(value, float):
            yield name, value
        elif isinstance(value, dict):
            yield from ((str(key)[:40], v) for key, v in value.items() if isinstance(v, float))
        elif isinstance(value, msgspec.Struct):
            yield from _floats(msgspec.structs.asdict(value))
        elif isinstance(value, tuple):
            for item in value:
                yield from _floats(msgspec.structs.asdict(item) if isinstance(item, msgspec.Struct) else {name: item})


def _check_directive(directive: Directive) -> None:
    _within("target_speed_mps", directive.target_speed_mps, 0.0, FAST_MPS)
    _within("headway_s", directive.headway_s, 0.0, TTL_MAX_S)
    _within("target_lane", directive.target_lane, 0, LANES_MAX - 1)
    if not directive.ttl_s > 0.0:
        raise OutOfBoundsError(f"ttl_s {directive.ttl_s:g} is not positive")


def _check_action(action: Action) -> None:
    _within("meta_action", action.meta_action, 0, len(MetaAction) - 1)
    _within("style", action.style, 0, 2)
    _within("turn_signal", action.turn_signal, -1, 1)
    _within("speed_cap_mps", action.speed_cap_mps, 0.0, FAR_M)
    _within("speed_goal_mps", action.speed_goal_mps, -FAR_M, FAR_M)
    for probability in action.probabilities:
        _within("a probability", probability, -FAR_M, FAR_M)


def _check_observation(seen: Observation) -> None:
    if seen.layout != ROW_LAYOUT:
        raise OutOfBoundsError(f"row layout {seen.layout[:20]!r} is not {ROW_LAYOUT!r}")
    if not seen.rows or len(seen.rows) % (4 * _WIDTH):
        raise OutOfBoundsError(f"rows of {len(seen.rows)} bytes are not whole rows of {4 * _WIDTH}")
    count = len(seen.lanes)
    if not 1 <= count <= LANES_MAX:
        raise OutOfBoundsError("an observation without lanes" if not count else f"{count} lanes, {LANES_MAX} at most")
    numbers = memoryview(seen.rows).cast("f").tolist()
    if not math.isfinite(sum(numbers)):
        raise OutOfBoundsError("a non-finite number in rows")
    if max(numbers) > FAR_M or min(numbers) < -FAR_M:
        raise OutOfBoundsError(f"a number in rows is beyond {FAR_M:g}")
    if numbers[_ID] < 0.0:
        raise OutOfBoundsError(f"the first row is the ego's, and its id {numbers[_ID]:g} is nobody's")
    lanes = numbers[_LANE::_WIDTH]
    if not (min(lanes) >= 0.0 and max(lanes) < count):
        raise OutOfBoundsError(f"a vehicle is in lane {max(lanes, key=abs):g} of {count}")
    if not 0 <= seen.target_lane < count:
        raise OutOfBoundsError(f"target_lane {seen.target_lane} is not one of {count} lanes")
    if not -1 <= seen.previous_lane < count:
        raise OutOfBoundsError(f"previous_lane {seen.previous_lane} is not one of {count} lanes, nor -1")
    for lane in seen.lanes:
        road = (lane.y_m, lane.start_m, lane.end_m, lane.change_from_m, lane.width_m, lane.speed_limit_mps)
        if not math.isfinite(sum(road)):
            raise OutOfBoundsError("a non-finite number in a lane")
    if not (math.isfinite(seen.target_speed_mps) and math.isfinite(seen.acceleration_mps2)):
        raise OutOfBoundsError("a non-finite set-point")
    _within("target_speed_mps", seen.target_speed_mps, -FAST_MPS, FAST_MPS)
    _within("acceleration_mps2", seen.acceleration_mps2, -FAR_M, FAR_M)
    _within("sight_m", seen.sight_m, 0.0, FAR_M)
    _within("hz", seen.hz, 1, 1000)
    if math.isnan(seen.goal_x_m):
        raise OutOfBoundsError("goal_x_m is nan")


def is_from_the_future(directive: Directive, now_ns: int) -> bool:
    """Whether a directive says that it is later than `now_ns`, by its stamp or by its id, which is one of microseconds:
    nobody can have sent it, and ids that are newer than all to come would shut everybody out."""
    return directive.stamp_ns > now_ns + AHEAD_NS or 1000 * directive.id > now_ns + 60 * AHEAD_NS
