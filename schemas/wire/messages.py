"""What travels on the bus: frozen structs, encoded as MessagePack maps.

Conventions, for every message:

* SI units, with the unit in the field's name. The road frame is right-handed seen from above with the x axis along
  the ego's direction of travel and the y axis growing to the **right** (highway-env's convention), so lane 0 is the
  leftmost lane and "left" means a smaller lane index.
* Fields are only ever appended, with a default; a name never changes its type or meaning. `schema` is `major.minor`:
  a reader refuses another major and reads a newer minor, ignoring fields that it does not know and keeping members of
  an enumeration that it does not know as they came (`Open`).
* `epoch` names one continuous world (a new one at every start or reset of the simulator); ticks count from 0 inside
  it. What belongs to an old epoch is stale whatever its age.
* `stamp_ns` is CLOCK_MONOTONIC of the publishing host, comparable on one host only. Nothing reads wall time for age.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Literal

from msgspec import Struct

from schemas.wire.program import Step

SCHEMA_VERSION = "3.4"

Manoeuvre = Literal["cruise", "follow", "overtake", "merge", "yield", "stop"]
Mode = Literal["NOMINAL", "DEGRADED", "FAIL-SAFE", "STOPPED"]
"""All is well; the fallback drives, or answers are missing; the simulator stops the car; it stands for that reason."""
Style = Literal["calm", "normal", "assertive"]

ROW_COLUMNS = ("id", "x_m", "y_m", "vx_mps", "vy_mps", "heading_rad", "length_m", "width_m", "lane")
"""Layout `rows/1` of `Observation.rows`: one little-endian float32 row per vehicle, the ego first, then by distance.

`id` is stable within an epoch (the ego is 0); `x_m`, `y_m` are the vehicle's centre in the road frame; `lane` is the
index in `Observation.lanes` of the lane that its centre is in."""
ROW_LAYOUT = "rows/1"


class MetaAction(IntEnum):
    """The paper's action space A (Eq. 2), and one action that only the safety mask may take.

    Each is a one-shot edit of the executor's set-points; CRUISE leaves them alone, so a repeated CRUISE holds them.
    """

    SLOW_DOWN = 0
    """Target speed minus one step."""
    CRUISE = 1
    """Set-points stay."""
    SPEED_UP = 2
    """Target speed plus one step."""
    LEFT = 3
    """Target lane minus one; while a change to the right is under way: give that change up."""
    RIGHT = 4
    """Target lane plus one; while a change to the left is under way: give that change up."""
    EMERGENCY_BRAKE = 5
    """Brake in lane as hard as the car can, for this tick. Never in the policy's distribution."""


POLICY_ACTIONS = 5
"""How many members of `MetaAction` the policy chooses among (the paper's five)."""


class Open(StrEnum):
    """An enumeration that may grow with a minor version: what a newer node sends is kept, with its text, as UNKNOWN."""

    @classmethod
    def _missing_(cls, value: object) -> Open | None:
        if not isinstance(value, str):
            return None
        unknown = str.__new__(cls, value)
        unknown._name_, unknown._value_ = "UNKNOWN", value
        return unknown


class Reason(Open):
    """Why the mask, or the passenger's intent, closes an action. The mask numbers them in this order, from 1."""

    NO_LANE = "no lane there"
    CHANGING = "one change at a time"
    LEAD = "lead too close"
    SPEED_FOR_GAP = "speed above the gap's"
    FRONT_GAP = "front gap in lane"
    REAR_GAP = "rear gap in lane"
    ONCOMING = "oncoming traffic"
    NO_RETURN = "no gap to return to"
    NOTHING_TO_PASS = "nothing to pass"
    FINISH = "finish the pass"
    GIVE_UP = "give up the pass"
    LANE_ENDS = "lane ends"
    GIVE_UP_CHANGE = "give up the change"
    NOT_WISHED = "not wished"


class Message(Struct, frozen=True, kw_only=True):
    """What every message carries."""

    epoch: int
    stamp_ns: int
    schema: str = SCHEMA_VERSION


