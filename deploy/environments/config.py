"""What an environment may be told: typed, and refused by name where it is no setting or cannot be done."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import msgspec
from numpy.random import Generator

from deploy.lab.episodes import task_of
from fast_node.mask import PRESETS
from fast_node.training.rollout import Task
from schemas.driving.reward import Weights
from schemas.driving.road import DECISION_TICKS, HZ
from sim_node.scenario_file import find_scenario
from sim_node.scenarios import Scenario
from sim_node.scenarios.lanes import with_lanes
from sim_node.scenarios.scenario import draw_wish

DECISION_HZ = HZ // DECISION_TICKS
AS_HIGHWAY_ENV = {
    "lanes_count": "lanes",
    "vehicles_density": "density",
    "duration": "duration_s",
    "policy_frequency": "decision_hz",
}
"""highway-env's words for the same."""
Range = tuple[float, float]


class Features(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="Features", tag_field="type"):
    """The policy's input, (15, 26): see `schemas.driving.features`."""

    flat: bool = False
    """As one row of 390."""


class Kinematics(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="Kinematics", tag_field="type"):
    """highway-env's observation of this name, with its options."""

    features: tuple[str, ...] = ("presence", "x", "y", "vx", "vy")
    vehicles_count: int = 5
    features_range: dict[str, Range] | None = None
    absolute: bool = False
    order: Literal["sorted", "shuffled"] = "sorted"
    normalize: bool = True
    clip: bool = True
    see_behind: bool = False
    include_obstacles: bool = True


class OccupancyGrid(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="OccupancyGrid", tag_field="type"):
    """highway-env's observation of this name, with its options."""

    features: tuple[str, ...] = ("presence", "vx", "vy", "on_road")
    grid_size: tuple[Range, Range] = ((-27.5, 27.5), (-27.5, 27.5))
    grid_step: Range = (5.0, 5.0)
    features_range: dict[str, Range] | None = None
    absolute: bool = False
    align_to_vehicle_axes: bool = False
    clip: bool = True
    as_image: bool = False


class MetaActions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="MetaAction", tag_field="type"):
    """The five meta-actions: slow down, cruise, speed up, left, right."""


