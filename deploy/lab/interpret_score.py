"""`fastslow interpret --score` and `--experiment`: the labelled commands, interpreted and scored."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np

from deploy.lab.interpret import DEFAULT_SCENE, interpret_lines, scene_of
from deploy.lab.interpreter import running_interpreter
from deploy.run.processes import ModelOptions
from schemas.runtime.process import CONFIG, OK, ConfigError
from schemas.wire.text import json_line
from slow_node.evaluation.score import DEV_SET, read_lines, score, table

SETS = ("dev", "blind")
"""Labelled commands in `slow_node/evaluation`."""


def measure(gold: list[dict[str, Any]], **options: Any) -> dict[str, Any]:
    """Score an interpreter on labelled lines, with its latencies and who answered. Raises `ConfigError`."""
    rows: list[dict[str, Any]] = []
    with running_interpreter(**options) as interpreter:
        interpret_lines([json.dumps(row) for row in gold], scene_of(DEFAULT_SCENE), interpreter, rows.append)
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
        "settings": {key: options[key] for key in sorted(options) if key not in ("model", "chat_model")},
        "rows": rows,
    }


def labelled_set(name: str, per_kind: int | None = None) -> list[dict[str, Any]]:
    """The labelled commands of one of `SETS`, or so many of every kind, the same ones every time."""
    rows = read_lines(DEV_SET.with_name(f"{name}.jsonl"))
    if per_kind is None:
        return rows
    draw = random.Random(0)
    kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in dict.fromkeys(row["kind"] for row in rows)}
    return [row for of_kind in kinds.values() for row in draw.sample(of_kind, min(per_kind, len(of_kind)))]


def score_set(name: str, *, as_json: bool, per_kind: int | None, output: str, **options: Any) -> int:
    """`fastslow interpret --score`. Exit code."""
    try:
        result = measure(labelled_set(name, per_kind), **options)
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    rows = result.pop("rows")
    if output != "-":
        Path(output).write_text("".join(json_line(row) + "\n" for row in rows), "utf-8")
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
                gold,
                ask="always",
                parser=False,
                k=k,
                empty_bank=empty,
                threads=threads,
                adapter=adapter,
                model=ModelOptions(budget_s=60.0),
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
