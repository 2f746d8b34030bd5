"""The filmstrip of a recording: the road at a few moments, and the speed over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Any

from deploy.film.story import worded
from deploy.lab.picture import picture
from deploy.record.moments import Moment
from deploy.report.figure import Figure
from deploy.report.road import View, draw_road, shade, view
from schemas.driving.road import LANE, VX, X, Y
from schemas.wire.codec import rows_of
from schemas.wire.messages import Command, Directive, Event, EventKind, MetaAction
from sim_node.drawing import AMBER, CHIPS, EGO, RED, SOURCES, meaning

WIDTH_IN = 7.6
TITLE_IN, SPEED_IN = 0.28, 1.7
AFTER_S = 4.0
"""So much is shown of the speed after the last moment."""
MARK_ROWS, TEXT_CHARS = 6, 60
CHAR_SHARE = 0.0085
"""Of the figure's width: a letter of the marks."""
ACTIONS = {**dict(CHIPS), MetaAction.EMERGENCY_BRAKE: "emergency brake"}
MARKED = {
    EventKind.DELAYED: shade(RED),
    EventKind.OVERRIDDEN: shade(AMBER),
    EventKind.CARRIED_OUT: shade(EGO),
    EventKind.FULFILLED: shade(EGO),
    EventKind.EXPIRED: shade(RED),
}


def nearest(moments: Sequence[Moment], at: Sequence[float]) -> list[Moment]:
    """The recorded tick at each of these times [s], without those that the recording does not reach."""
    reached = [at_s for at_s in at if at_s <= moments[-1].at_s + 0.1]
    return [min(moments, key=lambda moment: abs(moment.at_s - at_s)) for at_s in reached]


def filmstrip_figure(name: str, title: str, moments: Sequence[Moment], at: Sequence[float]) -> Figure | None:
    """The road at the times `at` [s]. None where the recording reaches none of them."""
    chosen = nearest(moments, at)
    if not chosen:
        return None
    times = ", ".join(f"{moment.at_s:.0f}" for moment in chosen)
    return Figure(
        name,
        f"What happened: {title}",
        f"The road at t = {times} s: the ego green, speeds in m/s; its path before and after as a line, where it "
        "steers for as a dashed box, a red edge around a car for which the mask closes an action. Below: the ego's "
        "speed, dotted the wished one, lines at the moments above; shaded where it drives in an oncoming lane.",
        partial(_draw, moments, chosen),
    )


def directive_at(moments: Sequence[Moment], moment: Moment) -> Directive | None:
    """What the action of a moment took into account."""
    wanted = None if moment.action is None else moment.action.directive_id
    said = (m for one in moments for m in one.heard if isinstance(m, Directive) and m.id == wanted)
    return next(said, None)


def height_in(seen: View, stretch: float = 1.0) -> float:
    """Of a strip that shows this, and so much wider than true, with its title [in]."""
    left, right, top, bottom = seen
    return stretch * WIDTH_IN * (bottom - top) / (right - left) + TITLE_IN


def _draw(moments: Sequence[Moment], chosen: Sequence[Moment], path: Path) -> None:
    tall = [*(height_in(view(moment.observation)) for moment in chosen), SPEED_IN]
    rows = len(tall)
    with picture(path, rows, figsize=(WIDTH_IN, sum(tall)), height_ratios=tall, layout="constrained", dpi=200) as (
        _,
        axes,
    ):
        for axis, moment in zip(axes[:-1, 0], chosen, strict=True):
            blamed = frozenset(c.vehicle for c in moment.action.closed) if moment.action else frozenset[int]()
            draw_road(axis, moment.observation, blamed)
            _path(axis, moments, moment)
            axis.set_title(f"t = {moment.at_s:.0f} s", loc="left", fontweight="bold", fontsize=8.5, pad=3)
            axis.set_title(_told(moments, moment), loc="right", fontsize=7.5, pad=3)
        _speed(axes[-1, 0], moments, chosen)


