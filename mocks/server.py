"""The loop that serves a world on its ports: one process, one thread, on run time."""

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

BELL = b"\a"  # of a CAN adapter that refuses a frame
PRIORITY, REAL_TIME = -10, 2  # niceness, and of 99: where the system lets us
NAP = 0.05  # wall s, the longest sleep: signals and ports that return are noticed within it
STALL = 0.005  # wall s; a longer gap in the loop is our own pause and no silence of the host
BURST = 400  # steps before the ports are looked at again when we are behind


class Server:
    """Owns the ports and keeps the world on time: run time is wall time since the start, times ``speed``."""

    def __init__(
        self,
        world: World,
        speakers: Mapping[str, DeviceEmulator],
        ports: Mapping[str, PtyPort | NetPort],
        speed: float,
        faults: Faults,
        trace: IO[str] | None = None,
    ) -> None:
        """``speakers`` and ``ports`` by device name; ``trace`` gets a JSON line per change of a command."""
        self.stopping = False
        self.triggered = False  # a signal asks for the faults that wait for it
        self.max_lag = 0.0  # wall s by which a sample left late
        self._forgiven = 0.0  # wall s by which time-outs were put off for pauses of our own
        self._world = world
        self._speakers = speakers
        self._ports = ports
        self._speed = speed
        self._faults = faults
        self._trace = trace
        self._start = time.monotonic()
        self._listened = self._start
        self._nap = 0.0
        for controller in world.controllers:
            controller.on_change = self._changed

    def run(self) -> None:
        """Serve until ``stopping``."""
        with contextlib.suppress(OSError):  # where we may: devices do not wait for a busy machine
            os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
            if hasattr(os, "sched_setscheduler"):
                os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME))
        gc.freeze()
        self._start = self._listened = time.monotonic()
        while not self.stopping:
            wall = time.monotonic()
            t = (wall - self._start) * self._speed
            self._forgive(wall)
            self._break(t)
            self._listen(t)
            self._talk(t)
            self._sleep()

    @property
    def t(self) -> float:
        """Run time of the world (s since the start)."""
        return self._world.t

    def _forgive(self, wall: float) -> None:
        """While this process was not run, it could not hear commands: no reason for a time-out."""
        gap = wall - self._listened - self._nap
        self._listened = wall
        if gap > STALL:
            self._forgiven += gap
            for controller in self._world.controllers:
                controller.deadline += gap * self._speed

    def _break(self, t: float) -> None:
        """Faults that begin and end."""
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

    def _listen(self, t: float) -> None:
        """Hand what the host wrote to the devices."""
        for name, port in self._ports.items():
            if not port.plugged or not (data := port.read()):
                continue
            if self._faults.active("refuse", name, t):
                port.write(BELL * data.count(b"\r"), time.monotonic())
            else:
                port.write(self._speakers[name].receive(data, t), time.monotonic())

    def _talk(self, t: float) -> None:
        """Bring the world to the present and send what has fallen due."""
        world = self._world
        for _ in range(BURST):
            if world.t > t:
                break
            if world.plant.steps >= world.next_due:
                self._send()
            world.advance()
        wall = time.monotonic()
        for port in self._ports.values():
            port.flush(wall)

    def _send(self) -> None:
        t = self._world.t
        for device, whole, _ in self._world.readings():
            sample = self._faults.reading(device, whole, t)
            if sample is not None:
                speaker = self._speakers[device]
                speaker.clock_error = self._faults.clock_error(device, t)
                data = self._faults.bytes(device, speaker.encode(sample, t), t)
                wall = time.monotonic()
                self.max_lag = max(self.max_lag, wall - self._start - t / self._speed)
                self._ports[device].write(data, wall)

    def _sleep(self) -> None:
        """Until something is due, or the host writes."""
        due = self._start + self._world.next_due * self._world.plant.step_s / self._speed
        self._nap = min(max(due - time.monotonic(), 0.0), NAP)
        select.select([port for port in self._ports.values() if port.plugged], [], [], self._nap)

    def _changed(self, t: float, node: int, n: float, why: str) -> None:
        if self._trace is not None:
            line = {"t": round(t, 6), "wall": time.monotonic(), "node": node, "n": round(n, 6), "why": why}
            line["forgiven"] = round(self._forgiven, 6)
            print(json.dumps(line), file=self._trace, flush=True)
