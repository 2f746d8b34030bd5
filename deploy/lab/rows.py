"""A row of `fastslow evaluate` as a task of its own: one driver on one road over many seeds. Rows are driven side by
side, and kept on disk, so that an evaluation that was interrupted goes on."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from deploy.lab.agents import LANGUAGE, Agent, behind_the_mask, drive
from deploy.lab.episodes import Directive
from deploy.lab.farm import Farm, code_digest
from deploy.lab.files import whole_lines
from deploy.lab.language_driver import drive_dilu, memory, running_model
from deploy.lab.orders import BEST, best_order
from fast_node.policies.load import BUILT_IN
from sim_node.results import EpisodeResult
from sim_node.scenarios import Scenario

_ROW = b'{"cell": '
"""How a line of a file of `Kept` begins."""
Driven = tuple[list[EpisodeResult], dict[str, Any]]
"""An episode for every seed, and what else there is to say: the order that was best, what the language model did."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A row before it is driven."""

    agent: str
    """Of `AGENTS`, of `LANGUAGE` or `BEST`; a policy as `load_policy` takes it where `is_policy`."""
    is_policy: bool
    scenario: Scenario
    seeds: range
    wish_mps: float | None
    directive: Directive
    checkpoint: Path | None
    conditions: Mapping[str, Any]
    """The rest of what `drive` takes."""

    @property
    def place(self) -> dict[str, Any]:
        """Who drives where, for its episodes."""
        return {
            "scenario": self.scenario.name,
            "agent": self.agent,
            "wish_mps": self.wish_mps,
            "directive": self.directive,
        }

    @property
    def asks_a_model(self) -> bool:
        return self.agent in LANGUAGE and not self.is_policy

    def again(self, more: Mapping[str, Any]) -> Callable[..., list[EpisodeResult]]:
        """Drives all of it, with a `watch` if one is given. more: as `drive_cell` has found it."""
        who: str | Agent = behind_the_mask(self.agent) if self.is_policy else self.agent
        if self.agent == BEST:
            who = behind_the_mask(more["order"])
        return partial(
            drive,
            who,
            self.scenario,
            self.seeds,
            checkpoint=self.checkpoint,
            wish_mps=self.wish_mps,
            directive=self.directive,
            **self.conditions,
        )


def drive_cell(cell: Cell) -> Driven:
    """All episodes of a row. Raises as `drive` does."""
    if cell.asks_a_model:
        return _drive_language(cell)
    more: dict[str, Any] = {}
    if cell.agent == BEST:
        order = best_order(cell.scenario, wish_mps=cell.wish_mps, directive=cell.directive, **cell.conditions)
        more["order"] = order
    return cell.again(more)(), more


def _drive_language(cell: Cell) -> Driven:
    if cell.directive != "hurry" or cell.wish_mps is not None:
        raise ValueError(f"{cell.agent} knows no directive but hurry, and no other speed to wish for")
    with running_model() as ask:
        results, metrics = drive_dilu(
            cell.scenario, cell.seeds, paused=cell.agent == "dilu-paused", ask=ask, bank=memory()
        )
    return results, {"llm": metrics.summary()}


def driven(cells: Sequence[Cell], farm: Farm, kept: Kept, progress: Callable[[str], None]) -> Iterator[Driven]:
    """What came of each cell, in order. Those that are not kept yet are driven on `farm`, and kept; whoever asks a
    language model, here: the model has this machine to itself."""
    results = {k: found for k, cell in enumerate(cells) if (found := kept.of(cell)) is not None}
    if results:
        progress(f"{len(results)} of {len(cells)} rows were driven before")
    todo = [k for k in range(len(cells)) if k not in results]
    away = [k for k in todo if not cells[k].asks_a_model]
    began_s, done = time.monotonic(), 0

    def tell(cell: Cell) -> None:
        wish = "" if cell.wish_mps is None else f", {cell.wish_mps:g} m/s wished"
        left_s = (time.monotonic() - began_s) / done * (len(todo) - done)
        progress(f"[{done}/{len(todo)}] {cell.agent} on {cell.scenario.name}{wish}; some {left_s:.0f} s left")

    def keep(k: int, found: Driven) -> None:
        nonlocal done
        done += 1
        results[k] = found
        kept.add(cells[k], found)
        tell(cells[k])

    for place, found in farm.run(drive_cell, [(cells[k],) for k in away]):
        keep(away[place], found)
    for k in todo:
        if k not in results:
            keep(k, drive_cell(cells[k]))
    return (results[k] for k in range(len(cells)))


class Kept:
    """A file with a row on each line. Rows of another state of the code or the weights do not count. What a policy of
    somebody else's code, or a language model, has driven is not kept: nobody knows whether it is the same."""

    def __init__(self, path: Path | None) -> None:
        """path: None: nothing is kept. Raises `ConfigError` for a file that cannot be used."""
        self._path = path
        self._rows: dict[str, Driven] = {}
        if path is None:
            return
        self._code = code_digest()
        self._rows = dict(whole_lines(path, _ROW, _driven))

    def of(self, cell: Cell) -> Driven | None:
        """What came of a cell, if it is kept."""
        return self._rows.get(self._name(cell)) if self._path and is_kept(cell) else None

    def add(self, cell: Cell, found: Driven) -> None:
        """Keep it; it is on the disk's side when this returns."""
        if self._path is None or not is_kept(cell):
            return
        results, more = found
        row = {"cell": self._name(cell), "episodes": [_plain(asdict(r)) for r in results], "more": more}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")

    def _name(self, cell: Cell) -> str:
        """Readable at its head; its tail is different for whatever might make its episodes different."""
        parts = [self._code, *(f"{f.name}={getattr(cell, f.name)!r}" for f in dataclasses.fields(cell))]
        named = (cell.agent, cell.agent.partition(":")[2]) if cell.is_policy else ()
        for path in (cell.checkpoint, *map(Path, named)):
            if path is not None and path.is_file():
                files = (path, path.with_suffix(".json"))
                parts += [hashlib.sha256(p.read_bytes()).hexdigest() for p in files if p.is_file()]
        tail = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
        return f"{cell.agent} on {cell.scenario.name}, {cell.seeds}, {tail}"


def is_kept(cell: Cell) -> bool:
    """Whether who drives is known to the last bit: by a name of ours, or by a file of weights."""
    name = cell.agent.partition(":")[0]
    return not cell.asks_a_model and (not cell.is_policy or name in BUILT_IN or Path(cell.agent).is_file())


def _driven(line: bytes) -> tuple[str, Driven]:
    """A row of the file: its cell's name, and what came of that."""
    row = json.loads(line)
    return row["cell"], ([EpisodeResult(**_read(e)) for e in row["episodes"]], row["more"])


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """JSON has no infinite numbers: they become words."""
    return {k: str(v) if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def _read(values: dict[str, Any]) -> dict[str, Any]:
    return {k: float(v) if isinstance(v, str) else v for k, v in values.items()}
