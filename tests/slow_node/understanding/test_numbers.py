"""Numbers in sentences: which are speeds, and how slips in them are mended."""

from __future__ import annotations

import pytest

from slow_node.understanding.numbers import quantities


@pytest.mark.parametrize(
    "text",
    [
        "it starts at 18:30",
        "the train leaves at ten",
        "be there by nine o'clock",
        "half past six",
        "ten to nine",
        "halb sieben",
        "18 Uhr 30",
        "vingt heures trente",
        "a las ocho y media",
        "alle otto e mezza",
        "20h30",
        "half negen",
        "klockan 17",
        "kello kahdeksan",
        "o godzinie 17:30",
        "\u516b\u70b9",
    ],
)
def test_a_time_of_day_is_no_speed(text: str) -> None:
    """What a clock shows is never taken for a number to drive at."""
    assert not [q for q in quantities(text) if q.kind == "speed"]


@pytest.mark.parametrize(
    ("text", "kmh"),
    [
        ("two hundred and ten", 210),
        ("zweihundertzehn", 210),
        ("deux cent dix", 210),
        ("doscientos diez", 210),
        ("duecentodieci", 210),
        ("duzentos e dez", 210),
        ("tweehonderdtien", 210),
        ("1hundred and10 km/h", 110),
        ("honderdvijfendertig", 135),
        ("quatre vingt dix neuf", 99),
        ("do osiemdziesi\u0119ciu", 80),
        ("sto dwadzie\u015bcia pi\u0119\u0107", 125),
        ("kahdeksaakymment\u00e4viitt\u00e4", 85),
        ("satakymmenen", 110),
        ("kahdeksaankymppiin", 80),
        ("hundratjugofem", 125),
        ("\u00e5ttio km/h", 80),
    ],
)
def test_compound_number_words_are_one_number(text: str, kmh: float) -> None:
    """Hundreds and compounds are read as one speed, in ten languages."""
    assert [round(q.value * 3.6, 2) for q in quantities(text)] == [kmh]


@pytest.mark.parametrize(
    ("text", "kmh"),
    [("drive 9O", 90), ("1OO km/h", 100), ("go l20", 120), ("8o km/h", 80), ("down to eigthy", 80), ("ninty", 90)],
)
def test_slips_in_numbers_are_mended(text: str, kmh: float) -> None:
    """Letters that look like digits and misspelled tens count as the numbers they stand for."""
    assert [round(q.value * 3.6, 2) for q in quantities(text)] == [kmh]


@pytest.mark.parametrize("text", ["im l8, hurry", "10 o'clock", "solo go", "he is on lane oil"])
def test_words_are_not_mended_into_speeds(text: str) -> None:
    """Shorthand and ordinary words with look-alike letters stay what they are."""
    assert not [q for q in quantities(text) if q.kind == "speed"]
