"""A real run, recorded by the real processes, comes out again to the last bit."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.record.container import McapFile
from deploy.record.encoding import json_schema, to_json
from deploy.record.export import rows, to_csv
from deploy.record.reader import METADATA, open_recording
from schemas.wire.messages import SCHEMA_VERSION
from schemas.wire.topics import TOPICS
from tests.running import child_of
from tests.waiting import until

ROOT = Path(__file__).parents[3]
ENV = os.environ | {"PYTHONPATH": str(ROOT)}


def fastslow(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    env = {**ENV, "FASTSLOW_DATA": str(folder)}
    command = [sys.executable, "-m", "deploy", *arguments]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=150)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of eight seconds on a two-way road, with a passenger in a hurry."""
    folder = tmp_path_factory.mktemp("run")
    words = ("--say", "I'm in a hurry", "--say-at", "1", "--scenario", "two-way", "--without", "llm")
    ran = fastslow("run", "--port", "0", "--seed", "3", "--duration", "8", "--json", *words, folder=folder)
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout)["missed"] == 0
    (path,) = folder.glob("runs/*/recording.mcap")
    return path


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.timeout(300)
class TestARealRun:
    def test_every_decision_comes_out_again(self, recording):
        checked = fastslow("replay", str(recording), "--check", "--json", folder=recording.parent)
        result = json.loads(checked.stdout)
        assert checked.returncode == 0, checked.stdout
        kinds = ("actions", "events", "directives", "replies", "observations")
        assert [result[f"{kind}_identical"] for kind in kinds] == [100.0] * 5
        assert result["ticks"] == result["checked"]["observations"] == 121
        assert min(result["checked"].values()) > 0
        assert set(result["unchecked"].values()) == {0}

    def test_another_driver_is_shown_to_decide_otherwise(self, recording):
        shown = fastslow("replay", str(recording), "--policy", "constant:slower", "--json", folder=recording.parent)
        result = json.loads(shown.stdout)
        assert sum(row["ticks"] for row in result["table"]) == result["otherwise"] > 0
        assert all(one["recorded"] != one["other"] for one in result["first"])

    def test_a_changed_message_is_found(self, recording, tmp_path):
        changed = tmp_path / "changed.mcap"
        source, target = open_recording(recording), McapFile(changed)
        target.add_metadata(METADATA, source.metadata)
        channels = {t.name: target.channel(f"/{t.name}", t.name, json_schema(t.type)) for t in TOPICS}
        for time_ns, topic, message in source.messages():
            data = to_json(message)
            if topic == "action" and b'"answers_tick":60,' in data:
                data = data.replace(b'"source":"', b'"why":"changed","source":"', 1).replace(b',"why":""', b"", 1)
            target.add(channels[topic], time_ns, time_ns, data)
        target.finish()
        checked = fastslow("replay", str(changed), "--check", "--json", folder=tmp_path)
        result = json.loads(checked.stdout)
        assert checked.returncode == 1
        assert result["first_difference"]["tick"] == 60
        assert result["first_difference"]["recorded"] == {"why": "changed"}

    def test_the_tables_have_a_row_for_every_message_and_every_car(self, recording, tmp_path):
        source = open_recording(recording)
        counts = to_csv(source, tmp_path)
        assert sum(counts.values()) == sum(1 for _ in rows(source))
        with (tmp_path / "action.csv").open(encoding="utf-8") as file:
            actions = list(csv.DictReader(file))
        assert [int(row["answers_tick"]) for row in actions] == sorted(int(row["answers_tick"]) for row in actions)
        with (tmp_path / "vehicles.csv").open(encoding="utf-8") as file:
            assert sum(row["id"] == "0" for row in csv.DictReader(file)) == counts["observation"] == 121


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.timeout(200)
@pytest.mark.parametrize("victim", ["deploy.record", "fast_node"])
def test_after_a_death_what_is_recorded_still_comes_out_again(tmp_path, victim):
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-m", "deploy", "run", "--port", "0", "--seed", "3", "--duration", "8", "--json"]
    more = ["--without", "llm", "--without", "slow", "--record", str(path)]
    env = {**ENV, "FASTSLOW_DATA": str(tmp_path)}
    with subprocess.Popen(
        [*command, *more], cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as run:
        until(lambda: path.exists() and path.stat().st_size > 40_000)
        os.kill(child_of(run.pid, victim), signal.SIGKILL)
        summary = json.loads(run.communicate(timeout=120)[0])
    assert (run.returncode, summary["restarts"]) == (0, 1)
    assert (victim == "fast_node") == (summary["missed"] > 0)
    checked = fastslow("replay", str(path), "--check", "--json", folder=tmp_path)
    result = json.loads(checked.stdout)
    assert checked.returncode == 0, checked.stdout
    assert result["checked"]["actions"] > 0
    assert (victim == "fast_node") == (result["unchecked"]["actions"] == 0)


def test_a_recording_that_was_cut_off_gets_its_summary(tmp_path):
    path = tmp_path / "a.mcap"
    file = McapFile(path)
    file.add_metadata(METADATA, {"seed": "3"})
    assert "still being recorded" in fastslow("export", "a.mcap", "--finish", folder=tmp_path).stderr
    file.close()
    assert fastslow("export", "a.mcap", "--finish", folder=tmp_path).returncode == 0
    assert open_recording(path).finished


def test_a_recording_of_an_older_protocol_is_refused_with_what_can_read_it(tmp_path):
    file = McapFile(tmp_path / "a.mcap")
    file.add_metadata(METADATA, {"protocol": "2.2", "revision": "12716e2"})
    file.close()
    told = fastslow("replay", "a.mcap", "--check", folder=tmp_path)
    assert (told.returncode, told.stderr.count("\n")) == (78, 1)
    assert f"its protocol is 2.2, ours {SCHEMA_VERSION}: use the fastslow that recorded it (12716e2)" in told.stderr


@pytest.mark.parametrize("arguments", [("--check",), ("--policy", "rule")])
def test_what_is_no_recording_is_told_in_one_line(tmp_path, arguments):
    (tmp_path / "a.mcap").write_bytes(b"my diary, not a recording")
    told = fastslow("replay", "a.mcap", *arguments, folder=tmp_path)
    assert (told.returncode, told.stderr.count("\n")) == (78, 1)
    assert "a.mcap is not an MCAP file" in told.stderr
