"""`fastslow interpret`: commands in, directives out, by the code that drives, without driving."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from deploy.run.launch import Launched
from deploy.run.model_server import embedded_server
from deploy.run.processes import choose_model
from schemas.runtime.process import CONFIG, FAILED, OK, USAGE, ConfigError
from schemas.wire.messages import Lane, Observation
from slow_node.config import SlowConfig
from slow_node.node import build_thinker
from slow_node.planning.directive import Plan, Refusal, plan_of
from slow_node.planning.scene import Scene, encode_scene
from slow_node.thinking import Thinker
from slow_node.understanding.slots import Slots

DEFAULT_SCENE: dict[str, Any] = {
    "lanes": 4,
    "ego_lane": 1,
    "speed_mps": 25.0,
    "limit_mps": 33.0,
    "vehicles": [{"gap_m": 40.0, "speed_mps": 20.0}],
}
SCENE_KEYS = {"scenario", "lanes", "ego_lane", "speed_mps", "limit_mps", "vehicles", "lead"}
VEHICLE_M = 5.0
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
SETS = ("dev", "blind")
"""Labelled commands in `slow_node/evaluation`."""

Ask = Literal["auto", "always", "unsure", "never"]


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
        rows = [(0, 0.0, 4.0 * ego, float(merged["speed_mps"]), 0, 0, VEHICLE_M, 2, ego)]
        for number, other in enumerate(vehicles, 1):
            lane, gap = int(other.get("lane", ego)), float(other["gap_m"])
            x = gap + VEHICLE_M if gap >= 0 else gap - VEHICLE_M
            rows.append((number, x, 4.0 * lane, float(other["speed_mps"]), 0, 0, VEHICLE_M, 2, lane))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, LineError):
            raise
        raise LineError(f"scene: {type(error).__name__}: {error}") from None
    return encode_scene(
        Observation(
            epoch=0,
            stamp_ns=time.monotonic_ns(),
            tick=0,
            scenario=str(merged.get("scenario", "highway")),
            lanes=lanes,
            rows=np.array(rows, np.float32).tobytes(),
            target_lane=ego,
        )
    )


async def interpret(thinker: Thinker, text: str, scene: Scene) -> dict[str, Any]:
    """One command's outcome, as an output line without its id."""
    began = time.perf_counter()
    verdict = await thinker.think(text, scene)
    slots = verdict.slots or Slots(outcome="unclear")
    plan: Plan | Refusal = plan_of(slots, scene)
    latency = time.perf_counter() - began
    outcome: str = "directive" if isinstance(plan, Plan) else plan.outcome
    if verdict.slots is None and not verdict.model_answered:
        outcome = "error"
    return {
        "text": text,
        "outcome": outcome,
        "directive": _directive(plan) if isinstance(plan, Plan) else None,
        "slots": slots.labelled(scene.limit_mps) if outcome == "directive" else dict(NO_SLOTS),
        "say": plan.say,
        "reasoning": slots.reasoning or verdict.why,
        "latency_s": round(latency, 4),
        "model": verdict.source,
        "retrieved": [{"command": e.command, "cosine": round(e.cosine, 3)} for e in verdict.nearest],
        **({"why": verdict.why} if verdict.why else {}),
    }


def _directive(plan: Plan) -> dict[str, Any]:
    return {
        "manoeuvre": plan.manoeuvre,
        "target_lane": plan.target_lane,
        "target_speed_mps": plan.target_speed_mps,
        "headway_s": plan.headway_s,
        "style": plan.style,
    }


