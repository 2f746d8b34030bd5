"""What the shipped policy's attention heads look at in recorded scenes: the node's steps are taken again for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from deploy.lab.picture import picture
from deploy.record.moments import Moment
from deploy.record.reader import Recording
from deploy.report.figure import Figure, Table
from deploy.report.filmstrip import WIDTH_IN, height_in, nearest
from deploy.report.road import MARGIN_M, View, draw_road, view
from fast_node.config import FastConfig
from fast_node.mask import PRESETS
from fast_node.node import FastNode
from fast_node.policies.attention import AttentionPolicy, load_attention
from schemas.driving.features import N_ROWS, Array
from schemas.driving.road import LANE, NOBODY, X, Y, is_oncoming, next_ahead
from schemas.wire.codec import rows_of
from schemas.wire.messages import Directive

ITSELF, LEADER, FOLLOWER = "the ego itself", "the leader", "the follower"
AHEAD, BEHIND, ONCOMING, FARTHER = "neighbours ahead", "neighbours behind", "oncoming cars", "farther cars"
ROLES = {
    ITSELF: "#34c77b",
    LEADER: "#d62f3f",
    FOLLOWER: "#e08a1e",
    AHEAD: "#3b82c4",
    BEHIND: "#86b6e0",
    ONCOMING: "#8f63c7",
    FARTHER: "#8a8f98",
}
"""Whom a head may watch. Leader and follower: next in the lane that the ego drives in or changes to; neighbours: next
ahead and behind in the lanes beside it; all of our direction."""
HEADS = ("#c23b8a", "#12908e", "#8a6d1f", "#5b5fc7")
WATCHES, LEAST_TICKS = 1.5, 15
"""A head watches who has this many times an equal part of what it has for cars; over so many ticks at least."""
WIDE_M, STRETCH = 90.0, 2.0
"""From this view on the road is drawn so much wider than true."""
SHOWN = 0.05
"""Shares below are not drawn."""
BARS_IN, BOW_IN, AROUND_M = 1.8, 0.25, 8.0
"""Height of the bars with their legend and of an arc; what is shown beyond the farthest car that is looked at."""


@dataclass(frozen=True)
class Look:
    """What the heads look at in one tick."""

    moment: Moment
    weights: NDArray[np.float32]
    """(H, 1 + cars): shares of each head's attention, the ego's own first; they sum to 1."""
    rows: tuple[int, ...]
    """Of the observation: the cars of the other columns."""
    roles: tuple[str, ...]
    """Of each column."""


class _Watched:
    """The policy, and what it was shown last."""

    def __init__(self, policy: AttentionPolicy) -> None:
        self._policy = policy
        self.seen: Array | None = None

    def logits(self, x: Array) -> Array:
        self.seen = x
        return self._policy.logits(x)


def looks_of(recording: Recording, moments: Sequence[Moment]) -> list[Look]:
    """What the shipped policy looks at in each recorded tick, the passenger's directives included."""
    try:
        config = msgspec.json.decode(recording.metadata.get("fast", "{}"), type=FastConfig)
    except ValueError:
        config = FastConfig()
    policy = load_attention()
    watched = _Watched(policy)
    node = FastNode(config, watched, PRESETS[str(policy.sidecar["mask_preset"])])
    directives: dict[int | None, Directive] = {}
    found = []
    for moment in moments:
        directives.update({m.id: m for m in moment.heard if isinstance(m, Directive)})
        action = moment.action
        if action is None:
            continue
        node.step(moment.observation, directives.get(action.directive_id), action.stamp_ns - action.compute_ns)
        if watched.seen is None:
            continue
        rows = rows_of(moment.observation)
        cars = sorted(range(1, len(rows)), key=lambda i, rows=rows: abs(rows[i][X] - rows[0][X]))[: N_ROWS - 1]  # type: ignore[misc]
        lane = moment.observation.target_lane
        roles = (ITSELF, *(role_of(rows, car, lane) for car in cars))
        found.append(Look(moment, policy.attention(watched.seen)[:, : len(roles)], tuple(cars), roles))
    return found


def role_of(rows: Any, car: int, lane: int) -> str:
    """Who the car in row `car` is to an ego that drives in, or changes to, `lane`."""
    if is_oncoming(rows[car]):
        return ONCOMING
    here, x = int(rows[car][LANE]), float(rows[0][X])
    next_one = car in (next_ahead(rows, here, x), _next_behind(rows, here, x))
    if not next_one or abs(here - lane) > 1:
        return FARTHER
    ahead = bool(rows[car][X] > x)
    if here != lane:
        return AHEAD if ahead else BEHIND
    return LEADER if ahead else FOLLOWER


