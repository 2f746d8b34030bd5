"""Who drives in evaluation: by name, with or without our mask; or any policy, always behind it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deploy.lab.episodes import DIRECTIVES, Directive, Watch, Words, always, by_the_tick, reckless, record, task_of
from deploy.run.processes import SIMS
from fast_node.mask import PRESETS
from fast_node.policies.checkpoint import read_sidecar
from fast_node.policies.load import OURS, load_policy
from fast_node.policies.mlp import BASELINES, LEARNERS
from fast_node.training.rollout import Driver, Fleet
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction
from sim_node.engine.batched import Batched
from sim_node.observe import senses
from sim_node.results import EpisodeResult
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import streams
from sim_node.sumo.world import SumoWorld


@dataclass(frozen=True)
class Agent:
    """A policy and the way in which it drives."""

    about: str
    policy: str
    """As `load_policy` takes it; "idm": highway-env's own driver; "brake": the emergency brake, held; "reckless": see
    `episodes.reckless`."""
    masked: bool = False
    checked: bool = False
    """The actuator checks what it does, as it does behind the mask."""


AGENTS: dict[str, Agent] = {
    "ours": Agent("the policy behind the mask", OURS, masked=True),
    "ours-unmasked": Agent("the policy alone", OURS),
    "rule": Agent("a few rules behind the mask", "rule", masked=True),
    "idm": Agent("highway-env's IDM and MOBIL in the ego's place", "idm"),
    "cruise": Agent("never acts", "constant:cruise"),
    "faster": Agent("always speeds up", "constant:faster"),
    "slower": Agent("always slows down", "constant:slower"),
    "left": Agent("always wants left", "constant:left"),
    "right": Agent("always wants right", "constant:right"),
    "brake": Agent("stops at once", "brake"),
    "reckless": Agent("turns towards the nearest car at full speed; the actuator checks it", "reckless", checked=True),
    "random-checked": Agent("draws an action every second; the actuator checks it", "random:0", checked=True),
    "random": Agent("draws an action every second", "random:0"),
    "random-masked": Agent("the same, behind the mask", "random:0", masked=True),
    **{f"{name}-bare": Agent(f"{name.upper()} as published", f"{name}-bare") for name in BASELINES},
    **{
        f"{name}-masked": Agent(f"{name.upper()} with our directives, behind our mask", f"{name}-masked", masked=True)
        for name in BASELINES
    },
}
"""What drives, by name."""
WORDLESS = ("idm", "brake", "reckless", "sumo")
"""What is no policy: it is not asked with a policy's input."""
USE_OURS = ("ours-unmasked", "rule", "random-masked")
"""Those that a checkpoint of ours changes, too: it brings the mask's preset."""
SUMO_DRIVERS = {"sumo-krauss": "Krauss", "sumo-eidm": "EIDM"}
"""SUMO's own driver in the ego's place, as fast as the road admits; only in SUMO's traffic."""
LANGUAGE: dict[str, str] = {
    "dilu-paused": "a language model alone, one decision a second (DiLu's method); the world waits while it thinks",
    "dilu-running": "the same, and the world goes on while it thinks",
}
"""Drivers that take up to a second or more of real time per decision: by name only, never with all the others."""


def trained_as(checkpoint: Path) -> str:
    """The agent whose policy lies in `checkpoint`: "ours", or a baseline such as "ppo-bare".

    Raises `ConfigError` for a file that is neither, and for another baseline's, which is a policy without a name.
    """
    sidecar = read_sidecar(checkpoint)
    algorithm = sidecar.get("algorithm", "ours")
    agent = "ours" if algorithm == "ours" else f"{algorithm}-{sidecar.get('variant')}"
    if agent not in AGENTS and algorithm in LEARNERS:
        raise ConfigError(f"{checkpoint.name} holds {agent!r}, which is no agent: give it as --policy {checkpoint}")
    if agent not in AGENTS:
        raise ConfigError(f"{checkpoint.name} holds {agent!r}, which this code does not know: train anew")
    return agent