class Lane(Struct, frozen=True, kw_only=True):
    """One lane of the road near the ego, as it lies there now."""

    y_m: float
    """Lateral position of its centre line."""
    start_m: float
    end_m: float
    """The lane exists for start_m <= x <= end_m."""
    direction: Literal[1, -1] = 1
    """+1 if traffic drives towards growing x; -1 on an oncoming lane, which may be borrowed to pass."""
    width_m: float = 4.0
    speed_limit_mps: float = 20.0
    kind: Literal["main", "ramp", "oncoming"] = "main"
    change_from_m: float = -1e9
    """Nobody changes out of this lane before this x: a ramp is beside the road only from here on."""


class Observation(Message, frozen=True, kw_only=True, tag="observation"):
    """What the ego sees at one tick: itself, its neighbours, the lanes. 15 Hz, from the simulator."""

    tick: int
    scenario: str
    lanes: tuple[Lane, ...]
    rows: bytes
    """(V, 9) float32, little-endian, C order, V >= 1; see `ROW_COLUMNS`. Decode with `schemas.wire.codec.rows_of`."""
    acceleration_mps2: float = 0.0
    """The ego's longitudinal acceleration over the last tick."""
    target_speed_mps: float = 0.0
    """The executor's speed set-point."""
    target_lane: int = 0
    """The executor's lane set-point; differs from the ego's lane while a change is under way."""
    goal_x_m: float = float("inf")
    """Where the road or the task ends."""
    crashed: bool = False
    applied_tick: int = -1
    """The newest action applied so far answers this tick (-1: none yet)."""
    layout: str = ROW_LAYOUT
    hz: int = 15
    previous_lane: int = -1
    """The lane that the running lane change left; -1 when none is under way."""
    sight_m: float = 200.0
    """How far the ego sees: cars beyond may exist and are not in `rows`."""


class Closure(Struct, frozen=True, kw_only=True):
    """Why the mask closed one action: the reason and, where there is one, the vehicle."""

    action: int
    reason: Reason
    vehicle: int = -1


class Action(Message, frozen=True, kw_only=True, tag="action"):
    """What the ego does for one tick. Exactly one is published for every observation, whatever fails."""

    answers_tick: int
    meta_action: int
    source: Literal["policy", "masked", "coordination", "fallback"]
    """Who decided: the policy; the mask against the policy; the coordination rules; the fallback controller."""
    speed_goal_mps: float | None = None
    """A speed step towards this goal stops at it, so that a wished speed can be held exactly."""
    directive_id: int | None = None
    compute_ns: int = 0
    """From the observation's arrival to this message's encoding."""
    budget_ns: int = 0
    closed: tuple[Closure, ...] = ()
    why: str = ""
    probabilities: tuple[float, ...] = ()
    """The policy's, of its five actions, before mask and intent close any; empty where it has not spoken."""
    speed_cap_mps: float | None = None
    """The ego drives no faster than this in the coming tick, whatever its set-point: what the cars ahead, the road's
    end and the intent admit. None: no cap."""
    style: int = 1
    """How the executor drives: 0 calm, 1 normal, 2 assertive."""
    turn_signal: int = 0
    """-1 left, 1 right: where the ego is changing to, or means to as soon as it can; 0: neither."""


class Command(Message, frozen=True, kw_only=True, tag="command"):
    """What the passenger said. Plain UTF-8 text on the same key is accepted as well and gets an id on arrival."""

    id: int
    text: str
    source: str = "passenger"


class Directive(Message, frozen=True, kw_only=True, tag="directive"):
    """The slow system's structured guidance: a preference that the safety mask may delay or refuse (paper's i_t)."""

    id: int
    command_id: int
    scene_tick: int
    """The tick of the observation it was thought for."""
    manoeuvre: Manoeuvre = "cruise"
    target_lane: int | None = None
    """Absolute lane index; wins over `relative_lane`."""
    relative_lane: Literal["left", "right"] | None = None
    """Relative to the ego's lane at `scene_tick`; the slow node resolves it to `target_lane` before publishing."""
    target_speed_mps: float | None = None
    headway_s: float | None = None
    style: Style = "normal"
    ttl_s: float = 30.0
    """Time to live, counted from `stamp_ns`: how long it may be pending. What it wishes for stands beyond that."""
    confidence: float = 1.0
    reasoning: str = ""
    say: str = ""
    """What to tell the passenger."""
    steps: tuple[Step, ...] = ()
    """The whole program of its command; empty where the command has no more than this."""
    step: int = 0
    """The first of `steps` that this directive carries out."""
    waits_for: str = ""
    """What the next step waits for; "": none waits."""


