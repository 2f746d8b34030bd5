"""Behind a steady leader, tick by tick as the node and the executor have it: the speed settles, and stays."""

from __future__ import annotations

import itertools
import math

import pytest

from fast_node.choice import choose, comfortable_mps, narrow
from fast_node.mask import PRESETS
from fast_node.mask.neighbours import survey
from schemas.driving.episode import held
from schemas.driving.intent import ASSERTIVE, CALM, NORMAL
from schemas.driving.road import DECISION_TICKS
from schemas.wire.messages import MetaAction
from tests.mask_scenes import DT, HIGHWAY, capped, every_preset, in_lane
from tests.scenes import car

HASTY, PATIENT = [0.0, 1.0, 2.0, -1.0, -1.0], [0.0, 2.0, 1.0, -1.0, -1.0]
"""Logits of a policy that likes to speed up best, and of one that likes to cruise."""


def followed(
    lead_mps: float,
    gap: float,
    speed: float,
    *,
    headway: float | None = 1.5,
    style: int = NORMAL,
    liking=HASTY,
    preset: str = "sim",
) -> tuple[list[float], list[float]]:
    """The ego's accelerations [m/s2] and gaps [m] over three minutes. headway: the wished one; None: nothing is
    wished, only the mask limits the speed."""
    ego, goes_on = in_lane(1, speed), int(MetaAction.CRUISE)
    accels, gaps = [], []
    for tick in range(round(180 / DT)):
        lead = car(1, 505 + gap + lead_mps * tick * DT, 1, lead_mps)
        rows, near = [ego.row(HIGHWAY), lead], [0] * (3 * len(HIGHWAY))
        reasons, _, cap = capped(rows, HIGHWAY, ego.target_speed, 1, -1, PRESETS[preset])
        if headway is not None:
            survey(rows, HIGHWAY, near)
            cap = min(cap, comfortable_mps(rows, near, HIGHWAY, 1, ego.accel, 28.0, headway, style))
            narrow(reasons, rows, near, HIGHWAY, ego.target_speed, 1, -1, -1, 1, 28.0, headway, cap)
        due = tick % DECISION_TICKS == 0
        meta, _ = choose(liking, reasons, due, goes_on)
        goes_on = held(meta) if due else goes_on
        accels.append(ego.accel)
        gaps.append(lead[1] - ego.x - 5.0)
        ego = ego.moved(meta, HIGHWAY, 28.0, cap)
    return accels, gaps


def sign_changes(accels: list[float]) -> int:
    """Of the last minute; less than 0.01 m/s2 has none."""
    signs = [a > 0.0 for a in accels[-round(60 / DT) :] if abs(a) > 0.01]
    return sum(a != b for a, b in itertools.pairwise(signs))


@pytest.mark.parametrize("lead_mps", [5.0, 10.0, 20.0, 26.0])
@pytest.mark.parametrize("headway", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("gap", [25.0, 60.0])
def test_the_wished_headway_is_reached_and_kept_without_a_limit_cycle(lead_mps, headway, gap):
    accels, gaps = followed(lead_mps, gap, min(lead_mps + 2.0, 28.0), headway=headway)
    assert gaps[-1] == pytest.approx(2.5 + headway * lead_mps, abs=0.2)
    assert sign_changes(accels) <= 1
    assert max(abs(a) for a in accels[-round(60 / DT) :]) < 0.05
    assert min(accels) > -2.1


@pytest.mark.parametrize(("style", "brake"), [(CALM, 1.5), (NORMAL, 2.0), (ASSERTIVE, 3.0)])
def test_every_style_settles_as_well_and_brakes_no_harder_than_it_likes(style, brake):
    accels, gaps = followed(15.0, 60.0, 25.0, style=style)
    assert gaps[-1] == pytest.approx(25.0, abs=0.2)
    assert sign_changes(accels) <= 1
    assert min(accels) >= -brake - 0.01


def test_a_patient_driver_follows_as_steadily():
    accels, gaps = followed(20.0, 60.0, 22.0, liking=PATIENT)
    assert (gaps[-1], sign_changes(accels)) == (pytest.approx(32.5, abs=0.2), 0)


def test_a_gap_that_is_wished_closer_than_is_safe_is_what_is_safe():
    # 26 m/s behind 26: (26 + 1.95)**2 = 1.95**2 + 13 * (gap - 2) + 6.5 / 9 * 26**2.
    accels, gaps = followed(26.0, 60.0, 28.0, headway=0.8)
    assert gaps[-1] == pytest.approx(2 + (27.95**2 - 1.95**2 - 6.5 / 9 * 26**2) / 13, abs=0.2)
    assert sign_changes(accels) <= 1


@every_preset
@pytest.mark.parametrize("lead_mps", [5.0, 15.0, 25.0])
def test_behind_the_mask_alone_whoever_would_rather_speed_up_settles_too(preset, lead_mps):
    accels, gaps = followed(lead_mps, 60.0, lead_mps, headway=None, preset=preset)
    p = PRESETS[preset]
    lag = p.ceiling_reaction_s * p.ceiling_brake
    brake = ((lead_mps + lag) ** 2 - lag**2 - p.ceiling_brake / p.lead_brake * lead_mps**2) / (2 * p.ceiling_brake)
    assert gaps[-1] == pytest.approx(max(p.standstill_m + p.follow_s * lead_mps, 2 + brake), abs=0.3)
    assert sign_changes(accels) <= 1


def test_a_leader_that_brakes_gently_to_a_stop_is_stopped_behind_as_gently():
    ego, x, v, hardest = in_lane(1, 20.0), 540.0, 20.0, 0.0
    for _ in range(round(20 / DT)):
        rows, near = [ego.row(HIGHWAY), car(1, x, 1, v)], [0] * (3 * len(HIGHWAY))
        reasons, _, cap = capped(rows, HIGHWAY, ego.target_speed, 1)
        survey(rows, HIGHWAY, near)
        cap = min(cap, comfortable_mps(rows, near, HIGHWAY, 1, ego.accel, 28.0, 1.5, NORMAL))
        meta, _ = choose(PATIENT, reasons, True, MetaAction.CRUISE)
        assert meta != MetaAction.EMERGENCY_BRAKE
        ego = ego.moved(meta, HIGHWAY, 28.0, cap)
        x, v = x + v * DT, max(v - 2.0 * DT, 0.0)
        hardest = min(hardest, ego.accel)
    assert (ego.speed, hardest > -2.1) == (pytest.approx(0.0, abs=0.05), True)
    assert math.isclose(x - ego.x - 5.0, 2.5, abs_tol=0.5)
