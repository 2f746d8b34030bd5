"""Orders to the simulator: another road, other traffic, a world that stands still."""

from __future__ import annotations

import pytest

from schemas.runtime.clock import ManualClock, Schedule
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics
from schemas.wire.messages import Action, Control, Event, MetaAction, Observation, Status
from sim_node import __main__ as shell
from sim_node.config import SimConfig
from sim_node.gate import Gate
from sim_node.node import SimNode


class Nobody:
    """No answer ever comes."""

    def __init__(self) -> None:
        self.gate = Gate(20_000_000)
        self.put_ns = 0

    def expect(self, observation: Observation, due_ns: int) -> None:
        pass

    def wait(self) -> Action | None:
        return None


class Faster(Nobody):
    """Every observation is answered at once: faster."""

    def __init__(self) -> None:
        super().__init__()
        self._asked = (0, 0)

    def expect(self, observation: Observation, due_ns: int) -> None:
        self._asked = observation.epoch, observation.tick

    def wait(self) -> Action:
        epoch, tick = self._asked
        return Action(epoch=epoch, stamp_ns=0, answers_tick=tick, meta_action=int(MetaAction.SPEED_UP), source="policy")


def order(do: str, scenario: str = "", seed: int | None = None, density: float | None = None) -> Control:
    return Control(epoch=0, stamp_ns=0, do=do, scenario=scenario, seed=seed, density=density)  # type: ignore[arg-type]


class World:
    def __init__(self, answers: Nobody | None = None) -> None:
        self.bus = LocalBus()
        self.node = SimNode(SimConfig(scenario="highway", seed=3))
        self.node.reset(1)
        self.seen = self.bus.subscribe(topics.OBSERVATION)
        self.events = self.bus.subscribe(topics.EVENT)
        self.loop = shell.Loop(self.bus, self.node, answers or Nobody(), Schedule(ManualClock(), 15))  # type: ignore[arg-type]

    def order(self, do: str, scenario: str = "", seed: int | None = None, density: float | None = None) -> None:
        self.bus.publish(topics.CONTROL, order(do, scenario, seed, density))

    def ticks(self, count: int = 1) -> list[int]:
        shown = []
        for _ in range(count):
            self.loop.tick(0)
            shown += [observation.tick for observation in self.seen.take()]
        return shown


def test_a_paused_world_stands_still_says_so_and_goes_on_where_it_was() -> None:
    world = World()
    assert world.ticks(2) == [0, 1]
    world.order("pause")
    assert world.ticks(5) == []
    world.order("resume")
    assert world.ticks(2) == [2, 3]


def test_the_heartbeat_says_whether_the_world_stands_still_and_can_be_sent() -> None:
    world = World()
    heartbeats = world.bus.subscribe(topics.STATUS)
    world.order("pause")
    world.ticks()
    status = Status(epoch=1, stamp_ns=0, node="sim", pid=1, seq=1, state="ready", metrics=world.loop.metrics())
    world.bus.publish(topics.STATUS, status)
    [heard] = heartbeats.take()
    assert heard.metrics["paused"] == 1.0


def test_a_step_is_one_tick_and_then_it_stands_still() -> None:
    world = World()
    world.order("step")
    assert world.ticks(4) == [0]
    world.order("step")
    assert world.ticks(4) == [1]
    world.order("resume")
    assert world.ticks(2) == [2, 3]


def test_a_restart_is_another_world_on_the_road_and_with_the_seed_that_were_ordered() -> None:
    world = World()
    world.ticks(3)
    world.order("restart", "merge", 8)
    world.loop.tick(0)
    [shown] = world.seen.take()
    [event] = world.events.take()
    assert (shown.scenario, shown.tick, shown.epoch) == ("merge", 0, 2)
    assert isinstance(event, Event)
    assert event.detail == "new world as ordered, seed 8"
    expected = SimNode(SimConfig(scenario="merge", seed=8))
    expected.reset(2)
    assert shown.rows == expected.observation(0).rows


def test_a_restart_keeps_what_is_not_named_and_the_counts() -> None:
    world = World()
    world.ticks(3)
    world.order("restart")
    world.loop.tick(0)
    [shown] = world.seen.take()
    fresh = SimNode(SimConfig(scenario="highway", seed=3))
    fresh.reset(2)
    assert shown.rows == fresh.observation(0).rows
    assert (world.node.metrics.ticks, world.node.metrics.episodes) == (4, 2)


def test_a_road_from_a_file_is_kept_at_a_restart_and_left_for_a_road_of_ours() -> None:
    config = SimConfig(scenario="mine.toml", scenario_toml='base = "highway"', traffic=("narrow",), density=2.0)
    node = SimNode(config)
    node.reset(0)
    before = node.observation(0)
    node.restart(order("restart"), 0)
    again = node.observation(0)
    assert (again.scenario, again.rows, again.lanes[0].width_m) == ("mine", before.rows, 3.2)
    node.restart(order("restart", "merge"), 0)
    assert node.observation(0).scenario == "merge"


def test_a_restart_with_a_density_has_that_much_traffic_and_a_later_one_keeps_it() -> None:
    world = World()
    world.order("restart", density=2.0)
    world.loop.tick(0)
    world.order("restart", seed=4)
    world.loop.tick(0)
    expected = SimNode(SimConfig(scenario="highway", seed=4, density=2.0))
    expected.reset(3)
    assert [shown.rows for shown in world.seen.take()][-1:] == [expected.observation(0).rows]
    assert world.events.take()[-1].detail == "new world as ordered, seed 4, density 2"
    assert (world.loop.metrics()["seed"], world.loop.metrics()["density"]) == (4.0, 2.0)


@pytest.mark.parametrize(
    ("scenario", "seed", "density"),
    [("moon", 1, None), ("merge", -1, None), ("merge", 1, 0.1), ("merge", 1, 3.5), ("merge-v0", 1, 2.0)],
)
def test_an_order_that_makes_no_sense_changes_nothing(scenario: str, seed: int, density: float | None) -> None:
    world = World()
    world.ticks(2)
    world.order("restart", scenario, seed, density)
    assert world.ticks(2) == [2, 3]


def test_a_restart_while_paused_shows_the_new_world_and_stands_still() -> None:
    world = World()
    world.order("pause")
    world.ticks()
    world.order("restart", "two-way", 1)
    assert world.ticks(3) == [0]
    world.order("step")
    assert world.ticks(3) == [1]


def test_a_world_that_stands_still_keeps_the_answer_until_it_goes_on() -> None:
    world = World(Faster())
    world.order("step")
    world.ticks(3)
    assert (world.node.tick, world.node.metrics.answered) == (0, 0)
    world.order("resume")
    assert world.ticks(2) == [1, 2]
    assert (world.node.tick, world.node.metrics.answered, world.node.metrics.holds) == (3, 3, 0)


def test_the_answer_to_a_world_that_was_replaced_meanwhile_is_dropped() -> None:
    world = World(Faster())
    world.order("step")
    world.ticks(1)
    world.order("restart")
    assert world.ticks(2) == [0]
    world.order("step")
    assert world.ticks(1) == [1]
    assert world.node.metrics.answered == 1
