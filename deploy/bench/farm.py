"""`python -m deploy.bench.farm`: what a Ray cluster adds to a task, measured on one of this machine, and how long a
thousand training runs take on a hundred machines, simulated with it."""

from __future__ import annotations

import heapq
import json
import time
from collections.abc import Sequence

import numpy as np

from deploy.lab.farm import LOCAL, Farm

TASKS, RESULT_BYTES = 1000, 300_000
"""A training run's policy and result have so many bytes."""
CELLS, MEAN_S, SPREAD = 1000, 40.0, 0.5
"""Runs, their mean length (the study's, on 2 cores), and its standard deviation in shares of that."""


def result(_: int) -> bytes:
    """A task that does nothing and returns as much as a training run."""
    return bytes(RESULT_BYTES)


def measured_s() -> tuple[float, float]:
    """(seconds until the first task is done, seconds a task from then on)."""
    began_s = time.perf_counter()
    tasks = Farm(ray=LOCAL).run(result, [(k,) for k in range(TASKS)])
    next(tasks)
    first_s = time.perf_counter() - began_s
    for _ in tasks:
        pass
    return first_s, (time.perf_counter() - began_s - first_s) / (TASKS - 1)


def finished_s(lengths_s: Sequence[float], slots: int, start_s: float, hand_out_s: float) -> float:
    """When the last of these tasks is done: one process hands them out in order, each to the next slot that is free."""
    free = [start_s] * slots
    handed_s = 0.0
    for length in lengths_s:
        handed_s += hand_out_s
        heapq.heappush(free, max(heapq.heappop(free), handed_s) + length)
    return max(free)


def main() -> None:
    start_s, each_s = measured_s()
    shape = 1.0 / SPREAD**2
    lengths = np.random.default_rng(0).gamma(shape, MEAN_S / shape, CELLS).tolist()
    rows = {slots: round(finished_s(lengths, slots, start_s, each_s), 1) for slots in (2, 20, 200, 1000, 2000)}
    print(json.dumps({"first_task_s": round(start_s, 2), "task_ms": round(1000 * each_s, 2), "done_s_by_slots": rows}))


if __name__ == "__main__":
    main()
