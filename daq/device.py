"""One loop for every device: open, read, stamp, decode, hand over, and open again when the port is lost."""

from __future__ import annotations

import contextlib
import math
import os
import select
import threading
import time
from collections.abc import Callable

from daq.clock import ClockMap, RunClock
from daq.protocol import Decoder, loadcell, nmea, vectornav, vesc
from daq.rig import Device, Rig
from daq.samples import NAN, Command, Esc, Frame, PortHealth
from daq.setpoints import Due, Setpoints
from daq.status import Latest, PortStatus, RateMeter, Source
from daq.transport import Port, PortError
from daq.writer import Item, Sink

IDLE_S = 0.5  # wall; longest wait for bytes
RETRY_S = (0.05, 0.1, 0.2, 0.5, 1.0)  # wall; waits between attempts to open
MUTE_BYTES = 2000  # so many without a valid frame are no start-up noise
JOIN_BYTES = 256  # as much may be the rest of a frame
RATE_WINDOW_S = 2.0  # wall


def make_decoder(device: Device, rig: Rig) -> Decoder:
    """The decoder for a device of the rig."""
    if device.protocol == "vectornav":
        return vectornav.Decoder()
    if device.protocol == "nmea":
        return nmea.Decoder()
    if device.protocol == "loadcell":
        force = device.calibration.force if device.calibration else None
        return loadcell.Decoder(device.pattern, device.saturation, force, skip_first=True)
    here = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    return vesc.Decoder(
        {thruster.node: thruster.pole_pairs for thruster in here},
        frozenset(thruster.node for thruster in here if thruster.reversed),
    )


