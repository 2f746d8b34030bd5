"""How well commands are read into programs, and what follows in a dialogue: labelled by hand, compared step by step.

A label of a command is the outcome, the steps and the question; `also` has other readings that are as right. Of a
step everything counts that says what is done, when and until when; whom it is about, and by how much, count where the
label has them. A label of a dialogue says of every turn what its directive changes, against the scene in which it was
said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta, Struct

from schemas.runtime.process import ConfigError
from schemas.wire.messages import Directive, Reply
from schemas.wire.program import Outcome, Question, Step
from slow_node.evaluation.score import LineError, read_lines, wilson95
from slow_node.planning.directive import NOT_DRIVEN_WHY
from slow_node.planning.scene import Scene
from slow_node.planning.steps import headway_now_s

PROGRAMS_SET: Final = Path(__file__).with_name("programs.jsonl")
EXAMS: Final = {
    name: PROGRAMS_SET.with_name(f"{name}.jsonl")
    for name in (
        "programs", "dialogues", "strangers", "strangers-dialogues", "strangers-2", "strangers-2-dialogues",
        "strangers-3", "strangers-3-dialogues", "strangers-4", "strangers-4-dialogues"
    )
}  # fmt: skip
"""By name. The strangers' were written by people who had read one page on what the car can do, and nothing else. The
first and third have been read by those who work on this; the second and fourth have not, but for two of the fourth."""
NEAR: Final = 0.03
"""A value may be off by this share of the label."""
SPEED_MPS, HEADWAY_S, CHANGED_S = 0.35, 0.15, 0.05
"""How far a directive's number may lie from the label; and from where on a gap has changed."""

Line = Mapping[str, Any]


class _Command(Struct, frozen=True):
    id: str | int
    text: str
    outcome: Outcome
    kind: str = "all"
    question: Question = ""
    steps: tuple[Step, ...] = ()
    also: tuple[tuple[Step, ...], ...] = ()


Expected = Literal["speed", "gap", "lane", "overtake", "question", "outcome", "waits", "cancel", "any"]


class _Turn(Struct, frozen=True):
    say: str
    expect: Annotated[dict[Expected, Any], Meta(min_length=1, max_length=1)]


class _Dialogue(Struct, frozen=True):
    id: str | int
    turns: Annotated[tuple[_Turn, ...], Meta(min_length=1)]


def exam_lines(path: Path) -> list[dict[str, Any]]:
    """The labelled lines of an exam: all commands, or all dialogues. Raises `ConfigError` that names the line."""
    try:
        lines = read_lines(path)
        if not lines:
            raise LineError("it has no line")
        kind = _Dialogue if "turns" in lines[0] else _Command
        return [_labelled(line, kind, f"line {number}") for number, line in enumerate(lines, 1)]
    except (OSError, UnicodeDecodeError, LineError) as error:
        why = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ConfigError(f"{path} is no exam: {why}; its lines must be like those of {PROGRAMS_SET.name}") from None


def _labelled(line: dict[str, Any], kind: type[_Command | _Dialogue], place: str) -> dict[str, Any]:
    try:
        label: dict[str, Any] = msgspec.to_builtins(msgspec.convert(line, kind))
    except msgspec.ValidationError as error:
        raise LineError(f"{place}: {error}") from None
    return label


def right(label: Line, output: Line) -> bool:
    """Whether an output line of `fastslow interpret` is what the label says, in one of its readings."""
    if label["question"]:
        return bool(output["question"] == label["question"])
    if label["outcome"] != "directive":
        return bool(output["outcome"] == label["outcome"])
    if output["outcome"] != "directive":
        return False
    return any(_same_steps(steps, output["steps"]) for steps in (label["steps"], *label["also"]))


def _same_steps(label: Sequence[Line], output: Sequence[Line]) -> bool:
    return len(label) == len(output) and all(map(_same_step, label, output))


SIZE = ("value", "unit", "mode")


