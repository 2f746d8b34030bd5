"""`make screenshots`: the cockpit in a real browser on the real system, into reports/; one goes to docs/cockpit.png.

What is seen is driven anew, so that two runs differ in moments, not in what they show. `--only` makes some of them.
"""

from __future__ import annotations

import argparse
import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.running import HURRY, ROOT
from tests.system.test_cockpit import CHROMIUM, PATIENCE_MS, QUIET, Run, aside, see, send_to, system
from tests.waiting import until

REPORTS = ROOT / "reports"
FRONT = ROOT / "docs" / "cockpit.png"
"""The README's picture: the state of the same name."""
STRANGE = "that lorry in front gives me the creeps, do something about it would you"


def say(page: Any, words: str) -> None:
    page.click("#tab-talk")
    page.fill("#words", words)
    page.click("#say button")
    see(page, ".said", words)


def drives(page: Any, ticks: int) -> None:
    """Wait until the car has driven so far in its world."""
    for _ in range(PATIENCE_MS // 100):  # the page forbids `wait_for_function`, which evaluates a text
        if int(page.inner_text("#clock").split()[1]) >= ticks:
            return
        page.wait_for_timeout(100)
    raise AssertionError("the car stands still")


def highway(page: Any) -> None:
    to(page, "highway", "3")
    say(page, HURRY)
    see(page, ".heard", "issued")
    drives(page, 120)


def highway_light(page: Any) -> None:
    page.click("#theme")
    highway(page)


def delay(page: Any) -> None:
    to(page, "two-way", "1")
    say(page, HURRY)
    see(page, "#directive .wait", "oncoming traffic")
    drives(page, 60)


def passing(page: Any) -> None:
    delay(page)
    see(page, "#banner", "borrowed lane")
    page.wait_for_timeout(1500)


def thought(page: Any) -> None:
    to(page, "highway", "3")
    say(page, STRANGE)
    page.click("#tab-thoughts")
    own = page.locator("#thoughts .thought", has_text=STRANGE).first
    own.wait_for(timeout=PATIENCE_MS)
    if own.get_attribute("open") is None:  # another command's was open
        own.locator("summary").click()
    own.locator("h3", has_text="Prompt").first.wait_for(timeout=PATIENCE_MS)


def program(page: Any) -> None:
    to(page, "highway", "3")
    say(page, "in twenty seconds take the left lane, then slow down a little")
    see(page, "#d-state", "waiting")
    drives(page, 60)


def dense(page: Any) -> None:
    page.fill("#density", "2.5")
    send_to(page, "merge", "4")
    drives(page, 75)


STATES: dict[str, tuple[Callable[[Any], None], int, int]] = {
    "highway-dark": (highway, 1440, 900),
    "highway-light": (highway_light, 1440, 900),
    "two-way-delay": (delay, 1440, 900),
    "two-way-passing": (passing, 1440, 900),
    "thought": (thought, 1440, 1500),
    "program": (program, 1440, 900),
    "merge-dense": (dense, 1440, 900),
    "phone": (delay, 390, 1500),
}
FRONT_STATE = "two-way-delay"


def to(page: Any, road: str, seed: str) -> None:
    """Begin on another road, with its own density."""
    page.fill("#density", "1")
    send_to(page, road, seed)


def shoot(browser: Any, url: str, name: str, state: Callable[[Any], None], width: int, height: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme="dark")
    page.goto(url, timeout=PATIENCE_MS)
    page.wait_for_selector("#link[data-is=live],#link[data-is=replay]", timeout=PATIENCE_MS)
    state(page)
    picture = FRONT if name == FRONT_STATE else REPORTS / f"cockpit-{name}.png"
    page.screenshot(path=picture)
    print(picture.relative_to(ROOT))
    page.close()


def replayed(page: Any) -> None:
    page.wait_for_timeout(6000)
    page.click("#pause")
    page.wait_for_timeout(500)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    every = [*STATES, "replay"]
    parser.add_argument("--only", nargs="*", default=every, choices=every)
    wanted = parser.parse_args().only
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        with tempfile.TemporaryDirectory() as folder:
            with system(Path(folder), "--scenario", "highway", "--seed", "3") as run:
                for name in STATES:
                    if name in wanted:
                        shoot(browser, run.url, name, *STATES[name])
            if "replay" in wanted:
                _replay(browser, run)
        browser.close()


def _replay(browser: Any, run: Run) -> None:
    """The recording of that run, in the same page."""
    import re
    import subprocess
    import sys

    [recording] = run.folder.glob("runs/*/recording.mcap")
    argv = [sys.executable, "-m", "deploy", "replay", str(recording), "--cockpit-port", "0"]
    with subprocess.Popen(argv, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = aside(functools.partial(until, lambda: process.stdout and process.stdout.readline(), "no address"))
            url = re.search(r"http://\S+/", str(line))
            assert url is not None
            shoot(browser, url.group(), "replay", replayed, 1440, 900)
        finally:
            process.terminate()


if __name__ == "__main__":
    main()
