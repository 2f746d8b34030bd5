"""Other traffic is drawn after the rest, car by car, and stays within what it says."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.driving.measures import CAR_LENGTH_M
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios import manners as m
from sim_node.scenarios.scenario import streams


@pytest.mark.parametrize("names", [["idm30"], ["hard-brakes"], ["trucks"], ["sway"], list(m.VARIED)])
def test_other_traffic_leaves_where_cars_start_as_it_is(names: list[str]) -> None:
    usual, other = (s.spawn(streams(7)[0]) for s in (SCENARIOS["highway"], SCENARIOS["highway"].varied(names)))
    for field in usual._fields[:-1]:
        assert np.array_equal(getattr(usual, field), getattr(other, field)), field
    assert (usual.manners == m.PLAIN).all()
    assert (other.manners[0] == m.PLAIN).all()  # the ego
    assert (other.manners[1:] != m.PLAIN).any()


def test_what_is_drawn_lies_within_its_ranges() -> None:
    scenario = SCENARIOS["highway"].varied(list(m.VARIED))
    for seed in range(20):
        spawn = scenario.spawn(streams(seed)[0])
        table = spawn.manners[1:]
        idm = table[:, m.IDM_ACCEL : m.IDM_TIME + 1] / m.PLAIN[: m.IDM_TIME + 1]
        assert ((idm >= 0.7) & (idm <= 1.3)).all()
        braking = table[table[:, m.HARD_MPS2] > 0.0]
        assert ((braking[:, m.HARD_MPS2] >= 6.0) & (braking[:, m.HARD_MPS2] <= 9.0)).all()
        assert (spawn.x[1:][table[:, m.HARD_MPS2] > 0.0] > spawn.x[0]).all()
        trucks = table[table[:, m.CAR_LENGTH] != CAR_LENGTH_M][:, m.CAR_LENGTH]
        assert ((trucks >= 12.0) & (trucks <= 16.5)).all()


def test_narrow_lanes_lie_side_by_side() -> None:
    lanes = SCENARIOS["merge"].varied(["narrow"]).lanes_at(300.0)
    assert [lane.width_m for lane in lanes] == pytest.approx([3.2] * 3)
    assert [lane.y_m for lane in lanes] == pytest.approx([0.0, 3.2, 6.4])


def test_unknown_traffic_is_refused_with_the_choice() -> None:
    with pytest.raises(ValueError, match="idm30"):
        SCENARIOS["merge"].varied(["circus"])
