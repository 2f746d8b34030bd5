"""What the tests of the slow node share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from slow_node.llm.embedding import HashedEmbedder
from slow_node.memory.bank import Memory


@pytest.fixture
def memory() -> Iterator[Memory]:
    """A bank without shipped examples."""
    bank = Memory(HashedEmbedder(), shipped=None)
    yield bank
    bank.close()
