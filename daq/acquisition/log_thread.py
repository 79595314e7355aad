"""From the ports' threads to the log: a bounded queue, and the one thread that writes."""

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
from seatrial.daq.samples import Event, Frame, PortHealth

QUEUE_ITEMS = 20_000
WRITE_S = 0.01  # wall
HEALTH_S = 1.0
STREAM_SAMPLES = 5_000  # that wait for the parent at most
DELETED = "the log was deleted while it is recorded: what comes now is lost"


class LogItem(NamedTuple):
    """The data of one read or write, for the log."""

    device: str
    direction: str  # "rx" | "tx"; "" when there are no raw bytes
    raw: bytes
    t: float
    frames: list[tuple[Frame, float]]  # with the estimated times


class LogSink:
    """The bounded queue between the ports' threads and the writer. Putting never waits. Events, which say why a run
    ended, have as much room again: a disk that hangs fills the queue with data."""

    def __init__(self, limit: int = QUEUE_ITEMS) -> None:
        self._items: deque[LogItem] = deque()
        self._limit = limit

    def put(self, item: LogItem) -> bool:
        """Append an item; False when the queue is full."""
        if len(self._items) >= (self._limit if item.raw else 2 * self._limit):
            return False
        self._items.append(item)
        return True

    def take(self) -> list[LogItem]:
        """Remove and return all items, oldest first. For the log thread alone."""
        out = []
        with contextlib.suppress(IndexError):
            while True:
                out.append(self._items.popleft())
        return out


class SampleStream:
    """The samples that were logged, for the parent: the log thread puts, the main thread takes; neither ever waits."""

    def __init__(self, limit: int = STREAM_SAMPLES) -> None:
        self._samples: deque[StreamedSample] = deque()
        self._limit = limit
        self.dropped = 0

    def put(self, sample: StreamedSample) -> None:
        """Append a sample, or count it as dropped where those before it were not taken."""
        if len(self._samples) < self._limit:
            self._samples.append(sample)
        else:
            self.dropped += 1

    @property
    def waiting(self) -> int:
        """How many there are to take."""
        return len(self._samples)

    def take(self, most: int) -> list[StreamedSample]:
        """Remove and return the oldest."""
        return [self._samples.popleft() for _ in range(min(most, len(self._samples)))]


class LogThread(threading.Thread):
    """Empties the queue into the log. The only thread that touches the recorder."""

    def __init__(
        self, recorder: Recorder, sink: LogSink, health: Callable[[], dict[str, PortHealth]], clock: RunClock
    ) -> None:
        super().__init__(name="writer", daemon=True)
        self._recorder, self._sink, self._health_of, self._clock = recorder, sink, health, clock
        self._ending = threading.Event()
        self.messages = 0
        self.stream: SampleStream | None = None  # while somebody wants the samples
        self.size = recorder.size
        self.failure = ""
        self.alarm = ""  # why nothing is kept now, though it may be again

    def run(self) -> None:
        """Until `end`: write what there is, every 10 ms, and the counters every second."""
        set_realtime_priority(behind=1)  # it compresses: the ports and the set-points come first
        health_at = time.monotonic() + HEALTH_S
        try:
            while not self._ending.wait(WRITE_S):
                if not self._recorder.paused:  # while it is, what comes waits in the queue
                    self._write()
                if time.monotonic() >= health_at:
                    health_at += HEALTH_S
                    self._health()
                self._recorder.tick()
                self.alarm = self._recorder.paused or (DELETED if self._recorder.is_deleted else "")
                self.size = self._recorder.size
            self._write()
            self._health()
        except SeatrialError as error:
            self.failure = str(error)
        except Exception as error:  # a programming error: the thrusters must go to zero all the same
            self.failure = f"the log could not be written ({type(error).__name__}: {error})"
        try:
            self._recorder.close()
        except SeatrialError as error:
            self.failure = self.failure or str(error)
        self.size = self._recorder.size

    def end(self) -> None:
        """Request the last write; `join` waits until the log is closed."""
        self._ending.set()

    def _write(self) -> None:
        for item in self._sink.take():
            if item.direction:
                self._recorder.write_raw(item.device, item.direction, item.raw, item.t)
            for frame, t in item.frames:
                if isinstance(frame.sample, Event):
                    self._recorder.event(t, frame.sample.kind, frame.sample.text)
                else:
                    self._recorder.write(item.device, frame, t)
                    self.messages += 1
                    if self.stream is not None:
                        self.stream.put(StreamedSample(item.device, frame.sample, t))

    def _health(self) -> None:
        for device, health in self._health_of().items():
            self._recorder.health(device, health, self._clock.now())
