"""A car that is reached from other hosts: certificates say who may do what, and outsiders may do nothing.

Door and visitors are in network namespaces of their own, joined by a cable, where this machine lets us make them (as
root, with `ip`); elsewhere all are on loopback.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from deploy.run.certificates import certificates
from deploy.run.launch import children, environment, temporary_folder
from deploy.run.links import DoorOptions, Links, car_name, endpoint
from deploy.run.processes import door_process, free_port
from schemas.runtime.bus import BusConfig, ZenohBus, open_bus
from schemas.runtime.bus_settings import Tls
from schemas.runtime.process import ConfigError
from schemas.wire import topics
from schemas.wire.messages import Status
from schemas.wire.roles import ROLES
from schemas.wire.topics import TOPICS
from tests.waiting import until

ROOT = Path(__file__).parents[3]
AUTHORITY = ROOT / "deploy/secure/authority.sh"
NAME = "car-7"
QUIET_S = 0.5
ROUNDS = 40
"""Of a visitor, after all that may pass has passed."""

pytestmark = [pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl"), pytest.mark.timeout(180)]


def made(folder: Path, *hosts: str) -> Path:
    subprocess.run(["sh", str(AUTHORITY), str(folder), *hosts], check=True, capture_output=True)
    return folder


def shown(folder: Path, role: str) -> Tls:
    found = certificates(str(folder / f"{role}.pem"), None, None, listens=role == "door")
    assert found is not None
    return found


@pytest.fixture(scope="module")
def made_wrong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates, those of another authority in `other`, one that has expired, and a key with a password."""
    folder = made(tmp_path_factory.mktemp("certs"))
    made(folder / "other")
    signed = "x509 -x509toreq -in door.pem -signkey door.key -out old.csr"
    expired = "x509 -req -in old.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days -1 -out old.pem"
    locked = "pkey -in door.key -aes256 -passout pass:secret -out locked.key"
    for words in (signed, expired, locked):
        subprocess.run(["openssl", *words.split()], cwd=folder, check=True, capture_output=True)
    return folder


@dataclass
class Hosts:
    """Two hosts: how to run something on each, and where the first one listens."""

    car: tuple[str, ...] = ()
    visitor: tuple[str, ...] = ()
    address: str = "127.0.0.1"

    @property
    def apart(self) -> bool:
        return bool(self.car)


