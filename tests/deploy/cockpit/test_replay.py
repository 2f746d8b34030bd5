"""A recording as a source: its speed, its playhead, its steps."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import pytest

from deploy.cockpit.sources import RecordingSource, Refused
from schemas.runtime.clock import NS
from schemas.wire.messages import Action, Command, Message, Observation
from tests.cockpit_scene import action, seen

OFFSET = 1_000 * NS


class Tape:
    """Ten seconds at 15 Hz, an action after each observation, and a command at 2 s."""

    clock_offset_ns = OFFSET

    def __init__(self) -> None:
        first_ns = OFFSET + 10 * NS
        self.start_ns = first_ns - 30 * NS  # the recorder was there before the car
        self.rows: list[tuple[int, str, Message]] = []
        for tick in range(150):
            at_ns = first_ns + tick * NS // 15
            self.rows.append((at_ns, "observation", seen(tick)))
            self.rows.append((at_ns + 400_000, "action", action(tick=tick)))
        said = Command(epoch=0, stamp_ns=12 * NS, id=1, text="faster")
        self.rows.append((first_ns + 2 * NS - 1, "command", said))
        self.rows.sort(key=lambda row: row[0])
        self.end_ns = self.rows[-1][0]

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[tuple[int, str, Message]]:
        for at_ns, topic, message in self.rows:
            if (
                (topics is None or topic in topics)
                and (start_ns is None or at_ns >= start_ns)
                and (end_ns is None or at_ns < end_ns)
            ):
                yield at_ns, topic, message


class Player:
    def __init__(self) -> None:
        self.now_ns = 0
        self.source = RecordingSource(Tape(), lambda: self.now_ns)

    def after(self, seconds: float) -> list[Message]:
        self.now_ns += round(seconds * NS)
        return self.source.take()


def ticks(messages: list[Message]) -> list[int]:
    return [m.tick for m in messages if isinstance(m, Observation)]


@pytest.mark.parametrize(("speed", "expected"), [(0.1, 2), (1.0, 16), (8.0, 121)])
def test_a_second_shows_as_many_ticks_as_the_speed_says(speed, expected):
    player = Player()
    player.source.control("speed", speed)
    assert len(ticks(player.after(1.0))) == expected


@pytest.mark.parametrize("speed", [0.0, -1.0, 9.0, float("nan")])
def test_another_speed_is_refused(speed):
    with pytest.raises(Refused):
        Player().source.control("speed", speed)


def test_a_paused_recording_stands_still_and_goes_on_where_it_was():
    player = Player()
    player.after(1.0)
    player.source.control("pause", None)
    assert player.after(5.0) == []
    player.source.control("resume", None)
    assert ticks(player.after(0.2)) == [16, 17, 18]


def test_a_step_is_one_tick_with_its_answer():
    player = Player()
    player.source.control("pause", None)
    player.after(0.0)
    for tick in (1, 2):
        player.source.control("step", None)
        assert ticks(shown := player.after(0.0)) == [tick]
        assert isinstance(shown[-1], Action)
        assert shown[-1].answers_tick == tick


def test_a_jump_makes_the_picture_whole_with_all_that_was_said_before():
    player = Player()
    before = player.source.generation
    player.source.control("seek", 9.0)
    messages = player.after(0.0)
    assert player.source.generation > before
    assert [m.text for m in messages if isinstance(m, Command)] == ["faster"]
    assert ticks(messages)[-1] == 135


def test_a_jump_back_forgets_what_was_said_later():
    player = Player()
    player.after(9.0)
    player.source.control("seek", 1.0)
    assert not any(isinstance(m, Command) for m in player.after(0.0))


@pytest.mark.parametrize("goal", [-5.0, 1e9])
def test_a_jump_stays_within_the_recording(goal):
    player = Player()
    player.source.control("seek", goal)
    assert 0.0 <= player.source.state()["position"] <= player.source.state()["length"]


def test_it_stops_at_its_end_and_begins_again_when_told_to_go_on():
    player = Player()
    player.after(20.0)
    assert player.source.paused
    player.source.control("resume", None)
    assert ticks(player.after(0.1))[0] == 0


def test_the_cars_clock_is_that_of_its_messages():
    player = Player()
    player.after(3.0)
    assert player.source.now_ns() == 13 * NS


def test_nobody_can_speak_to_a_recording():
    with pytest.raises(Refused):
        Player().source.say("faster")
