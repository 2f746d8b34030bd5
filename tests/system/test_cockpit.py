"""The cockpit in a real browser, showing the real system: what a passenger sees, says and gets."""

from __future__ import annotations

import functools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import pytest

from tests.running import HURRY, ROOT, child_of

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(170)]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
PATIENCE_MS = 60_000
T = TypeVar("T")


def aside(does: Callable[[], T]) -> T:
    """What waits, on a thread of its own: this one runs the browser driver's event loop."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(does).result()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield browser
        browser.close()


@dataclass
class Run:
    """The system, with where its cockpit is."""

    process: subprocess.Popen[bytes]
    url: str


@pytest.fixture
def system(tmp_path: Path) -> Iterator[Callable[..., Run]]:
    running: list[subprocess.Popen[bytes]] = []

    def start(*options: str) -> Run:
        env = {k: v for k, v in os.environ.items() if not k.startswith("OPENAI_")}
        said = tmp_path / "said"
        with said.open("wb") as out:
            process = subprocess.Popen(
                [sys.executable, "-m", "deploy", "run", "--port", "0", "--cockpit-port", "0", *options],
                cwd=tmp_path,
                env=env | {"PYTHONPATH": str(ROOT), "FASTSLOW_DATA": str(tmp_path)},
                stdout=out,
                stderr=out,
            )
        running.append(process)
        return Run(process, aside(lambda: address_in(said, process)))

    yield start
    for process in running:
        process.send_signal(signal.SIGTERM)
        aside(functools.partial(process.wait, timeout=60))


def address_in(said: Path, process: subprocess.Popen[bytes]) -> str:
    """The cockpit's address, once the run has told it."""
    until = time.monotonic() + PATIENCE_MS / 1000
    while not (found := re.search(r"http://127\.0\.0\.1:\d+/", said.read_text())):
        assert process.poll() is None, said.read_text()
        assert time.monotonic() < until, said.read_text()
        time.sleep(0.1)
    return found.group()


@contextmanager
def page_on(browser: Any, url: str, width: int = 1440, height: int = 900) -> Iterator[Any]:
    """A page that shows the running car; at its end it has had no error and has asked nobody else for anything."""
    page = browser.new_page(viewport={"width": width, "height": height})
    errors: list[str] = []
    hosts: set[str | None] = set()
    page.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: hosts.add(urlsplit(request.url).hostname))
    page.goto(url)
    page.wait_for_selector("#link[data-is=live]", timeout=PATIENCE_MS)
    yield page
    page.close()
    assert errors == []
    assert hosts == {"127.0.0.1"}


def see(page: Any, selector: str, text: str, timeout: int = PATIENCE_MS) -> None:
    """Wait until an element with this text is to be seen."""
    page.locator(selector, has_text=text).first.wait_for(timeout=timeout)


def test_a_hurry_is_typed_waits_for_oncoming_traffic_and_ends_on_the_own_side_again(browser, system):
    run = system("--scenario", "two-way", "--seed", "2")
    with page_on(browser, run.url) as page:
        page.keyboard.press("/")
        page.keyboard.type(HURRY)
        page.keyboard.press("Enter")
        see(page, ".said", HURRY)
        see(page, ".heard", "issued")
        see(page, "#directive", "Overtake")
        see(page, "#directive .wait", "oncoming traffic")
        see(page, "#banner", "borrowed lane")
        see(page, ".heard", "fulfilled")
        page.reload()
        see(page, ".said", HURRY)
        see(page, ".heard", "fulfilled")
        page.click("#tab-thoughts")
        see(page, ".thought", HURRY)


def test_a_killed_node_is_seen_to_go_and_to_come_back_while_the_car_drives_on(browser, system):
    run = system("--scenario", "highway", "--seed", "3")
    with page_on(browser, run.url) as page:
        page.keyboard.press("3")
        page.locator("#nodes li", has_text="slow").first.wait_for(timeout=PATIENCE_MS)
        os.kill(aside(lambda: child_of(run.process.pid, "slow_node")), signal.SIGKILL)
        see(page, "#events li[data-kind=back]", "slow")
        assert page.get_attribute("#link", "data-is") == "live"


def test_a_killed_cockpit_comes_back_to_the_same_page(browser, system):
    run = system("--scenario", "highway", "--seed", "3")
    page = browser.new_page()
    page.goto(run.url)
    page.wait_for_selector("#link[data-is=live]", timeout=PATIENCE_MS)
    os.kill(aside(lambda: child_of(run.process.pid, "deploy.cockpit")), signal.SIGKILL)
    page.wait_for_selector("#link[data-is=lost]", timeout=PATIENCE_MS)
    page.wait_for_selector("#link[data-is=live]", timeout=PATIENCE_MS)
    page.close()


def test_a_page_that_hangs_costs_the_loop_no_tick(browser, system, tmp_path):
    run = system("--scenario", "highway", "--seed", "3", "--duration", "20")
    page = browser.new_page()
    page.goto(run.url)
    page.wait_for_selector("#link[data-is=live]", timeout=PATIENCE_MS)
    page.evaluate("() => { setTimeout(() => { for (;;); }, 0); }")
    aside(lambda: run.process.wait(timeout=120))
    summary = json.loads(next(tmp_path.glob("runs/*/summary.json")).read_text())
    assert run.process.returncode == 0
    assert summary["ticks"] - summary["answered"] <= 1


def test_on_a_phone_nothing_is_cut_off_and_one_can_speak(browser, system):
    run = system("--scenario", "highway", "--seed", "3")
    with page_on(browser, run.url, 390, 844) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        page.fill("#words", "please slow down a little")
        page.click("#say button")
        see(page, ".heard", "issued")


def test_the_keys_open_help_and_change_the_theme(browser, system):
    run = system("--scenario", "highway", "--seed", "3")
    with page_on(browser, run.url) as page:
        before = page.get_attribute("html", "data-theme")
        page.keyboard.press("t")
        assert page.get_attribute("html", "data-theme") != before
        page.keyboard.press("?")
        see(page, "dialog[open]", "Keys")


def test_the_car_is_paused_stepped_and_sent_to_another_road(browser, system):
    run = system("--scenario", "highway", "--seed", "3")
    with page_on(browser, run.url) as page:
        page.locator("#transport").wait_for(timeout=PATIENCE_MS)
        page.keyboard.press("Space")
        page.wait_for_selector("#link[data-is=paused]", timeout=PATIENCE_MS)
        page.wait_for_timeout(1000)  # what was on its way has arrived
        stood = int(page.inner_text("#clock").split()[1])
        page.keyboard.press(".")
        see(page, "#clock", f"tick {stood + 1} ")
        page.select_option("#road-choice", "merge")
        page.fill("#seed", "4")
        page.click("#restart button")
        see(page, "#scenario", "merge")
        see(page, "#clock", "tick 0 ")
        page.keyboard.press("Escape")
        page.click("#pause")
        page.wait_for_selector("#link[data-is=live]", timeout=PATIENCE_MS)
