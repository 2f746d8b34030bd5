"""`fastslow interpret --experiment mind`: the quick reader alone, the language model alone, and both as they ship, on
the same commands."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from deploy.lab.cached_model import kept_in
from deploy.lab.interpret_score import labelled_set, measure
from deploy.run.processes import ModelOptions
from schemas.runtime.process import CONFIG, OK, ConfigError
from slow_node.evaluation.score import exact, wilson95
from slow_node.verdict import ACTS

SCHEMA = "fastslow.mind-experiment/1"
WAYS: dict[str, dict[str, Any]] = {
    "reader": {"ask": "never"},
    "model": {"ask": "always", "parser": False},
    "both": {"ask": "always"},
}
BUDGET_S = 60.0


def mind_experiment(folder: Path, *, as_json: bool, per_kind: int | None, threads: int) -> int:
    """Score the three. The model's answers are kept in `folder`, so that a run that was stopped goes on. Exit code."""
    gold = labelled_set("dev", per_kind)
    scores: dict[str, dict[str, Any]] = {}
    for name, options in WAYS.items():
        print(name, file=sys.stderr)
        kept = kept_in(folder / "answers.jsonl")
        try:
            model = ModelOptions(budget_s=BUDGET_S, embedded=True)
            needed = options["ask"] != "never"
            scores[name] = measure(gold, **options, threads=threads, model=model, chat_model=kept, needs_model=needed)
        except ConfigError as error:
            print(f"fastslow: {error}", file=sys.stderr)
            return CONFIG
    rows = {name: scores[name].pop("rows") for name in scores}
    both = rows["both"]
    result = {
        "schema": SCHEMA,
        "n": len(gold),
        "scores": scores,
        "asked": sum(row["model_asked"] for row in both),
        "decided": sum(row["model_decided"] for row in both),
        "acted": sum(row["confidence"] >= ACTS for row in both),
        "verdicts": {
            name: sum(row["verdict"] == name for row in both) for name in sorted({r["verdict"] for r in both})
        },
        "differ": _differ(gold, rows),
    }
    if as_json:
        print(json.dumps(result))
        return OK
    print("\n".join(_lines(result)))
    return OK


def _differ(gold: list[dict[str, Any]], rows: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Where reader and model alone are not both right or both wrong: who is right."""
    pairs = [
        (exact(g, reader), exact(g, model), reader["outcome"] == "refused")
        for g, reader, model in zip(gold, rows["reader"], rows["model"], strict=True)
    ]
    return {
        "reader_right": sum(a and not b for a, b, _ in pairs),
        "model_right": sum(b and not a for a, b, _ in pairs),
        "model_right_against_a_refusal": sum(b and not a and refused for a, b, refused in pairs),
    }


def _lines(result: dict[str, Any]) -> list[str]:
    scores = result["scores"]
    found = [f"{'exact match %':<16}{'n':>5}" + "".join(f"{name:>20}" for name in scores)]
    kinds = {"all": None, **dict.fromkeys(scores["reader"]["kinds"])}
    for kind in kinds:
        cells = []
        for of in scores.values():
            one = of if kind == "all" else of["kinds"][kind]
            low, high = (100 * bound for bound in one["exact_ci95"])
            cells.append(f"{100 * one['exact']:>10.1f} ({low:.0f}-{high:.0f})")
        n = result["n"] if kind == "all" else scores["reader"]["kinds"][kind]["n"]
        found.append(f"{kind:<16}{n:>5}" + "".join(f"{cell:>20}" for cell in cells))
    differ = result["differ"]
    found.append(
        f"where one of the two alone is right: the reader {differ['reader_right']}, the model {differ['model_right']}"
    )
    shares = [f"{name or 'nothing'} {n}" for name, n in result["verdicts"].items()]
    low, high = (100 * bound for bound in wilson95(result["decided"], result["n"]))
    found.append(f"asked {result['asked']}, decides {result['decided']} ({low:.0f}-{high:.0f} %): {', '.join(shares)}")
    return found
