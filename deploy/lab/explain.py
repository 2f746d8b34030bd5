"""`fastslow interpret --explain`: one command, with all that led to what the car makes of it."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from deploy.lab.interpret import interpret, read_scene
from deploy.lab.interpreter import running_interpreter
from deploy.record.thoughts import Kept, worded
from schemas.runtime.process import CONFIG, FAILED, OK, USAGE, ConfigError
from schemas.wire.text import plain
from slow_node.interpreter import Interpreter
from slow_node.planning.scene import Scene
from slow_node.thought import Trace, thought_of


def explain(text: str, scene_path: Path | None, *, as_json: bool, full: bool, **options: Any) -> int:
    """Print the thought about one command, and what comes of it. Exit code."""
    try:
        scene = read_scene(scene_path)
    except ValueError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return USAGE
    trace = Trace()
    try:
        with running_interpreter(**options) as interpreter:
            row = asyncio.run(_interpreted(interpreter, text, scene, trace))
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    if row.get("why"):
        trace.guards.append(row["why"])
    thought = thought_of(
        trace,
        epoch=0,
        stamp_ns=time.monotonic_ns(),
        command_id=0,
        command=text,
        source=row["model"],
        outcome=row["outcome"],
        slots=None,
    )
    meant = {name: value for name, value in row["slots"].items() if value not in (None, False)}
    meant |= {"steps": row["steps"]} if row["steps"] else {}
    kept = Kept(datetime.now(UTC).isoformat(timespec="milliseconds"), replace(thought, slots=json.dumps(meant)))
    if as_json:
        thinking = {"time": kept.time, **msgspec.to_builtins(kept.thought)}
        print(json.dumps({"schema": "fastslow.explain/1", "thought": thinking, "result": row}))
    else:
        said = plain(row["say"])
        print("\n".join([*worded(kept, full=full), *([f"  {'says':<10} {said}"] if said else [])]))
    return FAILED if row["outcome"] == "error" else OK


async def _interpreted(interpreter: Interpreter, text: str, scene: Scene, trace: Trace) -> dict[str, Any]:
    try:
        return await interpret(interpreter, text, scene, trace)
    finally:
        await interpreter.close()
