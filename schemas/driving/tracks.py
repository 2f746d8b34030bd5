"""From observations to tracks: cars that are missed for a moment go on, and noisy positions and speeds are filtered.

What every part of the fast system reads instead of the bare rows. A scene's tracks are a table (T, `COLUMNS`) that is
also its rows: the first columns are those of a message, the next four (`road.DOUBT_...`) say how far off the truth may
be, the others are this module's own. Plain arithmetic on sequences: the node runs it on lists, training compiles it.

Assumed of other cars: they change their speed by `BRAKE_MPS2` at most, by `ACCEL_MPS2` as a rule and for about
`ACCEL_S` on end; sideways by `SIDEWAYS_MPS2`. Assumed of the sensor: errors are independent from tick to tick, equal
for all cars, and of one size for a while; that size is not told but learnt from what does not fit together (`listen`).
The ego knows itself exactly. Where nothing misfits (below `EXACT_M`, `EXACT_MPS`) a track is the observation to the
last bit.
"""

from __future__ import annotations

import math
from typing import Any

from schemas.driving.road import (
    DOUBT_VX,
    DOUBT_VY,
    DOUBT_X,
    DOUBT_Y,
    HEADING,
    ID,
    LANE,
    LANE_START,
    LANE_WAY,
    LANE_Y,
    LENGTH,
    NOBODY,
    VX,
    VY,
    WIDTH,
    X,
    Y,
    road_end,
)

N_ROW = DOUBT_VY + 1
SOURCE, LOST_S, SEEN, LANE_TICKS, ACCEL, SD_X, SD_Y, VAR_VX, COV_VA, VAR_A, VAR_VY, JUMPED = range(N_ROW, N_ROW + 12)
"""Columns of a track: the sensor's number of the car; seconds since it was last seen; ticks on end that it was seen;
ticks for which another lane has been told; acceleration along the road; standard deviations, variances and a covariance
of the filters; what is left of the doubt after a jump [m, m/s]."""
RAW_X, RAW_Y, RAW_VX, RAW_VY, BEFORE_VX, BEFORE_VY = range(JUMPED + 1, JUMPED + 7)
"""The last observation, and the speeds of the one before."""
COLUMNS = BEFORE_VY + 1

NOISE_X, NOISE_Y, NOISE_VX, NOISE_VY = range(4)
"""Of the noise of a scene: mean misfits of positions [m] and speeds [m/s]."""
SIGMA = 4
"""SIGMA + NOISE_X ...: the standard deviations in use, 0 for what is exact."""
SAMPLES = 8
"""Positions, and after them speeds, that have been compared."""
N_NOISE = 10

GHOST_S = 1.0
"""A car that is missed lives on for this long."""
REMEMBER_S = 10.0
"""Then it is nobody's neighbour, but for this long it counts as not yet passed if its motion says so."""
EDGE_M = 1.0
"""A car that is expected this near to the end of sight has left it."""
LEFT_ROAD_M = 25.0
"""So near to the end of the road a car that is missed has left it."""
SPARE = 16
"""Tracks of missed cars, besides those that are seen."""

BRAKE_MPS2 = 6.0
ACCEL_MPS2, ACCEL_S = 2.0, 1.0
SIDEWAYS_MPS2 = 0.8
DRIFT_M = 0.02
"""What a position is off after a tick of even motion: how exact the motion model is at best."""
SURE = 2.5
"""Doubt is this many standard deviations."""
JUMP_M, JUMP_ASIDE_M, JUMP_SIGMAS = 5.0, 2.5, 6.0
"""A car that is farther from where it should be is another one, or has been taken for another one until now."""
SAME_M, SAME_ASIDE_M, SAME_MPS = 2.0, 1.2, 3.0
"""A new number this near to where a missed car should be is that car."""
JUMP_DOUBT, JUMP_FADES_S = 2.0, 0.5
LANE_TELLS = 3
"""Ticks after which a lane is believed that a noisy position does not bear out."""

