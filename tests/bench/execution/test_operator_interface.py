"""Tests of the display of a run and of signals as flags."""

from __future__ import annotations

import io
import os
import signal
import sys
import time
from collections.abc import Iterator

import pytest
from rich.console import Console

from seatrial.bench.execution.operator_interface import (
    AGAIN_S,
    CAUGHT,
    Keys,
    LiveDisplay,
    MissionStatus,
    PlainDisplay,
    StopSignals,
    make_display,
)

VIEW = MissionStatus("steps forward", 12.0, 70.0, (0.3,), (1350.0,), force=3.62)


def test_the_display_shows_command_rpm_force_and_the_guard() -> None:
    assert VIEW.values() == "n +0.30  rpm +1350  force   +3.6 N  guard ok"
    boat = MissionStatus("zigzag", 1.0, 2.0, (0.5, -0.25), (float("nan"), -900.0), speed=1.234, warning="gnss: no fix")
    assert boat.values() == "n +0.50 -0.25  rpm   --  -900  speed 1.23 m/s  warning: gnss: no fix"
    lost = MissionStatus("zigzag", 1.0, 2.0, (0.5,), (900.0,), force=float("nan"), speed=float("nan"))
    assert lost.values() == "n +0.50  rpm  +900  force   -- N  speed   -- m/s  guard ok"


def test_plain_lines_are_printed_per_segment_not_per_status(capsys: pytest.CaptureFixture[str]) -> None:
    with PlainDisplay(sys.stdout) as display:
        for _ in range(50):
            display.show(VIEW)
        display.show(MissionStatus("rest", 30.0, 70.0, (0.0,), (0.0,)))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert "12.0/70 s  steps forward" in lines[0]
    assert "30.0/70 s  rest" in lines[1]


def test_the_live_display_draws_the_view_and_keeps_printed_lines() -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=120, color_system=None)
    with LiveDisplay(console) as display:
        display.show(VIEW)
        display.say("tare: [zero]")
    text = out.getvalue()
    assert "steps forward" in text
    assert "12.0/70 s" in text
    assert "force   +3.6 N" in text
    assert "tare: [zero]" in text


def test_a_cleared_display_no_longer_claims_that_the_guard_is_ok() -> None:
    out = io.StringIO()
    with LiveDisplay(Console(file=out, force_terminal=True, width=100, color_system=None)) as display:
        display.show(VIEW)
        display.clear()
        before = len(out.getvalue())
        display.say("THE RUN ENDS: stopped by Ctrl-C")
    assert "guard ok" in out.getvalue()[:before]
    after = out.getvalue()[before:]
    assert "THE RUN ENDS" in after
    assert "guard ok" not in after


def test_a_terminal_of_80_columns_shows_all_text() -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=80, color_system=None)
    warning = "autopilot: no heartbeat for 3.1 s, and the antenna's plug is in the water"
    with LiveDisplay(console) as display:
        display.show(MissionStatus("random steps", 12.0, 3600.0, (0.5, -0.25), (1e3, -1e3), speed=1.2, warning=warning))
    text = " ".join(out.getvalue().split())
    assert "…" not in text
    for words in ("random steps", "12.0/3600 s", "n +0.50 -0.25", "speed 1.20 m/s", warning):
        assert words in text


def test_a_pipe_gets_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert isinstance(make_display(), PlainDisplay)  # the captured output of pytest is not a terminal
    make_display().say("tare")
    make_display(stderr=True).say("beside a document")
    assert capsys.readouterr() == ("tare\n", "beside a document\n")


@pytest.fixture
def handlers() -> Iterator[None]:
    """Restore the signal handlers after the test."""
    before = [(number, signal.getsignal(number)) for number in CAUGHT]
    yield
    for number, handler in before:
        signal.signal(number, handler)


@pytest.mark.parametrize("number", CAUGHT)
@pytest.mark.usefixtures("handlers")
def test_signals_end_the_wait_at_once_and_never_raise(number: signal.Signals) -> None:
    with StopSignals() as signals:
        assert not signals.wait(0.0)
        for _ in range(3):
            os.kill(os.getpid(), number)
        start = time.monotonic()
        assert signals.wait(5.0)
        assert time.monotonic() - start < 1.0
        assert signals.caught is number
        os.kill(os.getpid(), signal.SIGINT)
        assert signals.caught is number  # the first signal is the reason
    assert signal.getsignal(number) is signal.SIG_IGN


def test_a_key_that_is_held_or_pressed_twice_counts_once() -> None:
    keys = Keys()
    assert keys._without_repetitions(" ", 10.0) == " "
    assert [keys._without_repetitions("  p", 10.0 + 0.03 * k) for k in range(100)] == [""] * 100
    assert keys._without_repetitions(" ", 12.9 + AGAIN_S) == ""
    assert keys._without_repetitions("p", 14.0 + 2 * AGAIN_S) == " "
    assert keys._without_repetitions("mm", 20.0) == "mm"


def test_signal_handlers_are_restored_without_a_signal() -> None:
    before = [signal.getsignal(number) for number in CAUGHT]
    with StopSignals():
        assert [signal.getsignal(number) for number in CAUGHT] != before
    assert [signal.getsignal(number) for number in CAUGHT] == before


@pytest.mark.usefixtures("handlers")
def test_signals_survive_a_flood() -> None:
    with StopSignals() as signals:
        for _ in range(70_000):  # more signals than a pipe holds
            signal.raise_signal(signal.SIGINT)
        assert signals.wait(0.0)
