"""Ground station and mock autopilot joined without a port: each receives the messages of the other at once."""

from __future__ import annotations

from pathlib import Path

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.drivers.base import LinkRole
from seatrial.daq.drivers.mavlink import MavlinkDriver
from seatrial.daq.protocol.mavlink import MavlinkDecoder, make_decoder
from seatrial.daq.protocol.mavlink_wire import Codec, read_key
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Ahrs, Esc, Frame, Gnss
from seatrial.mocks.devices.autopilot import AutopilotEmulator
from seatrial.mocks.devices.autopilot_messages import LOOP_HZ
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.world import DeviceSpecs, EscController, EscSpec, bench_world

RIG = """
format = "seatrial-rig 1"
name = "mav"
[[device]]
name = "autopilot"
protocol = "mavlink"
port = "{port}"
rate_hz = {rate}
{more}
[[thruster]]
name = "left"
device = "autopilot"
node = 1
rc_channel = 1
position_m = [0.0, -0.15, 0.0]
rpm_max = 4500.0
[[thruster]]
name = "right"
device = "autopilot"
node = 3
rc_channel = 3
position_m = [0.0, 0.15, 0.0]
reversed = true
"""
LEVEL = Ahrs(0.3, 0.01, -0.02, 0.1, 0.2, 0.3, 0.4, 0.5, -9.8)


def rig_text(port: str = "udp:127.0.0.1:14550", rate: float = 25.0, more: str = "") -> str:
    return RIG.format(port=port, rate=rate, more=more)


def mav_rig(folder: Path | None = None, **how: object) -> Rig:
    return parse_rig(rig_text(**how), (folder or Path()) / "rig.toml")  # type: ignore[arg-type]


class Ends:
    """Ground station and autopilot with one clock, which `run` advances."""

    def __init__(self, rig: Rig, key: Path | None = None, role: LinkRole = LinkRole.DRIVE) -> None:
        device = rig.device("autopilot")
        assert device.mavlink is not None
        codec = Codec(device.mavlink.own_system_id, 190, None if key is None else read_key(key), 1_800_000_000.0)
        self.decoder: MavlinkDecoder = make_decoder(device, rig)
        self.driver = MavlinkDriver(device, rig.thrusters, codec, role, self.decoder)
        plant = bench_world(draw_bench(1), 0, DeviceSpecs({}, {}, [], []))
        self.controllers = {
            t.node: EscController(EscSpec("autopilot", t.node, 10.0, timeout_s=1.0), plant.plant, 0)
            for t in rig.thrusters
        }
        self.autopilot = AutopilotEmulator(rig, device, self.controllers, 1_800_000_000.0)
        self.t = 0.0
        self.deaf = False  # whether messages of the ground station are lost
        self.frames: list[Frame] = []
        self.decoder.listener = lambda message: self.driver.receive(message, self.t)

    def to_ground(self, data: bytes) -> None:
        self.frames += self.decoder.feed(data, self.t)

    def to_vehicle(self, data: bytes) -> None:
        if not self.deaf:
            self.to_ground(self.autopilot.receive(data, self.t))

    def run(self, seconds: float) -> None:
        """Advance the clock in steps of the autopilot's loop."""
        for _ in range(round(seconds * LOOP_HZ)):
            self.t += 1.0 / LOOP_HZ
            for controller in self.controllers.values():
                controller.check(self.t)
            self.to_ground(self.autopilot.encode(LEVEL, self.t))
            for node in self.controllers:
                self.autopilot.encode(Esc(node, -1200.0, 2.0, 0.0, 15.0, 30.0), self.t)
            if round(self.t * LOOP_HZ) % 10 == 0:
                fix = Gnss(1_800_000_000.0 + self.t, 38.7, -9.1, 2.0, 0.3, 0.4, 0.0, 5, 12, 0.8, 0.02)
                self.autopilot.encode(fix, self.t - 0.1)
            self.to_vehicle(self.driver.poll(self.t))
