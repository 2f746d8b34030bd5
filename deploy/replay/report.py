"""`fastslow replay --check`: the comparison, as JSON or as a table."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import msgspec

from deploy.record.container import McapFile
from deploy.record.reader import NotARecordingError, Recording, open_recording
from deploy.record.recorder import digest_of
from deploy.replay.check import Comparison, NodeFactory, check_fast, check_world
from deploy.replay.driver import Disagreement, compare_driver
from deploy.replay.slow import check_slow
from deploy.replay.tape import Tape
from fast_node.config import FastConfig
from fast_node.mask import PRESETS
from fast_node.mask.vocabulary import VERSION as MASK_VERSION
from fast_node.node import FastNode
from fast_node.policies.load import load_policy
from schemas.runtime.process import FAILED, OK, ConfigError
from sim_node.config import SimConfig
from slow_node.config import SlowConfig

SCHEMA = "fastslow.replay/1"


def load(path: Path) -> Recording:
    """The recording in `path`. Raises `ConfigError` where there is none."""
    try:
        return open_recording(path)
    except (OSError, NotARecordingError) as error:
        raise ConfigError(f"no recording to read at {path}: {error}") from None


def complete(recording: Recording) -> None:
    """Write the summary of a recording that has none. Raises `ConfigError` if it cannot be, or is still written."""
    if recording.finished:
        return
    try:
        McapFile(recording.path).finish()
    except BlockingIOError:
        raise ConfigError(f"{recording.path} is still being recorded") from None
    except OSError as error:
        raise ConfigError(f"cannot finish {recording.path}: {error.strerror}") from None


def replay_check(path: Path, *, as_json: bool) -> int:
    """Print how much of a recording comes out again; `FAILED` unless all that could be checked does."""
    recording = load(path)
    tape = Tape.of(recording)
    for line in warnings(recording):
        print(f"fastslow: {line}", file=sys.stderr)
    actions, events = check_fast(tape, node_factory(recording))
    directives, replies = check_slow(tape, told(recording, "slow", SlowConfig).budget_s)
    found = {
        "actions": actions,
        "events": events,
        "directives": directives,
        "replies": replies,
        "observations": check_world(tape, told(recording, "sim", SimConfig)),
    }
    first = next((c.first_difference for c in found.values() if c.first_difference), None)
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "file": str(path),
        "ticks": len(tape.observations),
        **{f"{name}_identical": 100.0 * c.share for name, c in found.items()},
        "checked": {name: c.checked for name, c in found.items()},
        "unchecked": {name: c.unchecked for name, c in found.items()},
        "first_difference": first,
    }
    print(json.dumps(result, default=repr) if as_json else "\n".join(_lines(found, result["ticks"], first)))
    return OK if all(c.identical == c.checked for c in found.values()) else FAILED


def _lines(found: dict[str, Comparison], ticks: int, first: dict[str, Any] | None) -> list[str]:
    lines = [f"{ticks} ticks"]
    for name, one in found.items():
        left = f", {one.unchecked} not checked: their inputs are not recorded" if one.unchecked else ""
        lines.append(f"{name:<13} {one.identical} of {one.checked} identical ({100.0 * one.share:.5g} %){left}")
    if first is not None:
        lines.append(f"first difference, at tick {first['tick']} of epoch {first['epoch']}:")
        lines += [f"  recorded {first['recorded']}", f"  again    {first['again']}"]
    return lines


def replay_other(path: Path, *, policy: str | None, mask_preset: str | None, as_json: bool) -> int:
    """Print where another policy, or the same behind another mask, would have decided otherwise."""
    recording = load(path)
    if mask_preset is not None and mask_preset not in PRESETS:
        raise ValueError(f"--mask-preset {mask_preset}: choose from {', '.join(PRESETS)}")
    found = compare_driver(Tape.of(recording), node_factory(recording, policy, mask_preset))
    result = {
        "schema": SCHEMA,
        "file": str(path),
        "policy": policy or recording.metadata.get("policy", "fastslow"),
        "mask_preset": mask_preset,
        "ticks": found.ticks,
        "otherwise": found.otherwise,
        "table": [{"recorded": a, "other": b, "ticks": n} for (a, b), n in found.table.most_common()],
        "first": found.first,
    }
    print(json.dumps(result) if as_json else "\n".join(_otherwise(found)))
    return OK


def _otherwise(found: Disagreement) -> list[str]:
    lines = [f"otherwise at {found.otherwise} of {found.ticks} ticks"]
    if found.otherwise:
        lines += ["", f"{'recorded':<16} {'other':<16} ticks"]
        lines += [f"{recorded:<16} {other:<16} {ticks}" for (recorded, other), ticks in found.table.most_common()]
        lines += ["", "the first of them:"]
        lines += [
            f"tick {one['tick']:>6}  {one['recorded']} ({one['recorded_by']}), other {one['other']} ({one['other_by']})"
            for one in found.first
        ]
    return lines


def node_factory(recording: Recording, policy: str | None = None, mask_preset: str | None = None) -> NodeFactory:
    """What makes fast nodes as the recorded one was, but for `policy` and `mask_preset`.

    Each gets a policy of its own, since one may remember. Raises `ConfigError` for one that cannot be loaded.
    """
    config = told(recording, "fast", FastConfig)
    spec = policy or config.policy
    load_policy(spec)

    def make() -> FastNode:
        loaded = load_policy(spec)
        return FastNode(config, loaded, PRESETS[mask_preset or loaded.mask_preset], stateless=loaded.stateless)

    return make


def told(recording: Recording, node: str, kind: type[Any]) -> Any:
    """The configuration that a node of the run had. Raises `ConfigError` where it is not in the recording."""
    try:
        return msgspec.json.decode(recording.metadata[node], type=kind)
    except (KeyError, ValueError) as error:
        raise ConfigError(f"{recording.path} does not say how its {node} node was configured: {error!r}") from None


def warnings(recording: Recording) -> list[str]:
    """What is not as it was when the run was recorded; differences may come from it."""
    about = recording.metadata
    found = []
    if about.get("mask") != MASK_VERSION:
        found.append(f"recorded behind {about.get('mask')}, this code has {MASK_VERSION}")
    policy = about.get("policy", "")
    if about.get("policy_sha256", "") != digest_of(policy):
        found.append(f"the policy {policy} is not the recorded one: its checkpoint differs")
    return found