class DeviceLoop(threading.Thread):
    """The thread of one port, its counters, and the last it heard.

    `setpoints` makes it an actuator too: due set-points are sent from this thread. When the port is lost while
    thrust is commanded, `on_lost(reason)` is called from this thread.
    """

    def __init__(
        self,
        device: Device,
        port: Port,
        decoder: Decoder,
        clock: RunClock,
        sink: Sink,
        setpoints: Setpoints | None = None,
        reversed_nodes: frozenset[int] = frozenset(),
        on_lost: Callable[[str], None] = lambda reason: None,
    ) -> None:
        super().__init__(name=f"port {device.name}", daemon=True)
        self.device = device
        self._port, self._decoder, self._clock, self._sink = port, decoder, clock, sink
        self._setpoints, self._reversed, self._on_lost = setpoints, reversed_nodes, on_lost
        self._clock_map = ClockMap()
        self._has_clock = False
        self._ending = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._latest: dict[Source, Latest] = {}
        self._t_last = -math.inf
        self._samples = self._dropped = self._opened = self._mute_bytes = 0
        self._unforgiven = self._forgiven = 0  # unparsed bytes: when the port was opened, and those not held against it
        self._joining = False
        self._open = False
        self._problem = ""
        self._rate = RateMeter(max(RATE_WINDOW_S * clock.speed, 10.0 / device.rate_hz))

    def wake(self) -> None:
        """Look at the set-points now."""
        with contextlib.suppress(OSError):  # the pipe is full: it is awake already
            os.write(self._wake_write, b"x")

    def end(self) -> None:
        """Ask the thread to send zero, close the port and end; `join` waits for it."""
        self._ending = True
        self.wake()

    def run(self) -> None:
        """The thread: until `end`, whatever the port does."""
        failures = 0
        while not self._ending:
            try:
                self._port.open()
                self._start()
                failures = 0
                while not self._ending:
                    self._step()
            except Exception as error:
                # Whatever it is, the port is opened again, and what it was stands in the status and in the log.
                known = isinstance(error, PortError)
                self._lost(str(error) if known else f"internal error ({type(error).__name__}: {error})")
                self._wait(-1, RETRY_S[min(failures, len(RETRY_S) - 1)])
                failures += 1
        self._finish()

    def _start(self) -> None:
        self._opened += 1
        self._open, self._problem = True, ""
        self._mute_bytes = 0
        self._decoder.reset()
        self._joining, self._unforgiven = True, self._unparsed()
        if self._setpoints is not None and self._setpoints.held:
            self._setpoints.zero(time.monotonic())  # what it was told before it was lost is not what holds now

    def _lost(self, why: str) -> None:
        was_open, self._open, self._problem = self._open, False, why
        self._port.close()
        if was_open and self._setpoints is not None and self._setpoints.active:
            self._setpoints.zero(time.monotonic())
            self._on_lost(f"{self.device.name} ({self.device.port}) {why}")

    def _step(self) -> None:
        wait = IDLE_S
        if self._setpoints is not None:
            wait = min(wait, self._setpoints.wait(self._clock.now(), time.monotonic(), self._clock.speed))
        if self._wait(self._port.fileno(), wait):
            data = self._port.read()
            t_rx = self._clock.now()
            if data:
                self._received(data, t_rx)
        if self._setpoints is not None:
            for due in self._setpoints.due(self._clock.now(), time.monotonic()):
                self._send(due)

    def _wait(self, fd: int, seconds: float) -> bool:
        """Wait for bytes at `fd` (none if negative), for a wake-up or for the time; whether there are bytes."""
        fds = [self._wake_read] if fd < 0 else [fd, self._wake_read]
        ready, _, _ = select.select(fds, [], [], seconds)
        if self._wake_read in ready:
            os.read(self._wake_read, 4096)
        return fd >= 0 and fd in ready

    def _received(self, data: bytes, t_rx: float) -> None:
        frames_before = self._decoder.frames
        frames = [(frame, self._estimate(frame)) for frame in self._decoder.feed(data, t_rx)]
        for frame, t in frames:
            node = frame.sample.node if isinstance(frame.sample, Esc) else None
            self._latest[self.device.name, node] = Latest(frame.sample, t)
            self._t_last = frame.t_rx
        self._samples += len(frames)
        if self._decoder.frames > frames_before:
            self._mute_bytes = 0
            self._join()
        else:
            self._mute_bytes += len(data)
        if not self._sink.put(Item(self.device.name, "rx", data, t_rx, frames)):
            self._dropped += max(len(frames), 1)

    def _join(self) -> None:
        """The first valid frame: a port is opened in the middle of a frame, which is nobody's error."""
        if self._joining:
            self._joining = False
            before = self._unparsed() - self._unforgiven
            self._forgiven += before if before <= JOIN_BYTES else 0

    def _unparsed(self) -> int:
        return self._decoder.unparsed_bytes + self._port.unparsed_bytes - self._forgiven

    def _estimate(self, frame: Frame) -> float:
        if math.isnan(frame.t_device):
            return frame.t_rx
        self._has_clock = True
        return self._clock_map.update(frame.t_device, frame.t_rx)

    def _send(self, due: Due) -> None:
        n = -due.n if due.node in self._reversed else due.n
        raw = vesc.pack_can(*vesc.encode_duty(due.node, n))
        t = self._clock.now()
        self._port.write(raw)
        frames = [(Frame(Command(due.node, due.n), t, NAN), t)] if due.fresh else []
        if not self._sink.put(Item(self.device.name, "tx", raw, t, frames)):
            self._dropped += max(len(frames), 1)

    def _finish(self) -> None:
        """Leave every thruster at zero, as well as the port lets us."""
        with contextlib.suppress(PortError):
            if self._setpoints is not None and self._open:
                for _ in range(3):
                    self._setpoints.zero(time.monotonic())
                    for due in self._setpoints.due(self._clock.now(), time.monotonic()):
                        self._send(due)
        self._port.close()

    def latest(self) -> dict[Source, Latest]:
        """The newest samples, by device and node."""
        return dict(self._latest)

    def health(self) -> PortHealth:
        """The counters, for the log."""
        decoder, port = self._decoder, self._port
        return PortHealth(
            port=self.device.port,
            bytes_in=port.bytes_in,
            frames=decoder.frames,
            checksum_errors=decoder.checksum_errors,
            unparsed_bytes=self._unparsed(),
            dropped=self._dropped,
            reconnects=max(self._opened - 1, 0),
            clock_bias=self._clock_map.bias if self._has_clock else NAN,
            clock_spread=self._clock_map.spread if self._has_clock else NAN,
        )

    def status(self, now: float) -> PortStatus:
        """The counters and what follows from them at run time `now`, for people and for the guard."""
        health = self.health()
        return PortStatus(
            name=self.device.name,
            protocol=self.device.protocol,
            port=health.port,
            expected=self.device.rate_hz,
            rate=self._rate.rate(now, self._samples),
            age=max(now - self._t_last, 0.0),
            samples=self._samples,
            frames=health.frames,
            checksum_errors=health.checksum_errors,
            unparsed_bytes=health.unparsed_bytes,
            dropped=health.dropped,
            reconnects=health.reconnects,
            bytes_in=health.bytes_in,
            latency=health.clock_bias,
            latency_spread=health.clock_spread,
            message=self._message(),
        )

    def _message(self) -> str:
        if self._problem:
            return self._problem
        if self._mute_bytes >= MUTE_BYTES:
            return f"no valid frame in {MUTE_BYTES} bytes: wrong baud rate or protocol?"
        others = self._decoder.other_nodes if isinstance(self._decoder, vesc.Decoder) else {}
        if others:
            nodes = ", ".join(str(node) for node in sorted(others))
            return f"frames of node {nodes}, which no thruster of the rig has"
        return ""
