"""The links within a car: who may say what to whom."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import msgspec
import pytest

from deploy.run.launch import temporary_folder
from deploy.run.links import DoorOptions, Links, carried, roles_of
from schemas.runtime.bus import BusConfig, BusError, ZenohBus, open_bus
from schemas.runtime.bus_settings import Tls
from schemas.wire.roles import NODES
from schemas.wire.topics import ACTION, COMMAND, DIRECTIVE, OBSERVATION, STATUS, TOPICS
from tests.waiting import until

CALLED = {"fast": (), "sim": ("fast",), "slow": ("sim", "fast")}
TLS = Tls(ca="ca.pem", cert="door.pem", key="door.key")


@pytest.fixture
def links() -> Iterator[Links]:
    with temporary_folder() as folder:
        made = Links(folder)
        made.write_logins()
        yield made


def peer(links: Links, name: str) -> BusConfig:
    return links.peer(name, *CALLED[name])


def everybody(links: Links, stack: ExitStack) -> dict[str, ZenohBus]:
    """All sessions of a car, linked."""
    configs: dict[str, Any] = {
        "supervisor": links.supervisor(),
        **{name: peer(links, name) for name in CALLED},
        **{name: links.client(name) for name in ("cockpit", "record", "door")},
    }
    return {name: stack.enter_context(open_bus(config)) for name, config in configs.items()}


def test_each_topic_comes_to_each_node_from_those_who_may_put_it_and_from_nobody_else(links: Links) -> None:
    with ExitStack() as stack:
        buses = everybody(links, stack)
        speakers = buses.keys() - {"supervisor"}  # which brings what the others say, and is trusted with it
        readers = {
            (name, topic.name): buses[name].subscribe_bytes(topic)
            for name in ("sim", "fast", "slow", "supervisor")
            for topic in TOPICS
        }
        heard: dict[tuple[str, str], set[str]] = {key: set() for key in readers}

        def listen() -> None:
            for key, reader in readers.items():
                heard[key].update(payload.decode() for payload in reader.take())

        wanted = {
            (name, topic.name): {who for who in speakers if who != name and topic in NODES[who]}
            for name, topic in ((n, t) for n in ("sim", "fast", "slow", "supervisor") for t in TOPICS)
        }

        def all_said() -> bool:
            for who in speakers:
                for topic in TOPICS:
                    buses[who].publish_bytes(topic, who.encode())
            time.sleep(0.01)
            listen()
            return all(heard[key] - {key[0]} >= wanted[key] for key in readers)

        until(all_said, "somebody is not heard who should be")
        for _ in range(20):
            all_said()
    assert {key: who - {key[0]} for key, who in heard.items()} == wanted
    assert wanted["sim", "action"] == {"fast"}
    assert wanted["fast", "directive"] == {"slow"}
    assert wanted["fast", "observation"] == {"sim"}


def test_who_has_no_password_is_not_linked(links: Links) -> None:
    with open_bus(links.supervisor()):
        stranger = BusConfig(mode="client", connect=(links.socket("bus"),))
        with pytest.raises(BusError), open_bus(stranger):
            pass
        with open_bus(links.client("cockpit")):
            pass


def test_who_gives_the_name_of_another_with_a_password_of_its_own_is_not_linked(links: Links) -> None:
    forged = links.folder / "forged"
    forged.write_text("fast:guessed\n")
    with open_bus(links.supervisor()):
        config = msgspec.structs.replace(links.client("cockpit"), login="fast", logins=str(forged))
        with pytest.raises(BusError), open_bus(config):
            pass


def test_a_name_without_a_password_is_told(links: Links) -> None:
    config = msgspec.structs.replace(links.client("cockpit"), login="wheels")
    with pytest.raises(BusError, match="wheels is not in"), open_bus(config):
        pass


def test_passwords_are_this_users_alone_and_new_in_each_run(links: Links) -> None:
    assert stat.S_IMODE(os.stat(links.logins).st_mode) == 0o600
    before = links.logins.read_text()
    links.write_logins()
    assert links.logins.read_text() != before
    assert [line.partition(":")[0] for line in before.splitlines()] == list(NODES)


def test_no_password_is_in_what_a_process_is_told(links: Links) -> None:
    passwords = [line.partition(":")[2] for line in links.logins.read_text().splitlines()]
    told = repr([links.peer("sim", "fast"), links.client("door"), links.supervisor()])
    assert not any(password in told for password in passwords)


def test_only_what_is_left_out_may_be_stood_in_for() -> None:
    door = DoorOptions(listen="tcp/127.0.0.1:1")
    assert carried(door)[0] == (COMMAND,)
    assert set(carried(door, ["fast"])[0]) >= {COMMAND, ACTION, STATUS}
    assert {DIRECTIVE, OBSERVATION}.isdisjoint(carried(door, ["fast"])[0])
    secure = DoorOptions(listen="tls/0.0.0.0:1", tls=TLS)
    assert set(roles_of(secure)) == {"passenger", "operator", "recorder"}
    assert set(roles_of(secure, ["slow"])) == {"passenger", "operator", "recorder", "slow"}
