"""A ride: deliberation over time, with all that came out of it, for tests."""

from __future__ import annotations

from schemas.runtime.clock import NS
from schemas.wire.messages import Command, Directive, Event, EventKind, Lane, Observation, Reason, Reply, Verdict
from schemas.wire.program import Outcome, Program, Question, Step
from slow_node.deliberation import Deliberation
from slow_node.effects import Effect, Interpret, Remember
from slow_node.interpretation import Interpretation
from slow_node.planning.scene import Scene, encode_scene
from slow_node.understanding.slots import Slots
from tests import scenes
from tests.scenes import car

LIMIT = 20.0
HURRY = Slots(outcome="directive", speed="faster", overtake=True, language="de")
CANCEL = Slots(outcome="directive", cancel=True, language="de")
LEFT = Slots(outcome="directive", lane="left")
Car = tuple[int, float, float]
"""Lane, distance ahead between centres [m], speed [m/s]."""
START_S = 100.0


def lane(direction: int = 1, kind: str = "main", start_m: float = -1e4, end_m: float = 1e4) -> Lane:
    return scenes.lane(oncoming=direction < 0, ramp=kind == "ramp", start_m=start_m, end_m=end_m, limit_mps=LIMIT)


ONE_WAY = (lane(), lane(), lane())
TWO_WAY = (lane(-1, "oncoming"), lane())


def seen(
    at_s: float,
    ego: int,
    *cars: Car,
    lanes: tuple[Lane, ...] = ONE_WAY,
    speed: float = 15.0,
    epoch: int = 1,
    at_m: float = 0.0,
) -> Observation:
    rows = [car(n, at_m + x, at, v) for n, (at, x, v) in enumerate(((ego, 0.0, speed), *cars))]
    return scenes.observation(*rows, lanes=lanes, epoch=epoch, stamp_ns=round(at_s * NS), tick=round(at_s * 15))


def scene(ego: int, *cars: Car, lanes: tuple[Lane, ...] = ONE_WAY, speed: float = 15.0) -> Scene:
    return encode_scene(seen(0.0, ego, *cars, lanes=lanes, speed=speed))


class Ride:
    """A deliberation with its time, and all that came out of it. Times in seconds."""

    def __init__(self, lanes: tuple[Lane, ...] = ONE_WAY, budget_s: float = 0.0, *, asks_again: bool = False) -> None:
        self.deliberation = Deliberation(budget_s, asks_again=asks_again)
        self.lanes, self.now_s, self.said = lanes, START_S, 0
        self.out: list[Effect] = []

    def look(
        self, ego: int, *cars: Car, after_s: float = 0.1, epoch: int = 1, speed: float = 15.0, at_m: float = 0.0
    ) -> list[Effect]:
        self.now_s += after_s
        observation = seen(self.now_s, ego, *cars, lanes=self.lanes, epoch=epoch, speed=speed, at_m=at_m)
        return self._keep(self.deliberation.on_scene(encode_scene(observation), self._now()))

    def hear(self, *, old_s: float = 0.0) -> list[Effect]:
        self.said += 1
        command = Command(epoch=1, stamp_ns=self._now() - round(old_s * NS), id=self.said, text=f"wish {self.said}")
        return self._keep(self.deliberation.on_command(command, self._now()))

    def say(
        self, slots: Slots | None, *, thinks_s: float = 0.0, reached: bool = True, program: Program | None = None
    ) -> list[Effect]:
        """A command that is understood so, or fails."""
        call = next(e for e in self.hear() if isinstance(e, Interpret))
        self.now_s += thinks_s
        found = Interpretation(slots, "", reached, program=program)
        return self._keep(self.deliberation.on_interpretation(call.id, found, self._now()))

    def read(self, slots: Slots) -> Interpret:
        """A command that the quick reader is sure of, and acts on; the model is still thinking."""
        call = next(e for e in self.hear() if isinstance(e, Interpret))
        self.answer(call, slots, provisional=True)
        return call

    def answer(
        self, call: Interpret, slots: Slots, verdict: Verdict = "", *, provisional: bool = False, why: str = ""
    ) -> list[Effect]:
        """What a call comes to."""
        found = Interpretation(slots, why, provisional=provisional, verdict=verdict)
        return self._keep(self.deliberation.on_interpretation(call.id, found, self._now()))

    def ask_for(self, *steps: Step, question: Question = "", outcome: Outcome = "directive") -> list[Effect]:
        """A command that is read as a program."""
        program = Program(outcome=outcome, steps=steps, question=question)
        return self.say(Slots(outcome=outcome), program=program)

    def tell(self, kind: str, reason: str | None = None, *, number: int = -1) -> list[Effect]:
        """The fast node reports about the newest directive, or the one of that number."""
        return self._keep(
            self.deliberation.on_event(
                Event(
                    epoch=1,
                    stamp_ns=self._now(),
                    kind=EventKind(kind),
                    node="fast",
                    tick=0,
                    reason=Reason(reason) if reason else None,
                    directive_id=self.directives[number].id,
                ),
                self._now(),
            )
        )

    def wait(self, seconds: int, ego: int, *cars: Car) -> list[Effect]:
        """So many seconds of the same scene, two scenes in each."""
        return [effect for _ in range(2 * seconds) for effect in self.look(ego, *cars, after_s=0.5)]

    @property
    def directives(self) -> list[Directive]:
        return [e for e in self.out if isinstance(e, Directive)]

    @property
    def replies(self) -> list[Reply]:
        return [e for e in self.out if isinstance(e, Reply)]

    @property
    def events(self) -> list[tuple[str, str]]:
        """What the slow node tells of its programs: kind and detail."""
        return [(str(e.kind), e.detail) for e in self.out if isinstance(e, Event)]

    @property
    def outcomes(self) -> list[str]:
        return [reply.outcome for reply in self.replies]

    @property
    def learnt(self) -> list[str]:
        return [e.outcome for e in self.out if isinstance(e, Remember)]

    def _now(self) -> int:
        return round(self.now_s * NS)

    def _keep(self, effects: list[Effect]) -> list[Effect]:
        self.out += effects
        return effects


def directives(effects: list[Effect]) -> list[Directive]:
    return [e for e in effects if isinstance(e, Directive)]


def riding(slots: Slots, ego: int, *cars: Car, lanes: tuple[Lane, ...] = ONE_WAY) -> Ride:
    """A ride on which this was just said."""
    ride = Ride(lanes)
    ride.look(ego, *cars)
    ride.say(slots)
    return ride


def ramp_ahead(end_m: float) -> tuple[Lane, ...]:
    """Two lanes that go on, and a ramp that ends."""
    return (lane(), lane(), lane(kind="ramp", end_m=end_m))