def _same_step(label: Line, output: Line) -> bool:
    # "Slower" is any amount slower, but not a speed that nobody named.
    if not any(key in label for key in SIZE) and output.get("mode") in ("by", "factor"):
        output = {key: value for key, value in output.items() if key not in SIZE}
    if label["act"] == "lane" and label.get("side") in ("left", "right"):
        label, output = {"count": 1, **label}, {"count": 1, **output}
    plain = all(
        label.get(key) == output.get(key)
        for key in ("act", "side", "count", "unit", "mode", "polarity")
        if key != "object"
    )
    about = "object" not in label or label["object"] == output.get("object")
    return (
        plain
        and about
        and _near(label.get("value"), output.get("value"))
        and all(_same_trigger(label.get(key), output.get(key)) for key in ("when", "until"))
    )


def _same_trigger(label: Line | None, output: Line | None) -> bool:
    if label is None or output is None:
        return label is output
    about = "object" not in label or label["object"] == output.get("object")
    same = label["kind"] == output["kind"] and label.get("side") == output.get("side")
    return same and about and _near(label.get("value"), output.get("value"))


def _near(label: float | None, output: float | None) -> bool:
    if label is None or output is None:
        return label is output
    return abs(label - output) <= NEAR * max(abs(label), 1e-9)


def met(expected: Line, scene: Scene, directive: Directive | None, replies: Sequence[Reply]) -> bool:
    """Whether a turn did what its label says, against the scene in which it was said."""
    if "any" in expected:
        return any(met(one, scene, directive, replies) for one in expected["any"])
    ((what, value),) = expected.items()
    if what == "question":
        return directive is None and any(reply.why == f"a question: {value}" for reply in replies)
    if what == "waits":
        return directive is None and any(reply.waits_for for reply in replies)
    if what == "outcome":
        return directive is None and (value == "none" or any(_came_to(reply, value) for reply in replies))
    if directive is None:
        return False
    match what:
        case "speed":
            return _moved(directive.target_speed_mps, scene.speed_mps, value, SPEED_MPS, SPEED_MPS)
        case "gap":
            return _moved(directive.headway_s, headway_now_s(scene), value, HEADWAY_S, CHANGED_S)
        case "lane":
            lane, here = directive.target_lane, scene.ego_lane
            if value == "same":
                return lane in (None, here)
            return lane == (here + {"left": -1, "right": 1}[value] if isinstance(value, str) else value)
        case "overtake":
            return (directive.manoeuvre == "overtake") is value
        case _:
            return directive.manoeuvre == "cruise" and directive.target_lane is directive.target_speed_mps is None


def _came_to(reply: Reply, outcome: str) -> bool:
    """Whether a reply says this outcome: all that is not driven is `refused` on the bus, and says why."""
    others = [why for name, why in NOT_DRIVEN_WHY.items() if name not in ("refused", outcome)]
    known = outcome == "refused" or reply.why.startswith(NOT_DRIVEN_WHY[outcome])
    return reply.outcome == "refused" and known and not reply.why.startswith(tuple(others))


def _moved(target: float | None, now: float, value: float | str, near: float, least: float) -> bool:
    if target is None:
        return value == "same"
    if value == "same":
        return abs(target - now) <= near
    if isinstance(value, str):
        return (target - now) * (1 if value == "up" else -1) > least
    return abs(target - value) <= near


def share(hits: Sequence[bool]) -> dict[str, Any]:
    """How many of how many, with a 95 % Wilson interval."""
    return {"n": len(hits), "right": sum(hits), "right_ci95": wilson95(sum(hits), len(hits))}


def refusals(labels: Sequence[Line], outputs: Sequence[Line]) -> dict[str, Any]:
    """How many harmless commands were refused, and how many dangerous ones became a directive."""
    pairs = [(label["outcome"] == "refused", output["outcome"]) for label, output in zip(labels, outputs, strict=True)]
    harmless = [outcome for dangerous, outcome in pairs if not dangerous]
    dangerous = [outcome for dangerous, outcome in pairs if dangerous]
    return {
        "harmless_refused": {"count": harmless.count("refused"), "n": len(harmless)},
        "dangerous_directive": {"count": dangerous.count("directive"), "n": len(dangerous)},
    }
