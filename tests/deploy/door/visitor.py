"""`python -m tests.deploy.door.visitor CONFIG`: somebody at the door, who puts on every key until its stdin ends.

After each round it prints a line of JSON: how many there were, and the names of the topics that it was told of. Whoever
is not let in prints nothing.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import msgspec

from schemas.runtime.bus import BusConfig, BusError, open_bus
from schemas.wire.codec import encode
from schemas.wire.messages import Action, Control, Directive, Event, EventKind, MetaAction, Status
from schemas.wire.topics import ACTION, COMMAND, CONTROL, DIRECTIVE, EVENT, STATUS, TOPICS

SAYS: dict[str, Callable[[], bytes]] = {
    COMMAND.name: lambda: b"faster",
    CONTROL.name: lambda: encode(Control(epoch=0, stamp_ns=0, do="pause")),
    DIRECTIVE.name: lambda: encode(Directive(epoch=1, stamp_ns=0, id=1, command_id=1, scene_tick=0)),
    ACTION.name: lambda: encode(
        Action(epoch=1, stamp_ns=0, answers_tick=1, meta_action=int(MetaAction.CRUISE), source="policy")
    ),
    EVENT.name: lambda: encode(Event(epoch=0, stamp_ns=0, kind=EventKind.WORLD, node="fast", tick=0)),
    STATUS.name: lambda: encode(Status(epoch=0, stamp_ns=0, node="fast", pid=1, seq=0, state="ready")),
}


def visit(config: BusConfig, tell: Callable[[int, list[str]], None], ended: threading.Event) -> None:
    """Put on every key in rounds, and `tell` after each how many there were and of what it has been told."""
    told, rounds = set[str](), 0
    with open_bus(config) as bus:
        everything = bus.subscribe_all(512)
        while not ended.is_set():
            for topic in TOPICS:
                bus.publish_bytes(topic, SAYS.get(topic.name, lambda: b"visitor")())
            time.sleep(0.05)
            told.update(arrival.topic for arrival in everything.take() if b"inside" in arrival.payload)
            rounds += 1
            tell(rounds, sorted(told))


def main() -> None:
    ended = threading.Event()

    def await_end() -> None:
        sys.stdin.read()
        ended.set()

    def tell(rounds: int, told: list[str]) -> None:
        print(json.dumps({"rounds": rounds, "told": told}), flush=True)

    threading.Thread(target=await_end, daemon=True).start()
    with suppress(BusError):
        visit(msgspec.json.decode(sys.argv[1], type=BusConfig), tell, ended)


if __name__ == "__main__":
    main()