def drive(
    agent: str | Agent,
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    checkpoint: Path | None = None,
    directive: Directive = "hurry",
    wish_mps: float | None = None,
    directive_at_s: float = 0.0,
    mask_preset: str | None = None,
    noise_m: float = 0.0,
    noise_mps: float = 0.0,
    dropout: float = 0.0,
    watch: Watch | None = None,
    sim: str = "highway-env",
) -> list[EpisodeResult]:
    """One episode per seed, with that seed's traffic and a directive (see `Directive`) from the start or from
    `directive_at_s` on, without words until then, and with another wished speed than the directive's where one is
    given. `checkpoint` takes the place of the shipped policy of the agent that it was trained as; ours drives as it
    was trained, alone: without the plans that the shipped driver adds to its network (see `policies.gaps`). It also
    brings the mask's preset, for whoever drives behind the mask, unless another is given.

    noise_m, noise_mps, dropout: of what it perceives, see `sim_node.observe.perceived`. sim: one of `SIMS`; SUMO's
    seeds follow one another.

    Raises `ConfigError` for an unusable policy or checkpoint, and where SUMO is missing, and ValueError for an unknown
    agent, preset or sim.
    """
    if sim not in SIMS:
        raise ValueError(f"sim {sim!r} is not one of: {', '.join(SIMS)}")
    model = None
    if sim == "sumo":
        if agent == "idm":
            raise ValueError(f"idm is highway-env's: in SUMO there are {', '.join(SUMO_DRIVERS)}")
        if isinstance(agent, str) and (model := SUMO_DRIVERS.get(agent)) is not None:
            agent = Agent("SUMO's own driver", "sumo")
    if mask_preset is not None and mask_preset not in PRESETS:
        raise ValueError(f"mask preset {mask_preset!r} is not one of: {', '.join(PRESETS)}")
    if directive not in DIRECTIVES:
        raise ValueError(f"directive {directive!r} is not one of: {', '.join(DIRECTIVES)}")
    if isinstance(agent, str) and agent not in AGENTS:
        raise ValueError(f"agent {agent!r} is not one of: {', '.join([*AGENTS, *LANGUAGE, 'constant:best'])}")
    name, who = (agent, AGENTS[agent]) if isinstance(agent, str) else ("", agent)
    own = trained_as(checkpoint) if checkpoint else None
    replaced = checkpoint if own == name or (own == "ours" and who.policy == OURS) else None
    policy = load_policy("constant:cruise" if who.policy in WORDLESS else str(replaced or who.policy))
    preset = mask_preset or (load_policy(str(checkpoint)) if own == "ours" else policy).mask_preset
    kind: Literal["idm", "executor"] = "idm" if who.policy == "idm" else "executor"
    checked = who.masked or who.checked
    if sim == "sumo":
        world: Batched = SumoWorld(scenario, len(seeds), seeds[0], ego_model=model, actuator=checked)
    else:
        world = Batched(scenario, len(seeds), 0, ego=kind, actuator=checked)
    with closing(world) if isinstance(world, SumoWorld) else nullcontext():
        sense = senses(seeds, noise_m, noise_mps, dropout)
        fleet = Fleet(world, task_of(scenario, preset), masked=who.masked, sense=sense)
        for i, seed in enumerate(seeds):
            world.load(i, scenario.spawn(streams(seed)[0]))
        if isinstance(world, SumoWorld):
            world.begin()
        words = Words(fleet, scenario, seeds, directive, directive_at_s, wish_mps)
        driver = None
        if who.policy == "reckless":
            step = reckless(fleet)
        elif who.policy in WORDLESS:
            step = always(fleet, MetaAction.EMERGENCY_BRAKE if who.policy == "brake" else MetaAction.CRUISE)
        else:
            driver = Driver(fleet, policy.logits, stateless=policy.stateless)
            step = by_the_tick(driver)
        if watch is not None:
            step = watch(fleet, driver, step)
        return record(fleet, scenario, step, words)


def behind_the_mask(spec: str) -> Agent:
    """Any policy that `load_policy` finds as an agent."""
    return Agent("a policy behind the mask", spec, masked=True)
