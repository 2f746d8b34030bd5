"""What a command still has to do: the steps that wait, for what, and until when the one under way lasts. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace

from schemas.driving.measures import INF
from schemas.driving.road import ID, LANE, LENGTH, VX, X, has_passed, is_oncoming
from schemas.runtime.clock import NS
from schemas.wire.messages import Command
from schemas.wire.program import Program, Trigger
from slow_node.planning.scene import Scene
from slow_node.planning.steps import Stage, ends, slots_of, stages
from slow_node.understanding.slots import Slots

WAIT_MAX_S, CRAWL_MPS = 60.0, 5.0
"""What has not come by then is not waited for any longer; a time or a distance that was named, as long as it takes, at
this speed at least."""
LONG_M = 6.5
"""A vehicle longer than this is a truck or a bus."""
CLEAR_M, CLEAR_S = 120.0, 8.0
"""No oncoming car nearer than this, in metres and in seconds: the way is clear."""
REACHED_MPS = 0.5
HERE_M = 5.0
"""An exit nearer than this is the one that we are at."""


@dataclass(frozen=True)
class Watch:
    """A trigger that is waited for, and the road on which that began."""

    trigger: Trigger
    began_ns: int
    x_m: float
    speed_mps: float
    car: int | None = None
    """The vehicle that it is about."""
    ahead: bool = False
    """It was ahead of us then."""
    exit_m: float = INF
    """Where the exit is."""

    def due(self, scene: Scene, now_ns: int) -> bool:
        """Whether it has come."""
        trigger = self.trigger
        match trigger.kind:
            case "time":
                return now_ns - self.began_ns >= (trigger.value or 0.0) * NS
            case "distance":
                return scene.x_m - self.x_m >= (trigger.value or 0.0)
            case "passed":
                return self._passed(scene)
            case "free":
                return _free(trigger.side, scene)
            case "clear":
                return scene.oncoming_gap_m > max(CLEAR_M, CLEAR_S * scene.oncoming_closing_mps)
            case "speed":
                goal = trigger.value or 0.0
                if self.speed_mps <= goal:
                    return scene.speed_mps >= goal - REACHED_MPS
                return scene.speed_mps <= goal + REACHED_MPS
            case "exit":
                return scene.x_m >= self.exit_m
            case _:
                return False

    def _passed(self, scene: Scene) -> bool:
        other = None if self.car is None else scene.others.get(self.car)
        if other is None:
            return True
        return has_passed(scene.ego, other) if self.ahead else has_passed(other, scene.ego)


def watch(trigger: Trigger, scene: Scene, now_ns: int) -> Watch:
    """Begin to wait for a trigger: from here, from now, for the vehicle that is meant."""
    car, ahead = _meant(trigger, scene) if trigger.kind == "passed" else (None, False)
    return Watch(trigger, now_ns, scene.x_m, scene.speed_mps, car, ahead, exit_ahead_m(scene))


def exit_ahead_m(scene: Scene) -> float:
    """Where the next exit is, as far as the lanes tell: where one of our direction leaves the road or ends, else where
    the road does. Along the road, in metres."""
    own = [lane for lane in scene.lanes if lane.direction == 1]
    leaves = [lane.start_m for lane in own if lane.kind == "ramp"] + [lane.end_m for lane in own]
    return min((at for at in leaves if at > scene.x_m + HERE_M), default=INF)


def _free(side: str | None, scene: Scene) -> bool:
    here = scene.ego_lane
    lanes = [here - 1] if side == "left" else [here + 1] if side == "right" else [here - 1, here + 1]
    return any(scene.exists(lane) and scene.lanes[lane].direction == 1 and lane in scene.free_lanes for lane in lanes)


def _meant(trigger: Trigger, scene: Scene) -> tuple[int | None, bool]:
    """The vehicle that is meant, and whether it is ahead: the nearest of its kind, first of those beside and behind in
    other lanes that are faster, for they pass; then of those ahead."""
    ego = scene.ego
    oncoming = trigger.object == "oncoming"
    long = trigger.object in ("truck", "bus")
    seen = [row for row in scene.others.values() if is_oncoming(row) == oncoming]
    kind = [row for row in seen if row[LENGTH] > LONG_M] if long else []
    near: tuple[float, int | None, bool] = (INF, None, False)
    for row in kind or seen:
        ahead = row[X] > ego[X] if not oncoming else True
        if oncoming and row[X] < ego[X]:
            continue
        if not oncoming and not ahead and (row[VX] <= ego[VX] or row[LANE] == ego[LANE]):
            continue
        distance = abs(row[X] - ego[X])
        if distance < near[0]:
            near = (distance, int(row[ID]), ahead)
    return near[1], near[2]


@dataclass(frozen=True)
class Agenda:
    """A command's program while it goes on."""

    command: Command
    program: Program
    language: str
    at: int
    """The stage that is under way, or waits."""
    waits: Watch | None = None
    """What the stage waits for; None: it is under way."""
    lasts: Watch | None = None
    """Until when the stage under way lasts."""

    @property
    def parts(self) -> tuple[Stage, ...]:
        return stages(self.program)

    @property
    def stage(self) -> Stage:
        return self.parts[self.at]

    @property
    def later(self) -> tuple[Stage, ...]:
        """The stages after this one."""
        return self.parts[self.at + 1 :]

    def asked(self, scene: Scene) -> Slots:
        """What the stage asks for on this road."""
        return slots_of(self.stage, scene, self.language, self.program.miles)

    @property
    def next_trigger(self) -> Trigger | None:
        """What the stage after this one waits for; None: there is none."""
        parts = self.parts
        return parts[self.at + 1][0].when if self.at + 1 < len(parts) else None

    @property
    def first_step(self) -> int:
        """The index in the program of the stage's first step."""
        return sum(len(part) for part in self.parts[: self.at])

    @property
    def has_named_lane(self) -> bool:
        """A step before this stage has asked for a lane."""
        return any(step.act == "lane" for step in self.program.steps[: self.first_step])

    def waiting(self) -> Trigger | None:
        """What is waited for now: by this stage, or by the next one."""
        return self.waits.trigger if self.waits is not None else self.next_trigger

    @property
    def is_open(self) -> bool:
        """Something of it is still to come."""
        return self.waiting() is not None or self.lasts is not None

    def under_way(self, scene: Scene, now_ns: int) -> Agenda:
        """Its stage has begun."""
        until = ends(self.stage)
        lasts = watch(until, scene, now_ns) if until is not None and until.kind != "done" else None
        return replace(self, waits=None, lasts=lasts)

    def moved_on(self, scene: Scene, now_ns: int) -> Agenda | None:
        """The next stage, and what it waits for; None: that was the last one."""
        trigger = self.next_trigger
        if trigger is None:
            return None
        waits = None if trigger.kind == "done" else watch(trigger, scene, now_ns)
        return replace(self, at=self.at + 1, waits=waits, lasts=None)

    def given_up(self, now_ns: int) -> bool:
        """It has waited for too long."""
        if self.waits is None:
            return False
        kind, value = self.waits.trigger.kind, self.waits.trigger.value or 0.0
        promised_s = value + 1.0 if kind == "time" else value / CRAWL_MPS if kind == "distance" else 0.0
        return now_ns - self.waits.began_ns > max(WAIT_MAX_S, promised_s) * NS


def told(trigger: Trigger | None) -> str:
    """What is waited for, in a few words of English for the record and the cockpit."""
    if trigger is None:
        return ""
    value = trigger.value or 0.0
    match trigger.kind:
        case "time":
            return f"{value:.0f} s"
        case "distance":
            return f"{value:.0f} m"
        case "passed":
            who = "the oncoming car" if trigger.object == "oncoming" else f"the {trigger.object or 'car'}"
            return f"{who} to pass"
        case "free":
            return f"room on the {trigger.side}" if trigger.side else "room beside us"
        case "clear":
            return "no oncoming traffic"
        case "speed":
            return f"{value:.1f} m/s"
        case "done":
            return "the step before"
        case "exit":
            return "the exit"
