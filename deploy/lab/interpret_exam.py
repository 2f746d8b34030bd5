"""`fastslow interpret --score --set NAME|FILE`: commands with programs as their labels, or dialogues.

A dialogue is held with the deliberation that drives, on a road where every directive is followed at once and in full:
what is judged is what is asked for, not how it is driven.
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from deploy.lab.interpret import DEFAULT_SCENE, interpret_lines, scene_of
from deploy.lab.interpreter import running_interpreter
from schemas.runtime.clock import NS
from schemas.runtime.process import CONFIG, OK, ConfigError
from schemas.wire.messages import Command, Directive, Event, EventKind, Reply
from schemas.wire.text import json_line
from slow_node.deliberation import Deliberation
from slow_node.effects import Effect, Interpret
from slow_node.evaluation.programs import EXAMS, exam_lines, met, refusals, right, share
from slow_node.interpreter import Interpreter
from slow_node.planning.scene import Scene

TURN_S = 5.0
"""Between two turns."""


def examine(name: str, *, as_json: bool, output: str, **options: Any) -> int:
    """Score one of `EXAMS`, or a file like them. Exit code."""
    try:
        labels = exam_lines(EXAMS.get(name) or Path(name))
        with running_interpreter(**options) as interpreter:
            rows = (_dialogues if "turns" in labels[0] else _programs)(interpreter, labels)
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    kinds = {
        kind: [row["right"] for row in rows if row["kind"] == kind] for kind in dict.fromkeys(r["kind"] for r in rows)
    }
    result = {
        "schema": "fastslow.interpret-exam/1",
        "set": name,
        **share([row["right"] for row in rows]),
        "kinds": {kind: share(hits) for kind, hits in kinds.items()},
        **({} if "turns" in labels[0] else refusals(labels, rows)),
    }
    if output != "-":
        Path(output).write_text("".join(json_line(row) + "\n" for row in rows), "utf-8")
    if as_json:
        print(json.dumps(result))
        return OK
    print(_line("all", result))
    for kind, of in result["kinds"].items():
        print(_line(kind, of))
    for name in ("harmless_refused", "dangerous_directive"):
        if name in result:
            print(f"{name.replace('_', ', but '):<25}{result[name]['count']} of {result[name]['n']}")
    return OK


def _line(name: str, of: dict[str, Any]) -> str:
    low, high = (100 * bound for bound in of["right_ci95"])
    return f"{name:<14}{of['right']:>4} of {of['n']:<4} {100 * of['right'] / of['n']:5.1f} % [{low:.0f}, {high:.0f}]"


def _programs(interpreter: Interpreter, labels: list[dict[str, Any]]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    interpret_lines([json.dumps(label) for label in labels], scene_of(DEFAULT_SCENE), interpreter, found.append)
    return [
        {**row, "kind": label["kind"], "right": right(label, row)} for label, row in zip(labels, found, strict=True)
    ]


def _dialogues(interpreter: Interpreter, labels: list[dict[str, Any]]) -> list[dict[str, Any]]:
    async def run() -> list[dict[str, Any]]:
        rows = [row for dialogue in labels for row in await _held(interpreter, dialogue)]
        await interpreter.close()
        return rows

    return asyncio.run(run())


async def _held(interpreter: Interpreter, dialogue: dict[str, Any]) -> list[dict[str, Any]]:
    """The turns of one dialogue, each with what came of it."""
    deliberation, rows = Deliberation(), []
    world = {"speed": 25.0, "lane": 1, "gap": 40.0}
    for number, turn in enumerate(dialogue["turns"]):
        now_ns = round((1.0 + number * TURN_S) * NS)
        scene = _scene(world, now_ns)
        out = list(deliberation.on_scene(scene, now_ns))
        command = Command(epoch=scene.epoch, stamp_ns=now_ns, id=number + 1, text=turn["say"])
        heard = deliberation.on_command(command, now_ns)
        call = next(effect for effect in heard if isinstance(effect, Interpret))
        found = await interpreter.interpret(call.command, call.scene, call.context)
        out = list(deliberation.on_interpretation(call.id, found, now_ns))
        mine = [e for e in out if isinstance(e, Reply) and e.command_id == command.id]
        directive = next((e for e in reversed(out) if isinstance(e, Directive)), None)
        if directive is not None:
            world = _followed(world, directive)
            deliberation.on_scene(_scene(world, now_ns + NS), now_ns + NS)
            _tell_done(deliberation, directive, now_ns + NS)
        rows.append(
            {
                "id": f"{dialogue['id']}-{number + 1}",
                "kind": "first turn" if number == 0 else "follow-up",
                "text": turn["say"],
                "right": met(turn["expect"], scene, directive, mine),
                "expect": turn["expect"],
                "outcome": mine[-1].outcome if mine else "",
                "say": mine[-1].say if mine else "",
                "why": mine[-1].why if mine else "",
            }
        )
    return rows


def _tell_done(deliberation: Deliberation, directive: Directive, now_ns: int) -> list[Effect]:
    """The fast node reports that it is done; an overtaking manoeuvre takes longer than a turn."""
    if directive.manoeuvre == "overtake":
        return []
    event = Event(
        epoch=directive.epoch, stamp_ns=now_ns, kind=EventKind.FULFILLED, node="fast", tick=0, directive_id=directive.id
    )
    return deliberation.on_event(event, now_ns)


def _scene(world: dict[str, Any], now_ns: int) -> Scene:
    from dataclasses import replace

    lead = {"gap_m": world["gap"], "speed_mps": 20.0}
    scene = scene_of({**DEFAULT_SCENE, "speed_mps": world["speed"], "ego_lane": world["lane"], "vehicles": [lead]})
    return replace(scene, stamp_ns=now_ns)


def _followed(world: dict[str, Any], directive: Directive) -> dict[str, Any]:
    if directive.manoeuvre == "overtake":
        return world
    lane, speed, headway = directive.target_lane, directive.target_speed_mps, directive.headway_s
    speed = world["speed"] if speed is None else speed
    gap = world["gap"] if headway is None else headway * speed
    return {"speed": speed, "lane": world["lane"] if lane is None else lane, "gap": gap}
