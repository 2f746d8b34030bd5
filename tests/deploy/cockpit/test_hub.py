"""One picture, many pages: the newest frame for each, every note for each, and nothing for who does not read."""

from __future__ import annotations

import json
from typing import Any

from deploy.cockpit.hub import IN_FLIGHT, MAX_BYTES, Hub, Page
from deploy.cockpit.sources import BusSource
from schemas.runtime.clock import NS
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics
from schemas.wire.messages import Command, Reply
from tests.cockpit_scene import seen


class Car:
    """A bus, a hub on it and a clock that is moved by hand."""

    def __init__(self) -> None:
        self.bus, self.now_ns, self.tick = LocalBus(), 10 * NS, 0
        self.hub = Hub(BusSource(self.bus, lambda: self.now_ns), lambda: self.now_ns)

    def page(self) -> Page:
        page = Page()
        self.hub.pages.add(page)
        return page

    def drive(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.bus.publish(topics.OBSERVATION, seen(self.tick))
            self.tick += 1
            self.now_ns += NS // 15
            self.hub.poll()

    def says(self, number: int, text: str = "well") -> None:
        self.bus.publish(
            topics.REPLY, Reply(epoch=1, stamp_ns=self.now_ns, command_id=number, outcome="issued", text="", say=text)
        )


def read(car: Car, page: Page) -> dict[str, Any] | None:
    payload = car.hub.message_for(page)
    if payload is None:
        return None
    page.confirm()
    message: dict[str, Any] = json.loads(payload)
    return message


def test_a_page_gets_the_newest_frame_and_the_road_once():
    car = Car()
    page = car.page()
    car.drive(5)
    first = read(car, page)
    car.drive()
    second = read(car, page)
    assert first is not None
    assert second is not None
    assert (first["frame"]["tick"], second["frame"]["tick"]) == (4, 5)
    assert (len(first["road"]["lanes"]), "road" in second) == (2, False)


def test_nothing_new_is_nothing_to_send():
    car = Car()
    page = car.page()
    car.drive()
    read(car, page)
    assert read(car, page) is None


def test_a_page_that_confirms_nothing_is_sent_nothing_more_and_its_frames_are_counted():
    car = Car()
    page = car.page()
    sent = 0
    for _ in range(100):
        car.drive()
        sent += car.hub.message_for(page) is not None
    assert sent == IN_FLIGHT
    assert car.hub.metrics()["dropped"] >= 100 - IN_FLIGHT - 2


def test_a_frozen_page_costs_another_none_of_its_frames():
    car = Car()
    frozen, awake = car.page(), car.page()
    for _ in range(50):
        car.drive()
        car.hub.message_for(frozen)
        message = read(car, awake)
        assert message is not None
        assert message["frame"]["tick"] == car.tick - 1
    assert awake.dropped == 0


def test_every_note_reaches_a_page_once_however_many_frames_it_missed():
    car = Car()
    page = car.page()
    for number in range(20):
        car.says(number)
        car.drive(3)
    heard = []
    while (message := read(car, page)) is not None:
        heard += [note["command_id"] for note in message["notes"]]
    assert heard == list(range(20))


def test_a_page_that_comes_late_or_again_gets_all_that_was_said():
    car = Car()
    car.says(1)
    car.drive(30)
    for _ in range(2):
        message = read(car, car.page())
        assert message is not None
        assert [note["command_id"] for note in message["notes"]] == [1]


def test_a_message_stays_bounded_however_much_there_is_to_tell():
    car = Car()
    page = car.page()
    for number in range(350):
        car.says(number, "x" * 590)
        car.hub.poll()
    sizes, told = [], 0
    while (payload := car.hub.message_for(page)) is not None:
        page.confirm()
        sizes.append(len(payload))
        told += len(json.loads(payload)["notes"])
    assert told == 350
    assert max(sizes) < MAX_BYTES + 8000


def test_what_is_said_on_the_page_reaches_the_bus_as_a_command():
    car = Car()
    commands = car.bus.subscribe(topics.COMMAND)
    car.hub.source.say("  faster please ")
    [command] = commands.take()
    assert isinstance(command, Command)
    assert (command.text, command.source) == ("faster please", "cockpit")


def test_without_ticks_a_frame_still_goes_out_for_the_ages_of_the_heartbeats():
    car = Car()
    page = car.page()
    for _ in range(4):
        car.now_ns += NS // 4
        car.hub.poll()
        assert read(car, page) is not None