EXACT_M, EXACT_MPS = 0.05, 0.1
"""Mean misfits below which positions and speeds count as exact."""
PRIOR, FORGET, CLIP = 5.0, 0.015, 0.1
"""Of the running means: samples of no misfit to begin with, weight of a new sample, and how far one may stick out."""
BELIE = 5.0
"""Speeds are in error by no more than so many times what the positions belie them by."""
LISTEN_TO = 8
"""Cars that are compared at a tick."""
MISFIT_M, MISFIT_MPS = 0.7979 * math.sqrt(2.0), 0.7979 * math.sqrt(6.0)
"""Mean misfit of a normal error of 1: of a difference of two positions, of the bend of three speeds."""


def follow(tracks: Any, noise: Any, seen: Any, lanes: Any, sight: float, dt: float) -> None:
    """Take in what is seen now.

    tracks: (T, COLUMNS), row 0 is the ego's, ID `NOBODY` where free; noise: (N_NOISE,); both zero but for the ids at
    the beginning of an epoch. seen: (V, 9) rows; lanes: (L, 8); sight [m]; dt: seconds since the last call.
    """
    ego = tracks[0]
    for c in range(LANE + 1):
        ego[c] = seen[0][c]
    for j in range(1, len(tracks)):
        if tracks[j][ID] != NOBODY:
            tracks[j][LOST_S] += dt
    at, strangers, heard = 0, 0, 0
    for i in range(1, len(seen)):
        row = seen[i]
        if row[ID] < 0:
            continue
        j = find(tracks, row[ID], at)
        if j < 0:
            strangers += 1
            continue
        at = j
        t = tracks[j]
        if heard < LISTEN_TO and t[SEEN] > 0.0 and t[LOST_S] <= dt:
            heard += 1
            listen(noise, t, row, dt)
        observe(t, row, noise, lanes, dt)
    for j in range(1, len(tracks)):
        if tracks[j][ID] != NOBODY and tracks[j][LOST_S] > 0.0:
            go_on(tracks[j], ego, lanes, sight, dt)
    if strangers > 0:
        for i in range(1, len(seen)):
            row = seen[i]
            if row[ID] >= 0 and not is_taken(tracks, row[ID]):
                welcome(tracks, row, noise)
    if heard > 0:
        settle(tracks, noise)


def find(tracks: Any, number: float, at: int) -> int:
    """The track of the car that the sensor calls `number` and that has not been seen yet at this tick; NOBODY if none.

    at: where to begin; cars are mostly told in one order.
    """
    count = len(tracks)
    for k in range(at + 1, at + count):
        j = k if k < count else k - count
        t = tracks[j]
        if t[SOURCE] == number and j > 0 and t[ID] != NOBODY and t[LOST_S] > 0.0:
            return j
    return NOBODY


def is_taken(tracks: Any, number: float) -> bool:
    """Whether a track has taken in the car that the sensor calls `number` at this tick."""
    taken = False
    for j in range(1, len(tracks)):
        t = tracks[j]
        taken = taken or (t[SOURCE] == number and t[ID] >= 0 and t[LOST_S] == 0.0)
    return taken


