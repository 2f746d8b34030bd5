"""`fastslow evaluate`: agents on scenarios over seeds that training never saw, many scenes at once, at 15 Hz."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fast_node.coordination import ASSERTIVE_HEADWAY_S
from fast_node.mask import OPEN, lane_table
from fast_node.policies.attention import SHIPPED, load_policy, read_sidecar
from fast_node.policies.mlp import BASELINES, load_mlp, shipped
from fast_node.policies.rule import rule_logits
from fast_node.training.rollout import DECISION_TICKS, Driver, Fleet, Task
from schemas.driving.intent import ANY_LANE
from schemas.runtime.process import ConfigError
from schemas.wire.messages import POLICY_ACTIONS, MetaAction
from sim_node.engine.batched import HZ, Batched
from sim_node.metrics import EpisodeResult, Recorder, summarise
from sim_node.scenarios import SCENARIOS, Scenario
from sim_node.scenarios.scenario import draw_wish, streams

FIRST_SEED = 1000
"""Evaluation seeds are 1000, 1001, ...; training draws its scenes from generators that are seeded otherwise."""
SCHEMA = "fastslow.evaluate/1"

Directive = Literal["hurry", "lane", "random"]
"""What the passenger asks for: full speed in any lane (on two-way: to overtake, one car after the other), full speed in
a lane drawn for the seed, or any lane and any speed drawn for the seed."""
DIRECTIVES: tuple[Directive, ...] = get_args(Directive)
PAPER: dict[str, tuple[float, float, float]] = {
    "highway": (25.46, 0.38, 8.65),
    "merge": (14.51, 0.32, 18.9),
    "two-way": (6.80, 0.19, 4.54),
}
"""What the paper reports of its own driver: average speed [m/s], acceleration variance [(m/s2)2], min TTC, mean [s]."""
Logits = Callable[[NDArray[np.float32]], NDArray[np.float32]]
Step = Callable[[int], NDArray[np.bool_]]
"""Advances a fleet at a tick, counted from 0, and says in which scenes the mask decided against the driver."""


def wilson95(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a proportion."""
    z, p = 1.96, successes / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * float(np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)))
    return max(0.0, centre - half), min(1.0, centre + half)


def task_of(scenario: Scenario, preset: str = "sim") -> Task:
    """The scenario as the fast system's training and evaluation see it, behind a mask with this preset."""
    ceiling = scenario.ego.speed_ceiling_mps
    return Task(
        name=scenario.name,
        lanes=np.array(lane_table(scenario.lanes_at(0.0))),
        sight_m=scenario.sight_m,
        speed_range=0.5 * ceiling,
        duration_ticks=round(scenario.duration_s * 15),
        goal=(scenario.success.reach_x_m, scenario.success.reach_lanes, scenario.end_x_m),
        draw=lambda rng, rows, home: draw_wish(rng, scenario, rows, home),
        preset=preset,
    )


def constant(action: MetaAction) -> Logits:
    """A driver that repeats one action."""
    row = np.zeros(POLICY_ACTIONS, np.float32)
    row[action] = 1.0
    return lambda x: np.broadcast_to(row, (len(x), POLICY_ACTIONS))


def uniform(seed: int) -> Logits:
    """A driver that draws one of the five actions once a second, and holds in between."""
    rng, calls = np.random.default_rng(seed), itertools.count()
    hold = constant(MetaAction.CRUISE)
    return lambda x: rng.random((len(x), POLICY_ACTIONS), np.float32) if next(calls) % DECISION_TICKS == 0 else hold(x)


AGENTS: dict[str, str] = {
    "ours": "the policy behind the mask",
    "ours-unmasked": "the policy alone",
    "rule": "a few rules behind the mask",
    "idm": "highway-env's IDM and MOBIL in the ego's place",
    "cruise": "never acts",
    "faster": "always speeds up",
    "slower": "always slows down",
    "left": "always wants left",
    "right": "always wants right",
    "brake": "stops at once",
    "random": "draws an action every second",
    "random-masked": "the same, behind the mask",
    **{f"{name}-bare": f"{name.upper()} as published, one decision a second" for name in BASELINES},
    **{f"{name}-masked": f"{name.upper()} with our directives, behind our mask" for name in BASELINES},
}
"""What drives, by name."""
MASKED = ("ours", "rule", "random-masked", *(f"{name}-masked" for name in BASELINES))
"""Those behind the mask."""
USE_OURS = ("ours-unmasked", "rule", "random-masked")
"""Those that a checkpoint of ours changes, too: it brings the mask's preset."""
LANGUAGE: dict[str, str] = {
    "dilu-paused": "a language model alone, one decision a second (DiLu's method); the world waits while it thinks",
    "dilu-running": "the same, and the world goes on while it thinks",
}
"""Drivers that take up to a second or more of real time per decision: by name only, never with all the others."""
_CONSTANT = {
    "cruise": MetaAction.CRUISE,
    "faster": MetaAction.SPEED_UP,
    "slower": MetaAction.SLOW_DOWN,
    "left": MetaAction.LEFT,
    "right": MetaAction.RIGHT,
}


