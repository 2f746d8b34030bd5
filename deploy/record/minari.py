"""A recording as a Minari data set, for learning from what was driven."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from deploy.record.export import missing
from deploy.record.reader import Recording
from schemas.driving.episode import Decision, Ending, closeness
from schemas.driving.road import ID, NOBODY, X
from schemas.wire.codec import rows_of
from schemas.wire.messages import ROW_COLUMNS, Action, MetaAction, Observation
from sim_node.observe import VEHICLES_MAX

HEADWAY_S = 1.5
"""What the reward asks for: the action says which speed was intended, not which gap."""
SHAPE = (1 + VEHICLES_MAX, len(ROW_COLUMNS))


def to_minari(recording: Recording, name: str) -> int:
    """Write the local data set `name` (such as `fastslow/highway-v0`); returns how many steps it has.

    An episode for each world, cut where an answer was missed; a step for each tick whose action was applied and whose
    next tick was recorded. Observations: (41, 9) rows
    in `ROW_COLUMNS`, absent vehicles with id -1; actions: `MetaAction`; rewards: the project's own, per tick, for the
    speed that the action aimed at. Raises `ConfigError` where minari is missing, ValueError where it has that name.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
    except ImportError:
        raise missing("minari") from None
    buffers, steps = [], 0
    for number, (seen, actions, rewards) in enumerate(_episodes(recording)):
        steps += len(actions)
        last = [False] * (len(actions) - 1)
        buffers.append(
            EpisodeBuffer(
                id=number,
                observations=np.stack([_padded(one) for one in seen]),
                actions=np.array(actions, np.int64),
                rewards=rewards,
                terminations=[*last, seen[-1].crashed],
                truncations=[*last, not seen[-1].crashed],
            )
        )
    if not buffers:
        raise ValueError("the recording holds no two ticks with an action between them")
    minari.create_dataset_from_buffers(
        name,
        buffers,
        algorithm_name=f"fastslow {recording.metadata.get('fastslow', '')}".strip(),
        observation_space=spaces.Box(-np.inf, np.inf, SHAPE, np.float32),
        action_space=spaces.Discrete(len(MetaAction)),
        data_format="arrow",
        description=f"Recorded: {Path(recording.path).name}, {seen[0].scenario}",
    )
    return steps


def _episodes(recording: Recording) -> Iterator[tuple[list[Observation], list[int], list[float]]]:
    """(T + 1 observations, T actions, T rewards) for each run of consecutive ticks of one world."""
    seen: dict[tuple[int, int], Observation] = {}
    answers: dict[tuple[int, int], Action] = {}
    for _, _, message in recording.messages({"observation", "action"}):
        if isinstance(message, Observation):
            seen[message.epoch, message.tick] = message
        elif isinstance(message, Action):
            answers[message.epoch, message.answers_tick] = message
    run: list[Observation] = []
    actions: list[int] = []
    rewards: list[float] = []
    for at, after in pairwise(sorted(seen)):
        action = answers.get(at)
        if action is not None and after == (at[0], at[1] + 1) and seen[after].applied_tick == at[1]:
            run = run or [seen[at]]
            run.append(seen[after])
            actions.append(action.meta_action)
            rewards.append(_reward(seen[at], seen[after], action))
        elif run:
            yield run, actions, rewards
            run, actions, rewards = [], [], []
    if run:
        yield run, actions, rewards


def _padded(observation: Observation) -> NDArray[np.float32]:
    table = np.zeros(SHAPE, np.float32)
    table[:, ID] = NOBODY
    rows = rows_of(observation)[: SHAPE[0]]
    table[: len(rows)] = rows
    return table


def _reward(before: Observation, after: Observation, action: Action) -> float:
    rows = rows_of(after)
    aim = action.speed_goal_mps if action.speed_goal_mps is not None else before.target_speed_mps
    ttc, short = closeness(rows.astype(float).tolist(), after.target_lane, HEADWAY_S)
    decision = Decision(np.array([action.meta_action]), rows_of(before)[:1, X], np.array([before.acceleration_mps2]))
    decision.tick(
        np.array([action.meta_action]),
        rows[:1],
        np.array([after.acceleration_mps2]),
        np.array([ttc]),
        np.array([short]),
        np.array([True]),
        np.array([int(Ending.COLLISION if after.crashed else Ending.NONE)]),
    )
    half = 0.5 * after.lanes[after.target_lane].speed_limit_mps
    return float(decision.earned(np.array([aim]), half, after.hz)[0])