def observe(t: Any, row: Any, noise: Any, lanes: Any, dt: float) -> None:
    """Take in an observation of the car of track `t`."""
    sx, sy, svx, svy = noise[SIGMA], noise[SIGMA + 1], noise[SIGMA + 2], noise[SIGMA + 3]
    x, y = t[X] + t[VX] * dt, t[Y] + t[VY] * dt
    lost = t[LOST_S]
    if (
        lost > GHOST_S
        or abs(row[X] - x) > JUMP_M + JUMP_SIGMAS * sx + 0.5 * BRAKE_MPS2 * lost * lost
        or abs(row[Y] - y) > JUMP_ASIDE_M + JUMP_SIGMAS * sy
    ):
        jumped = t[JUMPED] if lost > GHOST_S else JUMP_DOUBT
        begin(t, row, noise)
        t[JUMPED] = jumped
        doubt_of(t, 0.0)
        return
    if svx > 0.0:
        decay = math.exp(-dt / ACCEL_S)
        v, a = t[VX] + t[ACCEL] * dt, t[ACCEL] * decay
        var_v = t[VAR_VX] + dt * (2.0 * t[COV_VA] + dt * t[VAR_A])
        cov = decay * (t[COV_VA] + dt * t[VAR_A])
        var_a = decay * decay * t[VAR_A] + ACCEL_MPS2 * ACCEL_MPS2 * (1.0 - decay * decay)
        off, gain = row[VX] - v, 1.0 / (var_v + svx * svx)
        x += 0.5 * (v - t[VX]) * dt
        t[VX], t[ACCEL] = v + var_v * gain * off, a + cov * gain * off
        t[VAR_VX], t[COV_VA], t[VAR_A] = (
            var_v * (1.0 - var_v * gain),
            cov * (1.0 - var_v * gain),
            var_a - cov * cov * gain,
        )
        if t[VX] < 0.0 and lanes[int(t[LANE])][LANE_WAY] > 0.0 and t[VX] > -SURE * math.sqrt(t[VAR_VX]):
            t[VX] = 0.0  # it stands, and is no oncoming car
    else:
        t[VX], t[ACCEL], t[VAR_VX], t[COV_VA], t[VAR_A] = row[VX], 0.0, 0.0, 0.0, 0.0
    if svy > 0.0:
        var_v = t[VAR_VY] + SIDEWAYS_MPS2 * SIDEWAYS_MPS2 * dt * dt
        gain = var_v / (var_v + svy * svy)
        t[VY] += gain * (row[VY] - t[VY])
        t[VAR_VY] = var_v * (1.0 - gain)
    else:
        t[VY], t[VAR_VY] = row[VY], 0.0
    if sx > 0.0:
        sd = t[SD_X] + DRIFT_M + dt * math.sqrt(t[VAR_VX])
        gain = sd * sd / (sd * sd + sx * sx)
        t[X], t[SD_X] = x + gain * (row[X] - x), sd * math.sqrt(1.0 - gain)
    else:
        t[X], t[SD_X] = row[X], 0.0
    if sy > 0.0:
        sd = t[SD_Y] + DRIFT_M + dt * math.sqrt(t[VAR_VY])
        gain = sd * sd / (sd * sd + sy * sy)
        t[Y], t[SD_Y] = y + gain * (row[Y] - y), sd * math.sqrt(1.0 - gain)
    else:
        t[Y], t[SD_Y] = row[Y], 0.0
    lane = row[LANE]
    if lane == t[LANE]:
        t[LANE_TICKS] = 0.0
    else:
        t[LANE_TICKS] += 1.0
        nearer = sy == 0.0 or abs(t[Y] - lanes[int(lane)][LANE_Y]) < abs(t[Y] - lanes[int(t[LANE])][LANE_Y])
        if nearer or t[LANE_TICKS] >= LANE_TELLS:
            t[LANE], t[LANE_TICKS] = lane, 0.0
    remember(t, row)
    if t[JUMPED] > 0.0:
        t[JUMPED] = t[JUMPED] * math.exp(-dt / JUMP_FADES_S) if t[JUMPED] > 0.05 else 0.0
    doubt_of(t, 0.0)


def remember(t: Any, row: Any) -> None:
    """Keep an observation as it is, and what is not filtered."""
    t[HEADING], t[LENGTH], t[WIDTH] = row[HEADING], row[LENGTH], row[WIDTH]
    t[BEFORE_VX], t[BEFORE_VY] = t[RAW_VX], t[RAW_VY]
    t[RAW_X], t[RAW_Y], t[RAW_VX], t[RAW_VY] = row[X], row[Y], row[VX], row[VY]
    t[LOST_S] = 0.0
    t[SEEN] += 1.0
    if t[ID] < NOBODY:
        t[ID] = -2.0 - t[ID]


