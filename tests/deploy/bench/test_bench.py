"""The benchmark: its figures by hand-made samples, and one short run of it on the real processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from typer.testing import CliRunner

from deploy.bench import (
    latency,
    latency_report,
    latency_results,
    latency_samples,
    pingpong_end,
    scale,
    scale_fast_node,
    scale_simulators,
)
from deploy.bench.loads import asking
from deploy.bench.pingpongs import PingPongs
from deploy.bench.progress import MeasurementError
from deploy.bench.scale_points import breaking_point
from deploy.bench.transports import EndConfig
from deploy.cli.bench import app
from deploy.run import processes
from deploy.run.launch import children
from schemas.runtime.clock import ManualClock, MonotonicClock
from schemas.runtime.process import ConfigError
from schemas.wire.codec import rows_of
from sim_node.__main__ import REHEARSALS_NS, RehearsingClock
from tests.scenes import HIGHWAY, car, observation
from tests.waiting import PATIENCE_S, until

ROOT = Path(__file__).parents[3]


def fastslow(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{cwd}"}
    return subprocess.run(
        [sys.executable, "-m", "deploy", *arguments],
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def result_of(**took_us: list[float]) -> dict[str, Any]:
    rows = [latency_results.row_of(what, "none", "15hz", took) for what, took in took_us.items()]
    return {
        "schema": latency_results.SCHEMA,
        "rows": [{f: getattr(row, f) for f in row.__struct_fields__} for row in rows],
        "histograms": {f"{what}/none/15hz": latency_results.histogram(took) for what, took in took_us.items()},
    }


def test_a_row_has_the_percentiles_of_its_samples() -> None:
    row = latency_results.row_of("ours", "none", "15hz", list(range(1, 5002)))
    assert (row.n, row.p50_us, row.p90_us, row.p99_us, row.p999_us, row.max_us) == (
        5001,
        2501.0,
        4501.0,
        4951.0,
        4996.0,
        5001.0,
    )


@pytest.mark.parametrize(("ticks", "known"), [(2999, False), (3000, True)])
def test_p999_takes_3000_ticks(ticks: int, known: bool) -> None:
    assert (latency_results.row_of("ours", "none", "15hz", [1.0] * ticks).p999_us is not None) == known


def test_late_and_skipped_ticks_are_misses() -> None:
    assert latency_results.row_of("ours", "none", "15hz", [19_999.0, 20_001.0], skipped=3).misses == 4


def test_a_histogram_keeps_values_within_one_percent() -> None:
    values, counts = latency_results.centres(latency_results.histogram([123.4, 123.4, 45_678.0]))
    assert counts.tolist() == [2, 1]
    assert values == pytest.approx([123.4, 45_678.0], rel=0.01)


def test_a_result_does_not_differ_from_itself() -> None:
    one = result_of(ours=np.random.default_rng(0).lognormal(6, 0.3, 2000).tolist())
    compared = latency_results.compare(one, one)
    assert [row[p]["differ"] for row in compared["rows"] for p in ("p50_us", "p99_us")] == [False, False]
    assert (compared["only_a"], compared["only_b"], compared["hosts"]) == ([], [], {})


def test_a_result_twice_as_slow_is_told_as_such() -> None:
    took = np.random.default_rng(0).lognormal(6, 0.3, 2000)
    [row] = latency_results.compare(result_of(ours=took.tolist()), result_of(ours=(2 * took).tolist()))["rows"]
    assert row["p50_us"]["ratio"] == pytest.approx(2.0, rel=0.01)
    assert row["p50_us"]["differ"]
    assert row["max_us"]["b"] == pytest.approx(2 * row["max_us"]["a"], abs=0.2)


def test_what_makes_two_results_incomparable_is_said() -> None:
    one, other = result_of(ours=[1.0, 30_000.0], zmq=[1.0]), result_of(ours=[1.0, 2.0], dora=[1.0])
    one["host"], other["host"] = ({"realtime": mode, "cpu": "same", "cores": 2} for mode in ("fifo", "user"))
    said = list(latency_results.compared(latency_results.compare(one, other)))
    assert said[0] == "not the same realtime: fifo and user"
    assert "p99.9 - -> -   max 30000 -> 2   misses 1 -> 0" in said[1]
    assert said[2:4] == ["only in a: zmq/none/15hz", "only in b: dora/none/15hz"]


def test_results_without_a_common_row_are_an_error(tmp_path: Path) -> None:
    for name in ("zmq", "dora"):
        (tmp_path / name).write_text(json.dumps(result_of(**{name: [1.0]})))
    done = CliRunner().invoke(app, ["compare", str(tmp_path / "zmq"), str(tmp_path / "dora")])
    assert done.exit_code == 1
    assert "no row in common" in done.output


def test_a_result_without_histograms_names_the_file_to_take(tmp_path: Path) -> None:
    printed = result_of(ours=[1.0])
    del printed["histograms"]
    (tmp_path / "a.json").write_text(json.dumps(printed))
    with pytest.raises(ConfigError, match=r"latency\.json that the run saved"):
        latency_results.read(tmp_path / "a.json")


@pytest.mark.parametrize("content", [None, "nonsense", "[]", '{"schema": "another"}'])
def test_what_is_no_result_cannot_be_compared(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "a.json").write_text(content)
    with pytest.raises(ConfigError, match=r"a\.json"):
        latency_results.read(tmp_path / "a.json")


class Orders:
    """The benchmark's end of the orders, without a socket."""

    def __init__(self, *orders: object) -> None:
        self._orders: list[object] = [*orders, None]
        self.replies: list[Any] = []

    def recv(self) -> object:
        return self._orders.pop(0)

    def send(self, reply: object) -> None:
        self.replies.append(reply)