def directed(
    directive: Directive, scenario: Scenario, rng: np.random.Generator, rows: Any, home: int
) -> tuple[int, int, float, float]:
    """A directive for rows (V, 9) and a home lane, drawn as `draw_wish` draws and of the same form."""
    told = draw_wish(rng, scenario, rows, home, overtake_share=1.0)
    if directive == "random":
        return told
    lane = ANY_LANE if directive == "hurry" and scenario.wish_lanes else told[0]
    return lane, told[1], scenario.ego.speed_ceiling_mps, ASSERTIVE_HEADWAY_S


def load(fleet: Fleet, scenario: Scenario, scene: int, seed: int, directive: Directive) -> None:
    """Put that seed's traffic and directive into one scene of a fleet of `Batched` scenes."""
    world = fleet.world
    assert isinstance(world, Batched)
    traffic, wishes, _ = streams(seed)
    world.load(scene, scenario.spawn(traffic))
    fleet.told_lane[scene], fleet.pass_id[scene], fleet.v_des[scene], fleet.headway[scene] = directed(
        directive, scenario, wishes, world.rows[scene], int(world.target_lane[scene])
    )


def record(fleet: Fleet, scenario: Scenario, step: Callable[[int], NDArray[np.bool_] | None]) -> list[EpisodeResult]:
    """Drive every scene of a fleet to its end with a `Step`, and measure it."""
    w = fleet.world
    recorder, active = Recorder(scenario, len(fleet.wish)), np.ones(len(fleet.wish), np.bool_)
    for tick in range(round(scenario.duration_s * HZ)):
        lane, held = w.target_lane.copy(), w.previous_lane < 0
        overridden = step(tick)
        way_open = held & way_is_open(fleet, lane)
        if tick % DECISION_TICKS == 0 and not scenario.wish_lanes:
            overtake_on(fleet)
        recorder.tick(
            w.rows,
            w.accel,
            w.target_lane,
            w.previous_lane,
            w.crashed,
            active,
            fleet.wish,
            fleet.v_des,
            overridden,
            way_open,
        )
        active &= ~fleet.over()
        if not active.any():
            break
    return recorder.results()


