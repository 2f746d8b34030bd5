"""Compiling everything once: what `make setup` does, and what a test session then finds done."""

from __future__ import annotations

import pytest

from deploy.lab import compile as compiling


def test_every_step_says_how_long_it_took(capsys: pytest.CaptureFixture[str]) -> None:
    assert compiling.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" compiling ")[0] for line in lines] == ["[1/3]", "[2/3]", "[3/3]"]
    assert all(line.endswith(" s") for line in lines)


def test_a_folder_that_cannot_be_written_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/not-there")
    monkeypatch.setattr(compiling, "STEPS", {})
    assert compiling.main() == 0
    assert "/proc/not-there cannot be written" in capsys.readouterr().out
