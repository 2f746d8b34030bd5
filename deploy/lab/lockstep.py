"""The same nodes without processes or wall clock: reproducible episodes for evaluation and tests."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from deploy.lab.picture import picture
from fast_node.config import FastConfig
from fast_node.mask import PRESETS
from fast_node.node import FastNode
from fast_node.policies.load import load_policy
from fast_node.policies.policy import NamedPolicy
from schemas.driving.road import HZ
from schemas.runtime.clock import NS
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics
from schemas.wire.messages import Action, Directive, Event, EventKind, Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode

Ask = Callable[[Observation, int], Directive | None]
"""Called at every tick with the observation and the time [ns]; returns a new directive or None."""


@dataclass
class Episode:
    """What happened in one lock-step episode; times in seconds since its start."""

    seed: int
    collided: bool = False
    passed: bool = False
    fulfilled_s: float | None = None
    min_ttc_s: float = float("inf")
    seconds: float = 0.0
    speeds: list[float] = field(default_factory=list)
    lanes: list[int] = field(default_factory=list)
    accelerations: list[float] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    overridden: int = 0
    """Ticks in which the mask decided against the policy."""


def overtake_at(at_s: float, ttl_s: float = 120.0) -> Ask:
    """A passenger in a hurry, without a language model: one overtake directive at `at_s`."""

    def ask(observation: Observation, now_ns: int) -> Directive | None:
        if observation.tick != round(at_s * HZ):
            return None
        return Directive(
            epoch=observation.epoch,
            stamp_ns=now_ns,
            id=1,
            command_id=1,
            scene_tick=observation.tick,
            manoeuvre="overtake",
            target_speed_mps=8.0,
            style="assertive",
            ttl_s=ttl_s,
        )

    return ask


@dataclass(frozen=True)
class Tick:
    """What the nodes said at one tick of a lock-step drive."""

    observation: Observation
    action: Action
    events: list[Event]
    directive: Directive | None
    """The newest one so far."""


def drive(sim: SimNode, policy: NamedPolicy, ask: Ask, duration_s: float, preset: str | None = None) -> Iterator[Tick]:
    """Drive one episode tick by tick, until it is over or `duration_s` have passed; the messages are encoded and
    decoded as on the real bus. preset: of the mask, by default the policy's. `sim` is a tick ahead of what is yielded.
    """
    bus = LocalBus()
    observations, actions = bus.subscribe(topics.OBSERVATION), bus.subscribe(topics.ACTION)
    directives = bus.subscribe(topics.DIRECTIVE)
    mask = PRESETS[preset or policy.mask_preset]
    fast = FastNode(FastConfig(), policy, mask, stateless=policy.stateless)
    sim.reset(1)
    bus.publish(topics.OBSERVATION, sim.observation(0))
    for k in range(round(duration_s * HZ)):
        now_ns = k * NS // HZ
        seen = observations.wait()
        if (directive := ask(seen, now_ns)) is not None:
            bus.publish(topics.DIRECTIVE, directive)
        action, events = fast.step(seen, directives.peek(), now_ns)
        bus.publish(topics.ACTION, action)
        bus.publish(topics.OBSERVATION, sim.step(actions.wait(), now_ns + NS // HZ))
        yield Tick(seen, action, events, directives.peek())
        if sim.over:
            return


def run_episode(
    seed: int,
    policy: NamedPolicy,
    ask: Ask,
    *,
    duration_s: float = 60.0,
    scenario: str = "two-way",
    noise_m: float = 0.0,
    noise_mps: float = 0.0,
    dropout: float = 0.0,
) -> Episode:
    """Drive one episode and measure it. noise_m, noise_mps, dropout: see `SimConfig`."""
    config = SimConfig(scenario=scenario, seed=seed, noise_m=noise_m, noise_mps=noise_mps, dropout=dropout)
    episode, sim = Episode(seed), SimNode(config)
    for tick in drive(sim, policy, ask, duration_s):
        episode.events += tick.events
        episode.overridden += tick.action.source == "masked"
        if episode.fulfilled_s is None and any(e.kind == "fulfilled" for e in tick.events):
            episode.fulfilled_s = tick.observation.tick / HZ
        episode.speeds.append(sim.speed_mps)
        episode.lanes.append(sim.lane)
        episode.accelerations.append(tick.observation.acceleration_mps2)
    episode.seconds = len(episode.speeds) / HZ
    episode.collided = sim.metrics.collisions > 0
    episode.passed = sim.metrics.passed > 0
    episode.min_ttc_s = sim.metrics.min_ttc_s
    return episode


def draw(episode: Episode, told_s: float, path: Path) -> None:
    """Speed and lane over time on a two-way road, with what became of a directive given at `told_s`."""
    time_s = [k / HZ for k in range(len(episode.speeds))]
    with picture(path, 2, sharex=True, dpi=100, figsize=(10, 4.6), height_ratios=(2, 1)) as (_, axes):
        speed, lane = axes[:, 0]
        speed.plot(time_s, episode.speeds)
        lane.step(time_s, episode.lanes, color="tab:green", where="post")
        marks = [(told_s, "told to overtake", "black")]
        for event in episode.events:
            if event.kind == EventKind.CARRIED_OUT:
                marks.append((event.tick / HZ, f"delayed {event.duration_s:.0f} s: {event.reason}", "tab:red"))
            elif event.kind == EventKind.FULFILLED:
                marks.append((event.tick / HZ, "fulfilled", "tab:green"))
        for row, (at_s, text, colour) in enumerate(marks):
            speed.text(at_s + 0.2, 0.4 + 0.9 * row, text, color=colour, fontsize="small")
            for axis in (speed, lane):
                axis.axvline(at_s, color=colour, linestyle=":", linewidth=1)
        for axis in (speed, lane):
            axis.fill_between(
                time_s,
                0,
                1,
                where=[n == 0 for n in episode.lanes],
                transform=axis.get_xaxis_transform(),
                color="tab:orange",
                alpha=0.2,
                linewidth=0,
            )
        speed.set(ylabel="speed [m/s]", ylim=(0, 9), title=f"two-way, seed {episode.seed}, lock-step")
        lane.set(xlabel="time [s]", yticks=(0, 1), yticklabels=("oncoming", "own"))
        lane.invert_yaxis()


if __name__ == "__main__":
    draw(run_episode(1000, load_policy(), overtake_at(3.0)), 3.0, Path(sys.argv[1]))
