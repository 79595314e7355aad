"""Autopilots that pass commands on to thrusters: checks of their parameters and estimator, arming and disarming.

An autopilot is changed only on request: with `arm` it is put into MANUAL, armed, and disarmed at the end of the run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from seatrial.bench.execution.link_test import require_link_test
from seatrial.bench.execution.safety_guard import LINK_AGE_S, MANUAL, OPEN_SKY, RIVAL
from seatrial.daq.acquisition import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.drivers import DISARMED, LinkStatus, check_parameters, parameter_lines
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import read_note
from seatrial.daq.protocol import EKF_POSITION, EKF_STANDS, ROVER
from seatrial.daq.rig import Device, Rig

# Wall seconds.
AWAIT_S = 10.0  # longest wait for heartbeats, parameters and answers
ESTIMATOR_S = 60.0  # longest wait for the estimator, which needs 30 to 40 s after power-on
POLL_S = 0.05
LEAVE_S = 10.0  # longest wait for a confirmed disarming; a lost link may have to come back first
ASK_S = 1.0  # between two requests to disarm
RECEIVER_S = 3.0  # longest wait for RC_CHANNELS, which arrive once a second
REASONS_S = 1.0  # wait for the texts that follow a refusal
STATUS_AGE_S = 0.1  # largest age of a link's state in the status of the acquisition
NEUTRAL_S = 0.3  # duration of neutral sticks before arming
# Flags of EKF_STATUS_REPORT. Wanted: attitude, horizontal velocity, absolute horizontal position. Unwanted:
# constant-position mode.
EKF_WANTED, EKF_UNWANTED = 1 | 2 | EKF_POSITION, EKF_STANDS
MANUAL_NUMBER = 0.0  # number of the mode MANUAL of ArduPilot Rover


class Autopilots:
    """Autopilots that pass the commands of a mission on to thrusters: checked before a run, armed and disarmed.

    Thrusters on a CAN bus have no autopilot. A mission with only such thrusters has no autopilots, and the methods then
    do nothing. A link test is an earlier measurement of the time in which an autopilot ends thrust after our frames
    stop; its result is stored beside the rig file.

    Attributes
    ----------
    changes : dict of str to int
        By name of an autopilot: number of changes of its parameters that were known when they were checked. More
        changes during the run end it.
    found_armed : list of str
        Names of autopilots that were armed already before this run.
    tested_s : dict of str to float
        By name of an autopilot: time [wall s] from the last frame to neutral outputs in its stored link test. It is
        empty if the mission needs no link test.
    """

    def __init__(
        self,
        rig: Rig,
        thrusters: tuple[str, ...],
        acquisition: Acquisition,
        clock: RunClock,
        wait: Callable[[float], None],
        say: Callable[[str], None],
        n_max: float = 0.0,
    ) -> None:
        """Find the autopilots to which the thrusters of a mission are connected. Nothing is sent to them yet.

        Parameters
        ----------
        rig : Rig
            The rig with its devices and limits.
        thrusters : tuple of str
            Names of the thrusters of the mission.
        acquisition : Acquisition
            The running acquisition.
        clock : RunClock
            The run clock.
        wait : Callable
            Function that waits for the given wall seconds. It may raise an error that ends the run.
        say : Callable
            Function that prints a line for the operator.
        n_max : float
            Largest command of the mission, as a fraction of full command. If it is beyond `limits.link_test_n` of the
            rig, every autopilot needs a valid stored link test.
        """
        self._n_max = n_max
        self._rig, self._acquisition, self._clock, self._wait, self._say = rig, acquisition, clock, wait, say
        names = dict.fromkeys(rig.thruster(name).device for name in thrusters)
        self._devices = [device for name in names if (device := rig.device(name)).mavlink is not None]
        # Autopilots that this run has armed: monotonic time of the request to arm, later of the first one to disarm.
        self._armed: dict[str, float] = {}
        self.changes: dict[str, int] = {}
        self.found_armed: list[str] = []
        self.tested_s: dict[str, float] = {}

    @property
    def names(self) -> list[str]:
        """Names of the autopilots to which thrusters of the mission are connected; empty without one."""
        return [device.name for device in self._devices]

    def begin_link_test(self) -> None:
        """Let `await_ready` accept autopilots without a stored link test, because a link test itself is run.

        This method must be called before `await_ready`. The largest command then counts as 0. Nothing is sent.
        """
        self._n_max = 0.0

    def await_ready(self) -> None:
        """Wait until every autopilot has sent its parameters and has a position estimate, and check its parameters.

        Findings on parameters are written to the log. Those that allow driving are printed; those that forbid it are in
        the message of the error. `changes`, `found_armed` and `tested_s` are filled.

        Raises
        ------
        SeatrialError
            If an autopilot sends no heartbeat or parameters within 10 s (wall), does not run ArduPilot Rover, receives
            another ground station with our system id, has a parameter with which it must not be driven, or lacks a
            stored link test that the mission needs. Also if its estimator has no position after 60 s (wall).
        """
        for device in self._devices:
            self._await_parameters(device)
            self._await_estimator(device)

    def prepare(self, arm: bool) -> None:
        """Check that every autopilot is armed and in the mode MANUAL, in which it passes commands on.

        Parameters
        ----------
        arm : bool
            Whether to put each autopilot into MANUAL and arm it before the check.

        Raises
        ------
        SeatrialError
            If an autopilot refuses a request or does not answer it, or is in another mode or disarmed after all.
        """
        for device in self._devices:
            if arm:
                self._set_manual_and_arm(device)
            link = self._link_status(device)
            if link.mode != MANUAL:
                raise SeatrialError(
                    f"{device.name} is in mode {link.mode}: only MANUAL passes the commands on; set MANUAL, or give "
                    "--arm"
                )
            if not link.armed:
                raise SeatrialError(f"{device.name} is disarmed; arm it from its transmitter, or give --arm")

    def _link_status(self, device: Device) -> LinkStatus:
        """Return the newest state of an autopilot; if none was received yet, the default state without a heartbeat.

        Raises SeatrialError if the acquisition process has failed, or has ended by itself.
        """
        return self._acquisition.status().links.get(device.name, LinkStatus())

    def _await_link(self, device: Device, condition: Callable[[LinkStatus], bool], seconds: float) -> LinkStatus | None:
        """Wait up to ``seconds`` (wall) until the state of an autopilot fulfils ``condition``.

        ``condition`` is a function of the state that returns a bool. Return the first state that fulfils it, at once if
        the present one does, or None if no state did in that time. Errors of the wait, as after a signal, are passed
        on.
        """
        deadline = time.monotonic() + seconds
        while not condition(link := self._link_status(device)):
            if time.monotonic() > deadline:
                return None
            self._wait(POLL_S)
        return link

    def _await_parameters(self, device: Device) -> None:
        """Wait up to 10 s (wall) for heartbeat and parameters of an autopilot, and check whether it may be driven.

        Findings on parameters are written to the log, and those that allow driving are printed. The number of parameter
        changes, whether it is armed already, and the stored link test (if the mission needs it) are stored in
        `changes`, `found_armed` and `tested_s`. Raises SeatrialError if nothing arrives, or if the autopilot must not
        be driven: wrong vehicle, another ground station with our id, a parameter that forbids it, no valid link test.
        """
        link = self._await_link(device, lambda link: link.received and not link.parameters_pending, AWAIT_S)
        if link is None:
            port = self._acquisition.status().ports.get(device.name)
            why = f" ({port.message})" if port is not None and port.message else ""
            raise SeatrialError(
                f"{device.name} ({device.port}): no heartbeat or no parameters in {AWAIT_S:g} s{why}; check its power "
                "and link, system_id in the rig, and whether another program uses the port"
            )
        assert device.mavlink is not None
        if link.vehicle != ROVER:
            raise SeatrialError(
                f"{device.name} is {link.vehicle or 'of an unknown kind'}: only {ROVER} is driven; record it with "
                "`seatrial log`, and drive it with its own tools"
            )
        if link.other_station_frames:
            raise SeatrialError(f"{device.name}: {RIVAL}")
        self.changes[device.name] = len(link.changed)
        here = [thruster for thruster in self._rig.thrusters if thruster.device == device.name]
        found = check_parameters(link.parameters, here, device.mavlink.own_system_id)
        lines = parameter_lines(found)
        for told in lines:
            self._acquisition.mark("parameter", f"{device.name}: {told.text}")
            if not told.fatal:
                advice = "; set it with a ground station, if this matters" if told.is_answered else ""
                self._say(f"{device.name}: {told.text}{advice}")
        for line in link.refused:
            self._say(f"{device.name} refuses {line}; raise SCHED_LOOP_RATE, or lower the rate in the rig")
        if link.armed:
            self.found_armed.append(device.name)
            self._say(f"{device.name} IS ARMED ALREADY: this run will not disarm it; disarm it yourself after the run")
        fatal = [told.text for told in lines if told.fatal]
        if fatal and all(finding.value is None for finding in found if finding.fatal):
            raise SeatrialError(f"{device.name}: not driven, because {fatal[0]}")
        if fatal:
            forbid = "parameter forbids" if len(fatal) == 1 else "parameters forbid"
            # The recorded trials (docs/data/autopilot-faults.jsonl) are classified by these words.
            raise SeatrialError(
                f"{device.name}: {len(fatal)} {forbid} to drive, yours to set: {'; '.join(fatal)}; set them with a "
                "ground station, as seatrial changes no parameter"
            )
        if self._n_max > self._rig.limits.link_test_n:
            seconds = require_link_test(self._rig, device.name, self._await_receiver(device), self._n_max)
            self.tested_s[device.name] = seconds
            self._acquisition.mark("parameter", f"{device.name}: a lost link was tested, neutral after {seconds:.2f} s")

    def await_receivers(self) -> dict[str, LinkStatus]:
        """Wait until each autopilot has reported whether it receives a radio-control transmitter; return their states.

        The states are returned by name of the autopilot. The wait is at most 3 s (wall) for each. In the state of an
        autopilot without a report, `receiver` is None.
        """
        return {device.name: self._await_receiver(device) for device in self._devices}

    def _await_receiver(self, device: Device) -> LinkStatus:
        """Wait up to 3 s (wall) for the report whether an autopilot receives a radio-control transmitter.

        Return the newest state of the autopilot. Its `receiver` is None if no report has arrived.
        """
        self._await_link(device, lambda link: link.receiver is not None, RECEIVER_S)
        return self._link_status(device)

    def _await_estimator(self, device: Device) -> None:
        """Wait until the state estimator (EKF) of an autopilot has a position, and print that it is awaited.

        Nothing is printed if it has a position already. Raises SeatrialError after 60 s (wall) without a position.
        """

        def ready(link: LinkStatus) -> bool:
            """Return whether the EKF flags in an autopilot's state report attitude, velocity and absolute position.

            The flag of the constant-position mode must not be set. Without reported flags return False.
            """
            return link.ekf >= 0 and link.ekf & EKF_WANTED == EKF_WANTED and not link.ekf & EKF_UNWANTED

        if not ready(self._link_status(device)):
            self._say(f"{device.name}: waiting until its position estimator (EKF) is ready, up to {ESTIMATOR_S:g} s")
        if self._await_link(device, ready, ESTIMATOR_S) is None:
            flags = self._link_status(device).ekf
            raise SeatrialError(
                f"{device.name}: its position estimator has no position after {ESTIMATOR_S:g} s (EKF flags {flags}), "
                f"so that its heading may jump; {OPEN_SKY}, and run again"
            )

    def _set_manual_and_arm(self, device: Device) -> None:
        """Put an autopilot into the mode MANUAL and arm it, with zero commands on its thrusters.

        A request is left out if the autopilot is in MANUAL or armed already. Before the request to arm, the autopilot
        is stored as armed by this run, so that `disarm` disarms it, even if the request fails. Raises SeatrialError if
        the autopilot refuses a request, or if the request has no answer or no effect in 10 s (wall).
        """
        link = self._link_status(device)
        if link.mode != MANUAL:
            self._request_and_await(device, "mode", MANUAL_NUMBER, lambda link: link.mode == MANUAL)
        if self._link_status(device).armed:
            return
        # An autopilot arms only with neutral sticks. Without a transmitter our commands are the only sticks.
        nodes = {thruster.name: 0.0 for thruster in self._rig.thrusters if thruster.device == device.name}
        self._acquisition.schedule([(self._clock.now(), nodes)])
        self._wait(NEUTRAL_S)
        self._armed[device.name] = time.monotonic()
        self._request_and_await(device, "arm", 0.0, lambda link: link.armed)
        self._say(f"{device.name}: armed")

    def _request_and_await(self, device: Device, action: str, value: float, done: Callable[[LinkStatus], bool]) -> None:
        """Send a request to an autopilot, wait for its answer, and then until its state shows the effect.

        Parameters
        ----------
        device : Device
            The autopilot.
        action : str
            Request: "mode" or "arm".
        value : float
            Number of the mode; 0 for "arm".
        done : Callable
            Function that returns whether a state of the autopilot shows the effect.

        Raises
        ------
        SeatrialError
            If the autopilot refuses; the message contains its answer. Also if the answer is missing 10 s (wall) after
            the request, or the effect 10 s after the answer.
        """
        self._acquisition.request(device.name, action, value)
        link = self._await_link(device, lambda link: link.answer.startswith(f"{action}:"), AWAIT_S)
        if link is not None and link.answer != f"{action}: accepted":
            self._wait(REASONS_S)
            link = self._link_status(device)
        if link is None or link.answer != f"{action}: accepted":
            answer = link.answer if link else f"{action}: no answer"
            raise SeatrialError(f"{device.name}: request {answer}; remove the cause or check the link, and run again")
        if self._await_link(device, done, AWAIT_S) is None:
            raise SeatrialError(
                f"{device.name}: request {action} was accepted but took no effect in {AWAIT_S:g} s; check the switches "
                "of its transmitter, and run again"
            )

    def still_armed(self) -> list[str]:
        """Return the names of the mission's autopilots that report to be armed at present.

        If the acquisition has failed, so that there is no present report, return those that were armed before this run.
        """
        try:
            links = {name: self._link_status(self._rig.device(name)) for name in self.names}
        except SeatrialError:
            return self.found_armed  # the acquisition has failed: their state before the run is the newest one
        return [name for name, link in links.items() if link.armed]

    def release(self) -> None:
        """Disarm the autopilots that this run has armed, and require their confirmation. Thrust must be zero before.

        Autopilots that were armed before this run stay armed.

        Raises
        ------
        SeatrialError
            If an autopilot does not confirm within 10 s (wall). A run that leaves a vehicle armed counts as failed.
            Also if this run has armed one, and the acquisition process has failed or ended.
        """
        self.disarm()
        if armed := self.maybe_armed():
            raise SeatrialError(
                f"{', '.join(armed)}: disarming was not confirmed in {LEAVE_S:g} s: it may still be armed; keep clear "
                "of the propellers, and disarm it yourself or switch it off"
            )

    def maybe_armed(self) -> list[str]:
        """Return the names of autopilots that this run has armed and whose disarming is not confirmed.

        The confirmation is a heartbeat with the state "disarmed" that was received at least 0.1 s after the first
        request to disarm (before such a request: after that to arm) and is at most 3 s (wall) old. If the acquisition
        has failed, its watchdog process has tried to disarm them. Then an autopilot counts as disarmed only if the note
        that the watchdog has written beside the log reports this.
        """
        try:
            links = [self._link_status(self._rig.device(name)) for name in self._armed]
        except SeatrialError:  # the acquisition is gone, and the watchdog has sent the zero
            note = read_note(self._acquisition.path)
            return [name for name in self._armed if f"{name}: zero thrust was sent{DISARMED}" not in note]
        now, found = time.monotonic(), zip(self._armed.items(), links, strict=True)
        return [
            name
            for (name, requested_at), link in found
            # a heartbeat from before the request does not confirm it
            if link.armed or not link.age <= min(LINK_AGE_S, now - requested_at - STATUS_AGE_S)
        ]

    def disarmed(self) -> list[str]:
        """Return the names of autopilots that this run has armed, or tried to arm, and whose disarming is confirmed."""
        armed = self.maybe_armed()
        return [name for name in self._armed if name not in armed]

    def disarm(self) -> None:
        """Request the autopilots that this run has armed to disarm; no error is raised if they do not confirm it.

        The request is repeated every second to those that have not confirmed, for at most 10 s (wall). Signals do not
        interrupt it. Nothing is sent if this run has armed no autopilot. Otherwise SeatrialError is raised if the
        acquisition process has failed or ended.
        """
        begun, requested_at = time.monotonic(), -math.inf
        self._armed = dict.fromkeys(self._armed, begun)
        names = list(self._armed)  # all of them, because an arming may be newer than the last heartbeat
        while names and (now := time.monotonic()) - begun < LEAVE_S:
            if now - requested_at >= ASK_S:
                requested_at = now
                for name in names:
                    self._acquisition.request(name, "disarm")
            time.sleep(POLL_S)
            names = self.maybe_armed()
        if self._armed:
            time.sleep(POLL_S)  # so that the autopilot's texts about the disarming are in the log
