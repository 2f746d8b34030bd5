"""The best constant order is found by its ride score on seeds of its own."""

from __future__ import annotations

from dataclasses import replace

from deploy.lab.orders import CHOOSING_SEEDS, best_order
from fast_node.policies.fixed import WORDS
from sim_node.scenarios import SCENARIOS


def test_the_best_order_on_an_empty_road_prefers_to_speed_up() -> None:
    empty = replace(SCENARIOS["highway"], flows=(), duration_s=4.0)
    order = best_order(empty, range(900_000, 900_001)).removeprefix("constant:").split(",")
    assert sorted(order) == sorted(WORDS)
    assert order.index("faster") < order.index("cruise")


def test_it_is_chosen_on_seeds_that_it_is_not_judged_by() -> None:
    assert not set(CHOOSING_SEEDS) & set(range(1000, 10_000))