def test_a_round_behind_a_late_one_counts_from_when_it_was_due(monkeypatch: pytest.MonkeyPatch) -> None:
    slow_at = 51  # the rounds before it are for warming up

    def receive() -> bytes:
        nonlocal slow_at
        slow_at -= 1
        if slow_at == 0:
            manual.advance(0.05)
        return b""

    manual = ManualClock()
    monkeypatch.setattr(pingpong_end, "time", SimpleNamespace(monotonic_ns=manual.now_ns, sleep=manual.advance))
    orders = Orders(("paced", manual.now_ns() + 50_000_000, 10_000_000, 3))
    pingpong_end.near_end(EndConfig(transport="bus", near=True, folder=""), (lambda _: None, receive), orders)
    assert orders.replies[1][0] == [50_000_000, 40_000_000, 30_000_000]


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


@pytest.mark.parametrize(
    ("seconds", "loads", "each", "order"),
    [
        (900.0, "llm", 900.0, "llm"),
        (8.0, "none llm", 2.0, "none llm llm none none llm llm none"),
        (240.0, "none cpu llm", 60.0, "none cpu llm llm cpu none none cpu llm llm cpu none"),
        (360.0, "none cpu", 60.0, "none cpu cpu none none cpu cpu none none cpu cpu none"),
    ],
)
def test_loads_take_turns_for_their_time_in_all(seconds: float, loads: str, each: float, order: str) -> None:
    blocks = latency.blocks(seconds, loads.split())  # type: ignore[arg-type]
    assert blocks == [(load, each) for load in order.split()]


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


