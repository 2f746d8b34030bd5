"""What is kept of a latency run: round trips, and what the nodes' own stamps tell of each tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deploy.bench.deployed_system import trace_of
from deploy.bench.latency_results import DEADLINE_US
from deploy.bench.loads import Load
from deploy.bench.progress import MeasurementError, say
from schemas.driving.road import HZ
from schemas.runtime.clock import NS

PERIOD_NS = NS // HZ
TYPICAL_BYTES = (1024, 256)
"""Of an observation and an action, for the others' payloads while ours has sent none."""
PARTS = (
    "sim: encode and put",
    "bus out",
    "decode",
    "mask",
    "features",
    "policy",
    "rest of the step",
    "encode and put",
    "bus back",
)
"""Of ours, in the order of time. `bus out` starts when the simulator's put has returned: it is negative where the fast
node had the observation before that. `features` and `policy` are of the ticks at which a decision is due."""
ASKED = ("features", "policy")
"""0 at a tick at which the policy is not asked."""


@dataclass
class Paced:
    """What else the paced blocks of one load have shown so far, all of them together."""

    parts: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in PARTS})
    """Of ours, in us."""
    ages: list[float] = field(default_factory=list)
    """Of the applied actions, in us: from the observation's publication until the world was stepped with its answer."""
    late: dict[str, list[float]] = field(default_factory=dict)
    """By participant, in us: from when a round was due until it was sent; for ours, until it was published."""
    skipped: int = 0
    """Ticks that the simulator left out."""
    overdue: int = 0
    """Ticks published more than a period after they were due."""
    load: dict[str, float] = field(default_factory=dict)
    """What the load did; see `loaded`."""
    rss_mb: dict[str, float | None] = field(default_factory=dict)
    """Of the last block, as is `scheduling`."""
    scheduling: dict[str, str] = field(default_factory=dict)

    def loaded(self, did: dict[str, float]) -> None:
        """Add what the load did in one more block."""
        for name, value in did.items():
            self.load[name] = value if name in ("threads", "pages") else round(self.load.get(name, 0) + value, 1)
        if self.load.get("seconds"):
            self.load["tokens_per_s"] = round(self.load["tokens"] / self.load["seconds"], 1)

    def figures(self) -> dict[str, Any]:
        """For the result."""
        return {
            "load": self.load,
            "rss_mb": self.rss_mb,
            "scheduling": self.scheduling,
            "timer_late_us": {name: p50_p99(us) for name, us in self.late.items() if us},
            "applied_age_us": p50_p99(self.ages),
            "skipped_ticks": self.skipped,
            "overdue_ticks": self.overdue,
        }


@dataclass
class Samples:
    """Round trips in us, by what, load and pace, and what else was seen."""

    took: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)
    skipped: dict[tuple[str, str, str], int] = field(default_factory=dict)
    """Due times at which nothing was sent in time."""
    paced: dict[str, Paced] = field(default_factory=dict)
    """By load."""
    absent: dict[tuple[str, str, str], str] = field(default_factory=dict)
    """What should have been measured, and why it was not."""
    seen: bytes = b""
    """An observation of the real simulator, encoded."""
    block: str = ""
    """Which one is being measured, if there are several; part of the reason of a loss."""
    sizes: tuple[int, int] = TYPICAL_BYTES
    """Of an observation and an action."""

    def add(self, key: tuple[str, str, str], took_ns: Sequence[int], skipped: int = 0) -> None:
        self.took.setdefault(key, []).extend(t / 1000.0 for t in took_ns)
        self.skipped[key] = self.skipped.get(key, 0) + skipped

    def age_us(self, load: str) -> dict[str, float] | None:
        """Of the applied actions under this load: p50 and p99."""
        paced = self.paced.get(load)
        return p50_p99(paced.ages) if paced is not None else None

    def lose(self, key: tuple[str, str, str], why: str) -> None:
        """One row less, or a part of it, which is said at once."""
        why += self.block
        self.absent[key] = why
        say(f"bench: load {key[1]}, {key[2]}: without {key[0]}: {why}")


def read_traces(folder: Path, load: Load, first: int, ends: int, samples: Samples) -> None:
    """From the nodes' own stamps of the ticks due between `first` and `ends` [CLOCK_MONOTONIC ns], add to `samples` the
    round trips, their parts, how late they were published, and the ages of what was applied.

    Raises `MeasurementError` if there are none.
    """
    sim = trace_of(folder / "sim.trace").tolist()
    fast = {tuple(row[:2]): row for row in trace_of(folder / "fast.trace").tolist()}
    paced = samples.paced.setdefault(load, Paced())
    late = paced.late.setdefault("ours", [])
    took: list[int] = []
    missed = 0
    for epoch, tick, sent, answered, due, put, next_due, next_ns, age in sim:
        if not first <= due < ends:
            continue
        skipped = max(0, round((next_due - due) / PERIOD_NS) - 1)
        paced.skipped += skipped
        took.append(answered if answered >= 0 else max(PERIOD_NS, next_ns - sent))
        late.append((sent - due) / 1000.0)
        overdue = sent - due > PERIOD_NS
        paced.overdue += overdue
        missed += skipped + (overdue and took[-1] <= DEADLINE_US * 1000.0)  # the later ones count by themselves
        if age >= 0:
            paced.ages.append(age / 1000.0)
        row = fast.get((epoch, tick))
        if row is None or answered < 0:
            continue
        _, _, arrived, decoded, mask, features, policy, stepped, answer = row
        for name, ns in zip(
            PARTS,
            (
                put - sent,
                arrived - put,
                decoded - arrived,
                mask,
                features,
                policy,
                stepped - decoded - mask - features - policy,
                answer - stepped,
                sent + answered - answer,
            ),
            strict=True,
        ):
            if ns or name not in ASKED:
                paced.parts[name].append(ns / 1000.0)
    if not took:
        raise MeasurementError("the simulator did not tick")
    samples.add(("ours", load, "15hz"), took, missed)


def p50_p99(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    p50, p99 = (round(float(p), 1) for p in np.percentile(values, (50, 99)))
    return {"p50": p50, "p99": p99}
