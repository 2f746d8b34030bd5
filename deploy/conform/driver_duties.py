"""What somebody's driver has shown of each of its duties. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from statistics import median

from deploy.conform.driver_drive import Showing, Shown
from deploy.conform.verdict import NEWER, OTHER, READABLE, TOLERATED, Duty, Wrong, budget_text, judged
from schemas.runtime.clock import NS

CLOCKS_NS = 1_000_000
"""Two readings of one clock."""

Judge = Callable[[Showing], str]


def duties(showing: Showing) -> list[Duty]:
    """A verdict per duty."""

    def found(judge: Judge) -> str:
        if not showing.came and judge is not readable:
            raise Wrong("no action came")
        return judge(showing)

    return judged(DUTIES, showing.budget_ns, found)


def _of(showing: Showing, *phases: str) -> list[Shown]:
    return [shown for shown in showing.shown if shown.phase in phases]


def _answered(shown: Sequence[Shown], what: str) -> str:
    got = sum(bool(one.proper()) for one in shown)
    if got < (1 - TOLERATED) * len(shown):
        raise Wrong(f"{got} of {len(shown)} {what} were answered")
    return f"{got} of {len(shown)}"


def readable(showing: Showing) -> str:
    if showing.faults:
        reason, times = Counter(showing.faults).most_common(1)[0]
        raise Wrong(f"{len(showing.faults)} actions refused; {times} times: {reason}")
    if not showing.came:
        raise Wrong("no action came: is it a zenoh client of this router, on fastslow/ego/action?")
    return f"{sum(len(shown.answers) for shown in showing.shown)} actions"


def each_tick(showing: Showing) -> str:
    ours = _of(showing, "road")
    strange = [
        (s.seen, a) for s in ours for a, _ in s.answers if (a.epoch, a.answers_tick) != (s.seen.epoch, s.seen.tick)
    ]
    if len(strange) > TOLERATED * len(ours):
        seen, action = strange[-1]
        raise Wrong(
            f"tick {seen.tick} of epoch {seen.epoch} was shown, answers_tick {action.answers_tick} of epoch "
            f"{action.epoch} came"
        )
    return _answered(ours, "observations")


def once(showing: Showing) -> str:
    twice = [shown.seen.tick for shown in showing.shown if len(shown.proper()) > 1]
    if len(twice) > 1:
        raise Wrong(f"tick {twice[0]} was answered twice, and {len(twice) - 1} more")
    if len(showing.unasked) > 1:
        raise Wrong(f"{len(showing.unasked)} actions came while nothing was shown")
    return "never twice, never unasked"


def in_time(showing: Showing) -> str:
    took = sorted(at - s.put_ns for s in _of(showing, "road", "world") for _, at in s.proper()[:1])
    if not took:
        raise Wrong("no observation was answered")
    late = sum(ns > showing.budget_ns for ns in took)
    middle = f"{median(took) / 1e6:.1f} ms at the median"
    if late > TOLERATED * len(took):
        raise Wrong(f"{late} of {len(took)} answers came after {budget_text(showing.budget_ns)}; {middle}")
    return f"{middle}, {late} of {len(took)} late"


def epochs(showing: Showing) -> str:
    shown = _of(showing, "world")
    wrong = [a for s in shown[2:] for a, _ in s.answers if a.epoch != s.seen.epoch]
    if wrong:
        raise Wrong(f"epoch {shown[0].seen.epoch} was shown, answers of epoch {wrong[0].epoch} came")
    return f"{_answered(shown, 'observations of a new epoch')} of a new epoch"


def stamps(showing: Showing) -> str:
    pairs = [(s, a, at) for s in showing.shown for a, at in s.proper()]
    if not pairs:
        raise Wrong("no observation was answered")
    off = median(a.stamp_ns - at for _, a, at in pairs)
    if off > CLOCKS_NS:
        raise Wrong(f"stamp_ns is {off / NS:.3g} s ahead of CLOCK_MONOTONIC, which is asked for")
    early = sum(a.stamp_ns < s.put_ns - CLOCKS_NS for s, a, _ in pairs)
    if early > TOLERATED * len(pairs):
        raise Wrong(f"{early} of {len(pairs)} stamps are older than what they answer")
    return "between the observation and the arrival"


def closed(showing: Showing) -> str:
    answers = [a for s in showing.shown for a, _ in s.answers]
    for action in answers:
        for closure in action.closed:
            if closure.action == action.meta_action:
                raise Wrong(
                    f"tick {action.answers_tick}: it took action {closure.action}, which it closes: {closure.reason}"
                )
    return f"none taken of {sum(len(action.closed) for action in answers)}"


def carried_out(showing: Showing) -> str:
    if showing.refused:
        raise Wrong(f"the simulator's last check stopped {len(showing.refused)}: {showing.refused[0]}")
    crashed = [shown.seen.tick for shown in showing.shown if shown.seen.crashed]
    if crashed:
        raise Wrong(f"a collision at tick {crashed[0]}")
    return "all"


def newer(showing: Showing) -> str:
    return _answered(_of(showing, "newer"), f"observations of schema {NEWER} with unknown fields")


def nonsense(showing: Showing) -> str:
    return _answered(_of(showing, "nonsense")[1:], "observations after something unreadable")


def other(showing: Showing) -> str:
    taken = sum(bool(shown.answers) for shown in _of(showing, "other"))
    if taken > 1:
        raise Wrong(f"{taken} observations of schema {OTHER} were answered: refuse another major")
    return "not answered"


DUTIES: tuple[tuple[str, str, Judge], ...] = (
    ("readable", READABLE, readable),
    ("each tick", "every observation is answered, with its tick and epoch", each_tick),
    ("once", "one action per observation, none unasked", once),
    ("late", "within {budget} of the publication", in_time),
    ("epochs", "a new epoch is answered with that epoch", epochs),
    ("stamps", "CLOCK_MONOTONIC", stamps),
    ("closed", "no action that it closes itself", closed),
    ("carried out", "nothing that the simulator must stop, and no collision", carried_out),
    ("newer minor", "what is new in a later minor is ignored", newer),
    ("nonsense", "what cannot be read is dropped", nonsense),
    ("other major", "another major is refused", other),
)
