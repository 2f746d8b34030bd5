"""`fastslow interpret`: commands in, directives out, by the code that drives, without driving."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from pathlib import Path
from typing import IO, Any

import numpy as np

from deploy.lab.interpreter import running_interpreter
from schemas.driving.measures import CAR_LENGTH_M
from schemas.runtime.files import lines_bounded, read_text_bounded
from schemas.runtime.process import CONFIG, FAILED, OK, USAGE, ConfigError
from schemas.wire.bounds import LANES_MAX, check
from schemas.wire.messages import Directive, Lane, Observation
from schemas.wire.program import Program, plain
from schemas.wire.text import json_line
from schemas.wire.text import plain as plain_text
from slow_node.interpreter import Interpreter
from slow_node.planning.directive import ASKS, Refusal, directive_of
from slow_node.planning.scene import Scene, encode_scene
from slow_node.planning.steps import slots_of, stages
from slow_node.thought import Trace
from slow_node.understanding.slots import Slots

DEFAULT_SCENE: dict[str, Any] = {
    "lanes": 4,
    "ego_lane": 1,
    "speed_mps": 25.0,
    "limit_mps": 33.0,
    "vehicles": [{"gap_m": 40.0, "speed_mps": 20.0}],
}
SCENE_KEYS = {"scenario", "lanes", "ego_lane", "speed_mps", "limit_mps", "vehicles", "lead"}
NO_SLOTS: dict[str, Any] = {
    "speed": None,
    "target_speed_mps": None,
    "lane": None,
    "gap": None,
    "headway_s": None,
    "overtake": None,
    "cancel": False,
}
MAX_TEXT = 3000
VEHICLES_MAX = 200
LINE_BYTES = 100_000
"""Of an input line: a text in any letters, and a scene."""


class LineError(ValueError):
    """An input line that cannot be interpreted; `str()` says why."""


def scene_of(value: object) -> Scene:
    """A scene from JSON: keys of `DEFAULT_SCENE`, missing ones taken from it. Raises `LineError`.

    `lanes`: their number, or a list of {"direction", "kind", "limit_mps"}; `vehicles`: {"lane" (the ego's), "gap_m"
    (bumper to bumper, negative behind), "speed_mps" (along the road, negative: oncoming)}; `lead`: one such vehicle.
    """
    if not isinstance(value, dict):
        raise LineError("scene is not a JSON object")
    if unknown := set(value) - SCENE_KEYS:
        raise LineError(f"scene: unknown key {sorted(unknown)[0]!r}; choose from {', '.join(sorted(SCENE_KEYS))}")
    merged = {**DEFAULT_SCENE, **value}
    try:
        limit = float(merged["limit_mps"])
        count = merged["lanes"]
        if not 1 <= (count if isinstance(count, int) else len(count)) <= LANES_MAX:
            raise LineError(f"scene: 1 to {LANES_MAX} lanes")
        each = [{} for _ in range(count)] if isinstance(count, int) else list(count)
        lanes = tuple(
            Lane(
                y_m=4.0 * i,
                start_m=-1e4,
                end_m=1e4,
                direction=lane.get("direction", 1),
                kind=lane.get("kind", "main"),
                speed_limit_mps=float(lane.get("limit_mps", limit)),
            )
            for i, lane in enumerate(each)
        )
        ego = int(merged["ego_lane"])
        if not 0 <= ego < len(lanes):
            raise LineError(f"scene: ego_lane {ego} is not one of {len(lanes)} lanes")
        vehicles = list(merged["vehicles"] if "vehicles" in value or "lead" not in value else [])
        if value.get("lead"):
            vehicles.append(value["lead"])
        if len(vehicles) > VEHICLES_MAX:
            raise LineError(f"scene: {len(vehicles)} vehicles, {VEHICLES_MAX} at most")
        rows = [(0, 0.0, 4.0 * ego, float(merged["speed_mps"]), 0, 0, CAR_LENGTH_M, 2, ego)]
        for number, other in enumerate(vehicles, 1):
            lane, gap = int(other.get("lane", ego)), float(other["gap_m"])
            x = gap + CAR_LENGTH_M if gap >= 0 else gap - CAR_LENGTH_M
            rows.append((number, x, 4.0 * lane, float(other["speed_mps"]), 0, 0, CAR_LENGTH_M, 2, lane))
        with np.errstate(over="ignore"):
            packed = np.array(rows, np.float32).tobytes()
        seen = Observation(
            epoch=0,
            stamp_ns=time.monotonic_ns(),
            tick=0,
            scenario=str(merged.get("scenario", "highway"))[:80],
            lanes=lanes,
            rows=packed,
            target_lane=ego,
        )
        check(seen)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, LineError):
            raise
        raise LineError(f"scene: {type(error).__name__}: {error}") from None
    return encode_scene(seen)


def read_scene(path: Path | None) -> Scene:
    """The scene in a JSON file; None: the default one. Raises `ValueError` where it is of no use."""
    try:
        return scene_of(json.loads(read_text_bounded(path)) if path else DEFAULT_SCENE)
    except RecursionError:
        raise LineError("scene: nested too deep") from None
    except ConfigError as error:
        raise LineError(str(error)) from None


async def interpret(interpreter: Interpreter, text: str, scene: Scene, trace: Trace | None = None) -> dict[str, Any]:
    """One command's outcome, as an output line without its id. How it came about goes into `trace`."""
    began = time.perf_counter()
    found = await interpreter.interpret(text, scene, trace=trace)
    slots = found.slots or Slots(outcome="unclear")
    program = found.program or Program(outcome=slots.outcome)
    parts = stages(program)
    first = (
        slots_of(parts[0], scene, slots.language, program.miles) if program.outcome == "directive" and parts else slots
    )
    planned: Directive | Refusal = directive_of(first, scene)
    latency = time.perf_counter() - began
    outcome: str = planned.outcome if isinstance(planned, Refusal) else "directive"
    if found.slots is None and not found.model_answered:
        outcome = "error"
    return {
        "text": text,
        "outcome": outcome,
        "directive": {name: getattr(planned, name) for name in ASKS} if isinstance(planned, Directive) else None,
        "slots": slots.labelled(scene.limit_mps) if outcome == "directive" else dict(NO_SLOTS),
        "steps": [plain(step) for step in program.steps],
        "question": program.question,
        "model_asked": found.model_asked,
        "model_decided": found.model_decided,
        "verdict": found.verdict,
        "confidence": round(found.confidence, 4),
        "model_confidence": round(found.model_confidence, 4),
        "say": planned.say,
        "reasoning": slots.reasoning or found.why,
        "latency_s": round(latency, 4),
        "model": found.source,
        "retrieved": [{"command": e.command, "cosine": round(e.cosine, 3)} for e in found.nearest],
        **({"why": found.why} if found.why else {}),
    }


def interpret_lines(
    lines: Iterable[str | bytes | None],
    default: Scene,
    interpreter: Interpreter,
    write: Callable[[dict[str, Any]], None],
) -> tuple[int, int]:
    """Interpret input lines one by one, as they come; every non-empty line yields one output line. None: one that was
    too long. Commands and errors counted."""
    total = len(lines) if isinstance(lines, Sized) else 0

    async def run() -> tuple[int, int]:
        done = errors = 0
        for number, line in enumerate(lines, 1):
            if line is not None and not line.strip():
                continue
            identity: object = f"line-{number}"
            text = ""
            try:
                row = _row(line)
                identity = row.get("id", identity)
                text = row["text"] if isinstance(row.get("text"), str) else ""
                scene = _checked(row, default)
                result = await interpret(interpreter, text, scene)
            except Exception as error:  # nothing is lost: the line's place in the output says what happened
                result = {
                    "text": text,
                    "outcome": "error",
                    "directive": None,
                    "slots": dict(NO_SLOTS),
                    "steps": [],
                    "question": "",
                    "model_asked": False,
                    "model_decided": False,
                    "verdict": "",
                    "confidence": 0.0,
                    "model_confidence": 0.0,
                    "say": "",
                    "reasoning": "",
                    "latency_s": 0.0,
                    "model": "",
                    "retrieved": [],
                    "error": str(error) if isinstance(error, LineError) else f"{type(error).__name__}: {error}",
                }
                print(f"fastslow: line {number}: {result['error']}", file=sys.stderr)
            errors += result["outcome"] == "error"
            done += 1
            write({"id": identity, **result})
            _progress(done, total)
        await interpreter.close()
        return done, errors

    return asyncio.run(run())


def _row(line: str | bytes | None) -> dict[str, Any]:
    if line is None:
        raise LineError(f"longer than {LINE_BYTES:,} bytes")
    try:
        row = json.loads(line if isinstance(line, str) else line.decode(errors="replace"))
    except (ValueError, RecursionError) as error:
        raise LineError(f"not JSON: {error}") from None
    if not isinstance(row, dict):
        raise LineError('not a JSON object like {"id": 1, "text": "go faster"}')
    return row


def _checked(row: dict[str, Any], default: Scene) -> Scene:
    """The line's scene, once its text is known to be usable."""
    text = row.get("text")
    if not isinstance(text, str):
        raise LineError('no "text" of type string')
    if not text.strip() or len(text) > MAX_TEXT:
        raise LineError("text is empty" if not text.strip() else f"text is longer than {MAX_TEXT} characters")
    return scene_of(row["scene"]) if row.get("scene") is not None else default


def _progress(done: int, total: int) -> None:
    """total 0: as many as come."""
    of = f"/{total}" if total else ""
    if sys.stderr.isatty():
        print(f"\r{done}{of}", end="\n" if done == total else "", file=sys.stderr, flush=True)
    elif done % 100 == 0 or done == total:
        print(f"{done}{of}", file=sys.stderr, flush=True)


def batch(source: str, target: str, scene_path: Path | None, **options: Any) -> int:
    """`fastslow interpret --input --output`; "-" is stdin or stdout. Exit code."""
    try:
        default, given = read_scene(scene_path), _input(source)
    except (OSError, ValueError) as error:
        print(f"fastslow: {plain_text(str(error), 300)}", file=sys.stderr)
        return USAGE
    try:
        with given, _open(target) as out, running_interpreter(**options) as interpreter:

            def write(row: dict[str, Any]) -> None:
                out.write(json_line(row) + "\n")
                out.flush()

            done, errors = interpret_lines(lines_bounded(given, LINE_BYTES), default, interpreter, write)
    except OSError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return FAILED
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    print(f"{done} commands interpreted, {errors} errors", file=sys.stderr)
    return OK


def _input(source: str) -> IO[bytes]:
    """Opened, to be read as it comes; "-": stdin. Raises OSError, or ValueError for a path that is none."""
    return sys.stdin.buffer if source == "-" else open(source, "rb")


@contextlib.contextmanager
def _open(target: str) -> Iterator[IO[str]]:
    if target == "-":
        yield sys.stdout
        return
    with open(target, "w", encoding="utf-8") as out:
        yield out
