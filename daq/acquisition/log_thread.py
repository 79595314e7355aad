"""Queue between the threads of the ports and the log, and the only thread that writes the log."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from seatrial.daq.acquisition.status import StreamedSample
from seatrial.daq.clock import RunClock
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import Recorder
from seatrial.daq.realtime_priority import set_realtime_priority
from seatrial.daq.samples import Event, Frame, PortHealth, Transducer

QUEUE_ITEMS = 20_000  # reads and writes in the queue, at most
WRITE_S = 0.01  # wall s between writes to the log
HEALTH_S = 1.0  # wall s between writes of the counters
STREAM_SAMPLES = 5_000  # samples that wait for the parent, at most
DELETED = "the log was deleted during the recording: further data are lost; start a new recording"


class LogItem(NamedTuple):
    """Bytes and decoded samples of one read from a port or one write to it, which wait to be written to the log.

    Attributes
    ----------
    device
        Name of the device; empty for events of the process itself.
    direction
        "rx" or "tx"; "" if there are no raw bytes.
    raw
        Bytes that were read or written; empty for events.
    t
        Run time of the read or write [s].
    frames
        Decoded samples, each with its estimated run time [s].
    """

    device: str
    direction: str
    raw: bytes
    t: float
    frames: list[tuple[Frame, float]]


class LogSink:
    """Queue of data for the log, between the threads of the ports and the log thread. It is limited; `put` never waits.

    Parameters
    ----------
    limit : int
        Length of the queue from which on items with raw bytes are refused. Items without raw bytes, such as events, are
        refused from twice this length on.

    Notes
    -----
    For a refused item `put` returns False, and the item is lost. The threads of the ports count lost samples. Events
    have additional room, because a disk that hangs fills the queue with data, and an event may contain the reason why a
    run ended.
    """

    def __init__(self, limit: int = QUEUE_ITEMS) -> None:
        """Make an empty queue of data for the log.

        `limit` is the length of the queue from which on items with raw bytes are refused. Items without raw bytes, such
        as events, are refused from twice this length on.
        """
        self._items: deque[LogItem] = deque()
        self._limit = limit

    def put(self, item: LogItem) -> bool:
        """Append the bytes and samples of one read or write, or an event, to the queue of the log.

        Return True. If the queue is full, the item is not appended, and False is returned. The queue is full for an
        item with raw bytes if it has `limit` items, and for an item without, such as an event, if it has twice as many.
        """
        if len(self._items) >= (self._limit if item.raw else 2 * self._limit):
            return False
        self._items.append(item)
        return True

    def take(self) -> list[LogItem]:
        """Remove and return all data that wait to be written to the log, oldest first.

        Only the thread that writes the log may call this.
        """
        out = []
        with contextlib.suppress(IndexError):
            while True:
                out.append(self._items.popleft())
        return out


class SampleStream:
    """Queue of logged samples that are to be sent to the parent process. It has a limit, and its methods never wait.

    The log thread calls `put`, and the main thread calls `take`.

    Parameters
    ----------
    limit : int
        Largest number of samples in the queue.

    Attributes
    ----------
    dropped : int
        Number of samples that were lost because the queue was full.
    """

    def __init__(self, limit: int = STREAM_SAMPLES) -> None:
        """Make an empty queue for at most `limit` samples that are to be sent to the parent process."""
        self._samples: deque[StreamedSample] = deque()
        self._limit = limit
        self.dropped = 0

    def put(self, sample: StreamedSample) -> None:
        """Append a sample to the queue for the parent process.

        If the queue is full, the new sample is left out and counted in `dropped`.
        """
        if len(self._samples) < self._limit:
            self._samples.append(sample)
        else:
            self.dropped += 1

    @property
    def waiting(self) -> int:
        """Number of samples that wait to be sent to the parent process."""
        return len(self._samples)

    def take(self, n_max: int) -> list[StreamedSample]:
        """Remove and return the oldest samples that wait to be sent to the parent process, at most `n_max`.

        The oldest is first. The list is empty if no sample waits.
        """
        return [self._samples.popleft() for _ in range(min(n_max, len(self._samples)))]


class LogThread(threading.Thread):
    """Thread that writes the queued bytes and samples to the log. No other thread writes the log.

    Parameters
    ----------
    recorder : Recorder
        The open log. The thread closes it at its end.
    sink : LogSink
        Queue of the bytes and samples to write.
    health : Callable
        Function that returns the counters of each port by name of the device; they are written every second.
    clock : RunClock
        The run clock.

    Attributes
    ----------
    messages : int
        Number of samples written, without events.
    stream : SampleStream or None
        Queue of the samples for the parent process; None unless the parent has requested them.
    size : int
        Size of the log [bytes].
    failure : str
        Error that has ended the log; empty without one.
    alarm : str
        Why data are not kept at present: the disk is full (the log may go on later), or the file of the log was
        deleted. Empty otherwise.
    """

    def __init__(
        self, recorder: Recorder, sink: LogSink, health: Callable[[], dict[str, PortHealth]], clock: RunClock
    ) -> None:
        """Prepare the thread that writes the log. It is not started.

        `recorder` is the open log, which the thread closes at its end. `sink` is the queue of data to write. `health`
        is a function that returns the counters of each port by name of the device. `clock` is the run clock.
        """
        super().__init__(name="writer", daemon=True)
        self._recorder, self._sink, self._health_of, self._clock = recorder, sink, health, clock
        self._ending = threading.Event()
        self.messages = 0
        self.stream: SampleStream | None = None
        self.size = recorder.size
        self.failure = ""
        self.alarm = ""

    def run(self) -> None:
        """Write the queued data to the log until `end` is called, then close the log. This is the code of the thread.

        Data are written every 10 ms, and the counters of the ports every second. While a full disk pauses the recorder,
        data wait in the queue, and the recorder keeps the counters. An error of the log ends the thread and is stored
        in `failure`; the log is closed also then.
        """
        set_realtime_priority(behind=1)  # below the ports and set-points, because this thread compresses data
        health_at = time.monotonic() + HEALTH_S
        try:
            while not self._ending.wait(WRITE_S):
                if not self._recorder.paused:  # while the recorder is paused, items wait in the queue
                    self._write_queue()
                if time.monotonic() >= health_at:
                    health_at += HEALTH_S
                    self._write_counters()
                self._recorder.tick()
                deleted = f"{self._recorder.path}: {DELETED}" if self._recorder.is_deleted else ""
                self.alarm = self._recorder.paused or deleted
                self.size = self._recorder.size
            self._write_queue()
            self._write_counters()
        except SeatrialError as error:
            self.failure = str(error)
        except Exception as error:  # a programming error must be reported too, so that thrust ends
            why = f"({type(error).__name__}: {error}); check the disk, and report it if it happens again"
            self.failure = f"{self._recorder.path}: the log could not be written {why}"
        try:
            self._recorder.close()
        except SeatrialError as error:
            self.failure = self.failure or str(error)
        self.size = self._recorder.size

    def end(self) -> None:
        """Request the log thread to write the rest of the queue, close the log and end.

        The call does not wait; `join` does.
        """
        self._ending.set()

    def _write_queue(self) -> None:
        """Write all queued bytes, samples and events to the log, and pass samples on to the parent if requested.

        Events and samples of transducers are only written to the log, because the parent does not use them. All samples
        but events count in `messages`. Raise SeatrialError if the log cannot be written.
        """
        for item in self._sink.take():
            if item.direction:
                self._recorder.write_raw(item.device, item.direction, item.raw, item.t)
            for frame, t in item.frames:
                if isinstance(frame.sample, Event):
                    self._recorder.event(t, frame.sample.kind, frame.sample.text)
                else:
                    self._recorder.write(item.device, frame, t)
                    self.messages += 1
                    if self.stream is not None and not isinstance(frame.sample, Transducer):
                        self.stream.put(StreamedSample(item.device, frame.sample, t))

    def _write_counters(self) -> None:
        """Write the present counters of all ports (bytes, frames, errors) to the log, with the present run time.

        Raise SeatrialError if the log cannot be written.
        """
        for device, health in self._health_of().items():
            self._recorder.health(device, health, self._clock.now())
