"""Tests of a report in limited width: a terminal of 80 columns, and a tab."""

from __future__ import annotations

from pathlib import Path

from seatrial.ident.report.record_tabs import RecordTab
from tests.ident.pages import KINDS, printed, written


def test_long_warning_does_not_break_the_numbers() -> None:
    result = KINDS["thruster"]()
    rows = result["fit"]["parameters"]
    rows[0]["flag"] = "its error is 2.3 times as large because the other may leave its bound"
    text = printed(result)
    assert "2.794 ± 0.021" in text
    assert "⚠ a: its error is 2.3 times as large" in text
    assert max(map(len, text.splitlines())) <= 80


def test_noise_at_its_bound_is_named_as_such(tmp_path: Path) -> None:
    result = KINDS["thruster"]()
    row = result["fit"]["parameters"][0]
    row["name"], row["meaning"] = "e_psi", "noise of the heading"
    assert "e_psi" not in printed(result)
    row["flag"] = "at its bound 0.0017, the lowest possible value: the data show less noise than this"
    row["flag_codes"] = ["at bound"]
    assert "⚠ e_psi: at its bound 0.0017" in " ".join(printed(result).split())
    assert "estimated, at bound" in written(result, tmp_path)


def test_log_named_like_its_role_is_named_once() -> None:
    assert RecordTab("validation", "validation").title == "validation"
    assert RecordTab("morning", "estimation").title == "estimation · morning"
