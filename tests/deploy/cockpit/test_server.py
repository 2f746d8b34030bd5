"""Who may look and who may speak: hosts, origins, headers, and pages that mean harm."""

from __future__ import annotations

import json

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from deploy.cockpit.config import CockpitConfig
from deploy.cockpit.hub import Hub
from deploy.cockpit.server import ASKS, MAX_PAGES, WEB, Allowance, application
from deploy.cockpit.sources import BusSource
from schemas.runtime.bus import Subscription
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics
from schemas.wire.messages import Command, Status

HOST = "127.0.0.1:8000"
HERE = f"http://{HOST}"
LIVE = f"ws://{HOST}/live"


class Site:
    def __init__(self, *, writable: bool = True) -> None:
        self.bus = LocalBus()
        self.commands: Subscription[Command] = self.bus.subscribe(topics.COMMAND)
        self.hub = Hub(BusSource(self.bus))
        self.client = TestClient(application(self.hub, writable=writable), base_url=HERE)

    def answer(self, ask: object, **headers: str) -> str:
        """What is refused of an ask; "" if nothing is."""
        with self.client.websocket_connect(LIVE, headers=headers) as page:
            self.hub.poll()
            page.receive_text()
            page.send_text(json.dumps(ask))
            page.send_text(json.dumps({"do": "nonsense"}))  # is always refused, so that there is an end to wait for
            while "refused" not in (message := json.loads(page.receive_text())):
                pass
            refused: str = message["refused"]
            return refused


@pytest.fixture
def site() -> Site:
    return Site()


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost:9123", "[::1]:8000", "127.0.0.2"])
def test_a_loopback_host_is_served(site, host):
    assert site.client.get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example:8000", "127.0.0.1.evil.example", "10.0.0.7:8000", "", "localhost.evil", "["]
)
def test_another_host_is_refused(site, host):
    assert site.client.get("/", headers={"host": host}).status_code == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:8000", "http://127.0.0.1:8001"])
def test_a_page_of_another_origin_gets_no_connection(site, origin):
    with pytest.raises(WebSocketDisconnect), site.client.websocket_connect(LIVE, headers={"origin": origin}):
        pass


def test_the_own_origin_gets_one(site):
    assert "takes no orders" in site.answer({"seen": 1}, origin=HERE)


@pytest.mark.parametrize("path", ["/", "/app.js", "/style.css", "/missing.js"])
def test_every_answer_forbids_foreign_scripts_frames_and_sniffing(site, path):
    headers = site.client.get(path).headers
    assert "script-src 'self'" in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("path", ["/../config.py", "/%2e%2e/config.py", "/..%2fconfig.py", "//etc/passwd"])
def test_nothing_outside_of_the_pages_folder_is_served(site, path):
    assert site.client.get(path).status_code == 404


def test_the_page_asks_nobody_else_for_anything():
    assert [p.name for p in WEB.iterdir() if "://" in p.read_text().replace("http://www.w3.org/2000/svg", "").replace(
        "://${location.host}", "")] == []  # fmt: skip


def test_words_reach_the_car(site):
    site.answer({"say": "a bit faster"})
    assert [command.text for command in site.commands.take()] == ["a bit faster"]


@pytest.mark.parametrize("words", ["", "   ", "x" * 501])
def test_nothing_and_too_much_do_not(site, words):
    assert site.answer({"say": words}) != ""
    assert site.commands.take() == []


RESTARTS = [
    ({"scenario": "merge", "seed": 4, "density": 2}, ""),
    ({"scenario": "", "density": 0.5}, ""),
    ({"scenario": "moon"}, "no such road"),
    ({"seed": -1}, "whole number from 0"),
    ({"seed": 1.5}, "whole number from 0"),
    ({"density": 9}, "not within 0.2..3"),
    ({"density": "much"}, "is a number"),
    ({"scenario": "merge-v0", "density": 2}, "has no density but 1"),
]


@pytest.mark.parametrize(("world", "refused"), RESTARTS)
def test_a_restart_reaches_the_simulator_or_is_refused_with_what_is_possible(site, world, refused):
    orders = site.bus.subscribe(topics.CONTROL)
    beat = Status(epoch=0, stamp_ns=0, node="sim", pid=1, seq=1, state="ready", metrics={"paused": 0.0})
    site.bus.publish(topics.STATUS, beat)
    assert refused in site.answer({"do": "restart", "value": world})
    asked = [{"scenario": o.scenario, "seed": o.seed, "density": o.density} for o in orders.take()]
    assert asked == ([] if refused else [{"scenario": "", "seed": None, "density": None, **world}])


def test_beyond_loopback_a_page_may_look_but_not_speak():
    site = Site(writable=False)
    assert "read-only" in site.answer({"say": "faster"}, host="10.0.0.7:8000")
    assert site.commands.take() == []
    assert not CockpitConfig(host="0.0.0.0").writable
    assert CockpitConfig(host="::1").writable


@pytest.mark.parametrize("junk", ["", "{", "[]", '{"seen": "x"}', '{"unknown": 1}', "null", '{"say": 5}'])
def test_a_page_that_talks_nonsense_is_let_go(site, junk):
    with site.client.websocket_connect(LIVE) as page:
        page.send_text(junk)
        assert page.receive()["type"] == "websocket.close"
    assert len(site.hub.pages) == 0


def test_more_pages_than_the_bound_are_turned_away(site):
    pages = [site.client.websocket_connect(LIVE) for _ in range(MAX_PAGES)]
    for page in pages:
        page.__enter__()
    with pytest.raises(WebSocketDisconnect), site.client.websocket_connect(LIVE):
        pass
    for page in pages:
        page.__exit__(None, None, None)


def test_a_flood_of_wishes_is_held_back():
    allowance = Allowance(0.0)
    assert sum(allowance.take(0.0) for _ in range(1000)) == ASKS
    assert sum(allowance.take(60.0) for _ in range(1000)) == ASKS
