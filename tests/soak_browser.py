"""The cockpit's page in a real browser, for a long time: how much memory it takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.browser import CHROMIUM, QUIET
from tests.soak_meter import MB, Course


class Page:
    """An open page; None: there is no browser on this machine."""

    def __init__(self, page: Any | None) -> None:
        self._page, self._began_s, self._heap, self._elements = page, time.monotonic(), Course(), 0
        self._errors: list[str] = []
        if page is not None:
            self._devtools = page.context.new_cdp_session(page)
            page.on("pageerror", lambda error: self._errors.append(str(error)))

    def breathe(self) -> None:
        """Let the browser's driver handle what has come."""
        if self._page is not None:
            self._page.wait_for_timeout(1)

    def look(self) -> None:
        """One sample of the page's heap, without what is garbage."""
        if self._page is None:
            return
        self._devtools.send("HeapProfiler.collectGarbage")
        self._heap.at_s.append(time.monotonic() - self._began_s)
        self._heap.megabytes.append(self._devtools.send("Runtime.getHeapUsage")["usedSize"] / MB)
        self._elements = self._page.evaluate("document.getElementsByTagName('*').length")

    def told(self) -> dict[str, Any]:
        if self._page is None:
            return {"browser": "none on this machine"}
        live = self._page.get_attribute("#link", "data-is") == "live"
        return self._heap.told() | {"elements": self._elements, "errors": len(self._errors), "live": live}


@contextmanager
def page_of(url: str) -> Iterator[Page]:
    """The page, open; nothing where there is no browser."""
    if CHROMIUM is None:
        yield Page(None)
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(url)
        page.wait_for_selector("#link[data-is=live]", timeout=60_000)
        yield Page(page)
        browser.close()