class Directive(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the passenger asks for."""

    lane: int | None = None
    """None: any."""
    speed_mps: float | None = None
    """None: as fast as the road allows."""
    headway_s: float = 1.5
    overtake: bool = False
    """Pass the car ahead."""

    def __post_init__(self) -> None:
        if self.speed_mps is not None and not 0.0 <= self.speed_mps <= 60.0:
            raise ValueError(f"directive: speed_mps {self.speed_mps} is not within 0..60")
        if not 0.0 < self.headway_s <= 10.0:
            raise ValueError(f"directive: headway_s {self.headway_s} is not within 0..10")


class EnvConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that an environment may be told besides its road. SI units."""

    lanes: int | None = None
    """Side by side, on a highway; None: the road's own number."""
    density: float = 1.0
    """Of the traffic: times the road's own, 0.2 to 3."""
    traffic: tuple[str, ...] = ()
    """Other traffic: idm30, hard-brakes, trucks, narrow, sway, or several."""
    duration_s: float | None = None
    """Of an episode; None: the road's own."""
    decision_hz: int = DECISION_HZ
    """Actions per second, a divisor of 15."""
    mask: str | None = "sim"
    """The safety mask's preset; None: no mask."""
    obey: bool = True
    """Behind the mask, what is against the directive is closed, too, as in the live car."""
    directive: Directive | None = None
    """For all episodes; None: drawn at random, and again during an episode, as in training."""
    noise_m: float = 0.0
    noise_mps: float = 0.0
    dropout: float = 0.0
    """See `sim_node.observe.perceived`; of the Features alone."""
    observation: Features | Kinematics | OccupancyGrid = Features()
    action: MetaActions = MetaActions()
    reward: dict[str, float] = {}
    """Weights by the names of `schemas.driving.reward.Weights`."""

    def __post_init__(self) -> None:
        if self.decision_hz < 1 or HZ % self.decision_hz:
            raise ValueError(f"decision_hz {self.decision_hz} does not divide {HZ} ticks a second: use 1, 3, 5 or 15")
        if self.mask is not None and self.mask not in PRESETS:
            raise ValueError(f"mask {self.mask!r} is not one of: {', '.join(PRESETS)}; or None")
        if self.duration_s is not None and not 1.0 <= self.duration_s <= 3600.0:
            raise ValueError(f"duration_s {self.duration_s} is not within 1..3600")
        if not (0.0 <= self.noise_m <= 100.0 and 0.0 <= self.noise_mps <= 100.0 and 0.0 <= self.dropout < 1.0):
            raise ValueError("noise_m and noise_mps are to be within 0..100, dropout within 0..1")
        if (self.noise_m or self.noise_mps or self.dropout) and not isinstance(self.observation, Features):
            raise ValueError("noise_m, noise_mps and dropout are of the Features: choose that observation")
        _refuse_unknown("reward", self.reward, Weights._fields)

    @property
    def flat(self) -> bool:
        """Whether the Features come as one row."""
        return isinstance(self.observation, Features) and self.observation.flat

    @property
    def ticks(self) -> int:
        """Of the simulator, per decision."""
        return HZ // self.decision_hz

    def road(self, spec: str | Scenario) -> Scenario:
        """The road with this traffic. Raises ValueError for a name that is none, and for what this road cannot be."""
        scenario = find_scenario(spec) if isinstance(spec, str) else spec
        if self.lanes is not None:
            scenario = with_lanes(scenario, self.lanes)
        if self.duration_s is not None:
            scenario = replace(scenario, duration_s=self.duration_s)
        if self.directive is not None and self.directive.lane is not None:
            check_lane(scenario, self.directive)
        return scenario.varied(self.traffic, self.density)

    def task(self, scenario: Scenario) -> Task:
        """What is to be done there, and what it earns."""
        task = task_of(scenario, self.mask or "sim")
        return replace(task, weights=Weights(**self.reward), draw=partial(_drawn, scenario))


def _drawn(scenario: Scenario, rng: Generator, rows: Any, home: int) -> tuple[int, int, float, float]:
    return draw_wish(rng, scenario, rows, home)


def check_lane(scenario: Scenario, directive: Directive) -> None:
    """Raise ValueError for a directive whose lane does not exist."""
    if directive.lane is not None and not 0 <= directive.lane < len(scenario.lanes):
        raise ValueError(f"directive: lane {directive.lane} is not one of 0..{len(scenario.lanes) - 1}")


def read(config: Mapping[str, Any] | None, options: Mapping[str, Any]) -> EnvConfig:
    """The settings that `config` and the keywords of `gymnasium.make` say. Raises ValueError for what is none."""
    said: dict[str, Any] = {}
    for name, value in [*(config or {}).items(), *options.items()]:
        ours = AS_HIGHWAY_ENV.get(name, name)
        if ours in said:
            raise ValueError(f"{name} is told twice: once as a keyword or by its other name")
        said[ours] = value
    _refuse_unknown("", said, EnvConfig.__struct_fields__)
    settings: EnvConfig = convert(said, EnvConfig)
    return settings


def convert(said: Any, kind: type[Any]) -> Any:
    """`said` as that type. Raises ValueError that names the place."""
    if isinstance(said, kind):
        return said
    try:
        return msgspec.convert(msgspec.to_builtins(said, builtin_types=(float,)), kind)
    except (msgspec.ValidationError, TypeError) as error:
        text = str(error).replace("`$.", "`").replace("`", "'")
        raise ValueError(f"{text}{_HINTS.get(_place(text), '')}") from None


def _place(text: str) -> str:
    return text.rpartition("at '")[2].split(".")[0].rstrip("'") if "at '" in text else ""


_HINTS = {
    "observation": ": {'type': 'Features'}, 'Kinematics' or 'OccupancyGrid', with highway-env's options",
    "action": ": {'type': 'MetaAction'} alone; the ego is driven by set-points, so there are no continuous actions",
    "directive": f": {', '.join(Directive.__struct_fields__)}",
}


def _refuse_unknown(where: str, said: Mapping[str, Any], known: Sequence[str]) -> None:
    for name in said:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, 1)
            meant = f", such as {near[0]!r}" if near else ""
            raise ValueError(f"no setting {f'{where}.' if where else ''}{name}{meant}: choose from {', '.join(known)}")
