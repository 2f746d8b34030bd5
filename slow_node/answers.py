"""Questions about the ride, answered from scene, mask and events; and what is said while something is waited for."""

from __future__ import annotations

from schemas.wire.messages import Reason
from schemas.wire.program import Question, Trigger
from slow_node.agenda import Agenda, Watch
from slow_node.planning.replies import sentence, spoken_length, spoken_speed
from slow_node.planning.scene import SIGHT_M, Scene, is_slow
from slow_node.planning.spoken import place
from slow_node.pursuit import Pursuit

TIGHT_S = 1.0
"""A car ahead nearer than this is too near."""
_REASONS = {
    Reason.ONCOMING: "oncoming",
    Reason.NO_RETURN: "front",
    Reason.REAR_GAP: "rear",
    Reason.FRONT_GAP: "front",
    Reason.LEAD: "lead",
    Reason.SPEED_FOR_GAP: "lead",
    Reason.NO_LANE: "lane",
    Reason.LANE_ENDS: "lane",
}


class Answers:
    """What can be told of the present moment, in one language and its units."""

    def __init__(
        self, scene: Scene, pursuit: Pursuit | None, agenda: Agenda | None, language: str, miles: bool
    ) -> None:
        self._scene, self._pursuit, self._agenda = scene, pursuit, agenda
        self._language, self._miles = language, miles

    def to(self, question: Question) -> str:
        """The answer, with its numbers."""
        match question:
            case "speed" | "limit":
                return self._say(f"is_{question}")
            case "lane":
                return self._say("is_lane")
            case "gap":
                return self._say("is_gap" if self._scene.lead else "is_nobody")
            case "why_not_overtake":
                return self._why_not_overtake()
            case "why_slow":
                return self._why_slow()
            case "waiting":
                return self._waiting()
            case "safe":
                return self._safe()
            case _:
                return self._plan()

    def _why_not_overtake(self) -> str:
        lead, pursuit = self._scene.lead, self._pursuit
        if lead is None:
            return self._say("is_nobody")
        if pursuit is not None and pursuit.delayed_by and not pursuit.fulfilled:
            return self._held_up(pursuit.delayed_by)
        if pursuit is not None and pursuit.overtakes and not pursuit.fulfilled:
            return self._say("on_it")
        return self._say("not_asked" if is_slow(lead.speed_mps, self._scene.limit_mps) else "not_slow")

    def _why_slow(self) -> str:
        scene, pursuit = self._scene, self._pursuit
        lead = scene.lead
        near = lead is not None and lead.gap_m < 3.0 * max(scene.speed_mps, 10.0)
        if near and lead is not None and is_slow(lead.speed_mps, scene.limit_mps):
            return self._say("slow_lead")
        if pursuit is not None and pursuit.slots.speed in ("slower", "stop", "keep"):
            return self._say("as_wished")
        return self._say("is_speed")

    def _waiting(self) -> str:
        waits = self._agenda.waits if self._agenda is not None else None
        if waits is not None:
            return waits_sentence(waits.trigger, "", self._language, self._miles)
        if self._pursuit is not None and self._pursuit.delayed_by and not self._pursuit.fulfilled:
            return self._held_up(self._pursuit.delayed_by)
        return self._say("waits_nothing")

    def _safe(self) -> str:
        scene = self._scene
        if scene.lead is None:
            return self._say("safe_alone")
        return self._say("safe_tight" if scene.lead.gap_m < TIGHT_S * scene.speed_mps else "safe_yes")

    def _plan(self) -> str:
        if self._agenda is not None and self._agenda.waits is not None:
            return self._waiting()
        return self._say("plan" if self._pursuit is not None and not self._pursuit.fulfilled else "plan_none")

    def _held_up(self, rule: str) -> str:
        reason = self._say(f"reason_{_REASONS.get(Reason(rule), 'other')}")
        return sentence("held_up", self._language, reason=reason)

    def _say(self, key: str) -> str:
        scene, lead = self._scene, self._scene.lead
        gap = scene.oncoming_gap_m if key == "reason_oncoming" else lead.gap_m if lead else 0.0
        return sentence(
            key,
            self._language,
            speed=spoken_speed(scene.speed_mps, self._miles),
            limit=spoken_speed(scene.limit_mps, self._miles),
            lead=spoken_speed(lead.speed_mps if lead else 0.0, self._miles),
            gap=spoken_length(max(min(gap, SIGHT_M), 0.0), self._miles),
            seconds=f"{max(lead.gap_m, 0.0) / max(scene.speed_mps, 1.0):.1f}" if lead else "",
            sight=spoken_length(SIGHT_M, self._miles),
            text=self._pursuit.command.text[:80] if self._pursuit is not None else "",
            **place(scene),
        )


def waits_sentence(trigger: Trigger, then: str, language: str, miles: bool) -> str:
    """What is waited for, and what comes then."""
    value = trigger.value or 0.0
    said = {"time": f"{value:.0f}", "distance": spoken_length(value, miles), "speed": spoken_speed(value, miles)}
    kind = "oncoming" if trigger.object == "oncoming" else "done" if trigger.kind == "exit" else trigger.kind
    after = sentence("then", language, what=then) if then else ""
    return sentence(f"wait_{kind}", language, value=said.get(trigger.kind, ""), then=after).strip()


FAR_M = 2000.0
"""An exit farther away than this is not spoken of."""


def lasts_sentence(lasts: Watch, scene: Scene, language: str, miles: bool) -> str:
    """Until when something is done."""
    trigger = lasts.trigger
    if trigger.kind == "exit":
        ahead_m = lasts.exit_m - scene.x_m
        return sentence(
            "lasts_exit" if ahead_m < FAR_M else "lasts_road", language, value=spoken_length(min(ahead_m, FAR_M), miles)
        )
    value = trigger.value or 0.0
    said = {"time": f"{value:.0f}", "distance": spoken_length(value, miles), "speed": spoken_speed(value, miles)}
    return sentence(f"lasts_{trigger.kind}", language, value=said.get(trigger.kind, ""))
