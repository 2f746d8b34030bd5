"""What of a command is said to the car, and what is talk: to somebody else, or about something else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from slow_node.understanding.intent_parser import IntentParser

HEAD = Path(__file__).parents[2] / "weights" / "talk.safetensors"
"""Trained by `python -m slow_node.training.train_talk`."""

FOR_US, PERHAPS = 0.5, 0.1
"""From this probability on a sentence is for the car; the likeliest of several from this one on, where none is."""
MOST_SENTENCES = 12
"""A longer text is read as a whole."""


class Addressed:
    """A head on the intent parser's features. Without its weights every sentence is for the car."""

    def __init__(self, parser: IntentParser, path: Path = HEAD) -> None:
        from safetensors.numpy import load_file

        self._parser = parser
        self._weight: np.ndarray | None = None
        if path.is_file():
            tensors = load_file(path)
            self._weight, self._bias = tensors["weight"], float(tensors["bias"][0])

    def probability(self, sentence: str) -> float:
        """How likely a sentence is for the car."""
        if self._weight is None:
            return 1.0
        logit = float(np.concatenate(self._parser.features(sentence)) @ self._weight) + self._bias
        return float(1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0))))

    def kept(self, parts: list[str], known: Callable[[str], bool]) -> list[str]:
        """The sentences of several that are for the car, in order; none where all are talk.

        known: whether a sentence is for the car by its words alone.
        """
        if self._weight is None or not 2 <= len(parts) <= MOST_SENTENCES:
            return parts
        likely = [1.0 if known(part) else self.probability(part) for part in parts]
        found = [part for part, p in zip(parts, likely, strict=True) if p >= FOR_US]
        if found or max(likely) < PERHAPS:
            return found
        return [parts[int(np.argmax(likely))]]
