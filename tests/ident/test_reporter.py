"""Tests of progress: the time that a computation still needs, and details, which are rare in a text and shown at once
in a live line.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

import seatrial as st
from seatrial.api.messages import Messages
from seatrial.ident.cli.options import LineReporter, LiveLine
from seatrial.ident.reporter import TimeLeft, times_text


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


def test_time_left_of_a_phase_is_not_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """A design once said "0 s to go" at 5:08 of 7:31: its search took more parts than expected, and phases followed."""
    now = [0.0]
    monkeypatch.setattr("seatrial.ident.reporter.time.monotonic", lambda: now[0])
    left = TimeLeft(2500, "in this phase")
    now[0] = 250.0
    assert left.text(2400) == "10 s to go in this phase"
    for done in (2490, 2500, 2532):
        assert left.text(done) == "a few seconds to go in this phase"


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


@pytest.mark.parametrize("at_a_terminal", [True, False])
def test_a_user_who_chose_nothing_sees_a_line_every_30_seconds_at_a_terminal(
    at_a_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A script, whose output goes to a file, stays silent."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: at_a_terminal, raising=False)
    messages = Messages()
    for k in range(75):
        now[0] += 1.0
        messages.progress(f"design: {k + 1} of 75 comparisons", lambda: f"{now[0] - 100.0:.0f} s so far")
        messages.detail("two of three")
    shown = [f"{k} s so far: design: {k} of 75 comparisons" for k in (30, 60)] if at_a_terminal else []
    assert capsys.readouterr().err.splitlines() == shown


def test_a_design_in_python_shows_its_progress_like_a_diagnosis(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither is given ``progress``: the reporter of both decides by the place of the user."""
    made: list[bool | None] = []

    class Stop(Exception):
        """End of the call after the reporter is made."""

    def stopped(progress: bool | None = None, names: Mapping[str, str] | None = None) -> Messages:
        made.append(progress)
        raise Stop

    for name in ("runs", "fits"):
        monkeypatch.setattr(f"seatrial.api.{name}.Messages", stopped)
    for call in (lambda: st.design("horizontal:command", "x.toml", between=("wind", "mismatch")),
                 lambda: st.diagnose("model.toml", "run.mcap")):  # fmt: skip
        with pytest.raises(Stop):
            call()
    assert made == [None, None]


def test_a_live_line_shows_the_step_and_its_present_detail() -> None:
    shown: list[str] = []
    status: Any = SimpleNamespace(update=lambda line: shown.append(line.__rich__().plain))
    console: Any = None
    live = LiveLine(console, status)
    live.detail("reading")
    live.progress("fitting boat to 3 runs")
    live.detail("second fit: iteration 7")
    assert shown == ["reading", "fitting boat to 3 runs", "fitting boat to 3 runs: second fit: iteration 7"]


def test_a_live_line_is_one_line_and_its_times_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    console = Console(file=StringIO(), width=60)
    status: Any = SimpleNamespace(update=lambda line: None)
    live = LiveLine(console, status)
    live.progress("refitting with " + "a long effect " * 10, lambda: f"{now[0]:.0f} s so far")
    for k in (3.0, 4.0):
        now[0] = k
        (line,) = ("".join(s.text for s in console.render(live)).rstrip("\n")).split("\n")
        assert line.startswith(f"{k:.0f} s so far: refitting with a long effect")
        assert len(line) <= 60


def test_lines_have_the_times_of_when_they_are_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    lines, asked = LineReporter(), Messages(progress=True)
    for receiver in (lines, asked):
        receiver.progress("refitting with wind", lambda: f"{now[0]:.0f} s so far")
    now[0] = 40.0
    for receiver in (lines, asked):
        receiver.detail("iteration 3")
    expected = ["0 s so far: refitting with wind", "40 s so far: refitting with wind: iteration 3"]
    printed = capsys.readouterr()
    assert [line.strip() for line in printed.out.splitlines()] == expected
    assert printed.err.splitlines() == expected


def test_a_text_of_times_states_a_limit_only_if_it_says_more() -> None:
    assert times_text(5.0, None) == "0:05 so far"
    assert times_text(95.0, (130.0, 300.0)) == "1:35 so far, about 2 min to go, seldom more than 5 min"
    assert times_text(95.0, (130.0, 140.0)) == "1:35 so far, about 2 min to go"
    assert times_text(95.0, (0.0, 0.0)) == "1:35 so far, about 1 s to go"
