"""What is read from the traces of simulator and fast node."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.bench import latency_results, latency_samples
from deploy.bench.progress import MeasurementError


def stamps(folder: Path, sim: list[tuple[int, ...]], fast: list[tuple[int, ...]]) -> latency_samples.Samples:
    """What is read from such traces of one second."""
    for name, rows in (("sim.trace", sim), ("fast.trace", fast)):
        np.array(rows, np.int64).tofile(folder / name)
    samples = latency_samples.Samples()
    latency_samples.read_traces(folder, "none", 0, 1_000_000_000, samples)
    return samples


def test_unanswered_and_skipped_ticks_are_found_in_the_stamps(tmp_path: Path) -> None:
    tick = latency_samples.PERIOD_NS
    samples = stamps(
        tmp_path,
        [
            (7, 0, 0, 500_000, 0, 60_000, tick, tick, 510_000),
            (7, 1, tick, -1, tick, tick + 1, 2 * tick, 2 * tick, -1),
            (7, 2, 2 * tick, 600_000, 2 * tick, 2 * tick + 1, 5 * tick, 5 * tick, 620_000),
        ],
        [(7, 0, 100_000, 110_000, 20_000, 30_000, 40_000, 250_000, 300_000)],
    )
    assert samples.took["ours", "none", "15hz"] == [500.0, tick / 1000.0, 600.0]
    assert samples.skipped["ours", "none", "15hz"] == samples.paced["none"].skipped == 2
    assert samples.paced["none"].ages == [510.0, 620.0]
    assert {name: us for name, [us] in samples.paced["none"].parts.items()} == {
        "sim: encode and put": 60.0,
        "bus out": 40.0,
        "decode": 10.0,
        "mask": 20.0,
        "features": 30.0,
        "policy": 40.0,
        "rest of the step": 50.0,
        "encode and put": 50.0,
        "bus back": 200.0,
    }


@pytest.mark.parametrize(
    ("late_ns", "took_ns", "misses"),
    [
        (latency_samples.PERIOD_NS, 500_000, 0),
        (latency_samples.PERIOD_NS + 1, 500_000, 1),
        (latency_samples.PERIOD_NS + 1, 30_000_000, 1),
        (0, 30_000_000, 1),
    ],
)
def test_a_tick_published_more_than_a_period_late_is_a_miss_and_counts_once(
    tmp_path: Path, late_ns: int, took_ns: int, misses: int
) -> None:
    tick = latency_samples.PERIOD_NS
    samples = stamps(tmp_path, [(7, 0, late_ns, took_ns, 0, late_ns + 1, tick, 3 * tick, -1)], [])
    key = ("ours", "none", "15hz")
    assert latency_results.row_of(*key, samples.took[key], samples.skipped[key]).misses == misses
    assert samples.paced["none"].late["ours"] == [late_ns / 1000.0]


def test_the_blocks_of_a_load_are_pooled(tmp_path: Path) -> None:
    samples = stamps(
        tmp_path,
        [(7, 0, 10, 500_000, 0, 20, 2 * latency_samples.PERIOD_NS, latency_samples.PERIOD_NS, -1)],
        [(7, 0, 100_000, 110_000, 20_000, 30_000, 40_000, 250_000, 300_000)],
    )
    latency_samples.read_traces(tmp_path, "none", 0, 1_000_000_000, samples)
    paced = samples.paced["none"]
    for answers in (1, 3):
        paced.loaded({"answers": answers, "tokens": 64 * answers, "seconds": 2.0})
    assert samples.took["ours", "none", "15hz"] == [500.0, 500.0]
    assert (paced.parts["policy"], paced.late["ours"], paced.skipped) == ([40.0, 40.0], [0.01, 0.01], 2)
    assert paced.load == {"answers": 4, "tokens": 256, "seconds": 4.0, "tokens_per_s": 64.0}


def test_stamps_that_were_not_written_are_a_loss(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"no stamps in .*sim\.trace"):
        latency_samples.read_traces(tmp_path, "none", 0, 1, latency_samples.Samples())
