"""Tests of a report in limited width: a terminal of 80 columns, and a tab."""

from __future__ import annotations

from seatrial.ident.report.record_tabs import RecordTab
from tests.ident.pages import KINDS, printed


def test_long_warning_does_not_break_the_numbers() -> None:
    result = KINDS["thruster"]()
    rows = result["fit"]["parameters"]
    rows[0]["flag"] = "its error is 2.3 times as large because the other may leave its bound"
    text = printed(result)
    assert "2.794 ± 0.021" in text
    assert "⚠ a: its error is 2.3 times as large" in text
    assert max(map(len, text.splitlines())) <= 80


def test_log_named_like_its_role_is_named_once() -> None:
    assert RecordTab("validation", "validation").title == "validation"
    assert RecordTab("morning", "estimation").title == "estimation · morning"
