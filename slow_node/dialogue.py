"""What goes by the wish before it: "a bit more", "that's too much", "again", "the other way", "as before". Pure."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from schemas.wire.program import Act, Question, Side, Step, Trigger
from slow_node.planning.directive import may_take
from slow_node.planning.scene import Scene
from slow_node.planning.steps import headway_now_s
from slow_node.understanding.reading.values import A_BIT_MPS
from slow_node.understanding.slots import Slots

FOLLOW_UPS = ("more", "less", "again", "opposite", "back")
A_BIT_M = 10.0
"""What a bit more room is where no number was said; of speed, see `A_BIT_MPS`."""
MOST_LANES = 8
_ASKED_ABOUT: dict[Question, Step] = {
    "why_not_overtake": Step(act="overtake"),
    "safe": Step(act="overtake"),
    "why_slow": Step(act="faster"),
}
"""What "do it" means after a question."""
_OPPOSITE: dict[Act, Act] = {"faster": "slower", "slower": "faster", "closer": "farther", "farther": "closer"}
_OTHER_SIDE: dict[Side, Side] = {"left": "right", "right": "left", "leftmost": "rightmost", "rightmost": "leftmost"}


@dataclass(frozen=True)
class Said:
    """A wish that was acted on, and the road on which it was said."""

    steps: tuple[Step, ...]
    scene: Scene
    command: str = ""
    slots: Slots | None = None
    """Of its first stage."""


def follows(steps: tuple[Step, ...]) -> bool:
    """Whether steps go by a wish before them."""
    return len(steps) == 1 and steps[0].act in FOLLOW_UPS


def lacks_its_side(steps: tuple[Step, ...]) -> bool:
    """Whether steps ask for another lane without saying which."""
    return len(steps) == 1 and steps[0].act == "lane" and steps[0] == Step(act="lane")


def which_side(scene: Scene) -> str:
    """The key of the question, or of the refusal, for who wants another lane."""
    left, right = (may_take(scene, scene.kept_lane + way) for way in (-1, 1))
    if left and right:
        return "which_side"
    return "only_side_left" if left else "only_side_right" if right else "no_lane"


def asked(question: Question, scene: Scene, before: Said | None) -> Said | None:
    """What is talked of after a question; that before it, where it is about nothing that could be done."""
    step = _ASKED_ABOUT.get(question)
    return before if step is None else Said((step,), scene)


def resolved(said: Step, last: Said) -> tuple[Step, ...]:
    """The steps that are meant; empty where the wish before cannot be had more of, or turned round."""
    act = said.act
    if act == "again" and said.object == "now":
        return tuple(replace(step, when=None, polarity="do") for step in last.steps)
    if act == "again" and said.value is not None:
        return _of_size(said, last)
    if act == "again" and not any(step.act == "lane" and step.count and not step.side for step in last.steps):
        return last.steps
    if act == "back" and said.object == "one" and any(step.act == "lane" for step in last.steps):
        return _one_back(last)
    if act == "back":
        return _as_before(last)
    changed: list[Step] = []
    for step in last.steps:
        plain = replace(step, when=None, until=None)
        change = _named_as_change(plain) if act in ("more", "less") else plain
        one = {"more": _more, "again": _more, "less": _less, "opposite": _opposite}[act](_as_change(change, last.scene))
        if one is not None:
            changed.append(one)
    return tuple(changed)


def _of_size(said: Step, last: Said) -> tuple[Step, ...]:
    """The wish before with another number, in the unit that it had; empty where it had none."""
    value = said.value or 0.0
    *before, step = last.steps
    for name in ("when", "until"):
        trigger: Trigger | None = getattr(step, name)
        if trigger is not None and trigger.kind in ("time", "distance"):
            return (*before, replace(step, **{name: replace(trigger, value=value)}))
    if step.act == "lane" and 1 <= value <= MOST_LANES and not value % 1:
        return (*before, Step(act="lane", count=int(value)))
    if step.unit in ("s", "m"):
        return (*before, replace(step, value=value, unit=said.unit or step.unit))
    if step.unit == "mps" and step.value is not None and step.mode == "by":
        return (*before, replace(step, value=round(value / 3.6, 3)))
    return ()


def _named_as_change(step: Step) -> Step:
    """More of a speed or a gap that was named is a higher one, whatever it was before."""
    if step.mode in ("to", "at_least", "at_most") and step.value is not None and step.act in ("drive", "gap"):
        return Step(act="faster" if step.act == "drive" else "farther")
    return step


def _one_back(last: Said) -> tuple[Step, ...]:
    """One lane towards where we were before a change of lanes."""
    step = _opposite(_as_change(next(step for step in last.steps if step.act == "lane"), last.scene))
    if step is None or step.side is None:
        return ()
    return (Step(act="lane", side="left" if step.side.startswith("left") else "right", count=1),)


def _as_change(step: Step, scene: Scene) -> Step:
    """A value that was named as the change that it was then."""
    own = scene.own_lanes
    if step.act == "lane" and step.side is None and step.count is not None and scene.ego_lane in own:
        here = own.index(scene.ego_lane) + 1
        return Step(act="lane", side="left" if step.count < here else "right", count=1)
    if (
        step.act in ("drive", "faster", "slower")
        and step.value is not None
        and step.mode in ("to", "at_least", "at_most")
    ):
        return replace(
            step, act="faster" if step.value > scene.speed_mps else "slower", value=None, unit=None, mode=None
        )
    if step.act == "gap" and step.value is not None:
        before = headway_now_s(scene) * (max(scene.speed_mps, 1.0) if step.unit == "m" else 1.0)
        return replace(step, act="farther" if step.value > before else "closer", value=None, unit=None, mode=None)
    if step.act in ("yield", "smoother"):
        return Step(act="farther" if step.act == "yield" else "slower")
    return step


def _sized(step: Step, share: float) -> Step:
    """The change by so much of what it was; by a bit where no number was said."""
    if step.act in ("faster", "slower"):
        value = step.value if step.mode == "by" and step.value is not None else A_BIT_MPS
        return replace(step, value=round(share * value, 3), unit="mps", mode="by", object="", side=None)
    if step.mode == "by" and step.value is not None:
        return replace(step, value=round(share * step.value, 3))
    return replace(step, value=share * A_BIT_M, unit="m", mode="by")


def _more(step: Step) -> Step | None:
    if step.act in _OPPOSITE:
        return _sized(step, 1.0)
    return step if step.act == "lane" and step.side in ("left", "right") else None


def _less(step: Step) -> Step | None:
    if step.act in _OPPOSITE:
        return replace(_sized(step, 0.5), act=_OPPOSITE[step.act])
    return _opposite(step)


def _opposite(step: Step) -> Step | None:
    if step.act in _OPPOSITE:
        return replace(_sized(step, 1.0), act=_OPPOSITE[step.act])
    if step.act == "lane" and step.side in _OTHER_SIDE:
        return replace(step, side=_OTHER_SIDE[step.side])
    if step.act == "overtake":
        return replace(step, polarity="not" if step.polarity == "do" else "do")
    return None


def _as_before(last: Said) -> tuple[Step, ...]:
    """Speed, gap and lane as they were when the wish before was said, of what it has changed."""
    acts, scene = {step.act for step in last.steps}, last.scene
    if acts & {"overtake", "cancel"}:
        return (Step(act="cancel"),)
    steps: list[Step] = []
    if acts & {"drive", "faster", "slower", "stop", "smoother"}:
        steps.append(Step(act="drive", value=round(scene.speed_mps, 3), unit="mps", mode="to"))
    if acts & {"gap", "closer", "farther", "yield"}:
        steps.append(Step(act="gap", value=round(max(headway_now_s(scene), 1.0), 3), unit="s", mode="to"))
    if "lane" in acts:
        own = scene.own_lanes
        if scene.ego_lane in own:
            steps.append(Step(act="lane", count=min(own.index(scene.ego_lane) + 1, 8)))
    return tuple(steps)


def smaller(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """The first step by a bit, where it is a change without a number; as they are where it is none."""
    if not steps or steps[0].act not in _OPPOSITE or steps[0].value is not None or steps[0].object == "bit":
        return steps
    return (_sized(steps[0], 0.5), *steps[1:])
