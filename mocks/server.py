"""Server of the simulated devices: one loop in one thread that exchanges bytes between a world and its ports."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import select
import time
from collections.abc import Mapping
from typing import IO

from seatrial.mocks.devices import DeviceEmulator, Faults
from seatrial.mocks.ports import NetPort, PtyPort
from seatrial.mocks.world import World

BELL = b"\a"  # answer of a CAN adapter that refuses a frame
NICENESS, REAL_TIME_PRIORITY = -10, 2  # requested from the system; the real-time priorities end at 99
WAIT_MAX_S = 0.05  # wall s, longest wait: the loop notices signals and returned ports within this time
PAUSE_MIN_S = 0.005  # wall s; a longer gap in the loop is a pause of this process, not a silence of the host
STEPS_MAX = 400  # steps of the plant between two looks at the ports if the simulation is late


class Server:
    """Server of a simulated boat or bench: a loop that simulates it in real time and exchanges bytes at its ports.

    Run time is the wall time since the call of `run`, times ``speed``.

    Attributes
    ----------
    stopping : bool
        Set it to True to end `run`.
    triggered : bool
        Set it to True to start the faults whose start on the command line is `usr1` (the signal SIGUSR1).
    max_lag : float
        Largest delay of a sample so far [wall s].
    """

    def __init__(
        self,
        world: World,
        emulators: Mapping[str, DeviceEmulator],
        ports: Mapping[str, PtyPort | NetPort],
        speed: float,
        faults: Faults,
        trace: IO[str] | None = None,
    ) -> None:
        """Set up a server of simulated devices. It sets the hook `on_change` of all speed controllers, for the trace.

        Parameters
        ----------
        world : World
            The simulated boat or bench with its devices.
        emulators : mapping of str to DeviceEmulator
            Emulator of each device, by its name.
        ports : mapping of str to port
            Port of each device, by its name.
        speed : float
            Run seconds per wall second.
        faults : Faults
            Schedule of the faults.
        trace : text file, optional
            File that gets one line of JSON for each change of a thruster's effective command.
        """
        self.stopping = False
        self.triggered = False
        self.max_lag = 0.0
        self._extension_s = 0.0  # wall s by which time-outs were extended because of pauses of this process
        self._world = world
        self._emulators = emulators
        self._ports = ports
        self._speed = speed
        self._faults = faults
        self._trace = trace
        self._start = time.monotonic()
        self._last_round = self._start
        self._wait_s = 0.0
        for controller in world.controllers:
            controller.on_change = self._write_trace

    def run(self) -> None:
        """Simulate the boat or bench and serve the ports of its devices in real time, until `stopping` is set.

        The priority of this process is raised first, as far as the system allows. Run time 0 is the time of this call.
        The ports are not closed at the end.
        """
        # A real device keeps its time on a busy machine too. A system that denies the priority raises OSError.
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
            if hasattr(os, "sched_setscheduler"):
                os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME_PRIORITY))
        gc.freeze()  # shortens the pauses of the garbage collector
        self._start = self._last_round = time.monotonic()
        while not self.stopping:
            wall = time.monotonic()
            t = (wall - self._start) * self._speed
            self._extend_deadlines(wall)
            self._apply_faults(t)
            self._answer_hosts(t)
            self._advance_world(t)
            self._wait_for_next_sample()

    @property
    def t(self) -> float:
        """Simulated time of the boat or bench since the start of the run [s]."""
        return self._world.t

    def _extend_deadlines(self, wall: float) -> None:
        """Extend the time-outs of the speed controllers if this process was paused, so that it received no command.

        ``wall`` is the present monotonic time [s]. A pause is a time of more than 5 ms (wall) since the last round of
        the loop, beyond the intended wait.
        """
        gap = wall - self._last_round - self._wait_s
        self._last_round = wall
        if gap > PAUSE_MIN_S:
            self._extension_s += gap
            for controller in self._world.controllers:
                controller.deadline += gap * self._speed

    def _apply_faults(self, t: float) -> None:
        """Start and end the faults of ports and speed controllers that are due at run time ``t`` [s].

        They are "pull" (the port is closed), "esc-dead" and "esc-stuck". A controller obeys commands again when its
        fault ends. If `triggered` is set, all faults whose start on the command line is `usr1` start.
        """
        if self.triggered:
            self.triggered = False
            self._faults.trigger(t)
        for name, port in self._ports.items():
            pulled = self._faults.active("pull", name, t)
            if pulled and port.plugged:
                port.unplug()
            elif not pulled and not port.plugged:
                port.plug()
        for controller in self._world.controllers:
            dead = self._faults.active("esc-dead", controller.spec.name, t)
            if dead and not controller.dead:
                controller.die(t)
            elif not dead:
                controller.dead = False
            controller.stuck = self._faults.active("esc-stuck", controller.spec.name, t)

    def _answer_hosts(self, t: float) -> None:
        """Pass the bytes that hosts have sent to the emulated devices, and send their answers, at run time ``t`` [s].

        During a fault "refuse" the device gets no bytes, and each line of the host is answered with the character BELL.
        Ports that are not plugged are left out.
        """
        for name, port in self._ports.items():
            if not port.plugged or not (data := port.read()):
                continue
            if self._faults.active("refuse", name, t):
                port.write(BELL * data.count(b"\r"), time.monotonic())
            else:
                port.write(self._emulators[name].receive(data, t), time.monotonic())

    def _advance_world(self, t: float) -> None:
        """Advance the simulated boat or bench to run time ``t`` [s], and send the samples that become due.

        The last step ends just after ``t``. At most 400 steps (STEPS_MAX) are made, so that the ports are served even
        if the simulation is late; later calls make up for the rest. Then the bytes that wait at the ports are sent.
        """
        world = self._world
        for _ in range(STEPS_MAX):
            if world.t > t:
                break
            if world.plant.steps >= world.next_due:
                self._send_due_samples()
            world.advance()
        wall = time.monotonic()
        for port in self._ports.values():
            port.flush(wall)

    def _send_due_samples(self) -> None:
        """Send the samples of the devices that are due, as active faults change them, and update `max_lag`."""
        t = self._world.t
        for device, true_sample, _ in self._world.readings():
            sample = self._faults.reading(device, true_sample, t)
            if sample is not None:
                emulator = self._emulators[device]
                emulator.clock_error = self._faults.clock_error(device, t)
                data = self._faults.bytes(device, emulator.encode(sample, t), t)
                wall = time.monotonic()
                self.max_lag = max(self.max_lag, wall - self._start - t / self._speed)
                self._ports[device].write(data, wall)

    def _wait_for_next_sample(self) -> None:
        """Wait until the next sample is due or a host writes, for at most WAIT_MAX_S (0.05 s wall)."""
        due = self._start + self._world.next_due * self._world.plant.step_s / self._speed
        self._wait_s = min(max(due - time.monotonic(), 0.0), WAIT_MAX_S)
        select.select([port for port in self._ports.values() if port.plugged], [], [], self._wait_s)

    def _write_trace(self, t: float, node: int, n: float, why: str) -> None:
        """Write a changed effective command to the trace file as one line of JSON, if there is a trace file.

        The line also has the monotonic time ``wall`` [s], and ``forgiven``: the wall time [s] by which time-outs have
        been extended so far because of pauses of this process.

        Parameters
        ----------
        t : float
            Run time of the change [s].
        node : int
            Node of the speed controller.
        n : float
            New effective command, -1 to 1, positive forward.
        why : str
            Reason: "command", "timeout" or "dead".
        """
        if self._trace is not None:
            line = {"t": round(t, 6), "wall": time.monotonic(), "node": node, "n": round(n, 6), "why": why}
            line["forgiven"] = round(self._extension_s, 6)
            print(json.dumps(line), file=self._trace, flush=True)
