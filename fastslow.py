"""`import fastslow` registers the driving environments with Gymnasium: `gymnasium.make("fastslow/Highway-v0")`.

`gymnasium.make("fastslow:fastslow/Highway-v0")` imports it by itself. docs/gymnasium.md has the names and settings.
"""

from deploy.environments.register import ENVIRONMENTS, register

register()

__all__ = ["ENVIRONMENTS"]