def _next_behind(rows: Any, lane: int, x: float) -> int:
    behind = [i for i in range(1, len(rows)) if int(rows[i][LANE]) == lane and rows[i][X] <= x]
    return max((i for i in behind if not is_oncoming(rows[i])), key=lambda i: rows[i][X], default=NOBODY)


@dataclass(frozen=True)
class Watching:
    """How much of its attention a head gives to each who has a role, over all ticks that have one."""

    ticks: int
    share: tuple[float, ...]
    """Mean share of one such car, per head."""
    equal: float
    """The same if all who are there had the same."""
    times: tuple[float, ...]
    """Of the attention that is for cars, not for the ego itself: how many times an equal part one has, per head."""
    whole: tuple[float, ...]
    """Mean share of all such cars together over all ticks, per head."""
    whole_equal: float


def summed_up(looks: Sequence[Look]) -> dict[str, Watching]:
    """By role, those that there are."""
    found = {}
    for role in ROLES:
        here = [(look, [k for k, name in enumerate(look.roles) if name == role]) for look in looks]
        with_one = [(look, mine) for look, mine in here if mine]
        if not with_one:
            continue
        each = [look.weights[:, mine].mean(axis=1) for look, mine in with_one]
        of_cars = [w / np.maximum(1.0 - look.weights[:, 0], 1e-6) for w, (look, _) in zip(each, with_one, strict=True)]
        equal_of_cars = np.mean([1.0 / max(len(look.roles) - 1, 1) for look, _ in with_one])
        found[role] = Watching(
            len(with_one),
            tuple(np.mean(each, axis=0).tolist()),
            float(np.mean([1.0 / len(look.roles) for look, _ in with_one])),
            tuple((np.mean(of_cars, axis=0) / equal_of_cars).tolist()),
            tuple(np.mean([look.weights[:, mine].sum(axis=1) for look, mine in here], axis=0).tolist()),
            float(np.mean([len(mine) / len(look.roles) for look, mine in here])),
        )
    return found


def findings_of(watching: dict[str, Watching]) -> tuple[str, ...]:
    """What is seen, a sentence each: whom each head watches, and whether the heads share the work as in the paper."""
    cars = {role: one for role, one in watching.items() if role != ITSELF and one.ticks >= LEAST_TICKS}
    if not cars:
        return (f"Too few cars are seen to say whom a head watches: in fewer than {LEAST_TICKS} ticks.",)
    said, watched = [], list[list[str]]()
    for head, own in enumerate(watching[ITSELF].share):
        ranked = sorted(cars, key=lambda role: -cars[role].times[head])
        watched.append([role for role in ranked if cars[role].times[head] >= WATCHES])
        times = ", ".join(f"{role} {cars[role].times[head]:.1f}" for role in ranked)
        said.append(
            f"Head {head + 1} has {100 * own:.0f} % of its attention for the ego itself. "
            f"Of the rest, a car has so many times an equal part: {times}."
        )
    if LEADER not in cars or not {AHEAD, BEHIND} & cars.keys():
        said.append("Leader and neighbours are not both seen often enough to say more.")
        return tuple(said)
    whom = "; ".join(
        f"head {head + 1} watches {', then '.join(mine) or 'no kind of car'}" for head, mine in enumerate(watched)
    )
    first = [mine[0] if mine else "" for mine in watched]
    shared = LEADER in first and bool({AHEAD, BEHIND} & set(first))
    said.append(
        f"From {WATCHES:g} times on: {whom}. So it is {'true' if shared else 'not true'} here "
        "that one head puts the leader first and another the neighbours."
    )
    return tuple(said)


def attention_figure(
    name: str, title: str, recording: Recording, moments: Sequence[Moment], at: Sequence[float]
) -> Figure | None:
    """Scenes at the times `at` [s] with what each head looks at, and whom it watches over all ticks. None where no tick
    has an answer."""
    looks = looks_of(recording, moments)
    if not looks:
        return None
    watching = summed_up(looks)
    heads = range(len(looks[0].weights))
    table = Table(
        ("whom", "ticks with one", *(f"head {h + 1}, each [%]" for h in heads), "equal part [%]"),
        [
            (role, str(one.ticks), *(f"{100 * share:.1f}" for share in one.share), f"{100 * one.equal:.1f}")
            for role, one in watching.items()
        ],
    )
    return Figure(
        name,
        f"Attention over vehicles: {title}",
        "What the heads of the shipped policy look at. Arcs: shares of the ego's attention in the last layer, thicker "
        f"for more, those of {100 * SHOWN:.0f} % and more, {_arcs(len(heads))}; where more than {WIDE_M:.0f} m are "
        f"shown, the road is drawn {STRETCH:g} times as wide as it is. Bars: mean shares over all {len(looks)} ticks; "
        "the last bar is an equal part for everybody. Leader and follower are next in the ego's lane, neighbours next "
        "in the lanes beside.",
        partial(_draw, looks, watching, at),
        findings_of(watching),
        table,
    )


