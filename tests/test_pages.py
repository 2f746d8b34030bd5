"""The pages: what they name, and how long they are."""

from __future__ import annotations

import pkgutil
import re

import pytest

from tests.browser import CHROMIUM, QUIET
from tests.running import ROOT

PAPER = """<style>
@page { size: A4; margin: 15mm }
body { font: 10pt/1.2 serif; margin: 0 } code { font-size: 9pt } h1 { font-size: 14pt; margin: 0 }
h2 { font-size: 12pt; margin: 5pt 0 2pt } p, ul, ol, table { margin: 3pt 0 } ul, ol { padding-left: 14pt }
table { border-collapse: collapse } td, th { padding: 1pt 3pt; vertical-align: top }
</style>"""


PACKAGES = ("", "schemas.", "fast_node.", "slow_node.", "sim_node.", "deploy.")
"""Where the glossary's names may begin."""


def is_there(name: str) -> bool:
    for package in PACKAGES:
        try:
            pkgutil.resolve_name(package + name)
        except (ImportError, AttributeError, ValueError):
            continue
        return True
    return False


def test_what_the_glossary_names_is_where_it_says() -> None:
    rows = [line for line in (ROOT / "docs/glossary.md").read_text().splitlines() if line.startswith("| ")]
    names = [name for row in rows for name in re.findall(r"`([a-z_]+\.[\w.]+)`", row.rsplit(" | ", 1)[1])]
    assert len(names) > 50
    assert [name for name in names if not is_there(name)] == []


@pytest.mark.timeout(120)
def test_the_architecture_fits_on_two_a4_pages_at_ten_points() -> None:
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    markdown = pytest.importorskip("markdown_it").MarkdownIt("commonmark").enable("table")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        page = browser.new_page()
        page.set_content(PAPER + markdown.render((ROOT / "ARCHITECTURE.md").read_text()))
        pdf = page.pdf(prefer_css_page_size=True)
        browser.close()
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 2
