"""Thread of one device: opens the port, reads and decodes bytes, sends set-points, and reopens a lost port."""

from __future__ import annotations

import contextlib
import math
import os
import select
import threading
import time
from collections.abc import Callable

from seatrial.daq.acquisition.log_thread import LogItem, LogSink
from seatrial.daq.acquisition.sensor_health import SensorHealth
from seatrial.daq.acquisition.status import Latest, PortStatus, Source
from seatrial.daq.clock import ClockMap, RunClock, SuspendDetector
from seatrial.daq.drivers import DeviceDriver, Due, LinkStatus, Setpoints
from seatrial.daq.protocol import Decoder
from seatrial.daq.rig import Device
from seatrial.daq.samples import NAN, Ahrs, Command, Esc, Event, Frame, Gnss, PortHealth, Sample, Servo, Transducer
from seatrial.daq.transport import Port, PortError, decode_read

IDLE_S = 0.5  # wall s, longest wait for bytes
RETRY_S = (0.05, 0.1, 0.2, 0.5, 1.0)  # wall s, waits between attempts to open a port
DRIVEN_RETRY_S = 0.1  # wall s, longest such wait for a port that has commanded thrust
MUTE_BYTES = 2000  # bytes without a valid frame that are too many for start-up noise
STUCK_S = 0.25  # wall s; a thread that commands thrust runs every 20 ms
JOIN_BYTES = 256  # bytes before the first valid frame that may be the rest of an earlier frame
RATE_WINDOW_S = 2.0  # wall s
# Protocols whose samples do not arrive in the order of their times, as an attitude may precede an older fix.
UNORDERED = ("nmea", "ubx")
# Main kind of sample of protocols with several kinds on one port. It is stored under the name of the device alone, so
# that a fix does not replace an attitude as the newest sample.
MAIN: dict[str, type] = {"nmea": Gnss, "ubx": Gnss, "vectornav": Ahrs, "mip": Ahrs}


def _is_attitude(sample: Sample) -> bool:
    """Return whether a sample is of class Ahrs and contains a heading, and not only accelerations or rates."""
    return isinstance(sample, Ahrs) and not math.isnan(sample.yaw)


def source_of(device: Device, sample: Sample) -> Source:
    """Return the key (name and node) under which the newest sample of this kind is stored in the status.

    Parameters
    ----------
    device : Device
        The device that has sent the sample.
    sample : Sample
        The sample.

    Returns
    -------
    Source
        Name, and node or None. The name is that of the device for its main kind of sample, and `DEVICE/KIND` for every
        further kind, with KIND in lower case, such as `autopilot/gnss`. The main kind is `Gnss` for nmea and ubx,
        `Ahrs` for vectornav and mip, and `Ahrs` with a heading for an autopilot or an NMEA 2000 bus; servo outputs of
        an autopilot also have the name of the device. With any other protocol every kind is a main kind. The node is
        the number of the speed controller or of the servo output, and None for other samples.
    """
    if not device.sends_many_kinds:
        if isinstance(sample, MAIN.get(device.protocol, Sample)):
            return device.name, sample.node if isinstance(sample, Esc) else None
    elif isinstance(sample, Servo):
        return device.name, sample.node
    elif _is_attitude(sample):
        return device.name, None
    return f"{device.name}/{type(sample).__name__.lower()}", sample.node if isinstance(sample, Esc) else None


