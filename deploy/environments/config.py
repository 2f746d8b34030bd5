"""What an environment may be told: typed, and refused by name where it is no setting or cannot be done."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import msgspec

from deploy.lab.episodes import task_of
from fast_node.mask import PRESETS
from fast_node.training.rollout import Task
from schemas.driving.reward import Weights
from schemas.driving.road import DECISION_TICKS, HZ
from sim_node.scenario_file import find_scenario
from sim_node.scenarios import Scenario
from sim_node.scenarios.lanes import with_lanes

DECISION_HZ = HZ // DECISION_TICKS
AS_HIGHWAY_ENV = {
    "lanes_count": "lanes",
    "vehicles_density": "density",
    "duration": "duration_s",
    "policy_frequency": "decision_hz",
}
"""highway-env's words for the same."""
Range = tuple[float, float]
SEED_MAX = 2**63 - 1
"""Seeds are kept in 64 bits."""
OF_VEHICLES = (
    *("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "cos_d", "sin_d"),
    *("long_off", "lat_off", "ang_off"),
)
"""What highway-env tells of a car."""
OF_CELLS = (*OF_VEHICLES, "on_road")
VEHICLES_MAX = 1000
VALUES_MAX = 1_000_000
"""Of a grid."""


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

    def __post_init__(self) -> None:
        _check_features(self, OF_VEHICLES)
        if not 2 <= self.vehicles_count <= VEHICLES_MAX:  # for one, highway-env shows all that there are
            raise ValueError(f"vehicles_count {self.vehicles_count} is not within 2..{VEHICLES_MAX}, the ego included")


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
    """Bytes, for -1 to 1: 127 where nothing is. (highway-env's own are undefined there.)"""

    def __post_init__(self) -> None:
        _check_features(self, OF_CELLS)
        if self.absolute:
            raise ValueError("absolute True is not in highway-env's own OccupancyGrid: leave it out")
        if not all(0.0 < step < math.inf for step in self.grid_step):
            raise ValueError(f"grid_step {self.grid_step} is not two positive numbers of metres")
        values = len(self.features)
        for (low, high), step in zip(self.grid_size, self.grid_step, strict=True):
            cells = (high - low) / step
            if not 1.0 <= cells <= VALUES_MAX:
                raise ValueError(f"grid_size {low}..{high} has no number of cells of {step} m within 1..{VALUES_MAX}")
            values *= math.floor(cells)
        if values > VALUES_MAX:
            raise ValueError(f"grid_size {self.grid_size} has {values} values: take at most {VALUES_MAX}")


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
        for name, weight in self.reward.items():
            if not math.isfinite(weight):
                raise ValueError(f"reward.{name} {weight} is not a finite number")

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
        return replace(task, weights=Weights(**self.reward))


def check_lane(scenario: Scenario, directive: Directive) -> None:
    """Raise ValueError for a directive whose lane does not exist."""
    if directive.lane is not None and not 0 <= directive.lane < len(scenario.lanes):
        raise ValueError(f"directive: lane {directive.lane} is not one of 0..{len(scenario.lanes) - 1}")


def check_seed(seed: object, beyond: int = 0) -> None:
    """Raise ValueError for a seed that does not fit, with those up to `beyond` after it. What is no number is left to
    Gymnasium to refuse."""
    if isinstance(seed, int) and seed > SEED_MAX - beyond:
        raise ValueError(f"seed {seed} is above {SEED_MAX - beyond}, the largest here")


def _check_features(seen: Kinematics | OccupancyGrid, known: Sequence[str]) -> None:
    """Raise ValueError for features that highway-env does not have, or ranges that scale nothing."""
    if not seen.features:
        raise ValueError(f"features are none: choose from {', '.join(known)}")
    _refuse_unknown("features", seen.features, known)
    ranges = seen.features_range or {}
    _refuse_unknown("features_range", ranges, OF_VEHICLES)
    for name, (low, high) in ranges.items():
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"features_range.{name} {low}..{high} is not a finite range, the smaller first")


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
        ours = isinstance(error.__cause__, ValueError)  # it says already what would do
        raise ValueError(text if ours else f"{text}{_HINTS.get(_place(text), '')}") from None


def _place(text: str) -> str:
    return text.rpartition("at '")[2].split(".")[0].rstrip("'") if "at '" in text else ""


_HINTS = {
    "observation": ": {'type': 'Features'}, 'Kinematics' or 'OccupancyGrid', with highway-env's options",
    "action": ": {'type': 'MetaAction'} alone; the ego is driven by set-points, so there are no continuous actions",
    "directive": f": {', '.join(Directive.__struct_fields__)}",
}


def _refuse_unknown(where: str, said: Iterable[str], known: Sequence[str]) -> None:
    for name in said:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, 1)
            meant = f", such as {near[0]!r}" if near else ""
            raise ValueError(f"no setting {f'{where}.' if where else ''}{name}{meant}: choose from {', '.join(known)}")
