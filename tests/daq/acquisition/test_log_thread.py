"""Tests of the queue between ports and log: bounded, in order, never blocking."""

from __future__ import annotations

from seatrial.daq.acquisition.log_thread import LogItem, LogSink
from seatrial.daq.samples import NAN, Event, Frame, LoadCell


def item(k: int) -> LogItem:
    return LogItem("cell", "rx", b"%d\n" % k, float(k), [(Frame(LoadCell(float(k)), float(k), NAN), float(k))])


def test_a_full_queue_refuses_new_items_and_keeps_the_old_ones() -> None:
    sink = LogSink(limit=3)
    assert [sink.put(item(k)) for k in range(5)] == [True, True, True, False, False]
    assert [entry.t for entry in sink.take()] == [0.0, 1.0, 2.0]
    assert sink.take() == []
    assert sink.put(item(9))
    assert [entry.raw for entry in sink.take()] == [b"9\n"]


def test_a_full_queue_still_accepts_the_reason_of_the_end() -> None:
    """A disk that blocks for seconds fills the queue. The reason of the end of the run arrives after that."""
    sink = LogSink(limit=3)
    event = LogItem("", "", b"", 9.0, [(Frame(Event("stop", "the disk hangs"), 9.0, NAN), 9.0)])
    assert [sink.put(item(k)) for k in range(5)] == [True, True, True, False, False]
    # this part of the queue is bounded too
    assert [sink.put(event) for _ in range(5)] == [True, True, True, False, False]
    assert [entry.raw for entry in sink.take()] == [b"0\n", b"1\n", b"2\n", b"", b"", b""]
