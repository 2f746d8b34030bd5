"""`fastslow report`: which figures there are, what stands in them, and a page that needs nothing else."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from deploy.bench.latency_results import SCHEMA as BENCH
from deploy.bench.latency_results import histogram
from deploy.cli.app import app
from deploy.lab.evaluate import SCHEMA as EVALUATE
from deploy.lab.statistics import wilson95
from deploy.lab.study.matrix import SCHEMA as STUDY
from deploy.lab.study.report import summary_of
from deploy.report.inputs import read
from schemas.runtime.clock import NS
from schemas.runtime.process import ConfigError
from schemas.wire.messages import Message, Status
from tests.recordings import driven, write

pytest.importorskip("matplotlib")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def beat(seq: int, **metrics: float) -> Status:
    return Status(epoch=1, stamp_ns=seq * NS // 5, node="sim", pid=1, seq=seq, state="ready", metrics=metrics)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds on a two-way road, with heartbeats of a simulator that waited 0.3 ms for its answers."""
    messages: list[Message] = list(driven(4.0))
    messages += [beat(k, rtt_us=300.0 + k, age_us=320.0 + k) for k in range(20)]
    path = tmp_path_factory.mktemp("run") / "recording.mcap"
    return write(path, sorted(messages, key=lambda message: message.stamp_ns))


def evaluation(path: Path, success: float = 0.95) -> Path:
    row: dict[str, Any] = {
        "agent": "ours", "scenario": "merge", "wish_mps": None, "episodes": 20, "success": success,
        "success_ci95": wilson95(round(20 * success), 20), "ego_fault_collisions": 1,
        "ride_score": 70.0, "ride_score_low": 60.0, "ride_score_high": 80.0,
    }  # fmt: skip
    rows = [row, {**row, "agent": "rule", "wish_mps": 20.0}]
    path.write_text(json.dumps({"schema": EVALUATE, "rows": rows}), encoding="utf-8")
    return path


def study(path: Path) -> Path:
    figures = {
        "success": 0.5, "ego_fault_collisions": 1, "struck_collisions": 0, "avg_speed": 20.0, "max_speed": 25.0,
        "min_speed": 15.0, "accel_var": 0.2, "min_ttc_mean": 9.0, "override_share": 0.1, "episodes": 10,
    }  # fmt: skip
    cells = [
        {
            "scenario": "merge",
            "algorithm": a,
            "variant": v,
            "seed": s,
            "curve": [(0, -1.0), (10_000, s + 1.0)],
            **figures,
        }
        for a, v in (("ours", "masked"), ("ppo", "bare"))
        for s in (0, 1)
    ]
    path.write_text(json.dumps({"schema": STUDY, "cells": cells, "summary": summary_of(cells)}), encoding="utf-8")
    return path


def made(out: Path, *arguments: str | Path) -> str:
    """The page, made of this."""
    result = CliRunner().invoke(app, ["report", *map(str, arguments), "-o", str(out)])
    assert result.exit_code == 0, result.output
    return (out / "index.html").read_text(encoding="utf-8")


def failed(*arguments: str | Path) -> str:
    """What is said of a report that cannot be made."""
    result = CliRunner().invoke(app, ["report", *map(str, arguments)])
    assert (result.exit_code, result.output.count("Traceback")) == (78, 0)
    return result.stderr.splitlines()[-1]


def test_everything_gives_every_figure_as_png_and_svg_and_in_the_page(recording, tmp_path):
    out = tmp_path / "out"
    page = made(
        out, recording, evaluation(tmp_path / "e.json"), study(tmp_path / "study.json"), "--at", "1", "--at", "3"
    )
    names = ["success", "reward", "success-learnt", "filmstrip", "attention", "latency"]
    for name in names:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{name}.svg").read_text(encoding="utf-8").count("</svg>") == 1
    assert re.findall(r'<section id="([\w-]+)"', page) == names
    assert page.count("<svg") == len(names)


def test_the_page_asks_for_nothing_but_the_figures_beside_it(recording, tmp_path):
    page = made(tmp_path, recording, "--at", "1")
    wanted = set(re.findall(r'(?:href|src)="([^"#]+)"', page)) - {"data:,"}
    assert wanted == {f"{name}.{kind}" for name in ("filmstrip", "attention", "latency") for kind in ("png", "svg")}
    assert not re.search(r"https?://(?!www\.w3\.org|purl\.org|creativecommons\.org)", page)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")
