"""Tests of the time left of a diagnosis: it follows from the planned parts, and from the times of parts so far."""

from __future__ import annotations

import time

import pytest

from seatrial.ident.diagnosis.progress import SHARES, SearchProgress, SearchWork


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Time of the monotonic clock [s], in a list."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_the_time_left_is_unknown_before_the_first_refits(clock: list[float]) -> None:
    work = SearchWork()
    work.plan("candidate", 4, 10)
    with work.timed("start"):
        clock[0] += 7.0
    assert work.left() is None
    assert work.text() == "0:07 so far"


def test_the_time_of_a_kind_without_a_measurement_follows_from_the_refits(clock: list[float]) -> None:
    work = SearchWork()
    work.plan("exact", 2, 3)
    with work.timed("candidate", 2):
        clock[0] += 10.0
    assert work.left() == pytest.approx((10.0 * SHARES["exact"], 15.0 * SHARES["exact"]))
    with work.timed("exact"):
        clock[0] += 4.0
    assert work.left() == pytest.approx((4.0, 8.0))


def test_the_time_left_falls_while_candidates_are_refitted(clock: list[float]) -> None:
    work = SearchWork()
    work.plan("candidate", 4, 10)
    with work.timed("candidate", 2):
        clock[0] += 6.0
    assert work.left() == pytest.approx((6.0, 24.0))  # two more at 3 s are likely, and eight possible
    with work.timed("candidate", 2):
        clock[0] += 4.0
        assert work.left() == pytest.approx((2.0, 20.0))
        clock[0] += 10.0  # longer than expected: the other candidates are still ahead
        assert work.left() == pytest.approx((0.0, 18.0))
    assert work.left() == pytest.approx((0.0, 6 * 5.0))


def test_a_part_inside_another_one_is_counted_once(clock: list[float]) -> None:
    work = SearchWork()
    with work.timed("exact"), work.timed("tests"):
        clock[0] += 3.0
    assert work.seconds["exact"] == [3.0]
    assert work.seconds["tests"] == []


def test_a_failed_part_is_done(clock: list[float]) -> None:
    work = SearchWork()

    def interrupted() -> None:
        with work.timed("exact"):
            clock[0] += 3.0
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert work.seconds["exact"] == [3.0]


def test_steps_of_a_search_are_reported_with_their_times(clock: list[float]) -> None:
    lines: list[str] = []

    class Receiver:
        def progress(self, text: str, times: object = None) -> None:
            lines.append(f"{times() if callable(times) else None}: {text}")

        def detail(self, text: str) -> None:
            lines.append(text)

        def warning(self, text: str) -> None:
            lines.append(text)

    progress = SearchProgress(Receiver())
    clock[0] += 4.0
    progress.progress("round 1")
    progress.detail("iteration 3")
    progress.warning("a problem")
    assert lines == ["0:04 so far: round 1", "iteration 3", "a problem"]