def test_what_is_not_installed_is_absent_and_not_included(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def measure(options: latency.Options, load: str, _: Path, samples: latency_samples.Samples) -> None:
        for what in (*options.peers, "ours"):
            samples.add((what, load, "15hz"), [1_000])

    monkeypatch.setattr(latency, "available", lambda _: ("floor",))
    monkeypatch.setattr(latency, "_paced", measure)
    monkeypatch.setattr(latency, "_back_to_back", measure)
    result, _ = latency.run(latency.Options(loads=("none",), peers=("floor", "dora"), out=tmp_path))
    assert [(row["what"], row["pace"], row["why"]) for row in result["absent"]] == [
        ("dora", pace, "not installed: pip install 'fastslow[bench]'") for pace in latency.PACES
    ]
    assert [text.partition(":")[0] for text in result["included"][:-1]] == ["ours", "floor"]


class Model(BaseHTTPRequestHandler):
    """A language model's server that answers as `answer` does."""

    answer: Callable[[Model], object]

    def do_POST(self) -> None:
        self.answer()  # type: ignore[call-arg, misc]

    def words(self, n: int) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(n * b'data: {"choices":[{"delta":{"content":"a"}}]}\n\n')

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def asked(answer: Callable[[Model], object]) -> Iterator[dict[str, float]]:
    """Such a server, asked without pause; what it did is complete at the end of the block."""
    did: dict[str, float] = {}
    handler = type("Handler", (Model,), {"answer": answer})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            with asking(
                processes.Model(
                    base_url=f"http://127.0.0.1:{server.server_port}", name="m", embedded=True, port=server.server_port
                ),
                did,
            ):
                yield did
        finally:
            server.shutdown()


def test_the_load_counts_what_the_model_wrote_during_the_block() -> None:
    n = 0

    def answer(model: Model) -> None:
        nonlocal n
        n += 1
        model.words(7)

    with asked(answer) as did:
        before = n
        until(lambda: n >= before + 3, "the model was not asked again")
    assert did["answers"] >= 2
    assert did["tokens"] >= 2 * 7


def test_a_model_that_falls_silent_is_no_load() -> None:
    silent, end = threading.Event(), threading.Event()

    def answer(model: Model) -> None:
        model.words(1)
        silent.set()
        end.wait(PATIENCE_S)

    with pytest.raises(MeasurementError, match="the language model wrote nothing"), asked(answer):
        silent.wait(PATIENCE_S)
    end.set()


def test_a_model_that_fails_is_no_load() -> None:
    fails, failed = threading.Event(), threading.Semaphore(0)

    def answer(model: Model) -> None:
        if fails.is_set():
            model.send_error(500)
            failed.release()
        else:
            model.words(7)

    def until_two_have_failed() -> None:
        fails.set()
        for _ in range(2):
            assert failed.acquire(timeout=PATIENCE_S)

    with pytest.raises(MeasurementError, match=r"failed \d requests, the last one with: .*500"), asked(answer):
        until_two_have_failed()


def test_a_crowd_has_as_many_vehicles_as_asked_for() -> None:
    rows = rows_of(scale_fast_node.crowd(observation(car(0, 100, 1, 10), lanes=HIGHWAY[:2]), 50))
    assert len(set(rows[:, 0].tolist())) == len(set(rows[:, 1].tolist())) == 50


@pytest.mark.parametrize(
    ("beyond", "why"),
    [
        ({"x": 2, "n": 9, "p99_us": 25_000.0}, "p99 of 25.0 ms exceeds the deadline"),
        ({"x": 2, "n": 9, "p99_us": 900.0, "misses": 3}, "3 of 9 ticks missed"),
        ({"x": 2, "breaks": "too large"}, "too large"),
    ],
)
def test_the_knee_is_the_first_point_that_does_not_hold(beyond: dict[str, Any], why: str) -> None:
    points = [{"x": 1, "n": 9, "p99_us": 900.0, "misses": 0}, beyond, {"x": 4, "n": 9, "p99_us": 900.0}]
    assert breaking_point(points) == {"holds": 1, "breaks_at": 2, "then": why}


def test_the_largest_number_of_egos_is_found_between_two_that_were_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale_fast_node, "_egos", lambda _, n, __: {"x": n, "n": 1, "p99_us": 20_000.0 * n / 45})
    holds = breaking_point(scale_fast_node.egos(None, 1))["holds"]  # type: ignore[arg-type]
    assert 43 <= holds <= 45


