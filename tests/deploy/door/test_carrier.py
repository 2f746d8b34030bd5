"""What passes the door, and how fast."""

from __future__ import annotations

import pytest

from deploy.door.carrier import Carrier, Pace, why_not
from deploy.door.config import DoorConfig
from schemas.runtime.bus import BusConfig
from schemas.runtime.local_bus import LocalBus
from schemas.runtime.process import ConfigError, load_config
from schemas.wire import topics
from schemas.wire.codec import encode
from schemas.wire.messages import Directive, Event, EventKind, Status


def test_after_a_burst_only_so_many_a_second_pass() -> None:
    pace = Pace(10.0, 3)
    assert [pace.delay_s(5.0) for _ in range(5)] == pytest.approx([0.0, 0.0, 0.0, 0.1, 0.2])
    assert pace.delay_s(60.0) == 0.0


@pytest.mark.parametrize("text", [b"please slow down", b"\xff\xfe", b""])
def test_a_command_may_be_anything_that_is_short(text: bytes) -> None:
    assert why_not(topics.COMMAND, text) == ""
    assert "exceed" in why_not(topics.COMMAND, b"x" + text + b"x" * topics.COMMAND.max_bytes)


def test_any_other_topic_takes_only_its_own_messages() -> None:
    good = Directive(epoch=1, stamp_ns=0, id=1, command_id=1, scene_tick=0)
    assert why_not(topics.DIRECTIVE, encode(good)) == ""
    assert "not a Directive" in why_not(topics.DIRECTIVE, b"please slow down")


@pytest.mark.parametrize("node", ["sim", "supervisor", "slow", ""])
def test_an_event_and_a_status_pass_in_the_name_of_a_stand_in_and_of_nobody_else(node: str) -> None:
    for name, may in ((node, False), ("fast", True)):
        status = Status(epoch=0, stamp_ns=0, node=name, pid=1, seq=0, state="ready")
        event = Event(epoch=0, stamp_ns=0, kind=EventKind.WORLD, node=name, tick=0)
        for topic, message in ((topics.STATUS, status), (topics.EVENT, event)):
            assert (why_not(topic, encode(message), ("fast",)) == "") is may


def test_what_may_not_pass_is_named_and_what_follows_it_still_passes() -> None:
    outside, inside = LocalBus(), LocalBus()
    arrived, refused = inside.subscribe_bytes(topics.COMMAND), list[str]()
    source = outside.subscribe_bytes(topics.COMMAND)
    outside.publish_bytes(topics.COMMAND, b"x" * 10_000)
    outside.publish_bytes(topics.COMMAND, b"faster")
    carrier = Carrier(topics.COMMAND, source, inside.publish_bytes, lambda _, why: refused.append(why))
    carrier.run()
    assert carrier.name == "in_command"
    assert (arrived.take(), refused, carrier.carried) == ([b"faster"], ["10000 bytes exceed 3072"], 1)


def test_a_door_for_a_topic_that_there_is_not_is_refused() -> None:
    with pytest.raises(ConfigError, match="no topic 'acton'"):
        load_config(DoorConfig, ['{"outside": {}, "inward": ["acton"]}'])
    assert DoorConfig(outside=BusConfig()).inward == ("command",)
