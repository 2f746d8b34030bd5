"""`python -m deploy.door '{"bus": {...}, "outside": {...}}'`: let users in until a signal.

It has two sessions. The outer one is a router that strangers may reach, with zenoh's access control; the inner one is a
client of the supervisor's router. Nothing passes from one to the other but what `carrier` carries.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from deploy.door.carrier import Carrier
from deploy.door.config import DoorConfig
from deploy.door.sockets import allow_many, do_not_linger
from schemas.runtime.bus import BusError, Subscription, ZenohBus, open_bus
from schemas.runtime.process import ConfigError, Heartbeat, load_config, log, run_node
from schemas.runtime.realtime import weigh_session
from schemas.wire import topics
from schemas.wire.topics import Topic

NAME = "door"
POOLS = "(rx:(worker_threads:2))"
"""Of zenoh's threads: as zenoh has them, since here some may stand still."""
LOOK_S = 0.2
NICE = 10
"""Of its whole session: a flood must not take the cores from who drives, but a passenger's word is no idle matter."""


def carriers(inner: ZenohBus, outer: ZenohBus, config: DoorConfig) -> tuple[Carrier, ...]:
    """All of them, not yet begun."""

    def refuse(topic: Topic[Any], why: str) -> None:
        inner.faults[topic.name] = inner.faults.get(topic.name, 0) + 1
        inner.last_fault = f"{topic.name}: {why}"

    def told_of(topic: Topic[Any]) -> Subscription[bytes]:
        """What is said inside; of a topic that it carries in as well, nothing that it puts itself."""
        return inner.subscribe_others(topic) if topic in inward else inner.subscribe_bytes(topic)

    named = {topic.name: topic for topic in topics.TOPICS}
    inward, outward = ([named[name] for name in names] for names in (config.inward, config.outward))
    return (
        *(
            Carrier(topic, outer.subscribe_others(topic), inner.publish_bytes, refuse, config.stand_ins)
            for topic in inward
        ),
        *(Carrier(topic, told_of(topic), outer.publish_bytes) for topic in outward),
    )


def main() -> None:
    config = load_config(DoorConfig, sys.argv[1:])
    os.environ["ZENOH_RUNTIME"] = POOLS
    if config.polite:
        weigh_session(NICE)
    allow_many()
    try:
        with open_bus(config.bus) as inner, open_bus(config.outside) as outer:
            carrying = carriers(inner, outer, config)
            sockets = 0

            def metrics() -> dict[str, float]:
                return {"sockets": float(sockets), **{one.name: float(one.carried) for one in carrying}}

            with Heartbeat(inner, NAME, metrics):
                for carrier in carrying:
                    carrier.start()
                log(NAME, "ready", listen=config.outside.listen, inward=config.inward)
                while True:
                    sockets = do_not_linger()
                    time.sleep(LOOK_S)
    except BusError as error:
        raise ConfigError(f"users cannot be let in at {', '.join(config.outside.listen)}: {error}") from None


if __name__ == "__main__":
    code = run_node(NAME, main)
    sys.stderr.flush()
    os._exit(code)  # zenoh's threads that listen would take two seconds to end
