"""What the cockpit shows, from messages alone."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from deploy.cockpit.picture import NOTES, SILENT_NS, Picture
from schemas.runtime.clock import NS
from schemas.wire.messages import Closure, Command, Lane, Reason, Reply, Status
from tests.cockpit_scene import action, directive, event, seen


def notes(picture: Picture) -> list[dict[str, Any]]:
    return [json.loads(note.body) for note in picture.since(0)]


def picture_of(*messages: Any) -> Picture:
    picture = Picture()
    for message in messages:
        picture.take(message)
    return picture


def test_gap_and_time_to_collision_are_bumper_to_bumper_in_the_egos_lane():
    frame = picture_of(seen(0, (2, 425.0, 4.0, 1), (3, 380.0, 7.0, 1), (4, 500.0, -6.0, 0))).frame(10 * NS)
    assert (frame["ahead"]["gap"], frame["ahead"]["ttc"]) == (20.0, 10.0)
    assert (frame["behind"]["gap"], frame["behind"]["ttc"]) == (15.0, 15.0)
    assert (frame["oncoming"]["gap"], frame["oncoming"]["ttc"]) == (95.0, pytest.approx(7.9))


def test_nobody_near_is_none_and_not_infinite():
    frame = picture_of(seen()).frame(10 * NS)
    assert (frame["ahead"], frame["behind"], frame["oncoming"]) == (None, None, None)
    assert json.loads(msgspec.json.encode(frame)) == frame


def test_the_answer_is_timed_from_the_observation_that_it_answers():
    assert picture_of(seen(), action()).frame(11 * NS)["action"]["answered_ms"] == 0.4


CLOSED = Closure(action=3, reason=Reason.ONCOMING, vehicle=4)


def test_a_directive_waits_for_the_rule_that_closes_its_side_now():
    shown = picture_of(seen(), directive(), action(CLOSED)).frame(11 * NS)["directive"]
    assert (shown["state"], shown["reason"], shown["vehicle"]) == ("delayed", "oncoming traffic", 4)


def test_a_directive_that_is_thought_about_again_waits_on():
    picture = picture_of(seen(), directive(), action(CLOSED), seen(30), directive(id=8), action(CLOSED, tick=30))
    assert picture.frame(12 * NS)["directive"]["waited"] == 2.0


def test_a_directive_waits_no_longer_once_its_side_is_open_or_the_change_has_begun():
    picture = picture_of(seen(), directive(), action(CLOSED))
    assert picture_of(seen(), directive(), action()).frame(11 * NS)["directive"]["state"] == "active"
    picture.take(seen(1, target_lane=0, previous_lane=1))
    picture.take(action(CLOSED, tick=1))
    assert picture.frame(11 * NS)["directive"]["state"] == "active"


def test_a_wished_speed_waits_once_the_fast_node_has_said_so():
    faster = Closure(action=2, reason=Reason.SPEED_FOR_GAP, vehicle=2)
    picture = picture_of(seen(), directive(manoeuvre="cruise", target_lane=None), action(faster))
    assert picture.frame(11 * NS)["directive"]["state"] == "active"
    for message in (event("delayed", reason=faster.reason), action(faster)):
        picture.take(message)
    assert picture.frame(11 * NS)["directive"]["reason"] == "speed above the gap's"


def test_a_directive_that_has_ended_is_shown_a_little_longer_and_then_no_more():
    picture = picture_of(seen(), directive(), event("fulfilled"))
    assert picture.frame(12 * NS)["directive"]["state"] == "fulfilled"
    assert "directive" not in picture.frame(20 * NS)


def test_a_directive_of_another_world_is_not_shown():
    assert "directive" not in picture_of(seen(), directive(), seen(0, epoch=2)).frame(10 * NS)


def test_every_process_that_falls_silent_is_noted_once_and_again_when_it_is_back():
    beat = Status(epoch=1, stamp_ns=10 * NS, node="slow", pid=5, seq=1, state="ready")
    picture = picture_of(beat)
    for _ in range(3):
        picture.watch(beat.stamp_ns + SILENT_NS + 1)
    assert picture.frame(beat.stamp_ns + SILENT_NS + 1)["nodes"][0]["state"] == "gone"
    picture.take(msgspec.structs.replace(beat, stamp_ns=14 * NS, pid=6))
    assert [(note["node"], note["state"]) for note in notes(picture)] == [
        ("slow", "ready"), ("slow", "gone"), ("slow", "back"),
    ]  # fmt: skip


def test_what_is_said_and_answered_is_noted_in_order():
    picture = picture_of(
        Command(epoch=0, stamp_ns=10 * NS, id=3, text="overtake"),
        Reply(epoch=1, stamp_ns=11 * NS, command_id=3, outcome="issued", text="overtake", say="Yes.", directive_id=7),
        event("delayed", reason="oncoming traffic"),
    )
    assert [note["kind"] for note in notes(picture)] == ["command", "reply", "event"]
    assert notes(picture)[2]["what"] == "delayed"
    assert [note["n"] for note in notes(picture)] == [1, 2, 3]


def test_notes_are_bounded():
    picture = Picture()
    for number in range(NOTES + 50):
        picture.take(Command(epoch=0, stamp_ns=NS, id=number, text="x" * 500))
    assert len(picture.since(0)) == NOTES


def test_a_bent_lane_has_its_shape_from_the_simulators_own_geometry():
    lanes = tuple(Lane(y_m=4.0 * k, start_m=0.0, end_m=400.0) for k in range(3))
    shapes = picture_of(seen(scenario="merge", lanes=lanes)).road()["shapes"]  # type: ignore[index]
    assert shapes[:2] == [None, None]
    assert shapes[2][0][1] > shapes[2][-1][1] + 5.0


def test_the_road_of_a_foreign_simulator_is_straight():
    assert picture_of(seen(scenario="elsewhere")).road()["shapes"] == [None, None]  # type: ignore[index]


def test_seed_and_density_are_those_of_the_simulators_heartbeat():
    beat = Status(epoch=1, stamp_ns=0, node="sim", pid=1, seq=1, state="ready", metrics={"seed": 7.0, "density": 1.5})
    frame = picture_of(beat, seen()).frame(10 * NS)
    assert (frame["seed"], frame["density"]) == (7.0, 1.5)