@contextlib.contextmanager
def running_thinker(
    *,
    ask: Ask = "auto",
    k: int = 4,
    reader: bool = True,
    empty_bank: bool = False,
    threads: int = 1,
    adapter: bool = True,
    memory_path: str = "",
    budget_s: float = 8.0,
) -> Iterator[Thinker]:
    """A thinker and, where it may ask it, the embedded model's process. Raises `ConfigError`."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that the model ends with us
    model = choose_model()
    server: Launched | None = None
    try:
        if model.embedded and ask != "never":
            server = embedded_server(model.port, threads, adapter=adapter)
            if server is None:
                print("fastslow: the embedded model did not start; the reader answers alone", file=sys.stderr)
                ask = "never"
        thinker, memory, _ = build_thinker(
            SlowConfig(
                base_url=model.base_url,
                model=model.name,
                embedded=model.embedded,
                memory_path=memory_path,
                ask=ask,
                k=k,
                reader=reader,
                seeds=not empty_bank,
                adapter=adapter,
                budget_s=budget_s,
            )
        )
        try:
            yield thinker
        finally:
            memory.close()
    finally:
        if server is not None:
            server.end()
        signal.signal(signal.SIGTERM, before)


def interpret_lines(
    lines: list[str], default: Scene, thinker: Thinker, write: Callable[[dict[str, Any]], None]
) -> tuple[int, int]:
    """Interpret input lines one by one; every non-empty line yields one output line. Commands and errors counted."""

    async def run() -> tuple[int, int]:
        done = errors = 0
        for number, line in enumerate(lines, 1):
            if not line.strip():
                continue
            identity: object = f"line-{number}"
            text = ""
            try:
                row = _row(line)
                identity = row.get("id", identity)
                text = row["text"] if isinstance(row.get("text"), str) else ""
                scene = _checked(row, default)
                result = await interpret(thinker, text, scene)
            except Exception as error:  # nothing is lost: the line's place in the output says what happened
                result = {
                    "text": text,
                    "outcome": "error",
                    "directive": None,
                    "slots": dict(NO_SLOTS),
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
            _progress(done, len(lines))
        return done, errors

    return asyncio.run(run())


def _row(line: str) -> dict[str, Any]:
    try:
        row = json.loads(line)
    except ValueError as error:
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
    if sys.stderr.isatty():
        print(f"\r{done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)
    elif done % 100 == 0 or done == total:
        print(f"{done}/{total}", file=sys.stderr, flush=True)


def batch(source: str, target: str, scene_path: Path | None, **options: Any) -> int:
    """`fastslow interpret --input --output`; "-" is stdin or stdout. Exit code."""
    try:
        lines = (
            (sys.stdin.buffer.read() if source == "-" else Path(source).read_bytes())
            .decode("utf-8", errors="replace")
            .splitlines()
        )
        default = scene_of(json.loads(scene_path.read_text("utf-8")) if scene_path else DEFAULT_SCENE)
    except (OSError, ValueError) as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return USAGE
    try:
        with _open(target) as out, running_thinker(**options) as thinker:

            def write(row: dict[str, Any]) -> None:
                out.write(json.dumps(row, ensure_ascii=False) + "\n")
                out.flush()

            done, errors = interpret_lines(lines, default, thinker, write)
    except OSError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return FAILED
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    print(f"{done} commands interpreted, {errors} errors", file=sys.stderr)
    return OK


@contextlib.contextmanager
def _open(target: str) -> Iterator[IO[str]]:
    if target == "-":
        yield sys.stdout
        return
    with open(target, "w", encoding="utf-8") as out:
        yield out


def measure(gold: list[dict[str, Any]], **options: Any) -> dict[str, Any]:
    """Score an interpreter on labelled lines, with its latencies and who answered. Raises `ConfigError`."""
    from slow_node.evaluation.score import score

    rows: list[dict[str, Any]] = []
    with running_thinker(**options) as thinker:
        interpret_lines([json.dumps(row) for row in gold], scene_of(DEFAULT_SCENE), thinker, rows.append)
    latencies = np.array([row["latency_s"] for row in rows])
    answered = {str(row["model"]) for row in rows}
    return {
        **score(gold, rows),
        "latency_s": {
            "p50": float(np.percentile(latencies, 50)),
            "p95": float(np.percentile(latencies, 95)),
            "max": float(latencies.max()),
        },
        "answered_by": {name: sum(row["model"] == name for row in rows) for name in sorted(answered)},
        "settings": {key: options[key] for key in sorted(options)},
        "rows": rows,
    }


def labelled_set(name: str, per_kind: int | None = None) -> list[dict[str, Any]]:
    """The labelled commands of one of `SETS`, or so many of every kind, the same ones every time."""
    from slow_node.evaluation.score import DEV_SET, read_lines

    rows = read_lines(DEV_SET.with_name(f"{name}.jsonl"))
    if per_kind is None:
        return rows
    draw = random.Random(0)
    kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in dict.fromkeys(row["kind"] for row in rows)}
    return [row for of_kind in kinds.values() for row in draw.sample(of_kind, min(per_kind, len(of_kind)))]


def score_set(name: str, *, as_json: bool, per_kind: int | None, output: str, **options: Any) -> int:
    """`fastslow interpret --score`. Exit code."""
    from slow_node.evaluation.score import table

    try:
        result = measure(labelled_set(name, per_kind), **options)
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    rows = result.pop("rows")
    if output != "-":
        Path(output).write_text("".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows), "utf-8")
    if as_json:
        print(json.dumps(result))
    else:
        times = result["latency_s"]
        print(table(result))
        print(f"\nlatency p50 {times['p50']:.3f} s, p95 {times['p95']:.3f} s; answered by {result['answered_by']}")
    return OK


MEMORIES = (
    ("k = 0", 0, False, False),
    ("k = 2", 2, False, False),
    ("k = 4", 4, False, False),
    ("k = 4, empty bank", 4, True, False),
    ("its adapter, k = 0", 0, False, True),
)


def memory_experiment(*, as_json: bool, per_kind: int | None, threads: int) -> int:
    """The language model alone, behind the rules: with 0, 2, 4 recalled examples, an empty bank, and its adapter, which
    has learnt to do without examples. Exit code."""
    gold = labelled_set("dev", per_kind)
    found = []
    for name, k, empty, adapter in MEMORIES:
        print(name, file=sys.stderr)
        try:
            result = measure(
                gold, ask="always", reader=False, k=k, empty_bank=empty, threads=threads, adapter=adapter, budget_s=60.0
            )
        except ConfigError as error:
            print(f"fastslow: {error}", file=sys.stderr)
            return CONFIG
        found.append(
            {
                "memory": name,
                **{
                    key: result[key]
                    for key in (
                        "n",
                        "exact",
                        "exact_ci95",
                        "outcome_right",
                        "outcome_right_ci95",
                        "slot_f1",
                        "slot_f1_ci95",
                        "unsafe_recall",
                        "errors",
                        "answered_by",
                        "latency_s",
                    )
                },
            }
        )
    if as_json:
        print(json.dumps({"schema": "fastslow.memory-experiment/1", "rows": found}))
        return OK
    print(f"{'memory':<20}{'n':>4}{'exact':>7}  {'95 %':<15}{'slot F1':>8}  {'95 %':<15}{'p50 s':>6}")
    for row in found:
        f1 = "-" if row["slot_f1"] is None else f"{row['slot_f1']:.3f}"
        print(
            f"{row['memory']:<20}{row['n']:>4}{row['exact']:>7.3f}  {_range(row['exact_ci95']):<15}{f1:>8}"
            f"  {_range(row['slot_f1_ci95']):<15}{row['latency_s']['p50']:>6.2f}"
        )
    return OK


def _range(interval: list[float] | None) -> str:
    return "" if interval is None else "{:.3f}..{:.3f}".format(*interval)
