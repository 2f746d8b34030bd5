"""`import fastslow` registers the driving environments with Gymnasium: `gymnasium.make("fastslow/Highway-v0")`.

`gymnasium.make("fastslow:fastslow/Highway-v0")` imports it by itself. docs/gymnasium.md has the names and settings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

try:
    from deploy.environments.register import ENVIRONMENTS, register
except ModuleNotFoundError as error:
    if (error.name or "").split(".")[0] not in ("deploy", "fast_node", "schemas", "sim_node"):
        raise
    raise ImportError(
        f"{error.name} is not ours: another package of that name comes first on the path, perhaps in this folder. "
        "Start Python with -P, or elsewhere"
    ) from None

if TYPE_CHECKING:
    from deploy.environments.parallel import DrivingParallelEnv
    from deploy.environments.sb3 import Sb3VecEnv

__all__ = ["ENVIRONMENTS", "parallel_env", "sb3_vec_env"]

register()


def parallel_env(scenario: str = "highway", cars: int = 3, **settings: Any) -> DrivingParallelEnv:
    """Several cars on one road, by PettingZoo's parallel API. Raises ImportError without extra `train`."""
    from deploy.environments.parallel import DrivingParallelEnv

    return DrivingParallelEnv(scenario, cars, **settings)


def sb3_vec_env(scenario: str = "highway", num_envs: int = 16, **settings: Any) -> Sb3VecEnv:
    """Many roads at once for stable-baselines3 and sb3-contrib. Raises ImportError without extra `train`."""
    from deploy.environments.sb3 import Sb3VecEnv

    return Sb3VecEnv(scenario, num_envs, **settings)