def test_unanswered_ticks_last_their_period_and_skipped_ones_are_counted(tmp_path: Path) -> None:
    tick = latency_samples.PERIOD_NS
    stamps = [
        (7, 0, 0, 500, 0, 1, tick, tick, -1),
        (7, 1, tick, -1, tick, tick + 1, 2 * tick, 2 * tick, 0),
        (7, 2, 2 * tick, 600, 2 * tick, 2 * tick + 1, 5 * tick, 5 * tick, 0),
    ]
    np.array(stamps, np.int64).tofile(tmp_path / "0.trace")
    assert scale_simulators._round_trips(tmp_path / "0.trace", 0, 10 * tick) == ([500, tick, 600], 2)


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.realtime
def test_two_simulators_on_one_bus_are_answered_by_their_own_fast_nodes(tmp_path: Path, direct: bool) -> None:
    point = scale_simulators._pairs(tmp_path, "auto", 1.0, 2, direct=direct)
    assert 28 <= point["n"] <= 32
    assert point["misses"] < point["n"] / 2


def test_a_message_of_64_kib_is_lost_on_the_low_latency_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "SIZES", (1024, 65_536))
    assert breaking_point(scale.sizes(tmp_path, "off", 10)) == {
        "holds": 1024,
        "breaks_at": 65_536,
        "then": "lost without an error: the low-latency transport does not fragment",
    }


def test_the_curves_are_drawn(tmp_path: Path) -> None:
    points: list[dict[str, Any]] = [{"x": 1, "n": 9, "p50_us": 500.0, "p99_us": 900.0}, {"x": 2, "breaks": "too large"}]
    curve = {"points": points, "knee": breaking_point(points)}
    scale.plot({"curves": {"vehicles": curve, "egos": curve}}, tmp_path / "scale.png")
    assert (tmp_path / "scale.png").read_bytes().startswith(b"\x89PNG")


@contextmanager
def two_peers(folder: Path, other: str) -> Iterator[PingPongs]:
    with PingPongs(folder, ("floor", other), 512, 128, "off", patience_s=5.0) as peers:  # type: ignore[arg-type]
        yield peers


@pytest.mark.parametrize(
    ("peer", "part"), [("zmq", "far end"), ("bus", "far end"), ("bus", "near end"), ("dora", "dataflow")]
)
def test_a_peer_that_dies_is_dropped_and_says_which_part_it_was(tmp_path: Path, peer: str, part: str) -> None:
    pytest.importorskip({"bus": "zenoh"}.get(peer, peer))
    with two_peers(tmp_path, peer) as peers:
        os.kill(peers.parts(peer)[part], signal.SIGKILL)
        peers.order(peer, "rounds", 10)
        assert peers.reply(peer) is None
        assert f"its {part} was killed by signal 9" in peers.lost[peer]


def test_a_peer_goes_on_when_another_has_died(tmp_path: Path) -> None:
    with two_peers(tmp_path, "bus") as peers:
        os.kill(peers.parts("bus")["far end"], signal.SIGKILL)
        peers.order("bus", "rounds", 10)
        peers.reply("bus")
        peers.order("floor", "rounds", 10)
        reply = peers.reply("floor")
        assert reply is not None
        assert len(reply[0]) == 10


def test_a_peer_that_hangs_is_dropped(tmp_path: Path) -> None:
    with PingPongs(tmp_path, ("floor",), 512, 128, "off", patience_s=1.0) as peers:
        os.kill(peers.parts("floor")["far end"], signal.SIGSTOP)
        peers.order("floor", "rounds", 10)
        assert peers.reply("floor") is None
        assert "did not answer for 1 s" in peers.lost["floor"]


def test_no_process_outlives_its_block(tmp_path: Path) -> None:
    with children() as start:
        stubborn = start("child", (sys.executable, "-c", "import time; time.sleep(60)"), tmp_path / "log")
    assert stubborn.trouble() == "its child was killed by signal 15"