class DeviceLoop(threading.Thread):
    """Thread that serves the port of one device, with counters of the port and the newest samples of the device.

    Parameters
    ----------
    device : Device
        The device, from the rig.
    port : Port
        Its port, which is not open yet.
    decoder : Decoder
        Decoder of its protocol.
    clock : RunClock
        The run clock.
    sink : LogSink
        Queue of the log, into which all bytes and samples go.
    setpoints : Setpoints, optional
        Schedule of the thrusters of the device. None if the device drives no thruster.
    driver : DeviceDriver, optional
        Encoder of the set-points, which may also send messages of its own. None for a device without a driver.
    on_lost : Callable
        Function that is called with a reason after the first command if the port is lost or the computer was suspended,
        even while the thrusters are at rest. It is also called if this thread was stopped for a while under thrust.
    """

    def __init__(
        self,
        device: Device,
        port: Port,
        decoder: Decoder,
        clock: RunClock,
        sink: LogSink,
        setpoints: Setpoints | None = None,
        driver: DeviceDriver | None = None,
        on_lost: Callable[[str], None] = lambda reason: None,
    ) -> None:
        """Prepare the thread that serves the port of one device. It is not started, and the port is not opened.

        `decoder` decodes the received bytes, and `sink` is the queue of the log. `setpoints` is the schedule of the
        device's thrusters (None without one), and `driver` encodes the messages to the device (None without one).
        `on_lost` is called with a reason if the port is lost, or this thread or the computer was stopped, so
        that an old command could have been repeated.
        """
        super().__init__(name=f"port {device.name}", daemon=True)
        self.device = device
        self._port, self._decoder, self._clock, self._sink = port, decoder, clock, sink
        self._setpoints, self._driver, self._on_lost = setpoints, driver, on_lost
        self._attitudes = False
        self._many_kinds = device.sends_many_kinds  # looked up once, not for every sample
        self._unordered = self._many_kinds or device.protocol in UNORDERED
        self._clock_map = ClockMap()
        self._sensor_health = SensorHealth()
        self._suspended = SuspendDetector()
        self._has_clock = False
        self._ending = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._latest: dict[Source, Latest] = {}
        self._t_last = -math.inf
        self._samples = self._rated = self._dropped = self._opened = self._mute_bytes = 0
        # Unparsed bytes when the port was opened, and unparsed bytes that are not counted.
        self._unparsed_at_open = self._uncounted_bytes = 0
        self._joining = False
        self._open = False
        self._stepped = self._checked = time.monotonic()
        self._zeroed = math.nan
        self._problem = ""
        self._rate = RateMeter(max(RATE_WINDOW_S * clock.speed, 10.0 / device.rate_hz))

    def wake(self) -> None:
        """Wake the thread of the port from its wait, so that it sends set-points and messages that are due now.

        Any thread may call this.
        """
        with contextlib.suppress(OSError):  # the pipe is full: it is awake already
            os.write(self._wake_write, b"x")

    def end(self) -> None:
        """Request the thread of the port to send zero, close the port and end. The call does not wait; `join` does.

        Any thread may call this.
        """
        self._ending = True
        self.wake()

    def run(self) -> None:
        """Open the port of the device, serve it until `end` is called, send zero and close it (code of the thread).

        After any error the port is closed, and opened again after a wait that grows with the number of failures in a
        row.
        """
        failures = 0
        while not self._ending:
            try:
                self._port.open()
                self._reset_after_open()
                failures = 0
                while not self._ending:
                    self._step()
            except Exception as error:
                # After any error the port is opened again. The error is reported in the status and in the log.
                is_port_error = isinstance(error, PortError)
                self._close_lost_port(
                    str(error) if is_port_error else f"internal error ({type(error).__name__}: {error}): report it"
                )
                self._wait_for_bytes(-1, self._retry_s(failures))
                failures += 1
        self._send_final_zero()

    def _retry_s(self, failures: int) -> float:
        """Return the time [wall s] to wait before the next attempt to open the port.

        `failures` is the number of failed attempts in a row: the wait grows with it from 0.05 to 1 s. It is at most
        0.1 s for a port that has sent a command, because zero still has to be sent.
        """
        drives = self._setpoints is not None and bool(self._setpoints.held)
        return min(RETRY_S[min(failures, len(RETRY_S) - 1)], DRIVEN_RETRY_S if drives else math.inf)

    def is_at_zero(self, now: float) -> bool:
        """Return whether all thrusters of the port are at zero: zero was sent and repeated, and the port is open.

        Repeated means that zero was sent again for 0.5 s. Return True also if the port has never sent a command, open
        or not. `now` is a monotonic time [s].
        """
        if self._setpoints is None or not self._setpoints.held:
            return True
        return self._open and self._setpoints.is_settled(now)

    def _reset_after_open(self) -> None:
        """Reset decoder and driver after the port was opened, and command zero if it has sent a command before.

        Bytes and commands from before a loss of the port then have no effect.
        """
        self._opened += 1
        self._open, self._problem = True, ""
        self._checked = time.monotonic()
        self._mute_bytes = 0
        self._decoder.reset()
        self._joining, self._unparsed_at_open = True, self._count_unparsed()
        if self._driver is not None:
            self._driver.opened(time.monotonic())
        if self._setpoints is not None and self._setpoints.held:
            self._setpoints.zero(time.monotonic())  # a command from before the loss must not be sent

    def _close_lost_port(self, why: str) -> None:
        """Close the port after an error, and store the reason `why` as the fault of the port.

        If the port was open and has sent a command, zero is commanded first, and the acquisition process is informed by
        its function `on_lost`, so that it stops all thrust.
        """
        was_open, self._open, self._problem = self._open, False, why
        if was_open and self._setpoints is not None and self._setpoints.held:
            self._setpoints.zero(time.monotonic())
            self._on_lost(f"{self.device.name} ({self.device.port}) {why}")  # before the close, which may block
        self._port.close()

    def _step(self) -> None:
        """Serve the port once: wait for received bytes or until something has to be sent, then read and send.

        Received bytes are decoded. Set-points and messages of the driver that are due are sent. Zero is commanded if
        this thread or the computer was stopped for a while.
        """
        self._stepped = time.monotonic()
        wait = IDLE_S
        if self._setpoints is not None:
            wait = min(wait, self._setpoints.wait(self._clock.now(), time.monotonic(), self._clock.speed))
        if self._driver is not None:
            wait = min(wait, self._driver.wait(time.monotonic()))
        has_bytes = self._wait_for_bytes(self._port.fileno(), wait)
        if self._setpoints is not None:
            self._check_pause(self._setpoints, wait)
        if has_bytes:
            data = self._port.read()
            t_rx = self._clock.now()
            if data:
                self._decode_received(data, t_rx)
        if self._setpoints is not None:
            self._check_suspend(self._setpoints)
            self._check_pause(self._setpoints)
            self._send_setpoints(self._setpoints.due(self._clock.now(), time.monotonic()))
        if self._driver is not None:
            self._poll_driver(self._driver)

    def _check_pause(self, setpoints: Setpoints, waited: float = 0.0) -> None:
        """Command zero to the thrusters of `setpoints` if this thread was stopped for more than 0.25 s (STUCK_S, wall).

        Otherwise it would repeat an old command. `on_lost` is then called too, so that the process stops all thrust.
        The pause is the time since the last check, minus the intended wait `waited` [wall s]. A pause does not count if
        zero was already sent and repeated. The method is called at several places, because a pause can occur at any
        line of the loop.
        """
        now = time.monotonic()
        paused, self._checked = now - self._checked - waited, now
        if paused > STUCK_S and not setpoints.is_settled(now):
            setpoints.zero(now)
            text = f"the acquisition process stood still for {paused:.1f} s: the computer is too busy"
            self._on_lost(f"{text}; end other programs, and run again")

    def _check_suspend(self, setpoints: Setpoints) -> None:
        """Command zero to the thrusters of `setpoints` if the computer was suspended since the last check.

        Otherwise an old command would be repeated. `on_lost` is then called too, so that the process stops all thrust.
        Nothing is done if no command was ever sent.
        """
        if (slept := self._suspended.slept()) and setpoints.held:
            setpoints.zero(time.monotonic())
            text = f"the computer was suspended for {slept:.1f} s"
            self._on_lost(f"{text}; switch its suspend off (lid, battery, power settings), and run again")

    def _poll_driver(self, driver: DeviceDriver) -> None:
        """Send the requests and heartbeats of the driver that are due, and put them and its events into the log queue.

        A driver is the encoder of the messages to one device. Set-points are not sent here. Raise PortError if the port
        fails.
        """
        data = driver.poll(time.monotonic())
        t = self._clock.now()
        if data:
            self._port.write(data)
            self._queue_for_log("tx", data, t, [])
        if events := driver.events():
            self._queue_for_log("", b"", t, [(Frame(event, t, NAN), t) for event in events])

    def _queue_for_log(self, direction: str, raw: bytes, t: float, frames: list[tuple[Frame, float]]) -> None:
        """Put the bytes and samples of one read or write into the queue of the log.

        If the queue is full, each sample is counted as dropped; bytes without samples count as one. `direction` is "rx"
        for received and "tx" for sent bytes, and empty without bytes. `t` is the run time [s] of the read or write.
        `frames` are the decoded samples, each with its estimated run time [s].
        """
        if not self._sink.put(LogItem(self.device.name, direction, raw, t, frames)):
            self._dropped += max(len(frames), 1)

    def _wait_for_bytes(self, fd: int, seconds: float) -> bool:
        """Wait until there are bytes at the file descriptor `fd`, `wake` is called, or `seconds` (wall) have passed.

        Return True if bytes can be read, or the other end of the port was closed; False after `wake` or the time-out
        alone. If `fd` is negative, no bytes are awaited, and False is returned.
        """
        fds = [self._wake_read] if fd < 0 else [fd, self._wake_read]
        ready, _, _ = select.select(fds, [], [], seconds)
        if self._wake_read in ready:
            os.read(self._wake_read, 4096)
        return fd >= 0 and fd in ready

    def _decode_received(self, data: bytes, t_rx: float) -> None:
        """Decode the bytes `data` that were received from the port at run time `t_rx` [s].

        The newest samples, the counters and the checks of the sensor are updated. Transducers and events are not stored
        as newest samples, and do not count for rate and age, but for the number of samples. Bytes and samples are put
        into the queue of the log.
        """
        frames_before = self._decoder.frames
        frames = [
            (frame, self._estimate_run_time(frame)) for frame in decode_read(self._port, self._decoder, data, t_rx)
        ]
        for frame, t in frames:
            # A transducer that still reports does not prove that the receiver or the compass does.
            if not isinstance(frame.sample, (Event, Transducer)):
                self._latest[source_of(self.device, frame.sample)] = Latest(frame.sample, t)
                self._t_last = frame.t_rx
                self._rated += self._is_rated(frame.sample)
            self._sensor_health.take(frame)
        self._samples += len(frames)
        self._sensor_health.count(t_rx, self._decoder.frames, self._decoder.checksum_errors, self._clock_map.resets)
        if self._decoder.frames > frames_before:
            self._mute_bytes = 0
            self._exclude_join_bytes()
        else:
            self._mute_bytes += len(data)
        self._queue_for_log("rx", data, t_rx, frames)

    def _is_rated(self, sample: Sample) -> bool:
        """Return whether a sample counts for the measured rate of the device.

        This rate is compared with `rate_hz` of the rig. Of an autopilot or an NMEA 2000 bus only the attitudes count.
        On an NMEA 2000 bus that has sent no attitude so far, the position fixes count. Of all other devices every
        sample counts.
        """
        if not self._many_kinds:
            return True
        self._attitudes |= _is_attitude(sample)
        yaw = sample.yaw if isinstance(sample, Ahrs) else NAN
        return bool(self.device.is_rated(type(sample), yaw, self._attitudes))

    def _exclude_join_bytes(self) -> None:
        """Exclude the bytes that came before the first valid frame from the count of unparsed bytes.

        This is done once after each opening of the port, which may be in the middle of a frame. If there are more than
        256 such bytes (JOIN_BYTES), none is excluded, because they are no rest of a frame.
        """
        if self._joining:
            self._joining = False
            before = self._count_unparsed() - self._unparsed_at_open
            self._uncounted_bytes += before if before <= JOIN_BYTES else 0

    def _count_unparsed(self) -> int:
        """Return the number of received bytes that belong to no valid frame.

        The rest of a frame at each opening of the port is not counted (`_exclude_join_bytes`).
        """
        return self._decoder.unparsed_bytes + self._port.unparsed_bytes - self._uncounted_bytes

    def _estimate_run_time(self, frame: Frame) -> float:
        """Return the estimated run time [s] at which the sample in `frame` was measured.

        It follows from the device's own time of the sample and the map from the device's clock to run time. If the
        sample has no time of the device, it is the run time at which it was received.
        """
        if math.isnan(frame.t_device):
            return frame.t_rx
        self._has_clock = True
        return self._clock_map.estimate(frame.t_device, frame.t_rx, self._unordered, type(frame.sample))

    def _send_setpoints(self, dues: list[Due]) -> None:
        """Send the set-points `dues`, which are due, to the thrusters of the port, and put them into the log queue.

        All sent bytes are logged; only new set-points are also logged as commands. The run time from which all
        thrusters that have had a command have got zero is stored in `zeroed`. Nothing is done without a driver or due
        set-points.
        """
        if self._driver is None or self._setpoints is None or not dues:
            return
        for raw, carried in self._driver.command(dues, self._setpoints.held, time.monotonic()):
            t = self._clock.now()
            self._port.write(raw)
            frames = [(Frame(Command(due.node, due.n), t, NAN), t) for due in carried if due.fresh]
            self._queue_for_log("tx", raw, t, frames)
        self._setpoints.written()
        if any(n != 0.0 for n in self._setpoints.held.values()):
            self._zeroed = math.nan
        elif math.isnan(self._zeroed):
            self._zeroed = self._clock.now()

    @property
    def zeroed(self) -> float:
        """Run time [s] at which zero was first sent to every thruster of the port after the last other command.

        Thrusters that never had a command do not count. It is NaN if no set-point was sent yet, or if another command
        than zero has followed.
        """
        return self._zeroed

    def _send_final_zero(self) -> None:
        """Send zero to every thruster of the port three times, send the driver's last bytes, and close the port.

        Thrusters that never had a command are left out. If the port is not open, nothing is sent. An error of the port
        is suppressed, and ends the sending.
        """
        with contextlib.suppress(PortError):
            if self._setpoints is not None and self._open:
                for _ in range(3):
                    self._setpoints.zero(time.monotonic())
                    self._send_setpoints(self._setpoints.due(self._clock.now(), time.monotonic()))
            if self._driver is not None and self._open and (last := self._driver.shutdown_bytes(time.monotonic())):
                self._port.write(last)
                self._queue_for_log("tx", last, self._clock.now(), [])
        self._port.close()

    def latest(self) -> dict[Source, Latest]:
        """Return the newest sample of each kind and node of the device, by the key of `source_of`, as a new dict.

        Events and samples of transducers are not in it. Samples stay in it however old they are.
        """
        return dict(self._latest)

    def request(self, action: str, value: float) -> None:
        """Pass a request of the operator to the driver of the device, which sends it. Without a driver nothing happens.

        Parameters
        ----------
        action : str
            `arm`, `disarm`, `mode`, `mute` (send nothing while thrust is commanded) or `leave` (disarm at the end of
            the run, if this program has armed).
        value : float
            Number of the mode for `mode`, wall seconds for `mute`; unused otherwise.
        """
        if self._driver is not None:
            self._driver.request(action, value)
            self.wake()

    def is_stuck(self, now: float) -> bool:
        """Return whether the thread of the port hangs under thrust: its loop has not run for 0.25 s (STUCK_S, wall).

        `now` is a monotonic time [s]. Return False if the port is not open, drives no thruster, or has sent and
        repeated zero.
        """
        commanded = self._setpoints is not None and not self._setpoints.is_settled(now)
        return commanded and self._open and now - self._stepped > STUCK_S

    def link(self) -> LinkStatus | None:
        """Return the state of the autopilot at the port. Return None for a device that is not an autopilot.

        The state is also available if this program sends nothing to the autopilot.
        """
        return None if self._driver is None else self._driver.link_at(time.monotonic())

    @property
    def hint(self) -> str:
        """Advice to the user on the port or the link, such as on a slow adapter, in one line; empty without advice.

        The advice of the port takes precedence over that of the driver.
        """
        return self._port.hint or ("" if self._driver is None else self._driver.hint)

    def health(self) -> PortHealth:
        """Return the counters of the port since the start of the log, as they are written to the log every second.

        They are received bytes, frames, checksum errors, unparsed bytes, lost samples, reopenings, and bias and spread
        of the device clock (NaN without one).
        """
        decoder, port = self._decoder, self._port
        return PortHealth(
            port=self.device.port,
            bytes_in=port.bytes_in,
            frames=decoder.frames,
            checksum_errors=decoder.checksum_errors,
            unparsed_bytes=self._count_unparsed(),
            dropped=self._dropped,
            reconnects=max(self._opened - 1, 0),
            clock_bias=self._clock_map.bias if self._has_clock else NAN,
            clock_spread=self._clock_map.spread if self._has_clock else NAN,
        )

    def status(self, now: float) -> PortStatus:
        """Return the state of the port at run time `now` [s]: counters, rate and age of the samples, and its fault.

        The live table and the safety guard use it.
        """
        health = self.health()
        return PortStatus(
            name=self.device.name,
            protocol=self.device.protocol,
            port=health.port,
            expected=self.device.rate_hz,
            rate=self._rate.rate(now, self._rated),
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
            remark=self._decoder.remark,
            stuck=tuple(kind.__name__ for kind in self._sensor_health.stuck),
            open=self._open,
        )

    def _message(self) -> str:
        """Return the most severe present fault of the port or its device in one line.

        The order is: port that was lost or cannot be opened, fault that the driver reports, no valid frame in the last
        2000 bytes (MUTE_BYTES), implausible samples. Without a fault return the remark of the decoder on the received
        data, or an empty text.
        """
        if self._problem:
            return self._problem
        if self._driver is not None and (message := self._driver.message()):
            return message
        if self._mute_bytes >= MUTE_BYTES:
            return f"no valid frame in {MUTE_BYTES} bytes: check baud and protocol of this device in the rig"
        return self._sensor_health.message() or self._decoder.remark


class RateMeter:
    """Estimator of the rate of events from a counter that is read from time to time.

    Parameters
    ----------
    window : float
        Time [run s] over which the rate is averaged.
    """

    def __init__(self, window: float) -> None:
        """Prepare an estimator that has not read the counter yet.

        `window` is the time [run s] over which the rate is averaged.
        """
        self._window = window
        self._seen: list[tuple[float, int]] = []

    def rate(self, t: float, count: int) -> float:
        """Take a value of the counter, and return the mean rate of the events over the last window of time.

        Parameters
        ----------
        t : float
            Run time [s].
        count : int
            Value of the counter at that time.

        Returns
        -------
        float
            Rate [1/run s] since the oldest stored value, which is about a window old. It is NaN if the counter is zero,
            at the first value above zero, and while the counter has not grown since the oldest stored value and this
            value is less than a window old. After a window without events it is 0.
        """
        if count == 0:
            return math.nan
        self._seen.append((t, count))
        while len(self._seen) > 2 and self._seen[1][0] <= t - self._window:
            del self._seen[0]
        t_0, count_0 = self._seen[0]
        if count == count_0 and t - t_0 < self._window:
            return math.nan
        return (count - count_0) / (t - t_0) if t > t_0 else math.nan
