"""The safety mask (the paper's "safety-based action executor"): which actions are safe now, and why the others are not.

It reads the state and never the directive. `close_actions` calls one claim after another; each is a file of its own,
with its source and what it assumes. All of it is plain arithmetic on sequences: the node runs it as it is on lists, and
training compiles the same source with numba on arrays, so that there is one mask.

The claims rest on RSS distances (`schemas.driving.measures`) with one of the named `PRESETS`: what the ego and the
others are taken to do. They hold for traffic that does so, not for a real road.
"""

from fast_node.mask.closing import close_actions
from fast_node.mask.vocabulary import NOT_WISHED, OPEN, PRESETS, REAR_GAP, REASONS, VERSION, Preset
from schemas.driving.road import lane_table

__all__ = ["NOT_WISHED", "OPEN", "PRESETS", "REAR_GAP", "REASONS", "VERSION", "Preset", "close_actions", "lane_table"]
