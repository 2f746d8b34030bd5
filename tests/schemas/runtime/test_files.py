"""Files of strangers are read as far as they can be meant, and no farther."""

from __future__ import annotations

import io

from hypothesis import given
from hypothesis import strategies as st

from schemas.runtime.files import lines_bounded

MOST = 8


@given(st.binary(max_size=60))
def test_every_line_comes_in_its_place_and_none_is_longer_than_the_bound(raw: bytes) -> None:
    found = list(lines_bounded(io.BytesIO(raw), MOST))
    whole = raw.split(b"\n")
    wanted = whole[:-1] if raw.endswith(b"\n") or not raw else whole
    assert len(found) == len(wanted)
    for got, line in zip(found, wanted, strict=True):
        assert got == line.rstrip(b"\r\n") if got is not None else len(line) >= MOST


def test_a_line_that_is_too_long_costs_no_other() -> None:
    assert list(lines_bounded(io.BytesIO(b"one\n" + b"x" * 1000 + b"\ntwo"), MOST)) == [b"one", None, b"two"]
