"""`python -m tests.deploy.door.visitor CONFIG SECONDS`: somebody at the door, who puts on every key.

Prints as JSON whether the door let it in, and the names of the topics that it was told of.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import msgspec

from schemas.runtime.bus import BusConfig, BusError, open_bus
from schemas.wire.codec import encode
from schemas.wire.messages import Action, Control, Directive, MetaAction, Status
from schemas.wire.topics import ACTION, COMMAND, CONTROL, DIRECTIVE, STATUS, TOPICS

SAYS: dict[str, Callable[[], bytes]] = {
    COMMAND.name: lambda: b"faster",
    CONTROL.name: lambda: encode(Control(epoch=0, stamp_ns=0, do="pause")),
    DIRECTIVE.name: lambda: encode(Directive(epoch=1, stamp_ns=0, id=1, command_id=1, scene_tick=0)),
    ACTION.name: lambda: encode(
        Action(epoch=1, stamp_ns=0, answers_tick=1, meta_action=int(MetaAction.CRUISE), source="policy")
    ),
    STATUS.name: lambda: encode(Status(epoch=0, stamp_ns=0, node="visitor", pid=1, seq=0, state="ready")),
}


def visit(config: BusConfig, seconds: float) -> dict[str, object]:
    told = set[str]()
    try:
        with open_bus(config) as bus:
            everything = bus.subscribe_all(512)
            until_s = time.monotonic() + seconds
            while time.monotonic() < until_s:
                for topic in TOPICS:
                    bus.publish_bytes(topic, SAYS.get(topic.name, lambda: b"visitor")())
                time.sleep(0.05)
                told.update(arrival.topic for arrival in everything.take() if b"inside" in arrival.payload)
    except BusError:
        return {"let_in": False, "told": []}
    return {"let_in": True, "told": sorted(told)}


if __name__ == "__main__":
    print(json.dumps(visit(msgspec.json.decode(sys.argv[1], type=BusConfig), float(sys.argv[2]))))