def _told(moments: Sequence[Moment], moment: Moment) -> str:
    """What was asked for, and what was decided by whom."""
    ego = rows_of(moment.observation)[0]
    action = moment.action
    directive = directive_at(moments, moment)
    parts = [f"{ego[VX]:.1f} m/s"]
    if directive is not None:
        parts.append(f"asked for: {meaning(directive)}")
    if action is None:
        parts.append("not answered")
    else:
        did = ACTIONS.get(MetaAction(action.meta_action), "?")
        parts.append(f"{did}, by {SOURCES.get(action.source, action.source)}")
        side = None if directive is None or directive.target_lane is None else directive.target_lane
        if side is not None and side != moment.observation.target_lane:
            wanted = MetaAction.LEFT if side < moment.observation.target_lane else MetaAction.RIGHT
            held = next((c for c in action.closed if c.action == wanted), None)
            if held is not None:
                parts.append(f"{ACTIONS[wanted]} closed: {held.reason}")
    return "   ".join(parts)


def _path(axis: Any, moments: Sequence[Moment], moment: Moment) -> None:
    epoch = moment.observation.epoch
    for before, style in ((True, "-"), (False, ":")):
        points = [
            (ego[X], ego[Y])
            for one in moments
            if one.observation.epoch == epoch and (one.at_s <= moment.at_s if before else one.at_s >= moment.at_s)
            for ego in (rows_of(one.observation)[0],)
        ]
        axis.plot(*zip(*points, strict=True), style, color=shade(EGO), linewidth=1.0, zorder=2)


def _speed(axis: Any, moments: Sequence[Moment], chosen: Sequence[Moment]) -> None:
    shown = [moment for moment in moments if moment.at_s <= chosen[-1].at_s + AFTER_S]
    time_s = [moment.at_s for moment in shown]
    egos = [rows_of(moment.observation)[0] for moment in shown]
    axis.plot(time_s, [ego[VX] for ego in egos], color=shade(EGO), linewidth=1.5)
    goals = [moment.action.speed_goal_mps if moment.action else None for moment in shown]
    axis.plot(time_s, [float("nan") if goal is None else goal for goal in goals], ":", color="black", linewidth=0.9)
    borrowed = [moment.observation.lanes[int(ego[LANE])].direction < 0 for moment, ego in zip(shown, egos, strict=True)]
    axis.fill_between(
        time_s, 0, 1, where=borrowed, transform=axis.get_xaxis_transform(), color=shade(AMBER), alpha=0.2, linewidth=0
    )
    for moment in chosen:
        axis.axvline(moment.at_s, color="black", linewidth=0.6, alpha=0.5)
    _marks(axis, shown)
    axis.set(xlabel="time [s]", ylabel="speed [m/s]", xlim=(0.0, shown[-1].at_s))
    axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))


def _marks(axis: Any, shown: Sequence[Moment]) -> None:
    """What was said and what became of it, under the curve, each in the lowest row that has room for it."""
    last_s = shown[-1].at_s
    taken: list[list[tuple[float, float]]] = [[] for _ in range(MARK_ROWS)]
    for moment in shown:
        for message in moment.heard:
            if isinstance(message, Command):
                colour, text = "black", "\u201c" + shorten(message.text, TEXT_CHARS, placeholder=" ...") + "\u201d"
            elif isinstance(message, Event) and message.kind in MARKED:
                colour, text = MARKED[message.kind], worded(message)  # type: ignore[assignment]
            else:
                continue
            late = moment.at_s > 0.6 * last_s
            width_s = (len(text) + 2) * CHAR_SHARE * last_s
            span = (moment.at_s - width_s, moment.at_s) if late else (moment.at_s, moment.at_s + width_s)
            free = [row for row in taken if all(span[1] < left or right < span[0] for left, right in row)]
            row = free[0] if free else min(taken, key=len)
            row.append(span)
            at = 0.06 + 0.11 * taken.index(row)
            axis.plot([moment.at_s], [at], "o", color=colour, markersize=3, transform=axis.get_xaxis_transform())
            axis.annotate(
                text,
                (moment.at_s, at),
                (-5 if late else 5, 0),
                xycoords=axis.get_xaxis_transform(),
                textcoords="offset points",
                ha="right" if late else "left",
                va="center",
                fontsize=7,
            )
