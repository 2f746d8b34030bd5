"""What a drive of somebody's simulator shows of each of its duties. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import median

from deploy.conform.simulator_drive import GIVE_UP_S, Drive, Step
from deploy.conform.verdict import READABLE, TOLERATED, Duty, Wrong, budget_text, judged
from schemas.driving.measures import SPEED_STEP_MPS
from schemas.driving.road import HZ, ID, VX, VY, X, Y
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import EventKind, MetaAction

RATE_OFF = 0.1
STALE_NS, FUTURE_NS = 200_000_000, 1_000_000
"""How old a stamp may be at its arrival, and how far ahead."""
JUMP_M = 5.0
"""More than this beyond what the speed allows in a tick is another car, or another place."""
UNIT_RATIO = 1.25
"""What a car moves and what its speed says may differ by this factor: bends, noise."""
CLOSE = 2e-3
"""Two set-points are the same; float32 and rounding."""
HOLD_TICKS = 2
BRAKE_MPS2, GENTLE_MPS2 = 4.0, 4.5
"""A full brake is more than the one, a gentle one less than the other."""


Pair = tuple[Step, Step]
Judge = Callable[[Drive, list[Pair]], str]


def duties(drive: Drive) -> list[Duty]:
    """A verdict per duty, from a whole drive."""
    steps = drive.steps
    pairs = [(a, b) for a, b in pairwise(steps) if a.seen.epoch == b.seen.epoch and b.seen.tick == a.seen.tick + 1]

    def found(judge: Judge) -> str:
        if not steps and judge is not readable:
            raise Wrong("no observation could be read")
        return judge(drive, pairs)

    return judged(DUTIES, drive.budget_ns, found)


def _rows(step: Step) -> list[list[float]]:
    return rows_of(step.seen).tolist()  # type: ignore[no-any-return]


def readable(drive: Drive, pairs: Sequence[Pair]) -> str:
    if drive.faults:
        reason, times = Counter(drive.faults).most_common(1)[0]
        raise Wrong(f"{len(drive.faults)} messages refused; {times} times: {reason}")
    if not drive.steps:
        raise Wrong("no observation came: is it a zenoh client of this router, on fastslow/ego/observation?")
    return f"{len(drive.steps)} observations"


def keeps_going(drive: Drive, pairs: Sequence[Pair]) -> str:
    if drive.stopped:
        where = f"for {GIVE_UP_S:g} s in the phase '{drive.stopped}'"
        raise Wrong(f"no observation {where}: it has stopped, or waits for an answer")
    return "until the end"


def rate(drive: Drive, pairs: Sequence[Pair]) -> str:
    stated = {step.seen.hz for step in drive.steps}
    if stated != {HZ}:
        raise Wrong(f"hz says {', '.join(map(str, sorted(stated)))}: {HZ} is asked for")
    if not pairs:
        raise Wrong("no two observations of ticks in a row")
    hz = NS / max(median(b.arrived_ns - a.arrived_ns for a, b in pairs), 1)
    if abs(hz - HZ) > RATE_OFF * HZ:
        raise Wrong(f"{hz:.1f} observations a second, {HZ} are asked for")
    return f"{hz:.1f} Hz at the median"


def stamps(drive: Drive, pairs: Sequence[Pair]) -> str:
    age = median(step.arrived_ns - step.seen.stamp_ns for step in drive.steps)
    if age < -FUTURE_NS:
        raise Wrong(f"stamp_ns is {-age / NS:.3g} s ahead of CLOCK_MONOTONIC, which is asked for")
    if age > STALE_NS:
        raise Wrong(f"stamp_ns is {age / NS:.3g} s old on arrival: CLOCK_MONOTONIC at the publication is asked for")
    back = sum(b.seen.stamp_ns <= a.seen.stamp_ns for a, b in pairs)
    if back:
        raise Wrong(f"{back} stamps do not grow")
    return f"{age / 1e6:.1f} ms old at the median"


def units(drive: Drive, pairs: Sequence[Pair]) -> str:
    for column, speed, least, name in ((X, VX, 20.0, "x_m"), (Y, VY, 2.0, "y_m")):
        moved = said = 0.0
        for a, b in pairs:
            before = {row[ID]: row for row in _rows(a)}
            for row in _rows(b):
                if (was := before.get(row[ID])) is not None and abs(row[X] - was[X]) < 20.0:
                    moved += abs(row[column] - was[column])
                    said += abs(row[speed] + was[speed]) / 2 / HZ
        if max(moved, said) > least and not 1 / UNIT_RATIO < moved / max(said, 1e-9) < UNIT_RATIO:
            raise Wrong(
                f"by {name} the cars moved {moved:.0f} m, by their speeds {said:.0f} m: m/s and m are asked for"
            )
    gained = [(_rows(b)[0][VX] - _rows(a)[0][VX]) * HZ - b.seen.acceleration_mps2 for a, b in pairs]
    off = median(map(abs, gained)) if gained else 0.0
    if off > 0.5:
        raise Wrong(f"acceleration_mps2 is off by {off:.1f} m/s2 from what the ego's speed does")
    return "positions, speeds and acceleration agree"


def ids(drive: Drive, pairs: Sequence[Pair]) -> str:
    for step in drive.steps:
        rows = _rows(step)
        if rows[0][ID] != 0:
            raise Wrong(f"tick {step.seen.tick}: the first row's id is {rows[0][ID]:g}; it is the ego's, which is 0")
        if len({row[ID] for row in rows}) < len(rows):
            raise Wrong(f"tick {step.seen.tick}: two cars have one id")
    jumps, seen = [], 0
    for a, b in pairs:
        before = {row[ID]: row for row in _rows(a)}
        for row in _rows(b):
            if (was := before.get(row[ID])) is not None:
                seen += 1
                if abs(row[X] - was[X]) > abs(row[VX]) / HZ + JUMP_M:
                    jumps.append(f"car {row[ID]:g} jumped by {row[X] - was[X]:.0f} m at tick {b.seen.tick}")
    if len(jumps) > 0.01 * seen:
        raise Wrong(f"{jumps[0]}, and {len(jumps) - 1} times more: an id stays with its car")
    return f"{len({row[ID] for step in drive.steps for row in _rows(step)})} ids"


def ticks(drive: Drive, pairs: Sequence[Pair]) -> str:
    inside = [(a.seen, b.seen) for a, b in pairwise(drive.steps) if a.seen.epoch == b.seen.epoch]
    odd = [(a.tick, b.tick) for a, b in inside if b.tick != a.tick + 1]
    if len(odd) > TOLERATED * max(len(inside), 1) or any(b <= a for a, b in odd):
        raise Wrong(f"tick {odd[0][1]} came after tick {odd[0][0]} of the same epoch: one more each time is asked for")
    return f"{len(inside) - len(odd)} of {len(inside)} are one more than the last"


def worlds(drive: Drive, pairs: Sequence[Pair]) -> str:
    epochs = [step.seen.epoch for step in drive.steps]
    changes = [(a.seen, b.seen) for a, b in pairwise(drive.steps) if a.seen.epoch != b.seen.epoch]
    for a, b in changes:
        if b.epoch <= a.epoch:
            raise Wrong(f"epoch {b.epoch} came after {a.epoch}: a greater one is asked for")
        if b.tick > 2:
            raise Wrong(f"epoch {b.epoch} began at tick {b.tick}: 0 is asked for")
    crashed = [a for a, b in pairs if a.seen.crashed]
    if len(crashed) > 1:
        raise Wrong(f"the world went on after a crash at tick {crashed[0].seen.tick}: a new epoch is asked for")
    if not changes:
        raise Wrong("no new world came: not on `control` restart, nor by driving on for 20 s")
    told = {event.epoch for event in drive.events if event.kind == EventKind.WORLD}
    untold = [b.epoch for _, b in changes if b.epoch not in told]
    if untold:
        raise Wrong(f"no event of kind `world` for epoch {untold[0]}")
    return f"{len(set(epochs))} worlds, each announced"


def applies(drive: Drive, pairs: Sequence[Pair]) -> str:
    asked = [(a, b) for a, b in pairs if a.answer is not None and a.prompt and a.phase not in ("strays",)]
    if not asked:
        raise Wrong("no tick could be answered in time")
    missed = [(a, b) for a, b in asked if b.seen.applied_tick != a.seen.tick]
    if len(missed) > TOLERATED * len(asked):
        a, b = missed[0]
        raise Wrong(
            f"{len(missed)} of {len(asked)} prompt answers were not applied: after the answer to tick {a.seen.tick} "
            f"applied_tick is {b.seen.applied_tick}"
        )
    return f"{len(asked) - len(missed)} of {len(asked)} prompt answers"


def _applied(pairs: Sequence[Pair]) -> list[Pair]:
    return [(a, b) for a, b in pairs if a.answer is not None and b.seen.applied_tick == a.seen.tick]


def set_points(drive: Drive, pairs: Sequence[Pair]) -> str:
    done = _applied(pairs)
    rises = falls = 0
    for a, b in done:
        was, now, action = a.seen.target_speed_mps, b.seen.target_speed_mps, a.answer
        assert action is not None
        where = f"tick {a.seen.tick}: target_speed_mps went from {was:.2f} to {now:.2f}"
        meta, cap = action.meta_action, math.inf if action.speed_cap_mps is None else action.speed_cap_mps
        if meta == MetaAction.SPEED_UP:
            most = SPEED_STEP_MPS if action.speed_goal_mps is None else action.speed_goal_mps - was
            if not -CLOSE <= now - was <= most + CLOSE:
                raise Wrong(f"{where} by 'speed up': {most:.2g} m/s more, or its most, is asked for")
            rises += now - was > CLOSE
        elif meta == MetaAction.SLOW_DOWN:
            if not min(was, cap) - SPEED_STEP_MPS - CLOSE <= now <= was + CLOSE:
                raise Wrong(f"{where} by 'slow down': {SPEED_STEP_MPS:g} m/s less is asked for")
            falls += was - now > CLOSE
        elif abs(now - was) > CLOSE:
            raise Wrong(f"{where} by '{MetaAction(meta).name.lower()}': that one leaves it alone")
    if not rises or not falls:
        raise Wrong(f"target_speed_mps {'never rose by speed up' if not rises else 'never fell by slow down'}")
    return f"{rises} steps up, {falls} down"


def lane_changes(drive: Drive, pairs: Sequence[Pair]) -> str:
    begun, sideways = 0, (MetaAction.LEFT, MetaAction.RIGHT)
    for a, b in _applied(pairs):
        assert a.answer is not None
        if a.answer.meta_action in sideways:
            aim = a.seen.target_lane + (1 if a.answer.meta_action == MetaAction.RIGHT else -1)
            moved = b.seen.target_lane != a.seen.target_lane
            if moved and (b.seen.target_lane, b.seen.previous_lane) != (aim, a.seen.target_lane):
                raise Wrong(
                    f"tick {a.seen.tick}: target_lane {b.seen.target_lane}, previous_lane {b.seen.previous_lane} after "
                    f"a change from {a.seen.target_lane} to {aim}"
                )
            begun += moved
        elif b.seen.target_lane != a.seen.target_lane and b.seen.target_lane != a.seen.previous_lane:
            raise Wrong(f"tick {a.seen.tick}: target_lane changed without being asked to")
    lanes = drive.steps[0].seen.lanes
    if len(lanes) == 1:
        return "one lane: none is possible"
    if not begun:
        tried = {(s.seen.epoch, s.seen.tick + 1) for s in drive.steps if s.phase == "change"}
        refused = [e.detail for e in drive.events if e.kind == EventKind.ACTUATOR and (e.epoch, e.tick) in tried]
        if not refused:
            raise Wrong("left and right never changed target_lane")
        return f"none was possible: {refused[0]}"
    changing = [b for _, b in pairs if b.phase == "change" and b.seen.previous_lane >= 0]
    arrived = any(b.seen.previous_lane < 0 <= a.seen.previous_lane for a, b in pairs)
    if changing and not arrived:
        raise Wrong(
            f"the change was not over after {len(changing)} ticks: previous_lane {changing[-1].seen.previous_lane}"
        )
    return f"{begun} begun"


def speeds(drive: Drive, pairs: Sequence[Pair]) -> str:
    capped = [a for a in drive.steps if a.phase == "cap"]
    if capped:
        action = capped[0].answer
        assert action is not None
        assert action.speed_cap_mps is not None
        speed = _rows(capped[-1])[0][VX]
        if speed > action.speed_cap_mps + 1.0 and capped[0].seen.epoch == capped[-1].seen.epoch:
            raise Wrong(f"{speed:.1f} m/s after 1.6 s under a speed_cap_mps of {action.speed_cap_mps:.1f}")
    braked = [b for a, b in _applied(pairs) if a.phase == "brake"]
    if not braked:
        raise Wrong("no 'emergency brake' was applied")
    least = min(b.seen.acceleration_mps2 for b in braked)
    if least > -BRAKE_MPS2 and all(_rows(b)[0][VX] > 2.0 for b in braked):
        raise Wrong(f"'emergency brake' slows down with {-least:.1f} m/s2 at most: as hard as the car can is asked for")
    return "the cap is kept, the emergency brake brakes"


def strays(drive: Drive, pairs: Sequence[Pair]) -> str:
    here = [(a, b) for a, b in pairs if a.phase == "strays" and a.prompt]
    if not here:
        raise Wrong("no stray could be tried in time")
    for k, (a, b) in enumerate(here):
        if b.seen.applied_tick > a.seen.tick:
            raise Wrong(f"applied_tick is {b.seen.applied_tick} after tick {a.seen.tick}")
        if abs(b.seen.target_speed_mps - a.seen.target_speed_mps) > CLOSE:
            raise Wrong(
                f"tick {a.seen.tick}: something that answers another tick or epoch, comes second, or cannot be read "
                f"was carried out (the {k + 1}th of them)"
            )
    kept = sum(b.seen.applied_tick == a.seen.tick for a, b in here)
    if kept < (1 - 2 * TOLERATED) * len(here):
        raise Wrong(f"beside them only {kept} of {len(here)} good answers were applied")
    return f"{len(here)} without effect"


def late(drive: Drive, pairs: Sequence[Pair]) -> str:
    for phase, what in (("late", budget_text(drive.budget_ns)), ("short", "its own budget_ns")):
        tried = [(a, b) for a, b in pairs if a.phase == phase and a.answer is None]
        if not tried:
            raise Wrong(f"no answer after {what} could be tried")
        used = [a for a, b in tried if b.seen.applied_tick == a.seen.tick]
        if used:
            raise Wrong(f"tick {used[0].seen.tick}: an answer that came after {what} was applied")
    return "none was applied"


def silence(drive: Drive, pairs: Sequence[Pair]) -> str:
    here = [(a, b) for a, b in pairs if a.phase == "silence" and not a.seen.crashed]
    if len(here) < 6:
        raise Wrong("the world did not go on without answers")
    first = here[0][0].seen
    for a, b in here[:HOLD_TICKS]:
        if abs(b.seen.target_speed_mps - first.target_speed_mps) > CLOSE or b.seen.target_lane != a.seen.target_lane:
            raise Wrong("the set-points changed in the first two ticks without an answer")
    before, after = _rows(here[HOLD_TICKS][0])[0][VX], _rows(here[-1][1])[0][VX]
    if before > 3.0 and after > before - 0.5:
        raise Wrong(
            f"{after:.1f} m/s after {len(here)} ticks without an answer, {before:.1f} before: it does not brake"
        )
    hardest = min(b.seen.acceleration_mps2 for _, b in here)
    if hardest < -GENTLE_MPS2:
        raise Wrong(f"it brakes with {-hardest:.1f} m/s2 without an answer: gently, some 2.5, is asked for")
    if here[-1][1].seen.applied_tick > first.tick:
        raise Wrong("applied_tick went on without answers")
    return f"from {before:.1f} to {after:.1f} m/s in {len(here) - HOLD_TICKS} ticks"


DUTIES: tuple[tuple[str, str, Judge], ...] = (
    ("readable", READABLE, readable),
    ("keeps going", "it never ends, nor waits longer than the budget, whatever is sent to it", keeps_going),
    ("rate", "15 observations a second", rate),
    ("stamps", "CLOCK_MONOTONIC of the publication, growing", stamps),
    ("units", "SI units, in the road frame", units),
    ("ids", "one per car, for as long as it exists; the ego first, with 0", ids),
    ("ticks", "one more at each step", ticks),
    ("epochs", "an episode's end begins a greater epoch at tick 0, and an event `world` says so", worlds),
    ("answers", "the first action with this tick and epoch is applied, and applied_tick says so", applies),
    ("set-points", "an action edits them once, by one step", set_points),
    ("lane changes", "left and right set target_lane, and previous_lane until the change is over", lane_changes),
    ("speeds", "no faster than speed_cap_mps; 5 brakes as hard as the car can", speeds),
    ("strays", "what is no answer to this tick has no effect", strays),
    ("budget", "what comes after {budget}, or after the action's own budget_ns, is not applied", late),
    ("silence", "without answers the set-points hold for two ticks; then it brakes gently", silence),
)