def way_is_open(fleet: Fleet, lane: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(S,) where the change from `lane` towards the wished lane was open when the fleet looked last; without a mask:
    where another lane is wished."""
    side = np.where(fleet.wish < lane, int(MetaAction.LEFT), int(MetaAction.RIGHT))
    is_open = fleet.rule[np.arange(len(lane)), side] == OPEN
    return np.asarray((fleet.wish != ANY_LANE) & (fleet.wish != lane) & is_open)


def trained_as(checkpoint: Path) -> str:
    """The agent whose policy lies in `checkpoint`: "ours", or a baseline such as "ppo-bare".

    Raises `ConfigError` for a file that is neither.
    """
    sidecar = read_sidecar(checkpoint)
    algorithm = sidecar.get("algorithm", "ours")
    agent = "ours" if algorithm == "ours" else f"{algorithm}-{sidecar.get('variant')}"
    if agent not in AGENTS:
        raise ConfigError(f"{checkpoint.name} holds {agent!r}, which this code does not know: train anew")
    return agent


def drive(
    agent: str,
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    checkpoint: Path | None = None,
    directive: Directive = "hurry",
    wish_mps: float | None = None,
) -> list[EpisodeResult]:
    """One episode per seed, with that seed's traffic and a directive from the start (see `Directive`), and with
    another wished speed than that where one is given. `checkpoint` takes the place of the shipped policy of the agent
    that it was trained as; ours also brings the mask's preset, for whoever drives behind the mask.

    Raises `ConfigError` for an unusable checkpoint and ValueError for an unknown agent.
    """
    if directive not in DIRECTIVES:
        raise ValueError(f"directive {directive!r} is not one of: {', '.join(DIRECTIVES)}")
    if agent not in AGENTS:
        raise ValueError(f"agent {agent!r} is not one of: {', '.join([*AGENTS, *LANGUAGE])}")
    n = len(seeds)
    world = Batched(scenario, n, 0, ego="idm" if agent == "idm" else "executor")
    own = trained_as(checkpoint) if checkpoint else None
    policy = load_policy(checkpoint if checkpoint and own == "ours" else SHIPPED)
    preset = str(policy.sidecar["mask_preset"])
    fleet = Fleet(world, task_of(scenario, preset), masked=agent in MASKED)
    for i, seed in enumerate(seeds):
        load(fleet, scenario, i, seed, directive)
    if wish_mps is not None:
        fleet.v_des[:] = wish_mps
    algorithm, _, variant = agent.partition("-")
    if algorithm in BASELINES:
        logits: Logits = load_mlp(checkpoint if checkpoint and own == agent else shipped(algorithm, variant)).logits
    elif algorithm == "ours":
        logits = policy.logits
    elif agent == "rule":
        logits = rule_logits
    elif agent in ("random", "random-masked"):
        logits = uniform(0)
    else:
        logits = constant(_CONSTANT.get(agent, MetaAction.CRUISE))
    if agent == "brake":
        brake = np.full(n, int(MetaAction.EMERGENCY_BRAKE))
        return record(fleet, scenario, unasked(fleet, lambda tick: brake))
    return record(fleet, scenario, by_the_second(fleet, logits) if variant == "bare" else by_the_tick(fleet, logits))


def by_the_tick(fleet: Fleet, logits: Logits) -> Step:
    """As the fast node drives: it looks, and may decide, at every tick."""
    driver = Driver(fleet, logits)

    def step(tick: int) -> NDArray[np.bool_]:
        driver.tick()
        return driver.overridden

    return step


def by_the_second(fleet: Fleet, logits: Logits) -> Step:
    """As one that knows no mask has learnt to: a decision a second, held in between."""
    hold = np.full(len(fleet.wish), int(MetaAction.CRUISE))
    return unasked(fleet, lambda tick: logits(fleet.observe()).argmax(-1) if tick % DECISION_TICKS == 0 else hold)


def unasked(fleet: Fleet, act: Callable[[int], NDArray[np.int64]]) -> Step:
    """Actions as they come, with nobody to decide against them."""
    never = np.zeros(len(fleet.wish), np.bool_)

    def step(tick: int) -> NDArray[np.bool_]:
        fleet.look()
        fleet.world.tick(act(tick), fleet.v_des)
        return never

    return step


def overtake_on(fleet: Fleet) -> None:
    """Whoever has passed its car is asked to pass the next, as the slow node asks while the passenger is in a hurry."""
    rows = fleet.world.rows
    for s in np.flatnonzero(fleet.pass_id >= 0):
        ahead = (
            (rows[s, :, 0] > 0)
            & (rows[s, :, 8] == fleet.told_lane[s])
            & (rows[s, :, 3] > -0.1)
            & (rows[s, :, 1] > rows[s, 0, 1])
        )
        if ahead.any() and not ahead[rows[s, :, 0] == fleet.pass_id[s]].any():
            nearest = np.where(ahead, rows[s, :, 1], np.inf).argmin()
            fleet.pass_id[s] = int(rows[s, nearest, 0])


def _drive_language(
    agent: str, scenario: Scenario, seeds: Sequence[int], directive: Directive, wish_mps: float | None
) -> tuple[list[EpisodeResult], dict[str, Any]]:
    """The episodes of a driver of `LANGUAGE`, and what its model did."""
    from deploy.lab.language_driver import drive_dilu, memory, running_model

    if directive != "hurry" or wish_mps is not None:
        raise ValueError(f"{agent} knows no directive but hurry, and no other speed to wish for")
    with running_model() as ask:
        results, figures = drive_dilu(scenario, seeds, paused=agent == "dilu-paused", ask=ask, bank=memory())
    return results, figures.summary()


def evaluate_all(
    agents: Sequence[str] | None,
    scenarios: Sequence[str],
    episodes: int,
    *,
    first_seed: int = FIRST_SEED,
    checkpoint: Path | None = None,
    directive: Directive = "hurry",
    wishes_mps: Sequence[float | None] = (None,),
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """A row per scenario, agent and wished speed [m/s] (None: as the directive has it), over the seeds from
    `first_seed`; per scenario the seeds that nobody survived. The result's own `wish_mps` is None for several wishes.

    Without agents the one whose policy is in `checkpoint`, or ours. Raises `ConfigError` for a checkpoint that none of
    the agents uses, and as `drive` does.
    """
    own = trained_as(checkpoint) if checkpoint else "ours"
    agents = [own] if agents is None else agents
    if checkpoint and not set(agents) & {own, *(USE_OURS if own == "ours" else ())}:
        raise ConfigError(f"{checkpoint.name} drives as {own}, not as {', '.join(agents)}: choose --agent {own}")
    seeds = range(first_seed, first_seed + episodes)
    rows, unsurvived = [], {}
    for name in scenarios:
        if name not in SCENARIOS:
            raise ValueError(f"scenario {name!r} is not one of: {', '.join(SCENARIOS)}")
        died = set(range(episodes))
        for agent, wish_mps in itertools.product(agents, wishes_mps):
            progress(f"{agent} on {name}" + ("" if wish_mps is None else f", {wish_mps:g} m/s wished"))
            more: dict[str, Any] = {}
            if agent in LANGUAGE:
                results, more["llm"] = _drive_language(agent, SCENARIOS[name], seeds, directive, wish_mps)
            else:
                results = drive(
                    agent, SCENARIOS[name], seeds, checkpoint=checkpoint, directive=directive, wish_mps=wish_mps
                )
            died &= {i for i, r in enumerate(results) if r.collided}
            good = sum(r.success for r in results)
            rows.append(
                {
                    "agent": agent,
                    "scenario": name,
                    "speed_set": SCENARIOS[name].speed_set,
                    "wish_mps": wish_mps,
                    "first_seed": first_seed,
                    "success_ci95": wilson95(good, episodes),
                    **_numbers(summarise(results)),
                    **more,
                }
            )
        unsurvived[name] = sorted(first_seed + i for i in died)
    return {
        "schema": SCHEMA,
        "directive": directive,
        "wish_mps": wishes_mps[0] if len(wishes_mps) == 1 else None,
        "rows": rows,
        "unsurvived": unsurvived,
    }


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}%"


def _numbers(figures: dict[str, float]) -> dict[str, float | None]:
    """With None for what is not a number, as JSON has it."""
    return {name: None if math.isnan(value) else value for name, value in figures.items()}


def table(result: dict[str, Any]) -> str:
    """The rows as plain text, one line each."""
    lines = [
        f"{'scenario':<16}{'agent':<14}{'wish':>6}{'success':>22}{'own':>5}{'hit':>5}{'speed':>7}{'a var':>7}"
        f"{'min TTC':>9}{'lane ok':>9}{'feasible':>9}{'of these':>9}{'speed ok':>9}{'masked':>8}"
    ]
    for r in result["rows"]:
        low, high = r["success_ci95"]
        good = f"{100 * r['success']:.1f} % ({100 * low:.0f}-{100 * high:.0f})"
        wish = "-" if r["wish_mps"] is None else f"{r['wish_mps']:g}"
        lines.append(
            f"{r['scenario']:<16}{r['agent']:<14}{wish:>6}{good:>22}"
            f"{r['ego_fault_collisions']:>5}{r['struck_collisions']:>5}"
            f"{r['avg_speed']:>7.2f}{r['accel_var']:>7.2f}{r['min_ttc_mean']:>9.2f}{100 * r['lane_compliance']:>8.1f}%"
            f"{_percent(r['lane_feasible']):>9}{_percent(r['lane_compliance_feasible']):>9}"
            f"{_percent(r['speed_compliance']):>9}{100 * r['override_share']:>7.1f}%"
        )
    lines += [
        f"{name}: nobody survived {', '.join(map(str, seeds))}"
        for name, seeds in result["unsurvived"].items()
        if seeds and len(result["rows"]) > 1
    ]
    return "\n".join(lines)


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Speed against comfort, as a PNG: a panel per scenario, a colour per agent, a point per wish. Solid, left:
    acceleration variance; dashed and hollow, right: mean of the smallest TTC; stars: the paper's own driver."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    names, agents = (list(dict.fromkeys(r[key] for r in rows)) for key in ("scenario", "agent"))
    figure, axes = plt.subplots(1, len(names), figsize=(5.5 * len(names), 4.5), squeeze=False, layout="constrained")
    legend = {}
    for axis, name in zip(axes[0], names, strict=True):
        right = axis.twinx()
        for k, agent in enumerate(agents):
            points = sorted(
                (r["wish_mps"], r["avg_speed"], r["accel_var"], r["min_ttc_mean"])
                for r in rows
                if (r["scenario"], r["agent"]) == (name, agent)
            )
            _, speed, variance, ttc = zip(*points, strict=True)
            (legend[agent],) = axis.plot(speed, variance, f"C{k}o-")
            right.plot(speed, ttc, f"C{k}o--", markerfacecolor="none")
            for wish, x, y, _ in points:
                axis.annotate(f"{wish:g}", (x, y), (0, 6), textcoords="offset points", ha="center", fontsize="small")
        if name in PAPER:
            x, y, seconds = PAPER[name]
            (legend["the paper's"],) = axis.plot(x, y, "k*", markersize=12)
            right.plot(x, seconds, "k*", markersize=12, markerfacecolor="none")
        axis.set(title=name, xlabel="average speed [m/s]", ylabel="acceleration variance [(m/s2)2], solid")
        right.set_ylabel("smallest TTC, mean [s], dashed, hollow")
        for side in (axis, right):
            side.margins(y=0.1)
            side.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    figure.legend(legend.values(), legend.keys(), loc="outside upper center", ncols=len(legend), fontsize="small")
    figure.savefig(path, dpi=120, format="png")
    plt.close(figure)
