"""What a meta-action means between two decisions: the same for the node, training, evaluation and the environment."""

from __future__ import annotations

from schemas.wire.messages import MetaAction

_LEFT, _CRUISE = int(MetaAction.LEFT), int(MetaAction.CRUISE)


def held(action: int) -> int:
    """What follows `action` until the next decision: a speed goes on to rise or fall, a lane change has begun once."""
    return action if action < _LEFT else _CRUISE