def begin(t: Any, row: Any, noise: Any) -> None:
    """Begin a track with its first observation; its number stays."""
    for c in range(X, LANE + 1):
        t[c] = row[c]
    t[SEEN], t[LANE_TICKS], t[ACCEL], t[COV_VA], t[JUMPED] = 0.0, 0.0, 0.0, 0.0, 0.0
    t[SD_X], t[SD_Y] = noise[SIGMA], noise[SIGMA + 1]
    t[VAR_VX], t[VAR_VY] = noise[SIGMA + 2] * noise[SIGMA + 2], noise[SIGMA + 3] * noise[SIGMA + 3]
    t[VAR_A] = ACCEL_MPS2 * ACCEL_MPS2 if noise[SIGMA + 2] > 0.0 else 0.0
    remember(t, row)


def doubt_of(t: Any, lost: float) -> None:
    """Say how far off the truth may be, `lost` seconds after the car was last seen."""
    sd_vx, sd_vy, jumped = math.sqrt(t[VAR_VX]), math.sqrt(t[VAR_VY]), t[JUMPED]
    t[DOUBT_X] = SURE * (t[SD_X] + sd_vx * lost) + 0.5 * BRAKE_MPS2 * lost * lost + jumped
    t[DOUBT_VX] = SURE * sd_vx + BRAKE_MPS2 * lost + jumped
    t[DOUBT_Y] = SURE * (t[SD_Y] + sd_vy * lost) + 0.5 * SIDEWAYS_MPS2 * lost * lost
    t[DOUBT_VY] = SURE * sd_vy + SIDEWAYS_MPS2 * lost


def go_on(t: Any, ego: Any, lanes: Any, sight: float, dt: float) -> None:
    """A car that is not seen at this tick goes on as it went, or is gone."""
    lost = t[LOST_S]
    t[SEEN] = 0.0
    if t[ACCEL] != 0.0:
        before = t[VX]
        t[VX] += t[ACCEL] * dt
        if t[VX] * before < 0.0:
            t[VX] = 0.0  # it has come to rest
        t[ACCEL] *= math.exp(-dt / ACCEL_S)
    t[X] += t[VX] * dt
    move_aside(t, lanes, dt)
    if t[ID] < 0:
        if lost > REMEMBER_S:
            t[ID] = float(NOBODY)
        return
    doubt_of(t, lost)
    dx, dy = t[X] - ego[X], t[Y] - ego[Y]
    off_road = t[X] > road_end(lanes) - LEFT_ROAD_M if t[VX] >= 0.0 else t[X] < lanes[0][LANE_START] + LEFT_ROAD_M
    if off_road or math.sqrt(dx * dx + dy * dy) > sight - EDGE_M - t[DOUBT_X]:
        t[ID] = float(NOBODY)
    elif lost > GHOST_S:
        t[ID] = -2.0 - t[ID]


def move_aside(t: Any, lanes: Any, dt: float) -> None:
    """Go on sideways, into the next lane where that is nearer then."""
    y = t[Y] + t[VY] * dt
    lane = int(t[LANE])
    aside = lane + 1 if t[VY] > 0.0 else lane - 1
    if 0 <= aside < len(lanes):
        own, other = lanes[lane][LANE_Y], lanes[aside][LANE_Y]
        if abs(t[Y] - own) <= abs(t[Y] - other) and abs(y - own) > abs(y - other):
            t[LANE] = float(aside)
    t[Y] = y


def welcome(tracks: Any, row: Any, noise: Any) -> None:
    """A number that no track has: a missed car under a new number where it should be, else a new car."""
    place, longest = NOBODY, -1.0
    for j in range(1, len(tracks)):
        t = tracks[j]
        if t[ID] >= 0 and t[LOST_S] > 0.0:
            aside, apart = abs(t[Y] - row[Y]) - SURE * noise[SIGMA + 1], abs(t[X] - row[X])
            if (
                apart < SAME_M + t[DOUBT_X] + SURE * noise[SIGMA]
                and aside < SAME_ASIDE_M + t[DOUBT_Y]
                and abs(t[VX] - row[VX]) < SAME_MPS + t[DOUBT_VX] + SURE * noise[SIGMA + 2]
            ):
                number, jumped = t[ID], t[JUMPED] + (0.0 if noise[SIGMA] > 0.0 else apart)
                begin(t, row, noise)
                t[ID], t[SOURCE], t[JUMPED] = number, row[ID], min(jumped, JUMP_DOUBT)
                doubt_of(t, 0.0)
                return
        rank = REMEMBER_S * 4.0 if t[ID] == NOBODY else t[LOST_S] if t[LOST_S] > 0.0 else -1.0
        if rank > longest:
            place, longest = j, rank
    if place == NOBODY:
        return  # `tracks` has room for all that are seen
    t = tracks[place]
    t[ID] = t[SOURCE] = row[ID]
    begin(t, row, noise)
    doubt_of(t, 0.0)