Verdict = Literal["", "confirmed", "refined", "withdrew", "overruled", "decided", "unanswered"]
"""What the language model's answer did to the quick reader's, which was acted on first: it is the same; another
directive follows; nothing is left of it; it counts for nothing. decided: the car had waited for it. unanswered: none
came, or none in time. "": no model was asked, or it has not answered yet."""
ReplyOutcome = Literal["heard", "refused", "issued", "fulfilled", "expired", "superseded", "cancelled", "failed"]
ENDS = ("fulfilled", "expired", "superseded", "cancelled", "failed")
"""What ends a directive: an event's kind or a reply's outcome."""


class Reply(Message, frozen=True, kw_only=True, tag="reply"):
    """An answer to the passenger. `heard` or `refused` within 1 s of the command, then how it went on."""

    command_id: int
    outcome: ReplyOutcome
    text: str
    """The command as it was understood (its first 200 characters)."""
    say: str = ""
    why: str = ""
    directive_id: int | None = None
    waits_for: str = ""
    """Understood, and done once this has come; "": nothing is waited for."""
    verdict: Verdict = ""
    """The language model has answered meanwhile. Where it changes nothing, the outcome is that of the reply before."""


class EventKind(Open):
    """What has happened; since when it counts is in `schemas/README.md`."""

    DELAYED = "delayed"
    """The mask holds back what the directive asks for."""
    OVERRIDDEN = "overridden"
    """The ego accelerates to the limit first, whatever speed was asked for, until a car behind leaves room."""
    CARRIED_OUT = "carried_out"
    """A lane change that was delayed begins."""
    FULFILLED = "fulfilled"
    EXPIRED = "expired"
    WORLD = "world"
    """A new world has begun; `detail` says after what."""
    WAITING = "waiting"
    """A step of a command waits; `detail` says for what."""
    DUE = "due"
    """What a step waited for has come; its directive is sent."""
    FAULT = "fault"
    """A part of the run has given up, and the run goes on without it; `detail` says which and why."""
    ACTUATOR = "actuator"
    """The simulator has not carried out an action, or has braked instead; `detail` says which and why."""


class Event(Message, frozen=True, kw_only=True, tag="event"):
    """Something that happened to a directive or to the world, with the reason for it and for how long.

    About a directive, `reason` is the mask's; of one that has ended the last that held it up, None if none did.
    """

    kind: EventKind
    node: str
    tick: int
    reason: Reason | None = None
    vehicle: int = -1
    since_tick: int = -1
    """The tick at which the condition began; -1 when the event has no extent."""
    duration_s: float = 0.0
    """From `since_tick` to `tick`."""
    directive_id: int | None = None
    command_id: int | None = None
    detail: str = ""


class Status(Message, frozen=True, kw_only=True, tag="status"):
    """A node's heartbeat, with its metrics."""

    node: str
    pid: int
    seq: int
    state: Literal["starting", "ready", "degraded", "stopping"]
    metrics: dict[str, float] = {}
    detail: str = ""
    mode: Mode | None = None
    """How the car is driven; the simulator knows, and no other node says."""
    mode_why: str = ""
    mode_since_ns: int = 0
    """When it began; 0: it has been so since the start."""


class Control(Message, frozen=True, kw_only=True, tag="control"):
    """What somebody orders who watches the simulator. A real road would not obey."""

    do: Literal["pause", "resume", "step", "restart"]
    """Stand still; go on; one tick, then stand still; a new world."""
    scenario: str = ""
    """Of a restart: the road; "" for the same."""
    seed: int | None = None
    """Of a restart: which traffic; None for the same."""
    density: float | None = None
    """Of a restart: times the road's own traffic; None for the same."""
