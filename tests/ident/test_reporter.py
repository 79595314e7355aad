"""Tests of the time that a computation still needs, as its progress shows it."""

from __future__ import annotations

import time

import pytest

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