def _arcs(heads: int) -> str:
    return "head 1 above, head 2 below" if heads == 2 else "a colour per head"


def _draw(looks: Sequence[Look], watching: dict[str, Watching], at: Sequence[float], path: Path) -> None:
    by_moment = {id(look.moment): look for look in looks}
    moments = [look.moment for look in looks]
    chosen = [by_moment[id(moment)] for moment in nearest(moments, at)] or [looks[len(looks) // 2]]
    views = [_view(look) for look in chosen]
    tall = [*(height_in(seen, _stretch(seen)) for seen in views), BARS_IN]
    with picture(path, len(tall), figsize=(WIDTH_IN, sum(tall)), height_ratios=tall, layout="constrained", dpi=200) as (
        figure,
        axes,
    ):
        for axis, look, seen in zip(axes[:-1, 0], chosen, views, strict=True):
            draw_road(axis, look.moment.observation, seen=seen)
            axis.set_aspect(_stretch(seen))
            axis.set_title(f"t = {look.moment.at_s:.0f} s", loc="left", fontweight="bold", fontsize=8.5, pad=3)
            own = "   ".join(f"head {h + 1}: itself {100 * w[0]:.0f} %" for h, w in enumerate(look.weights))
            axis.set_title(own, loc="right", fontsize=7.5, pad=3)
            _draw_arcs(axis, look, seen)
        _bars(axes[-1, 0], watching)
        figure.legend(*axes[-1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(watching))


def _view(look: Look) -> View:
    """All cars that are looked at, and room for the arcs."""
    left, right, top, bottom = view(look.moment.observation)
    rows = rows_of(look.moment.observation)
    for car, share in zip(look.rows, look.weights[:, 1:].max(axis=0), strict=True):
        if share >= SHOWN:
            left, right = min(left, float(rows[car][X]) - AROUND_M), max(right, float(rows[car][X]) + AROUND_M)
    room = (right - left) / WIDTH_IN / _stretch((left, right, top, bottom)) * BOW_IN - MARGIN_M
    return left, right, top - room, bottom + room


def _stretch(seen: View) -> float:
    return STRETCH if seen[1] - seen[0] > WIDE_M else 1.0


def _draw_arcs(axis: Any, look: Look, seen: View) -> None:
    from matplotlib.patches import FancyArrowPatch

    rows = rows_of(look.moment.observation)
    ego = rows[0]
    for head, weights in enumerate(look.weights):
        for car, share in zip(look.rows, weights[1:], strict=True):
            if share < SHOWN:
                continue
            away_in = abs(float(rows[car][X] - ego[X])) * WIDTH_IN / (seen[1] - seen[0])
            bow = min(0.4, 2.0 * BOW_IN / max(away_in, 0.1))
            up = (head % 2 == 0) == bool(rows[car][X] > ego[X])
            axis.add_patch(
                FancyArrowPatch(
                    (float(ego[X]), float(ego[Y])),
                    (float(rows[car][X]), float(rows[car][Y])),
                    connectionstyle=f"arc3,rad={-bow if up else bow}",
                    arrowstyle="-",
                    color=HEADS[head % len(HEADS)],
                    linewidth=0.6 + 5.0 * float(share),
                    alpha=0.85,
                    zorder=4,
                )
            )


def _bars(axis: Any, watching: dict[str, Watching]) -> None:
    heads = len(next(iter(watching.values())).whole)
    names = [*(f"head {h + 1}" for h in range(heads)), "equal part"]
    start = np.zeros(len(names))
    for role, one in watching.items():
        wide = np.array([*one.whole, one.whole_equal])
        axis.barh(names, 100 * wide, left=100 * start, height=0.7, color=ROLES[role], label=role, alpha=0.9)
        for k, (at, share) in enumerate(zip(start, wide, strict=True)):
            if share >= 0.06:
                axis.text(
                    100 * (at + share / 2),
                    k,
                    f"{100 * share:.0f}",
                    ha="center",
                    va="center",
                    fontsize=7.5,
                    color="white",
                )
        start += wide
    for label, colour in zip(axis.get_yticklabels(), HEADS[:heads], strict=False):
        label.set_color(colour)
        label.set_fontweight("bold")
    axis.invert_yaxis()
    axis.set(xlim=(0, 100), xlabel="share of the attention [%]")
    axis.grid(visible=False)
