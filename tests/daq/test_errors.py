"""Tests of the helpers for messages: the closest known name."""

from __future__ import annotations

import pytest

from seatrial.daq.errors import closest_name


@pytest.mark.parametrize(
    ("name", "known", "closest"),
    [
        ("colum", ["name", "column", "columns"], "column"),
        ("rate", ["name", "rate_hz"], "rate_hz"),
        ("baudrate", ["rate_hz", "baud"], "baud"),
        ("N-Max", ["name", "n_max"], "n_max"),
        ("n", ["name", "node"], None),  # too short to stand for another
        ("colour", ["port", "name"], None),
        ("x", [], None),
    ],
)
def test_the_closest_name_is_a_misspelling_or_lacks_its_unit(name: str, known: list[str], closest: str | None) -> None:
    assert closest_name(name, known) == closest
