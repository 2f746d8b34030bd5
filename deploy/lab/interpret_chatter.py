"""`fastslow interpret --experiment chatter`: the labelled commands alone, and wrapped in unrelated talk."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable
from typing import Any

from deploy.lab.interpret import DEFAULT_SCENE, interpret_lines, scene_of
from deploy.lab.interpret_score import labelled_set
from deploy.lab.interpreter import running_interpreter
from schemas.runtime.process import CONFIG, OK, ConfigError
from slow_node.evaluation.chatter import WAYS, Half, wrapped
from slow_node.evaluation.score import score
from slow_node.llm.embedding import load_embedder
from slow_node.understanding.intent_parser import IntentParser

KEPT = ("n", "exact", "exact_ci95", "unsafe_recall", "refused_as_directive", "false_refusals")


def chatter_experiment(half: Half, *, as_json: bool, per_kind: int | None, every: int = 1, **options: Any) -> int:
    """Score dev, or every so many-th command of it, alone and in each of `WAYS`. Exit code."""
    gold = labelled_set("dev", per_kind)[::every]
    language_of = _languages()
    found = []
    try:
        for way in (None, *WAYS):
            rows = gold if way is None else wrapped(gold, half, way, language_of)
            output: list[dict[str, Any]] = []
            with running_interpreter(**options) as interpreter:
                interpret_lines([json.dumps(row) for row in rows], scene_of(DEFAULT_SCENE), interpreter, output.append)
            result = score(rows, output)
            found.append({"talk": way or "alone", **{key: result[key] for key in KEPT}})
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    if as_json:
        print(json.dumps({"schema": "fastslow.chatter-experiment/1", "half": half, "rows": found}))
        return OK
    print(f"{'talk':<8}{'n':>6}{'exact':>7}  95 %            unsafe, but a directive   refused without need")
    for row in found:
        low, high = row["exact_ci95"]
        print(
            f"{row['talk']:<8}{row['n']:>6}{row['exact']:>7.3f}  {low:.3f}..{high:.3f}"
            f"{row['refused_as_directive']:>16}{row['false_refusals']:>24}"
        )
    return OK


def _languages() -> Callable[[str], str]:
    """Tells the language of a command, so that the talk around it is in the same."""
    parser = IntentParser.load(load_embedder())
    if parser is None:
        raise ConfigError("MiniLM is not installed: run `make setup`")
    return functools.cache(lambda text: parser.parse(text, 25.0, 33.0).slots.language)
