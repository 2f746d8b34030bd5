"""A stranger's policy, `package.module:factory`: found, tried, checked at each answer, and asked under a deadline."""

from __future__ import annotations

import importlib
import math
import os
import queue
import sys
import threading
import time
import traceback
from concurrent.futures import Future
from typing import Any

import numpy as np

from fast_node.policies.policy import NamedPolicy, Policy
from schemas.driving.features import Array, features
from schemas.runtime.process import ConfigError
from schemas.wire.messages import POLICY_ACTIONS


def load_outsider(spec: str) -> NamedPolicy:
    """The policy that the factory of `package.module:factory` returns. The current folder is importable.

    The policy may have an attribute `mask_preset` (default "sim"). It is asked a few times before it drives, so that
    what is wrong is told now and the first inference, often a slow one, is over. Raises `ConfigError`, one line.
    """
    module, _, factory = spec.partition(":")
    if (here := os.getcwd()) not in sys.path:
        sys.path.insert(0, here)
    try:
        loaded = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"policy {spec}: cannot import {module} from {here}: {_line(error)}; mend it, or start where it lies"
        ) from None
    found = getattr(loaded, factory, None)
    if not callable(found):
        raise ConfigError(
            f"policy {spec}: {module} has no callable {factory!r}: name one that returns an object with logits(x)"
        )
    try:
        policy = found()
    except (Exception, SystemExit) as error:
        raise ConfigError(f"policy {spec}: {factory}() raised {_line(error)}; mend it") from None
    if not callable(getattr(policy, "logits", None)):
        raise ConfigError(
            f"policy {spec}: {factory}() returned {type(policy).__name__}, which has no method logits(x): return an "
            "object that has"
        )
    checked = CheckedPolicy(spec, policy)
    prove(spec, policy)
    return NamedPolicy(spec, checked, mask_preset=str(getattr(policy, "mask_preset", "sim")), stateless=False)


def prove(name: str, policy: Policy) -> None:
    """Ask a policy three times before it drives, one scene and two at once: what is wrong with it is told now. Raises
    `ConfigError`, one line."""
    one = _probe()
    for x in (one, np.stack([one, one]), one):
        CheckedPolicy(name, policy).logits(x)


class CheckedPolicy:
    """A stranger's policy whose every answer is checked: five finite preferences for each input."""

    def __init__(self, name: str, policy: Policy) -> None:
        self._name, self._policy = name, policy

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`. Raises `ConfigError`, one line, where the stranger raises or the answer is none."""
        try:
            answer = np.asarray(self._policy.logits(x.copy()), np.float32)  # a copy: what is ours stays as it is
        except (Exception, SystemExit) as error:
            raise ConfigError(f"policy {self._name}: logits(x) raised {_line(error)}; mend it") from None
        wanted = (*x.shape[:-2], POLICY_ACTIONS)
        if answer.shape != wanted:
            raise ConfigError(
                f"policy {self._name}: logits(x) returned shape {answer.shape} for x of shape {x.shape}: return "
                f"{wanted}, five preferences for each input"
            )
        if not np.isfinite(answer).all():
            raise ConfigError(f"policy {self._name}: logits(x) returned a number that is not finite: mend it")
        return answer


class DeadlinePolicy:
    """Asks a policy on a thread of its own, and does not wait longer than `budget_s` for the answer."""

    def __init__(self, policy: Policy, budget_s: float) -> None:
        self._policy, self._budget_s = policy, budget_s
        self._questions: queue.SimpleQueue[tuple[Array, Future[Array]]] = queue.SimpleQueue()
        self._last: Future[Array] | None = None
        self._thread: threading.Thread | None = None

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`. Raises TimeoutError where no answer comes in time, or the last question is still open:
        a late answer is dropped."""
        if self._last is not None and not self._last.done():
            raise TimeoutError("the policy is still busy with an earlier tick")
        if self._thread is None:  # now, and not before, for threads inherit the scheduling of who starts them
            self._thread = threading.Thread(target=self._work, name="policy", daemon=True)
            self._thread.start()
        self._last = Future()
        self._questions.put((x, self._last))
        try:
            return self._last.result(self._budget_s)
        except TimeoutError:
            raise TimeoutError(f"the policy did not answer within {1000 * self._budget_s:g} ms") from None

    def _work(self) -> None:
        while True:
            x, answer = self._questions.get()
            try:
                answer.set_result(self._policy.logits(x))
            except BaseException as error:  # told to who waits; this thread goes on
                answer.set_exception(error if isinstance(error, Exception) else RuntimeError(repr(error)))


TRUSTED_AGAIN = 15
"""Answers, three a second: 5 s. The scheduler's odd pause is no fault of the policy, and every hand-over costs."""


class WatchedPolicy:
    """Asks a policy directly, which is quickest, until an answer takes longer than `limit_s`: then under that deadline,
    so that a tick is answered in time whatever has become of the policy, until `TRUSTED_AGAIN` answers on end were."""

    def __init__(self, policy: Policy, limit_s: float) -> None:
        self._policy, self._limit_s = policy, limit_s
        self._deadline = DeadlinePolicy(policy, limit_s)
        self._on_trial = 0
        """So many answers in time are wanted before it is asked directly."""

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`. Raises TimeoutError where no answer comes in time."""
        if self._on_trial:
            watched, self._on_trial = self._on_trial, TRUSTED_AGAIN
            answer = self._deadline.logits(x)
            self._on_trial = watched - 1
            return answer
        start_s = time.monotonic()
        answer = self._policy.logits(x)
        if time.monotonic() - start_s > self._limit_s:
            self._on_trial = TRUSTED_AGAIN
        return answer


def _probe() -> Array:
    """The policy input of a plain scene: a slower car ahead, one beside, one behind; no lane is wished."""
    rows: list[tuple[Any, ...]] = [
        (0, 0.0, 4.0, 25.0, 0.0, 0.0, 5.0, 2.0, 1),
        (1, 40.0, 4.0, 20.0, 0.0, 0.0, 5.0, 2.0, 1),
        (2, 3.0, 0.0, 25.0, 0.0, 0.0, 5.0, 2.0, 0),
        (3, -30.0, 4.0, 26.0, 0.0, 0.0, 5.0, 2.0, 1),
    ]
    return features(rows, math.nan, 30.0, 1.5, 25.0, False, 1e4)


def _line(error: BaseException) -> str:
    """An exception in one line: type, message, and where in the stranger's code it was raised."""
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"[:160].rstrip(": ")
    ours = (__file__, importlib.__file__)
    theirs = [f for f in traceback.extract_tb(error.__traceback__) if f.filename not in ours and f.filename[0] != "<"]
    return f"{said} ({os.path.basename(theirs[-1].filename)}, line {theirs[-1].lineno})" if theirs else said