def _ip(*words: str) -> bool:
    try:
        return subprocess.run(["ip", *words], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


@pytest.fixture(scope="module")
def hosts() -> Iterator[Hosts]:
    mark = os.getpid() % 100_000
    car, visitor, cable = f"fscar{mark}", f"fsvis{mark}", (f"fsa{mark}", f"fsb{mark}")
    steps = (
        ("netns", "add", car),
        ("netns", "add", visitor),
        ("link", "add", cable[0], "netns", car, "type", "veth", "peer", "name", cable[1], "netns", visitor),
        *(("-n", space, "link", "set", "lo", "up") for space in (car, visitor)),
        ("-n", car, "addr", "add", "10.77.0.1/24", "dev", cable[0]),
        ("-n", visitor, "addr", "add", "10.77.0.2/24", "dev", cable[1]),
        ("-n", car, "link", "set", cable[0], "up"),
        ("-n", visitor, "link", "set", cable[1], "up"),
    )
    try:
        if all(_ip(*step) for step in steps):
            yield Hosts(("ip", "netns", "exec", car), ("ip", "netns", "exec", visitor), "10.77.0.1")
        else:
            yield Hosts()
    finally:
        for space in (car, visitor):
            _ip("netns", "del", space)


class Visit(msgspec.Struct):
    """What a visitor tells after a round; no rounds: it was not let in."""

    rounds: int = 0
    told: list[str] = []


@dataclass
class Car:
    inside: ZenohBus
    hosts: Hosts
    endpoint: str
    folder: Path
    """With the certificates."""

    def visited(
        self, config: BusConfig, puts: Collection[str] = (), reads: Collection[str] = ()
    ) -> tuple[Visit, set[str]]:
        """What a visitor tells last, and the topics on which something of it came in.

        puts, reads: the topics that are waited for, in and out.
        """
        puts, reads = set(puts), set(reads)
        heard = {topic.name: self.inside.subscribe_bytes(topic) for topic in TOPICS}

        def come() -> set[str]:
            mine = (b"inside", b"door")
            taken = {name: reader.take() for name, reader in heard.items()}
            return {name for name, these in taken.items() if any(not any(m in one for m in mine) for one in these)}

        last_s = time.monotonic()
        while time.monotonic() - last_s < QUIET_S:  # the door may still carry what the last visitor said
            last_s = time.monotonic() if come() else last_s
            time.sleep(0.05)
        told = msgspec.json.encode(config).decode()
        visit = subprocess.Popen(
            [*self.hosts.visitor, sys.executable, "-m", "tests.deploy.door.visitor", told],
            cwd=ROOT,
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert visit.stdin
        assert visit.stdout
        lines = visit.stdout
        found = [Visit()]
        reader = threading.Thread(
            target=lambda: found.extend(msgspec.json.decode(line, type=Visit) for line in lines), daemon=True
        )
        reader.start()
        came, last_round = set[str](), None

        def is_over() -> bool:
            """All that may pass has, and had it been more, the rounds since would have shown it."""
            nonlocal came, last_round
            for topic in TOPICS:
                self.inside.publish_bytes(topic, b"inside")
            time.sleep(0.05)
            came |= come()
            if last_round is None and found[-1].rounds and came >= puts and set(found[-1].told) >= reads:
                last_round = found[-1].rounds + ROUNDS
            return visit.poll() is not None or (last_round is not None and found[-1].rounds >= last_round)

        until(is_over, f"what should pass does not: in {came}, out {found[-1].told}")
        visit.stdin.close()
        visit.wait()
        reader.join()
        visit.stdout.close()
        return found[-1], came

    def client(self, tls: Tls | None, name: str = NAME, scheme: str = "tls") -> BusConfig:
        at = self.endpoint.replace("tls/", f"{scheme}/")
        return BusConfig(mode="client", connect=(at,), tls=tls, namespace=name)


@pytest.fixture(scope="module")
def car(hosts: Hosts) -> Iterator[Car]:
    with ExitStack() as stack:
        folder = stack.enter_context(temporary_folder())
        certs = made(folder / "certs", hosts.address)
        listen = f"tls/{hosts.address if hosts.apart else '127.0.0.1'}:{7447 if hosts.apart else free_port()}"
        links = Links(folder, DoorOptions(listen=listen, tls=shown(certs, "door"), name=NAME), frozenset({"fast"}))
        links.write_logins()
        inside = stack.enter_context(open_bus(links.supervisor()))
        beats = inside.subscribe(topics.STATUS)
        door = stack.enter_context(children())("door", [*hosts.car, *door_process(links).argv], folder / "door.jsonl")

        def is_up() -> Status | None:
            assert not door.trouble(), door.trouble()
            return beats.peek()

        until(is_up, "no door")
        yield Car(inside, hosts, listen, certs)


def test_the_page_on_using_it_gives_each_role_what_the_table_of_roles_gives_it() -> None:
    told = re.findall(r"^\| `(\w+)` \| (.*) \| (.*) \|$", (ROOT / "docs/using.md").read_text(), re.MULTILINE)
    rows = {role: cells for role, *cells in told if role in ROLES}
    every = {topic.name for topic in TOPICS}
    for role, may in ROLES.items():
        for cell, topics_ in zip(rows[role], (may.puts, may.reads), strict=True):
            names = {"nothing": set[str](), "everything": every}.get(cell, set(re.findall(r"`(\w+)`", cell)))
            assert names == {topic.name for topic in topics_}, role
    assert rows.keys() == ROLES.keys()


@pytest.mark.parametrize("role", ["passenger", "operator", "recorder", "fast"])
def test_each_role_does_its_job_and_no_more(role: str, car: Car, record_property: Any) -> None:
    may = ROLES[role]
    puts, reads = ({topic.name for topic in topics_} for topics_ in (may.puts, may.reads))
    found, came = car.visited(car.client(shown(car.folder, role)), puts, reads)
    record_property("measured", f"{role}, {'network namespaces' if car.hosts.apart else 'loopback'}")
    assert found.rounds
    assert came == puts
    assert set(found.told) == reads


def test_a_node_whose_place_is_taken_is_nobody(car: Car) -> None:
    found, came = car.visited(car.client(shown(car.folder, "slow")))
    assert (came, found.told) == (set(), [])


def outsiders(car: Car, elsewhere: Path) -> dict[str, BusConfig]:
    """Who is none of ours."""
    forged = made(elsewhere)
    ours = shown(car.folder, "operator")
    mixed = Tls(ca=ours.ca, cert=str(forged / "operator.pem"), key=str(forged / "operator.key"))
    return {
        "no certificate, no TLS": car.client(None, scheme="tcp"),
        "a certificate of another authority": car.client(shown(forged, "operator")),
        "a certificate of another authority that trusts ours": car.client(mixed),
    }


@pytest.mark.parametrize("number", range(3))
def test_an_outsider_delivers_and_receives_nothing(number: int, car: Car, tmp_path: Path, record_property: Any) -> None:
    who, config = list(outsiders(car, tmp_path).items())[number]
    found, came = car.visited(config)
    record_property("measured", f"{who}: {len(came)} samples in, {len(found.told)} out")
    assert (came, found.told) == (set(), [])


def test_who_calls_another_car_is_not_heard_by_this_one(car: Car) -> None:
    found, came = car.visited(car.client(shown(car.folder, "operator"), name="car-8"))
    assert (came, found.told) == (set(), [])


@pytest.mark.parametrize(
    ("text", "tls", "words"),
    [
        ("tls/0.0.0.0:7447", False, "needs --cert"),
        ("tcp/0.0.0.0:7447", False, "open to everybody"),
        ("tcp/127.0.0.1:7447", True, "no certificate"),
        ("tcp/127.0.0.1:99999", False, "no endpoint"),
        ("quic/127.0.0.1:7447", False, "no endpoint"),
        ("127.0.0.1:7447", False, "no endpoint"),
    ],
)
def test_where_nobody_could_be_let_in_safely_is_one_line_that_names_the_fix(text: str, tls: bool, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        endpoint(text, Tls(ca="a", cert="b", key="c") if tls else None, "--listen")


def test_files_that_are_no_certificates_are_named_with_their_option(tmp_path: Path) -> None:
    (tmp_path / "door.pem").write_text("nothing")
    with pytest.raises(ConfigError, match=r"door\.pem is no PEM file: give another one with --cert"):
        certificates(str(tmp_path / "door.pem"), None, None, listens=True)
    with pytest.raises(ConfigError, match="--key and --ca need --cert"):
        certificates(None, "door.key", None, listens=True)
    with pytest.raises(ConfigError, match=r"--cert: there is no file .*passenger\.pem: check the path"):
        certificates(str(tmp_path / "passenger.pem"), None, None, listens=True)
    with pytest.raises(ConfigError, match="letters, digits"):
        car_name("car/*")


def test_a_device_or_a_pipe_is_no_certificate_and_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in ("/dev/zero", str(tmp_path / "pipe")):
        with pytest.raises(ConfigError, match=f"--cert: {path} is no plain file"):
            certificates(path, None, None, listens=True)


@pytest.mark.parametrize(
    ("cert", "key", "ca", "words"),
    [
        ("door.pem", "operator.key", "ca.pem", r"operator\.key is no key .* of the certificate .*door\.pem: .*--key"),
        ("door.pem", "locked.key", "ca.pem", r"locked\.key is no key without a password"),
        ("door.key", "door.key", "ca.pem", r"no key .* of the certificate .*door\.key"),
        ("door.pem", "door.key", "door.key", r"door\.key is no certificate of an authority: .*--ca"),
        ("door.pem", "door.key", "door.pem", r"door\.pem is not good for --listen with .*--ca"),
        ("door.pem", "door.key", "other/ca.pem", r"door\.pem is not good for --listen with .*other/ca\.pem"),
        (
            "operator.pem",
            "operator.key",
            "ca.pem",
            r"operator\.pem is not good for --listen with .*: give another --cert",
        ),
        ("old.pem", "door.key", "ca.pem", r"old\.pem is not good .*expired"),
    ],
)
def test_key_certificate_and_authority_that_do_not_match_are_told_before_anything_starts(
    cert: str, key: str, ca: str, words: str, made_wrong: Path
) -> None:
    with pytest.raises(ConfigError, match=words) as told:
        certificates(str(made_wrong / cert), str(made_wrong / key), str(made_wrong / ca), listens=True)
    assert "\n" not in str(told.value)


def test_a_visitors_certificate_must_be_of_the_authority_that_it_trusts(made_wrong: Path) -> None:
    assert shown(made_wrong, "passenger").cert == str(made_wrong / "passenger.pem")
    with pytest.raises(ConfigError, match=r"passenger\.pem is not good for --connect"):
        certificates(str(made_wrong / "passenger.pem"), None, str(made_wrong / "other/ca.pem"), listens=False)


@pytest.mark.parametrize(
    ("host", "words"),
    [
        ("192.0.2.1", "cannot listen on 192.0.2.1:7555: .*; give an address of this computer"),
        ("[2001:db8::1]", r"cannot listen on \[2001:db8::1\]:7555: .*; give an"),
        ("nowhere..", "cannot listen on nowhere..:7555: there is no host of that name"),
    ],
)
def test_where_this_computer_cannot_listen_is_not_called_a_port_that_is_held(
    host: str, words: str, made_wrong: Path, tmp_path: Path
) -> None:
    told = subprocess.run(
        [sys.executable, "-P", "-m", "deploy", "run", f"--listen=tls/{host}:7555", f"--cert={made_wrong / 'door.pem'}"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment(),
        check=False,
    )
    assert told.returncode == 78
    assert re.fullmatch(f"fastslow: {words}.*\n", told.stderr)
    assert list(tmp_path.iterdir()) == []
