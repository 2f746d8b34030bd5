"""What a report is made of: recordings, tables of `evaluate`, studies and latency benchmarks, told apart by content,
rows by their suffix."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from deploy.bench import latency_results
from deploy.lab.evaluate import SCHEMA as EVALUATE
from deploy.lab.statistics import wilson95
from deploy.lab.study.matrix import SCHEMA as STUDY
from deploy.record.container import MAGIC
from deploy.record.moments import length_s
from deploy.record.reader import Recording
from deploy.replay.report import load
from deploy.run.processes import RECORDING
from schemas.runtime.process import ConfigError
from sim_node.results import ride_interval

IN_FOLDER = (RECORDING, "study.json", "latency.json")
"""What is looked for in a folder."""
KNOWN = (
    "a recording, what `evaluate --json` or `--rows` has written, a study.json, or a latency.json of `bench latency`"
)


@dataclass(frozen=True)
class Successes:
    """How often one driver succeeded on one road."""

    road: str
    driver: str
    episodes: int
    success: float
    low: float
    high: float
    """95 % Wilson interval."""
    ride: tuple[float, float, float] | None = None
    """Ride score with its 95 % interval; a study has none."""
    own_fault: int | None = None
    """Collisions."""
    source: str = field(default="", compare=False)
    """The file's name: the same episodes as JSON and as rows are one."""


@dataclass
class Inputs:
    """All that was given, by kind."""

    about: list[tuple[str, str]] = field(default_factory=list)
    """(file, what it is)."""
    recordings: list[Recording] = field(default_factory=list)
    successes: list[Successes] = field(default_factory=list)
    """Of evaluations."""
    learnt: list[Successes] = field(default_factory=list)
    """Of studies, right after their training."""
    studies: list[list[dict[str, Any]]] = field(default_factory=list)
    """The cells of each."""
    latencies: list[tuple[str, dict[str, Any]]] = field(default_factory=list)


def read(runs: Sequence[Path]) -> Inputs:
    """Read files, and folders of runs. Raises `ConfigError` for what is missing, damaged or something else."""
    inputs = Inputs()
    for path in (file for run in runs for file in _files(run)):
        try:
            with path.open("rb") as file:
                head = file.read(len(MAGIC))
            if head == MAGIC:
                about = _recording(path, inputs)
            elif path.suffix == ".csv":
                about = _rows(path, inputs)
            else:
                about = _result(path, inputs)
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}") from None
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise ConfigError(f"{path} is none of: {KNOWN} ({error!r})") from None
        inputs.about.append((str(path), about))
    inputs.successes = _told_apart(inputs.successes)
    inputs.learnt = _told_apart(inputs.learnt)
    return inputs


def _told_apart(found: Sequence[Successes]) -> list[Successes]:
    """Each once; of one driver on one road in several files, each with its file's name."""
    once = list(dict.fromkeys(found))
    times = Counter((one.road, one.driver) for one in once)
    return [
        replace(one, driver=f"{one.driver} ({one.source})") if times[one.road, one.driver] > 1 else one for one in once
    ]


def name_of(recording: Recording) -> str:
    """A recording's for people: its own, or its run's folder's."""
    path = recording.path
    return path.absolute().parent.name if path.name == RECORDING else path.stem


def _files(run: Path) -> Iterable[Path]:
    if not run.is_dir():
        return [run]
    found = [run / name for name in IN_FOLDER if (run / name).is_file()]
    if not found:
        raise ConfigError(f"{run} holds none of {', '.join(IN_FOLDER)}: name a file")
    return found


def _recording(path: Path, inputs: Inputs) -> str:
    recording = load(path)
    seconds = length_s(recording)
    inputs.recordings.append(recording)
    about = recording.metadata
    whole = "" if recording.finished else ", cut off"
    told = [f"{name} {about[name]}" for name in ("seed", "policy") if about.get(name)]
    road = about.get("scenario", "an unknown road")
    return f"recording of {seconds:.0f} s on {road}{whole}: {', '.join([*told, about.get('mask', '')]).strip(', ')}"


def _rows(path: Path, inputs: Inputs) -> str:
    with path.open(newline="", encoding="utf-8") as file:
        episodes = list(csv.DictReader(file))
    groups: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in episodes:
        groups.setdefault((row["scenario"], _driver(row["agent"], row["wish_mps"] or None)), []).append(row)
    for (road, driver), some in groups.items():
        good, n = sum(row["success"] == "True" for row in some), len(some)
        fault = sum(row["collided"] == "True" and row["struck"] != "True" for row in some)
        low, high = wilson95(good, n)
        ride = _rounded(ride_interval([float(row["ride_score"]) for row in some]))
        inputs.successes.append(Successes(road, driver, n, good / n, low, high, ride, fault, path.name))
    if not groups:
        raise ValueError("it has no rows")
    return f"{len(episodes)} episodes, a row each"


def _result(path: Path, inputs: Inputs) -> str:
    result = json.loads(path.read_text(encoding="utf-8"))
    schema = result.get("schema")
    if schema == EVALUATE:
        for row in result["rows"]:
            low, high = row["success_ci95"]
            ride = _rounded([row[name] for name in ("ride_score", "ride_score_low", "ride_score_high")])
            who, fault = _driver(row["agent"], row["wish_mps"]), row["ego_fault_collisions"]
            inputs.successes.append(
                Successes(row["scenario"], who, row["episodes"], row["success"], low, high, ride, fault, path.name)
            )
        return f"evaluation of {len(result['rows'])} rows, {result['rows'][0]['episodes']} episodes each"
    if schema == STUDY:
        inputs.studies.append(result["cells"])
        for row in result["summary"]:
            low, high = row["success_ci95"]
            who = row["algorithm"] if row["algorithm"] == "ours" else f"{row['algorithm']}-{row['variant']}"
            inputs.learnt.append(
                Successes(row["scenario"], who, row["episodes"], row["success"], low, high, source=path.name)
            )
        return f"study of {len(result['cells'])} training runs"
    if schema == latency_results.SCHEMA:
        inputs.latencies.append((path.parent.name or path.name, latency_results.read(path)))
        return f"latency benchmark of {len(result['rows'])} rows"
    raise ValueError(f"schema {schema!r}")


def _driver(agent: str, wish_mps: Any) -> str:
    return agent if wish_mps is None else f"{agent}, {float(wish_mps):g} m/s wished"


def _rounded(values: Sequence[float | None]) -> tuple[float, float, float] | None:
    """Mean and interval as they are shown: the same episodes are then the same as rows and as a table. None: none."""
    if None in values:
        return None
    mean, low, high = (round(value, 1) for value in values if value is not None)
    return mean, low, high
