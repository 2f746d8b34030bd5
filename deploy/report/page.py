"""The report as one HTML page: it needs nothing but itself, and is light or dark as the reader's system is."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from deploy.report.figure import Figure, Report, Table

PIXELS_PER_POINT = 1.5
"""So large a drawing is shown where there is room: its text is then as large as the page's small print."""


def write_page(report: Report, path: Path) -> None:
    """Write the page; the SVG files of the figures lie beside it."""
    page = Template((files("deploy.report") / "page.html").read_text(encoding="utf-8"))
    inputs = "".join(f"<li><code>{escape(name)}</code> {escape(about)}</li>" for name, about in report.inputs)
    contents = "".join(f'<li><a href="#{figure.name}">{escape(figure.title)}</a></li>' for figure in report.figures)
    figures = "".join(_figure(figure, number, path.parent) for number, figure in enumerate(report.figures, 1))
    left_out = "".join(f"<li><b>{escape(what)}</b>: {escape(why)}.</li>" for what, why in report.left_out)
    path.write_text(
        page.substitute(
            made=datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC"),
            inputs=inputs,
            contents=contents,
            figures=figures,
            left_out=f'<section id="left-out"><h2>Left out</h2><ul>{left_out}</ul></section>' if left_out else "",
        ),
        encoding="utf-8",
    )


def _figure(figure: Figure, number: int, folder: Path) -> str:
    findings = "".join(f"<li>{escape(text)}</li>" for text in figure.findings)
    links = " ".join(f'<a href="{figure.name}.{kind}" download>{kind.upper()}</a>' for kind in ("png", "svg"))
    drawing = inline((folder / f"{figure.name}.svg").read_text(encoding="utf-8"), figure)
    return (
        f'<section id="{figure.name}"><h2>{escape(figure.title)}</h2><figure><div class="drawing">{drawing}</div>'
        f"<figcaption><b>Figure {number}.</b> {escape(figure.caption)} "
        f'<span class="files">{links}</span></figcaption></figure>'
        f"{f'<ul class=findings>{findings}</ul>' if findings else ''}"
        f"{_table(figure.table) if figure.table else ''}</section>"
    )


def inline(svg: str, figure: Figure) -> str:
    """A drawing as a part of the page: black becomes the ink of the reader's theme, and a reader hears its title."""
    start = svg.index("<svg")
    body = svg[start:].replace("#000000", "currentColor")
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    wide = re.search(r'width="([\d.]+)pt"', body)
    most = f' style="max-width: {PIXELS_PER_POINT * float(wide[1]):.0f}px"' if wide else ""
    body = re.sub(r'\s(?:width|height)="[\d.]+pt"', "", body, count=2)
    named = re.sub(r'\bid="', f'id="{figure.name}.', body)
    named = re.sub(r"(url\(#|href=\"#)", rf"\g<1>{figure.name}.", named)
    return named.replace("<svg", f'<svg role="img" aria-label="{escape(figure.title)}" fill="currentColor"{most}', 1)


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    return (
        f"<details><summary>The numbers</summary><div class=wide><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table></div></details>"
    )
