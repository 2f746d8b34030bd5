"""What the numbers of a message may be, to the last one, and what is said of those that may not."""

from __future__ import annotations

import math
from typing import Any

import pytest

from schemas.driving.road import LANE, X
from schemas.wire import messages as m
from schemas.wire.bounds import AHEAD_NS, OutOfBoundsError, check, is_from_the_future
from schemas.wire.journal import Input, Journal
from schemas.wire.thought import Recalled, Thought
from tests.scenes import car, directive, lane, observation

EGO = car(0, 500.0, 1, 8.0)
FAR, TOO_FAR = 1e6, 1_000_000.5


def refusal(message: m.Message) -> str:
    """What is said of it; "": nothing."""
    try:
        check(message)
    except OutOfBoundsError as error:
        return str(error)
    return ""


def action(**fields: Any) -> m.Action:
    return m.Action(epoch=1, stamp_ns=1, **{"answers_tick": 1, "meta_action": 1, "source": "policy", **fields})


def scene(**fields: Any) -> m.Observation:
    return observation(EGO, **fields)


def with_column(column: int, value: float) -> list[float]:
    return [value if k == column else number for k, number in enumerate(EGO)]


@pytest.mark.parametrize(
    ("name", "within", "least", "most", "beyond"),
    [
        ("target_speed_mps", "0..200", 0.0, 200.0, (-0.1, 200.5)),
        ("headway_s", "0..60", 0.0, 60.0, (-0.1, 60.5)),
        ("target_lane", "0..15", 0, 15, (-1, 16)),
    ],
)
def test_a_directive_is_read_up_to_its_bounds(name: str, within: str, least: float, most: float, beyond: Any) -> None:
    assert [refusal(directive(**{name: value})) for value in (least, most, None)] == ["", "", ""]
    said = [refusal(directive(**{name: value})) for value in (*beyond, math.nan)]
    assert said == [*(f"{name} {value:g} is not within {within}" for value in beyond), f"{name} is nan"]


def test_a_directive_lives_for_some_time() -> None:
    assert [refusal(directive(ttl_s=s)) for s in (0.5, 0.0, -1.5)] == [
        "",
        "ttl_s 0 is not positive",
        "ttl_s -1.5 is not positive",
    ]


@pytest.mark.parametrize(
    ("name", "within", "least", "most", "beyond"),
    [
        ("meta_action", "0..5", 0, 5, (-1, 6)),
        ("style", "0..2", 0, 2, (-1, 3)),
        ("turn_signal", "-1..1", -1, 1, (-2, 2)),
        ("speed_cap_mps", "0..1e+06", 0.0, FAR, (-0.1, TOO_FAR, math.nan)),
        ("speed_goal_mps", "-1e+06..1e+06", -FAR, FAR, (-TOO_FAR, TOO_FAR, math.nan)),
    ],
)
def test_an_action_is_read_up_to_its_bounds(name: str, within: str, least: float, most: float, beyond: Any) -> None:
    assert [refusal(action(**{name: value})) for value in (least, most)] == ["", ""]
    said = [refusal(action(**{name: value})) for value in beyond]
    assert said == [f"{name} {value:g} is not within {within}" for value in beyond]


def test_probabilities_are_numbers_that_one_can_reckon_with() -> None:
    assert refusal(action(probabilities=(-FAR, FAR))) == ""
    for bad in (-TOO_FAR, TOO_FAR, math.nan):
        assert refusal(action(probabilities=(0.5, bad))) == f"a probability {bad:g} is not within -1e+06..1e+06"


