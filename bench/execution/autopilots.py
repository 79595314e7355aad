"""Autopilots between us and the thrusters: their parameters, their estimator, arming, and what they do by themselves.

Nothing of theirs is changed but what was asked for: with `arm` they are put into MANUAL and armed, and disarmed again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from seatrial.bench.execution.link_test import require_link_test
from seatrial.bench.execution.safety_guard import LINK_AGE_S, MANUAL, RIVAL
from seatrial.daq.acquisition import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.drivers import DISARMED, LinkStatus, check_parameters
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import read_note
from seatrial.daq.protocol import EKF_POSITION, EKF_STANDS, ROVER
from seatrial.daq.rig import Device, Rig

# Wall seconds.
AWAIT_S = 10.0  # for heartbeats, parameters and answers
ESTIMATOR_S = 60.0  # it needs 30 to 40 s after power-on
POLL_S = 0.05
LEAVE_S = 10.0  # for the disarming to be seen, where the link has to come back first
ASK_S = 1.0  # between two requests to disarm
RECEIVER_S = 3.0  # for RC_CHANNELS, which come once a second
REASONS_S = 1.0  # for the texts that come after a refusal
STATUS_AGE_S = 0.1  # of what the acquisition says of a link, at most
NEUTRAL_S = 0.3  # of neutral sticks before arming
# EKF_STATUS_REPORT: attitude, horizontal velocity, absolute horizontal position; and no constant-position mode.
EKF_WANTED, EKF_UNWANTED = 1 | 2 | EKF_POSITION, EKF_STANDS
MANUAL_NUMBER = 0.0  # of ArduPilot Rover's mode


class Autopilots:
    """The autopilots that the thrusters of a mission hang on; none where they hang on a CAN bus."""

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
        """`n_max`: the largest command of the mission; beyond `limits.link_test_n` it needs a link test."""
        self._n_max = n_max
        self._rig, self._acquisition, self._clock, self._wait, self._say = rig, acquisition, clock, wait, say
        names = dict.fromkeys(rig.thruster(name).device for name in thrusters)
        self._devices = [device for name in names if (device := rig.device(name)).mavlink is not None]
        self._armed: dict[str, float] = {}  # by us: when arming, then disarming, was asked for first (monotonic)
        self.changes: dict[str, int] = {}  # by device: parameter changes before its parameters were checked
        self.found_armed: list[str] = []  # autopilots that were armed before this run asked for it
        self.tested_s: dict[str, float] = {}  # by device: seconds to neutral after a lost link, by its link test

    @property
    def names(self) -> list[str]:
        """Of the autopilots."""
        return [device.name for device in self._devices]

    def begin_link_test(self) -> None:
        """What runs is the link test itself, which needs none before it, however little `limits.link_test_n` allows."""
        self._n_max = 0.0

    def await_ready(self) -> None:
        """Until every autopilot is fit to run the mission. Raises SeatrialError."""
        for device in self._devices:
            self._await_parameters(device)
            self._await_estimator(device)

    def prepare(self, arm: bool) -> None:
        """See that every autopilot is armed and passes the commands on; arms it only with `arm`. Raises
        SeatrialError."""
        for device in self._devices:
            if arm:
                self._arm(device)
            link = self._link(device)
            if link.mode != MANUAL:
                raise SeatrialError(
                    f"{device.name} is in {link.mode}: only MANUAL passes the commands on; set it, or give --arm"
                )
            if not link.armed:
                raise SeatrialError(f"{device.name} is disarmed; arm it from its transmitter, or give --arm")

    def _link(self, device: Device) -> LinkStatus:
        return self._acquisition.status().links.get(device.name, LinkStatus())

    def _await(self, device: Device, condition: Callable[[LinkStatus], bool], seconds: float) -> LinkStatus | None:
        deadline = time.monotonic() + seconds
        while not condition(link := self._link(device)):
            if time.monotonic() > deadline:
                return None
            self._wait(POLL_S)
        return link

    def _await_parameters(self, device: Device) -> None:
        link = self._await(device, lambda link: link.received and not link.parameters_pending, AWAIT_S)
        if link is None:
            port = self._acquisition.status().ports.get(device.name)
            why = f" ({port.message})" if port is not None and port.message else ""
            raise SeatrialError(f"{device.name} ({device.port}): no heartbeat or no parameters in {AWAIT_S:g} s{why}")
        assert device.mavlink is not None
        if link.vehicle != ROVER:
            raise SeatrialError(f"{device.name} is {link.vehicle or 'of an unknown kind'}: only {ROVER} is driven")
        if link.rivals:
            raise SeatrialError(f"{device.name}: {RIVAL}; end it, or give it another own_system_id")
        self.changes[device.name] = len(link.changed)
        here = [thruster for thruster in self._rig.thrusters if thruster.device == device.name]
        found = check_parameters(link.parameters, here, device.mavlink.own_system_id)
        for finding in found:
            self._acquisition.mark("parameter", f"{device.name}: {finding}")
            if not finding.fatal:
                self._say(f"{device.name}: {finding}")
        for line in link.refused:
            self._say(f"{device.name} refuses {line}")
        if link.armed:
            self.found_armed.append(device.name)
            self._say(f"{device.name} IS ARMED ALREADY: this run did not arm it and will not disarm it")
        fatal = [str(finding) for finding in found if finding.fatal]
        if fatal:
            forbid = "parameter forbids" if len(fatal) == 1 else "parameters forbid"
            raise SeatrialError(f"{device.name}: {len(fatal)} {forbid} to drive, yours to set: {'; '.join(fatal)}")
        if self._n_max > self._rig.limits.link_test_n:
            seconds = require_link_test(self._rig, device.name, self._await_receiver(device), self._n_max)
            self.tested_s[device.name] = seconds
            self._acquisition.mark("parameter", f"{device.name}: a lost link was tested, neutral after {seconds:.2f} s")

    def await_receivers(self) -> dict[str, LinkStatus]:
        """What each autopilot says of itself, once it has said whether it hears a receiver, or had its time to."""
        return {device.name: self._await_receiver(device) for device in self._devices}

    def _await_receiver(self, device: Device) -> LinkStatus:
        self._await(device, lambda link: link.receiver is not None, RECEIVER_S)
        return self._link(device)

    def _await_estimator(self, device: Device) -> None:
        def ready(link: LinkStatus) -> bool:
            return link.ekf >= 0 and link.ekf & EKF_WANTED == EKF_WANTED and not link.ekf & EKF_UNWANTED

        if not ready(self._link(device)):
            self._say(f"{device.name}: waiting for its estimator, up to {ESTIMATOR_S:g} s")
        if self._await(device, ready, ESTIMATOR_S) is None:
            flags = self._link(device).ekf
            raise SeatrialError(
                f"{device.name}: its estimator is not ready (EKF flags {flags}); without a position fix yaw will jump"
            )

    def _arm(self, device: Device) -> None:
        link = self._link(device)
        if link.mode != MANUAL:
            self._ask(device, "mode", MANUAL_NUMBER, lambda link: link.mode == MANUAL)
        if self._link(device).armed:
            return
        # It arms only with sticks at neutral, and without a transmitter ours are the only ones.
        nodes = {thruster.name: 0.0 for thruster in self._rig.thrusters if thruster.device == device.name}
        self._acquisition.schedule([(self._clock.now(), nodes)])
        self._wait(NEUTRAL_S)
        self._armed[device.name] = time.monotonic()
        self._ask(device, "arm", 0.0, lambda link: link.armed)
        self._say(f"{device.name}: armed")

    def _ask(self, device: Device, action: str, value: float, done: Callable[[LinkStatus], bool]) -> None:
        """Ask, and wait for the answer and for its effect; raises SeatrialError with the autopilot's reason."""
        self._acquisition.request(device.name, action, value)
        link = self._await(device, lambda link: link.answer.startswith(f"{action}:"), AWAIT_S)
        if link is not None and link.answer != f"{action}: accepted":
            self._wait(REASONS_S)
            link = self._link(device)
        if link is None or link.answer != f"{action}: accepted":
            raise SeatrialError(f"{device.name}: {link.answer if link else f'{action}: no answer'}")
        if self._await(device, done, AWAIT_S) is None:
            raise SeatrialError(f"{device.name}: {action} was accepted and has not come about in {AWAIT_S:g} s")

    def still_armed(self) -> list[str]:
        """Return the autopilots that this run has not disarmed and that report to be armed."""
        try:
            links = {name: self._link(self._rig.device(name)) for name in self.names}
        except SeatrialError:
            return self.found_armed  # as they were found: nothing newer is known
        return [name for name, link in links.items() if link.armed]

    def release(self) -> None:
        """Disarm what was armed here; thrust has to be zero before. Raises SeatrialError where it is not confirmed: a
        run that leaves a vehicle armed has not ended well."""
        self.disarm()
        if armed := self.maybe_armed():
            raise SeatrialError(f"{', '.join(armed)}: disarming was not confirmed in {LEAVE_S:g} s")

    def maybe_armed(self) -> list[str]:
        """Those that were armed here and have not said since, in a heartbeat of now, that they are disarmed."""
        try:
            links = [self._link(self._rig.device(name)) for name in self._armed]
        except SeatrialError:  # the acquisition is gone, and the watchdog has sent the zero
            note = read_note(self._acquisition.path)
            return [name for name in self._armed if f"{name}: zero was sent{DISARMED}" not in note]
        now, found = time.monotonic(), zip(self._armed.items(), links, strict=True)
        return [
            name
            for (name, asked), link in found
            # a heartbeat of before the request says nothing of what came of it
            if link.armed or not link.age <= min(LINK_AGE_S, now - asked - STATUS_AGE_S)
        ]

    def disarm(self) -> None:
        """Ask to disarm what was armed here until it is, and for a while where the link has to come back first;
        whatever signals come."""
        begun, asked = time.monotonic(), -math.inf
        self._armed = dict.fromkeys(self._armed, begun)
        names = list(self._armed)  # all of them at first: an arming may be newer than the last heartbeat
        while names and (now := time.monotonic()) - begun < LEAVE_S:
            if now - asked >= ASK_S:
                asked = now
                for name in names:
                    self._acquisition.request(name, "disarm")
            time.sleep(POLL_S)
            names = self.maybe_armed()
        if self._armed:
            time.sleep(POLL_S)  # its own texts about it are in the log then
