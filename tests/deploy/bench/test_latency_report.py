"""What is promised of a latency run, judged."""

from __future__ import annotations

import pytest

from deploy.bench import latency_report, latency_results


def paced(
    what: str, load: str = "none", *, p50: float = 100.0, p99: float = 1000.0, n: int = 3600, misses: int = 0
) -> latency_results.Row:
    return latency_results.Row(
        what=what,
        load=load,
        pace="15hz",
        n=n,
        p50_us=p50,
        p90_us=p50,
        p99_us=p99,
        p999_us=None,
        max_us=p99,
        misses=misses,
    )


def judged(*rows: latency_results.Row, **fast: object) -> dict[str, tuple[object, object, object]]:
    return {
        str(t["figure"]): (t["value"], t["reached"], t["valid"]) for t in latency_report.targets(rows, fast, "auto")
    }


def test_promises_are_judged_one_by_one() -> None:
    rows = (paced("ours", p50=150.0, p99=1300.0), paced("floor", p99=1000.0), paced("bus"), paced("dora", p50=500.0))
    assert judged(*rows, first_action_s=0.6, rss_mb=90.0) == {
        "paced p50, ours / floor": (1.5, True, True),
        "paced p99, ours / floor": (1.3, True, True),
        "paced p99, ours [ms]": (1.3, False, True),
        "p50 15hz, dora / bus": (5.0, True, True),
        "p50 15hz, dora / ours": (3.333, False, True),
        "fast node, start to first action [s]": (0.6, False, True),
        "fast node, resident memory [MB]": (90.0, True, True),
    }


def test_the_age_of_the_applied_action_is_judged_by_the_bare_bus() -> None:
    found = latency_report.targets([paced("bus")], {}, "auto", {"p50": 150.0, "p99": 1600.0})
    assert {t["figure"]: (t["value"], t["reached"]) for t in found} == {
        "age of the applied action p50 / bare zenoh": (1.5, True),
        "age of the applied action p99 / bare zenoh": (1.6, False),
        "age of the applied action p99 [ms]": (1.6, True),
    }


@pytest.mark.parametrize(("mode", "reached"), [("fifo", False), ("user", True), ("off", True)])
def test_a_plain_user_may_double_under_load(mode: str, reached: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency_report, "resolve", lambda _: mode)
    assert judged(paced("ours"), paced("ours", "cpu", p99=1900.0))["paced p99, load cpu / none"] == (1.9, reached, True)


def test_cockpit_and_recorder_may_cost_a_tenth_and_no_tick() -> None:
    rows = (paced("ours", misses=1), paced("ours", "watched", p50=110.0, p99=1111.0, misses=2))
    assert {figure: said for figure, said in judged(*rows).items() if "watched" in figure} == {
        "paced p50, load watched / none": (1.1, True, True),
        "paced p99, load watched / none": (1.111, False, True),
        "missed deadlines more, load watched": (1.0, False, True),
    }


@pytest.mark.parametrize(("idle", "valid"), [(1250.0, True), (1251.0, False)])
def test_a_ratio_to_a_disturbed_idle_part_is_not_reached(idle: float, valid: bool) -> None:
    _, reached, found = judged(paced("ours", p99=idle), paced("ours", "llm"))["paced p99, load llm / none"]
    assert (reached, found) == (valid, valid)


@pytest.mark.parametrize(
    ("load", "n", "misses", "said"),
    [("llm", 13_500, 0, [True]), ("llm", 13_499, 1, [False]), ("llm", 13_499, 0, []), ("cpu", 13_500, 0, [])],
)
def test_misses_are_judged_after_15_minutes_beside_the_model(load: str, n: int, misses: int, said: list[bool]) -> None:
    found = judged(paced("ours", load, n=n, misses=misses))
    assert [reached for figure, (_, reached, _) in found.items() if "missed" in figure] == said


def test_the_text_marks_what_cannot_be_judged() -> None:
    targets = latency_report.targets([paced("ours", p99=2000.0), paced("ours", "llm")], {}, "auto")
    result = {
        "host": {
            "cpu": "c",
            "cores": 2,
            "kernel": "k",
            "realtime": "off",
            "load_average": [0.0],
            "revision": None,
            "versions": {},
        },
        "rows": [],
        "absent": [],
        "loads": {},
        "parts_us": {},
        "bus_paced_minus_back_to_back_us": {"none": 300.0},
        "targets": targets,
        "included": [],
    }
    said = list(latency_report.lines(result))
    assert any(line.startswith("INVALID  paced p99, load llm / none: 0.5 ") and "disturbed" in line for line in said)
    assert any("minus back to back: 300 us" in line for line in said)