@pytest.mark.parametrize(
    ("name", "within", "least", "most", "beyond"),
    [
        ("target_speed_mps", "-200..200", -200.0, 200.0, (-200.5, 200.5)),
        ("acceleration_mps2", "-1e+06..1e+06", -FAR, FAR, (-TOO_FAR, TOO_FAR)),
        ("sight_m", "0..1e+06", 0.0, FAR, (-0.1, TOO_FAR)),
        ("hz", "1..1000", 1, 1000, (0, 1001)),
    ],
)
def test_an_observation_is_read_up_to_its_bounds(
    name: str, within: str, least: float, most: float, beyond: Any
) -> None:
    assert [refusal(scene(**{name: value})) for value in (least, most)] == ["", ""]
    said = [refusal(scene(**{name: value})) for value in beyond]
    assert said == [f"{name} {value:g} is not within {within}" for value in beyond]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"goal_x_m": math.inf}, ""),
        ({"goal_x_m": math.nan}, "goal_x_m is nan"),
        ({"target_speed_mps": math.nan}, "a non-finite set-point"),
        ({"acceleration_mps2": math.inf}, "a non-finite set-point"),
        ({"target_lane": 2}, "target_lane 2 is not one of 2 lanes"),
        ({"target_lane": -1}, "target_lane -1 is not one of 2 lanes"),
        ({"target_lane": 0}, ""),
        ({"previous_lane": 1}, ""),
        ({"previous_lane": 2}, "previous_lane 2 is not one of 2 lanes, nor -1"),
        ({"previous_lane": -2}, "previous_lane -2 is not one of 2 lanes, nor -1"),
        ({"layout": "rows/2" + 20 * "x"}, f"row layout {'rows/2' + 14 * 'x'!r} is not 'rows/1'"),
        ({"rows": b""}, "rows of 0 bytes are not whole rows of 36"),
        ({"rows": bytes(35)}, "rows of 35 bytes are not whole rows of 36"),
        ({"lanes": ()}, "an observation without lanes"),
        ({"lanes": tuple(lane(k) for k in range(16))}, ""),
        ({"lanes": tuple(lane(k) for k in range(17))}, "17 lanes, 16 at most"),
        ({"lanes": (lane(0), m.Lane(y_m=math.nan, start_m=0.0, end_m=1.0))}, "a non-finite number in a lane"),
    ],
)
def test_a_scene_that_makes_no_sense_is_refused_with_the_reason(fields: dict[str, Any], said: str) -> None:
    assert refusal(scene(**fields)) == said


def test_a_road_may_have_one_lane() -> None:
    assert refusal(observation(car(0, 500.0, 0, 8.0), lanes=(lane(0),), target_lane=0)) == ""


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        (X, FAR, ""),
        (X, -FAR, ""),
        (X, 1.1 * FAR, "a number in rows is beyond 1e+06"),
        (X, -1.1 * FAR, "a number in rows is beyond 1e+06"),
        (X, math.inf, "a non-finite number in rows"),
        (LANE, 0.0, ""),
        (LANE, 2.0, "a vehicle is in lane 2 of 2"),
        (LANE, -3.0, "a vehicle is in lane -3 of 2"),
    ],
)
def test_a_vehicle_is_where_one_can_reckon_with_it(column: int, value: float, said: str) -> None:
    rows = b"".join(observation(row).rows for row in (EGO, with_column(column, value)))
    assert refusal(scene(rows=rows)) == said


@pytest.mark.parametrize(("number", "said"), [(0, ""), (-1, "the first row is the ego's, and its id -1 is nobody's")])
def test_the_first_row_is_somebody(number: int, said: str) -> None:
    assert refusal(observation(car(number, 500.0, 1, 8.0))) == said


def test_no_number_of_any_message_is_not_finite_however_deep_it_lies() -> None:
    header: dict[str, Any] = {"epoch": 1, "stamp_ns": 1}
    status: dict[str, Any] = {**header, "node": "sim", "pid": 1, "seq": 1, "state": "ready"}
    thought: dict[str, Any] = {**header, "command_id": 1, "command": "", "source": "", "outcome": "", "answers": ("a",)}
    event = m.Event(**header, kind=m.EventKind.WORLD, node="sim", tick=1, duration_s=math.inf)
    recalled = Recalled(command="", similarity=math.nan, slots="", outcome="")
    assert refusal(m.Status(**status, metrics={"a": 1.0})) == ""
    assert refusal(m.Status(**status, metrics={"a": "text"})) == ""  # type: ignore[dict-item]
    assert refusal(m.Status(**status, metrics={50 * "x": math.nan})) == 40 * "x" + " is nan"
    assert refusal(Thought(**thought)) == ""
    assert refusal(Thought(**thought, recalled=(recalled,))) == "similarity is nan"
    assert refusal(Journal(**header, seq=1, inputs=(Input(now_ns=1, event=event),))) == "duration_s is inf"


@pytest.mark.parametrize(
    ("stamp_ns", "number", "future"),
    [(AHEAD_NS, 1, False), (AHEAD_NS + 1, 1, True), (0, 60_000_000, False), (0, 60_000_001, True)],
)
def test_a_directive_is_no_later_than_a_second_by_its_stamp_and_a_minute_by_its_id(
    stamp_ns: int, number: int, future: bool
) -> None:
    assert AHEAD_NS == 10**9
    now_ns = 5 * 10**9
    late = directive(stamp_ns=stamp_ns + now_ns, id=number + now_ns // 1000)
    assert is_from_the_future(late, now_ns) == future
