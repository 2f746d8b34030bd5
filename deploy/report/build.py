"""`fastslow report`: figures of all that was given, each as PNG and SVG, and one page with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from deploy.record.moments import Moment, moments
from deploy.record.reader import Recording
from deploy.report.attention import attention_figure
from deploy.report.figure import Figure, Report
from deploy.report.filmstrip import filmstrip_figure
from deploy.report.inputs import Inputs, name_of, read
from deploy.report.page import write_page
from deploy.report.results import latency_figure, reward_figure, success_figure
from schemas.runtime.process import ConfigError

CASE_STUDY_S = (1.0, 3.0, 20.0, 23.0)
"""The moments of the paper's filmstrip."""
PAGE = "index.html"


def build(
    runs: Sequence[Path], out: Path, at: Sequence[float], progress: Callable[[str], None] = lambda _: None
) -> Report:
    """Write the report of `runs` into the folder `out`; `at`: the filmstrips' moments [s].

    Raises `ConfigError` for a run that cannot be read, a folder that cannot be written, and if there is no figure at
    all; ImportError without matplotlib.
    """
    inputs = read(runs)
    report = Report(inputs.about)
    try:
        out.mkdir(parents=True, exist_ok=True)
        for figure in _figures(inputs, at, report):
            progress(f"drawing {figure.name}")
            for suffix in (".png", ".svg"):
                figure.draw(out / f"{figure.name}{suffix}")
            report.figures.append(figure)
        if not report.figures:
            raise ConfigError(f"there is nothing to draw: {'; '.join(why for _, why in report.left_out)}")
        write_page(report, out / PAGE)
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename or out}: {error.strerror}") from None
    return report


def _figures(inputs: Inputs, at: Sequence[float], report: Report) -> list[Figure]:
    """In the order of the page; what there is no data for goes into `report.left_out`."""
    found: list[Figure] = []

    def keep(what: str, figure: Figure | None, why: str) -> None:
        if figure is None:
            report.left_out.append((what, why))
        else:
            found.append(figure)

    keep(
        "Success",
        success_figure(inputs.successes, "success", "Success") if inputs.successes else None,
        "no result of `fastslow evaluate` (--json or --rows) is given",
    )
    for number, cells in enumerate(inputs.studies, 1):
        found.append(reward_figure(cells, number))
    if inputs.learnt:
        found.append(success_figure(inputs.learnt, "success-learnt", "Success after learning"))
    if not inputs.studies:
        keep("Reward while learning", None, "no study.json is given: `fastslow study` writes it")
    for number, recording in enumerate(inputs.recordings, 1):
        _of_recording(recording, number, at, keep)
    if not inputs.recordings:
        for what in ("What happened", "Attention over vehicles"):
            keep(what, None, "no recording is given: `fastslow run --record FILE.mcap` writes one")
    keep(
        "Latency",
        latency_figure(inputs.recordings, inputs.latencies),
        "no recording, and no latency.json of `fastslow bench latency`, is given",
    )
    return found


def _of_recording(
    recording: Recording, number: int, at: Sequence[float], keep: Callable[[str, Figure | None, str], None]
) -> None:
    seen: list[Moment] = list(moments(recording))
    suffix = "" if number == 1 else f"-{number}"
    title = f"{name_of(recording)}, {seen[0].observation.scenario}"
    times = ", ".join(f"{t:g}" for t in at)
    keep(
        f"What happened: {title}",
        filmstrip_figure(f"filmstrip{suffix}", title, seen, at),
        f"it lasts {seen[-1].at_s:.1f} s, and reaches none of {times} s: choose moments with --at",
    )
    keep(
        f"Attention over vehicles: {title}",
        attention_figure(f"attention{suffix}", title, recording, seen, at),
        "nobody answered in it",
    )
