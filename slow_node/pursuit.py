"""One command that is being pursued: its directive, and what its road asks for now. Pure, as `deliberation` is."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec import structs

from schemas.driving.measures import INF
from schemas.wire.messages import Command, Directive
from slow_node.planning.directive import (
    directive_of,
    hurried,
    may_take,
    on_this_road,
    onward_directive,
    right_directive,
    slow_lead,
)
from slow_node.planning.scene import Scene
from slow_node.understanding.slots import Slots


@dataclass(frozen=True)
class Pursuit:
    """A command after it was understood, until it is fulfilled, cancelled, replaced or given up."""

    command: Command
    slots: Slots
    scene: Scene
    """In which it was understood."""
    directive: Directive
    """The newest that was sent, as far as it still stands."""
    began_ns: int
    directive_ids: frozenset[int]
    """All that were sent for it."""
    lead_id: int | None
    """The car that an overtake is about."""
    from_lane: int
    """The rightmost own lane that it was planned from: a hurry goes back as far as that."""
    fulfilled: bool = False
    """The passenger has had the last reply; what was asked for stands on."""
    reached: bool = False
    """What was asked for is so, and is to last."""
    returning: bool = False
    news: str = ""
    """Why to plan again, as soon as the rate allows."""
    planned_ns: int | None = None
    """When it was last planned again."""
    delayed_by: str = ""
    """The mask's reason that last delayed it."""
    min_ttc_s: float = INF

    @property
    def hurried(self) -> bool:
        """It does not end with the next car."""
        return hurried(self.slots)

    @property
    def is_done(self) -> bool:
        """Nothing is left to come true."""
        return self.fulfilled or self.reached

    @property
    def overtakes(self) -> bool:
        return self.directive.manoeuvre == "overtake"

    def passed(self, scene: Scene) -> bool:
        """The car that it is about lies behind the ego, or is out of sight."""
        return scene.has_passed(self.lead_id)

    def news_from(self, before: Scene, scene: Scene) -> str:
        """What has changed on its road, or calls for more from a hurry; "" for nothing."""
        lane = self.directive.target_lane
        if self.overtakes and self.passed(scene) and not self.passed(before):
            return "the car ahead is passed"
        if lane is not None and lane != scene.ego_lane and lane in scene.free_lanes and lane not in before.free_lanes:
            return f"lane {lane} is clear again"
        if self.overtakes or not self.hurried:
            return ""
        if slow_lead(scene) and (self.fulfilled or scene.two_way):
            return "a slow car is ahead"
        if self._right_again(scene) and lane != scene.home_lane + 1:
            return "the right lane is free"
        if self._too_slow_there(scene):
            return "a slow car is on the right"
        return ""

    def planned_again(self, scene: Scene) -> Directive:
        """The directive for the same words on the road as it is now.

        What is relative to the moment it was said (left, slower, this gap), or half done, stays as it is.
        """
        kept = on_this_road(self.directive, scene)
        over = self.overtakes and scene.ego_lane == self.directive.target_lane
        if scene.borrowing or self.returning or over:
            return kept
        if self.overtakes or self.hurried:
            fresh = onward_directive(self.slots, scene) if self.fulfilled else directive_of(self.slots, scene)
            if isinstance(fresh, Directive) and fresh.manoeuvre == "overtake":
                return structs.replace(fresh, say="") if self.overtakes else fresh
        if not self.overtakes and self._right_again(scene):
            return right_directive(scene, self.slots.language)
        if not self.overtakes and self._too_slow_there(scene):
            return structs.replace(kept, target_lane=None)
        return kept

    def _right_again(self, scene: Scene) -> bool:
        """A hurry that is over its first car, one-way and farther left than it began, could keep right."""
        right = scene.home_lane + 1
        return (
            self.fulfilled
            and not scene.two_way
            and self.hurried
            and right <= self.from_lane
            and may_take(scene, right)
            and right in scene.free_lanes
            and right not in scene.slow_lanes
        )

    def _too_slow_there(self, scene: Scene) -> bool:
        """It was sent back to the right, has not gone yet, and would run up to a slow car there."""
        lane = self.directive.target_lane
        return self.fulfilled and self.hurried and lane == scene.home_lane + 1 and lane in scene.slow_lanes
