"""Tests of the boats with the imperfections of real boats: the lines of the table, and three boats."""

from __future__ import annotations

import pytest

from tests.measured.data import measured
from tests.measured.real_boats import BoatCase, document, line, run_boat, table

ROW = {
    "key": "asv1-none",
    "hidden": "none",
    "code": "0",
    "vehicle": {"masses": {"m_u": [3.2, 1.26], "m_v": [-12.0, -3.4], "m_r": [1.0, None]}},
    "found": [["wind", "identified"]],
    "ratio": [0.5, 0.4, 0.612],
    "cpu": [20.4, 61.0],
    "cpu_again": 30.4,
    "slowness": 2.0,
}


def test_line_of_a_boat_has_the_answer_and_the_errors_of_the_masses() -> None:
    masses = ["+3 % (+1.3)", "-12 % (-3.4)", "+1 %"]
    assert table([ROW])[1] == [
        "asv1-none",
        "none",
        "wind (identified)",
        "0.50 (0.40 to 0.61)",
        *masses,
        "20 + 61",
        "30",
    ]
    assert line(ROW) == "asv1-none: wind identified (81 s)"
    failed = {"key": "b", "hidden": "wind", "code": "0", "error": "RuntimeError: no"}
    assert table([failed])[1][2] == "failed: RuntimeError: no"
    text = document([ROW, failed]).replace("\n", " ")
    assert "1 of 2 are" in text
    assert "The machine needs 2 to 2 times as long" in text


@pytest.mark.study
@pytest.mark.parametrize(
    ("boat", "effect"),
    [("asv12-fouled_prop", "mismatch"), ("cat14-bent_skeg", "yaw-bias"), ("toy11-wind_strong", "wind")],
)
def test_effect_of_a_realistic_boat_is_identified(boat: str, effect: str) -> None:
    measured("real_boats")
    row = run_boat(BoatCase(boat))
    assert row.get("error") is None
    assert [effect, "identified"] in row["found"]