def test_in_a_browser_drawings_take_the_readers_ink_and_nothing_is_wider_than_a_phone(recording, tmp_path):
    sync_api = pytest.importorskip("playwright.sync_api")
    made(tmp_path, recording, evaluation(tmp_path / "e.json"), "--at", "1")
    with sync_api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        inks, said = {}, []
        for scheme in ("light", "dark"):
            page = browser.new_page(color_scheme=scheme, viewport={"width": 390, "height": 800})
            page.on("console", lambda message: said.append(message.text))
            page.goto((tmp_path / "index.html").as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") == 390
            inks[scheme] = page.evaluate("getComputedStyle(document.querySelector('#success svg')).fill")
        browser.close()
    assert (said, inks) == ([], {"light": "rgb(26, 29, 33)", "dark": "rgb(228, 232, 236)"})


def test_without_data_a_figure_is_left_out_and_the_page_says_why(recording, tmp_path):
    page = made(tmp_path, recording, "--at", "30")
    out = page.split('id="left-out"')[1]
    assert "it lasts 3.9 s, and reaches none of 30 s" in out
    assert "no study.json is given" in out
    assert "filmstrip" not in re.findall(r'<section id="([\w-]+)"', page)
    assert (tmp_path / "attention.png").exists()


def test_the_same_episodes_as_table_and_as_rows_are_counted_once(tmp_path):
    with (tmp_path / "rows.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["scenario", "agent", "wish_mps", "success", "collided", "struck", "ride_score"])
        writer.writeheader()
        for k in range(4):
            row = {"scenario": "merge", "agent": "ours", "success": k > 0, "collided": k == 0, "struck": False}
            writer.writerow({**row, "wish_mps": "", "ride_score": 60.0 + k})
    counted = read([tmp_path / "rows.csv"]).successes
    (one,) = counted
    assert (one.road, one.driver, one.episodes, one.success, one.own_fault) == ("merge", "ours", 4, 0.75, 1)
    assert [one.low, one.high] == wilson95(3, 4)
    assert one.ride == (61.5, 60.2, 62.8)
    table = {
        "agent": "ours", "scenario": "merge", "wish_mps": None, "episodes": 4, "success": 0.75,
        "success_ci95": wilson95(3, 4), "ego_fault_collisions": 1,
        "ride_score": 61.5, "ride_score_low": 60.23, "ride_score_high": 62.77,
    }  # fmt: skip
    (tmp_path / "table.json").write_text(json.dumps({"schema": EVALUATE, "rows": [table]}), encoding="utf-8")
    assert read([tmp_path / "rows.csv", tmp_path / "table.json"]).successes == counted


def test_other_episodes_of_the_same_driver_on_the_same_road_are_told_apart_by_their_files(tmp_path):
    plain, dense = evaluation(tmp_path / "plain.json", 0.95), evaluation(tmp_path / "dense.json", 0.5)
    found = read([plain, dense]).successes
    assert {one.driver for one in found} >= {"ours (plain.json)", "ours (dense.json)"}
    assert len({(one.road, one.driver) for one in found}) == len(found)


def test_the_numbers_beside_the_bars_have_the_interval(tmp_path):
    page = made(tmp_path, evaluation(tmp_path / "e.json"))
    low, high = (100 * share for share in wilson95(19, 20))
    assert f"<td>95.0 %</td><td>{low:.1f} to {high:.1f} %</td><td>70.0 (60.0 to 80.0)</td><td>1</td>" in page
    assert "rule, 20 m/s wished" in page


def test_latency_has_the_simulators_own_times_and_a_benchmarks(recording, tmp_path):
    row = {"what": "ours", "load": "none", "pace": "15hz"}
    bench = {"schema": BENCH, "rows": [row], "histograms": {"ours/none/15hz": histogram([400.0] * 98 + [25_000.0] * 2)}}
    (tmp_path / "latency.json").write_text(json.dumps(bench), encoding="utf-8")
    page = made(tmp_path / "out", recording, tmp_path / "latency.json", "--at", "1")
    run = recording.parent.name
    assert f"<td>{run}</td><td>round trip</td><td>20</td><td>0.31</td><td>0.32</td><td>0.32</td><td>0</td>" in page
    assert re.search(rf"<td>{run}</td><td>until it is decided</td><td>60</td>", page)
    assert re.search(r"load none</td><td>ours</td><td>100</td><td>0.40</td><td>2\d\.\d\d</td>.*?<td>2</td>", page)


def test_a_folder_of_a_run_stands_for_what_it_holds(recording, tmp_path):
    study(tmp_path / "study.json")
    found = read([recording.parent, tmp_path])
    assert (len(found.recordings), len(found.studies)) == (1, 1)
    with pytest.raises(ConfigError, match="holds none of"):
        read([Path(__file__).parent])


def test_what_cannot_be_read_is_told_in_a_line_that_names_what_can(recording, tmp_path):
    (tmp_path / "diary.json").write_text('{"schema": "diary/1"}', encoding="utf-8")
    (tmp_path / "empty.json").write_text(json.dumps({"schema": EVALUATE, "rows": []}), encoding="utf-8")
    (tmp_path / "diary.csv").write_text("day,mood\n1,good\n", encoding="utf-8")
    out = ("-o", tmp_path / "out")
    for name in ("diary.json", "diary.csv", "empty.json"):
        assert f"{name} is none of: a recording, what `evaluate --json`" in failed(tmp_path / name, *out)
    assert "No such file" in failed(tmp_path / "none.mcap", *out)
    assert "there is nothing to draw" in failed(write(tmp_path / "short.mcap", list(driven(0.1))[:1]), *out)
    (tmp_path / "out.txt").write_text("", encoding="utf-8")
    assert "cannot write" in failed(recording, "-o", tmp_path / "out.txt" / "deeper")
