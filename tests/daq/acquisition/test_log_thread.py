"""The queue between ports and log: bounded, in order, and never waiting."""

from __future__ import annotations

from daq.acquisition.log_thread import LogItem, LogSink
from daq.samples import NAN, Frame, LoadCell


def item(k: int) -> LogItem:
    return LogItem("cell", "rx", b"%d\n" % k, float(k), [(Frame(LoadCell(float(k)), float(k), NAN), float(k))])


def test_a_full_queue_refuses_and_keeps_what_it_has() -> None:
    sink = LogSink(limit=3)
    assert [sink.put(item(k)) for k in range(5)] == [True, True, True, False, False]
    assert [entry.t for entry in sink.take()] == [0.0, 1.0, 2.0]
    assert sink.take() == []
    assert sink.put(item(9))
    assert [entry.raw for entry in sink.take()] == [b"9\n"]