def marked(mark: str, module: str = "") -> list[int]:
    """The processes that have `mark` in their environment and `module` in their command line."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (
                mark.encode() in (process / "environ").read_bytes()
                and module.encode() in (process / "cmdline").read_bytes()
            ):
                found.append(int(process.name))
        except OSError:  # it has ended, or is somebody else's
            continue
    return found


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command line in the background, and the mark of its processes."""
    mark = f"FASTSLOW_TEST={uuid4()}"
    env = {**os.environ, "PYTHONPATH": str(ROOT), **dict([mark.split("=")])}
    process = subprocess.Popen(
        [sys.executable, "-m", "deploy", *arguments],
        cwd=folder,
        env=env,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        yield process, mark
    finally:
        process.kill()
        process.wait()


def wait_for(mark: str, module: str) -> int:
    return until(lambda: marked(mark, module), f"no {module} came up")[0]


FLOOR_ALONE = ("bench", "latency", "--seconds", "2", "--load", "none", "--peer", "floor", "--json")
needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes in /proc")


@needs_proc
@pytest.mark.realtime
def test_without_ours_the_others_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSLOW_TEST", mark := str(uuid4()))
    samples = latency_samples.Samples()

    def kill() -> None:
        wait_for(mark, "deploy.bench.pingpong_end")
        os.kill(wait_for(mark, "fast_node"), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    latency._paced(latency.Options(seconds=1.0, peers=("floor",)), "none", tmp_path, samples)
    killer.join()
    assert [len(took) for took in samples.took.values()] == [15]
    assert samples.absent["ours", "none", "15hz"].startswith("fast killed by signal 9")


@pytest.mark.parametrize(("absent", "code"), [("ours", 1), ("floor", 1), ("zmq", 0), ("dora", 0)])
def test_only_without_ours_or_the_floor_the_benchmark_fails(
    absent: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latency, "run", lambda _: ({"rows": [], "absent": [{"what": absent}]}, Path("x")))
    assert CliRunner().invoke(app, ["latency", "--json"]).exit_code == code


@needs_proc
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.realtime
def test_a_signal_ends_the_benchmark_and_all_it_started(tmp_path: Path, number: int, code: int) -> None:
    with started(tmp_path, *FLOOR_ALONE) as (process, mark):
        wait_for(mark, "deploy.bench.pingpong_end")
        process.send_signal(number)
        _, said = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, said.splitlines()[-1], marked(mark)) == (code, "fastslow: stopped", [])


def test_stamps_that_were_not_written_are_a_loss(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"no stamps in .*sim\.trace"):
        latency_samples.read_traces(tmp_path, "none", 0, 1, latency_samples.Samples())


class Announced:
    """Counts the announcements."""

    def __init__(self) -> None:
        self.times = 0

    def announce_next(self, _: object) -> None:
        self.times += 1


@pytest.mark.parametrize(("ahead_ns", "times"), [(50_000_000, len(REHEARSALS_NS)), (-1, 0)])
def test_a_tick_is_announced_unless_it_is_late(ahead_ns: int, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    announced, manual = Announced(), ManualClock()
    monkeypatch.setattr(MonotonicClock, "now_ns", lambda _: manual.now_ns())
    monkeypatch.setattr(MonotonicClock, "sleep_until", lambda _, due_ns: manual.sleep_until(due_ns))
    RehearsingClock(announced, poll=False).sleep_until(ahead_ns)  # type: ignore[arg-type]
    assert announced.times == times


@pytest.mark.parametrize(
    "arguments",
    [("run", "--realtime", "warp"), ("bench", "latency", "--load", "gpu"), ("bench", "latency", "--peer", "carrier")],
)
def test_what_does_not_exist_is_a_usage_error(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    done = fastslow(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "choose from" in done.stderr


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """One short run on the real processes, where pyzmq is broken."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "zmq.py").write_text("raise ImportError('libzmq.so.5: no such file')\n")
    done = fastslow(
        "bench",
        "latency",
        "--seconds",
        "2",
        "--load",
        "none",
        "--peer",
        "floor",
        "--peer",
        "bus",
        "--peer",
        "bus-default",
        "--peer",
        "zmq",
        "--json",
        "--out",
        "out",
        "--plot",
        "picture.png",
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result, folder


@pytest.mark.realtime
def test_every_contender_is_measured_at_both_paces(measured: tuple[dict[str, Any], Path]) -> None:
    assert {(row["what"], row["pace"]) for row in measured[0]["rows"]} == {
        (what, pace) for what in ("floor", "bus", "bus-default", "ours") for pace in ("15hz", "back-to-back")
    }


@pytest.mark.realtime
def test_a_peer_that_cannot_start_is_absent_with_its_last_words(measured: tuple[dict[str, Any], Path]) -> None:
    words = "end ended with code 1: ImportError: libzmq.so.5: no such file"
    assert [(row["what"], row["pace"], words in row["why"]) for row in measured[0]["absent"]] == [
        ("zmq", "15hz", True),
        ("zmq", "back-to-back", True),
    ]


@pytest.mark.realtime
def test_a_row_is_what_was_promised(measured: tuple[dict[str, Any], Path]) -> None:
    assert set(measured[0]["rows"][0]) == {
        "what",
        "load",
        "pace",
        "n",
        "p50_us",
        "p90_us",
        "p99_us",
        "p999_us",
        "max_us",
        "misses",
    }


@pytest.mark.realtime
def test_the_paced_loop_is_measured_at_every_tick(measured: tuple[dict[str, Any], Path]) -> None:
    [ours] = [row for row in measured[0]["rows"] if (row["what"], row["pace"]) == ("ours", "15hz")]
    assert 29 <= ours["n"] + measured[0]["loads"]["none"]["skipped_ticks"] <= 31


@pytest.mark.realtime
def test_the_parts_of_a_tick_are_all_there(measured: tuple[dict[str, Any], Path]) -> None:
    parts = measured[0]["parts_us"]["none"]
    assert tuple(parts) == latency_samples.PARTS
    assert all(part["p50"] > 0 for name, part in parts.items() if name != "bus out")  # which may overlap the put


@pytest.mark.realtime
def test_what_is_applied_is_about_as_old_as_the_round_trip(measured: tuple[dict[str, Any], Path]) -> None:
    age, [ours] = (
        measured[0]["loads"]["none"]["applied_age_us"],
        [row for row in measured[0]["rows"] if (row["what"], row["load"], row["pace"]) == ("ours", "none", "15hz")],
    )
    assert ours["p50_us"] <= age["p50"] <= latency_results.DEADLINE_US


@pytest.mark.realtime
def test_all_say_how_late_they_were_and_how_they_are_scheduled(measured: tuple[dict[str, Any], Path]) -> None:
    paced = measured[0]["loads"]["none"]
    assert paced["timer_late_us"].keys() == {"floor", "bus", "bus-default", "ours"}
    assert paced["scheduling"].keys() == {"floor", "bus", "bus-default", "sim", "fast"}


@pytest.mark.realtime
def test_the_text_says_what_the_result_does(measured: tuple[dict[str, Any], Path]) -> None:
    result = measured[0]
    said = "\n".join(latency_report.lines(result))
    for row in result["rows"]:
        assert f"{row['load']:<5} {row['pace']:<13} {row['what']:<12} {row['n']:>7} {row['p50_us']:>8.0f}" in said
    for name, how in result["loads"]["none"]["scheduling"].items():
        assert f"{name} {how}" in said
    assert "none  15hz          zmq          absent: " in said
    assert "sent after it was due, load none, p50/p99 us: floor " in said
    assert "parts of ours, load none, p50/p99 us: sim: encode and put " in said
    assert all(target["figure"] in said for target in result["targets"])
    assert all(f"included: {text}" in said for text in result["included"])


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


@pytest.mark.realtime
def test_the_saved_result_can_be_compared(measured: tuple[dict[str, Any], Path]) -> None:
    saved = str(measured[1] / "out" / "latency.json")
    done = fastslow("bench", "compare", saved, saved, "--json", cwd=measured[1])
    rows = json.loads(done.stdout)["rows"]
    assert [row["p50_us"]["ratio"] for row in rows] == [1.0] * len(measured[0]["rows"]) == [1.0] * 8


@pytest.mark.realtime
def test_the_picture_is_drawn(measured: tuple[dict[str, Any], Path]) -> None:
    assert (measured[1] / "picture.png").read_bytes().startswith(b"\x89PNG")
