"""Tests of the helpers for messages: the closest known name, and the place of a warning."""

from __future__ import annotations

from typing import Any

import pytest

from seatrial.daq.errors import SeatrialWarning, closest_name


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
        ("compassmotor", ["compass", "compass-motor"], "compass-motor"),
    ],
)
def test_the_closest_name_is_a_misspelling_or_lacks_its_unit(name: str, known: list[str], closest: str | None) -> None:
    assert closest_name(name, known) == closest


def test_the_place_of_a_warning_is_the_line_of_the_user() -> None:
    """The user calls a function of seatrial that reaches `warn` through other functions and a context manager."""
    package = """
from contextlib import contextmanager
from seatrial.daq.errors import warn

@contextmanager
def opened():
    warn("the log is short")
    yield

def outer():
    with opened():
        pass
"""
    own: dict[str, Any] = {"__name__": "seatrial.example"}
    exec(compile(package, "inside.py", "exec"), own)
    user = {"__name__": "__main__", "outer": own["outer"]}
    with pytest.warns(SeatrialWarning, match="the log is short") as found:
        exec(compile("\n\nouter()\n", "users_script.py", "exec"), user)
    assert [(w.filename, w.lineno) for w in found] == [("users_script.py", 3)]