def listen(noise: Any, t: Any, row: Any, dt: float) -> None:
    """Compare what is seen of a car with what was seen of it a tick ago: what does not fit is the sensor's error.

    Whatever the car does, it has moved by no less than its lower and no more than its higher speed; and over three
    ticks its speed bends little. Running means of both, in which no sample weighs more than a few usual ones.
    """
    weight = max(1.0 / (noise[SAMPLES] + PRIOR), FORGET)
    noise[SAMPLES] += 1.0
    along = misfit(row[X] - t[RAW_X], t[RAW_VX] * dt, row[VX] * dt)
    aside = misfit(row[Y] - t[RAW_Y], t[RAW_VY] * dt, row[VY] * dt)
    hear(noise, NOISE_X, along, weight)
    hear(noise, NOISE_Y, aside, weight)
    if t[SEEN] > 1.0:
        weight = max(1.0 / (noise[SAMPLES + 1] + PRIOR), FORGET)
        noise[SAMPLES + 1] += 1.0
        bend, aside_bend = row[VX] - 2.0 * t[RAW_VX] + t[BEFORE_VX], row[VY] - 2.0 * t[RAW_VY] + t[BEFORE_VY]
        hear(noise, NOISE_VX, min(abs(bend), BELIE * along / dt), weight)  # positions that bear a speed out clear it
        hear(noise, NOISE_VY, min(abs(aside_bend), BELIE * aside / dt), weight)


def misfit(moved: float, one: float, other: float) -> float:
    """How far `moved` is outside of what lies between the two."""
    return max(moved - max(one, other), min(one, other) - moved, 0.0)


def hear(noise: Any, k: int, sample: float, weight: float) -> None:
    """Take a sample into a running mean."""
    noise[k] += weight * (min(sample, 3.0 * noise[k] + CLIP) - noise[k])


def settle(tracks: Any, noise: Any) -> None:
    """From the misfits to the errors in use: up at once, and with them the doubt about all that was believed before;
    down slowly."""
    for k in range(SIGMA):
        exact, per = (EXACT_M, MISFIT_M) if k < NOISE_VX else (EXACT_MPS, MISFIT_MPS)
        now = noise[k] / per if noise[k] > exact else 0.0
        before = noise[SIGMA + k]
        noise[SIGMA + k] = now if now >= before or now == 0.0 else max(now, 0.99 * before)
        if now > before:
            grow(tracks, k, before, now)


def grow(tracks: Any, k: int, before: float, now: float) -> None:
    """The error of quantity `k` turns out to be `now`, not `before`: so is that of what has been believed."""
    for j in range(1, len(tracks)):
        t = tracks[j]
        if t[ID] == NOBODY:
            continue
        if k == NOISE_X:
            t[SD_X] = t[SD_X] * now / before if before > 0.0 else now
        elif k == NOISE_Y:
            t[SD_Y] = t[SD_Y] * now / before if before > 0.0 else now
        elif k == NOISE_VX:
            share = now / before if before > 0.0 else 0.0
            t[VAR_VX] = t[VAR_VX] * share * share if before > 0.0 else now * now
            t[COV_VA] *= share
            t[VAR_A] = max(t[VAR_A], ACCEL_MPS2 * ACCEL_MPS2)
        else:
            t[VAR_VY] = t[VAR_VY] * (now / before) * (now / before) if before > 0.0 else now * now
        doubt_of(t, t[LOST_S])
