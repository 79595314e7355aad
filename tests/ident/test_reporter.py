"""Tests of progress: the time that a computation still needs, and details, which are rare in a text and shown at once
in a live line.
"""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from seatrial.api.messages import Messages
from seatrial.ident.cli.options import LineReporter, LiveLine
from seatrial.ident.reporter import TimeLeft


def test_time_left_follows_from_the_parts_that_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    left = TimeLeft(10)
    now[0] += 20.0
    assert left.text(2) == "80 s to go"
    assert left.text(1) == "3 min to go"
    assert left.text(11) == "0 s to go"


def test_time_left_of_more_parts_than_expected_counts_the_least_number(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("seatrial.ident.reporter.time.monotonic", lambda: now[0])
    left = TimeLeft(60)
    now[0] = 61.0
    assert left.text(61) == "0 s to go"
    assert left.text(61, 100.0) == "39 s to go"


def test_details_are_printed_at_most_every_30_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    lines, asked, quiet = LineReporter(), Messages(progress=True), Messages(progress=False)
    for receiver in (lines, asked, quiet):
        receiver.progress("fitting boat to 3 runs")
    for k in range(70):
        now[0] += 1.0
        for receiver in (lines, asked, quiet):
            receiver.detail(f"iteration {k + 1}")
    shown = ["fitting boat to 3 runs", *(f"fitting boat to 3 runs: iteration {k}" for k in (30, 60))]
    printed = capsys.readouterr()
    assert printed.out.split("\n") == [*(f"  {line}" for line in shown), ""]
    assert printed.err.split("\n") == [*shown, ""]


def test_a_live_line_shows_the_step_and_its_present_detail() -> None:
    shown: list[str] = []
    status: Any = SimpleNamespace(update=shown.append)
    console: Any = None
    live = LiveLine(console, status)
    live.detail("reading")
    live.progress("fitting boat to 3 runs")
    live.detail("second fit: iteration 7")
    assert shown == ["reading", "fitting boat to 3 runs", "fitting boat to 3 runs: second fit: iteration 7"]
