"""`seatrial devices tcp:...`: what an autopilot is, and from its own parameters the tables that drive it in a rig.

Nothing of it is changed: parameters are read under a system id of our own, without heartbeats.
"""

from __future__ import annotations

import math
import select
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from seatrial.daq.drivers import LEFT, PADDLES, RIGHT, check_parameters, parameter_names
from seatrial.daq.protocol import INVALID, ROVER, Codec, MavlinkDecoder, Samples, vehicle_name
from seatrial.daq.rig import AutopilotOutput, Device, MavlinkSettings, Thruster
from seatrial.daq.tools.discovery import DiscoveredDevice
from seatrial.daq.transport import Port, PortError, make_port

LISTEN_S, ANSWERS_S, AGAIN_S = 4.0, 6.0, 0.7  # wall: for a heartbeat, for all answers, between two requests
ASK_AS = 253  # our system id: no autopilot's ground station
LOOP_PART = 0.8  # of SCHED_LOOP_RATE: a faster message is denied
RATE_HZ = 25.0
OUTPUTS_HZ = 50.0  # by a network: what feeds a fit is known at its samples
STEERING, THROTTLE = 26.0, 70.0  # SERVOn_FUNCTION
MOTORS = range(33, 41)  # SERVOn_FUNCTION of ArduSub and ArduCopter
SIDES = {LEFT: ("left", -0.3), RIGHT: ("right", 0.3)}
OF_TABLES = ("BATT_LOW_VOLT", "INS_GYRO_FILTER", "GPS1_POS_X", "GPS1_POS_Y", "GPS1_POS_Z")
ENDS = ("MIN", "TRIM", "MAX")


@dataclass(frozen=True)
class DiscoveredAutopilot(DiscoveredDevice):
    """An autopilot, and the parameters that it has told."""

    vehicle: str = ""
    system_id: int = 1
    signed: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)

    def toml(self, name: str, alone: bool = True) -> str:
        """A [[device]], and a [[thruster]] for each side that it drives; a comment for each caveat."""
        p = self.parameters
        loop = LOOP_PART * p.get("SCHED_LOOP_RATE", math.inf)
        own = int(p.get("MAV_GCS_SYSID", p.get("SYSID_MYGCS", 255.0)))
        lines = [f"# {self.vehicle}", "[[device]]", f'name = "{name}"', 'protocol = "mavlink"', f'port = "{self.port}"']
        lines += [f"baud = {self.baud}"] if self.baud else []
        lines += [f"rate_hz = {min(RATE_HZ, loop):.1f}", f"system_id = {self.system_id}", f"own_system_id = {own}"]
        lines += ['# caveat: it signs its frames; key_file = "signing.key" is missing here'] if self.signed else []
        lever = [p.get(f"GPS1_POS_{axis}", 0.0) for axis in "XYZ"]
        if any(lever):
            lines.append(f"# caveat: it knows its GNSS antenna at {lever} m; only fused fixes are corrected for it")
        if not self.baud and RATE_HZ < loop < math.inf:
            lines += ["[device.rates]", f"SERVO_OUTPUT_RAW = {min(OUTPUTS_HZ, loop):.1f}"]
        if self.vehicle != ROVER:
            return "\n".join([*lines, f"# caveat: only {ROVER} is driven: no [[thruster]] behind {self.vehicle}", ""])
        if not p:
            return "\n".join([*lines, "# caveat: it has told no parameter: thrusters are yours to write", ""])
        thrusters = self.thrusters(name, "" if alone else f"{name}_")
        for thruster in thrusters:
            lines += _thruster_lines(thruster)
        lines += self._without(thrusters)
        lines += [f"# caveat: {finding}" for finding in check_parameters(p, thrusters, own)]
        if p.get("BATT_LOW_VOLT", 0.0) > 0.0:
            lines += [f"# of [limits]: voltage_min_v = {p['BATT_LOW_VOLT']:.1f}, its BATT_LOW_VOLT"]
        if p.get("INS_GYRO_FILTER", 0.0) > 0.0:
            late = 1e3 / (2.0 * math.pi * p["INS_GYRO_FILTER"] / math.sqrt(2.0))
            lines += [f"# INS_GYRO_FILTER {p['INS_GYRO_FILTER']:g} Hz makes its yaw rate about {late:.0f} ms late"]
        return "\n".join([*lines, ""])

    def thrusters(self, device: str, prefix: str = "") -> list[Thruster]:
        """One for each channel of a two-paddle mix, at the first output that it moves, named by its side."""
        p = self.parameters
        found: dict[int, Thruster] = {}
        for node in range(1, 17):
            function = p.get(f"SERVO{node}_FUNCTION", 0.0)
            if function not in PADDLES:
                continue
            channel = int(p.get(*PADDLES[function]))
            if channel in found:
                continue
            name, y = SIDES[function]
            pulses = [_pulses(p, f"{kind}{k}") for kind, k in (("RC", channel), ("SERVO", node))]
            found[channel] = Thruster(
                name=prefix + name,
                device=device,
                node=node,
                position_m=(0.0, y, 0.0),
                pole_pairs=1,
                rpm_max=math.nan,
                timeout_s=p.get("RC_OVERRIDE_TIME", 1.0),
                output=AutopilotOutput(channel, *pulses),
            )
        return list(found.values())

    def _without(self, thrusters: Sequence[Thruster]) -> list[str]:
        """What else hangs on its outputs and cannot be driven."""
        p = self.parameters
        functions = {node: p.get(f"SERVO{node}_FUNCTION", 0.0) for node in range(1, 17)}
        driven = {thruster.node for thruster in thrusters}
        lines = []
        for node, function in functions.items():
            if function in PADDLES and node not in driven:
                side, channel = SIDES[function][0], int(p.get(*PADDLES[function]))
                lines.append(f"# caveat: output {node} ({side}) turns with channel {channel}, too: nothing watches it")
            elif function == STEERING:
                lines.append(f"# caveat: output {node} steers (SERVO{node}_FUNCTION 26): a rudder is not driven")
            elif function == THROTTLE:
                lines.append(f"# caveat: output {node} is the throttle of both sides (70): only 73 and 74 are driven")
            elif int(function) in MOTORS:
                lines.append(f"# caveat: output {node} is motor {int(function) - 32}: omni frames are not driven")
        if not thrusters:
            lines.append("# caveat: no output is a left (73) or right (74) throttle: no [[thruster]]")
        return lines


def _pulses(p: Mapping[str, float], prefix: str) -> tuple[float, float, float]:
    low, neutral, high = (p.get(f"{prefix}_{end}", us) for end, us in zip(ENDS, (1000.0, 1500.0, 2000.0), strict=True))
    return low, neutral, high


def _thruster_lines(thruster: Thruster) -> list[str]:
    assert thruster.output is not None
    out = thruster.output
    return [
        *("", "[[thruster]]", f'name = "{thruster.name}"', f'device = "{thruster.device}"', f"node = {thruster.node}"),
        *(f"rc_channel = {out.rc_channel}", f"rc_us = {list(out.rc_us)}", f"pwm_us = {list(out.pwm_us)}"),
        f"position_m = {list(thruster.position_m)}  # caveat: measure it: forward, starboard, down of the reference, m",
        f"timeout_s = {max(thruster.timeout_s, 0.1):.3g}",
    ]


class _Ears:
    """One open port: everything that the autopilot says until a condition is met."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.decoder = MavlinkDecoder(Samples({}), 0, 1)
        self.decoder.listener = self._take
        self.heartbeat: Any = None
        self.parameters: dict[str, float] = {}
        self.attitudes: list[float] = []  # s since its boot

    def _take(self, m: Any) -> None:
        if m.get_type() == "HEARTBEAT" and m.autopilot != INVALID:
            self.heartbeat = m
        elif m.get_type() == "PARAM_VALUE":
            self.parameters[m.param_id] = float(m.param_value)
        elif m.get_type() == "ATTITUDE":
            self.attitudes.append(m.time_boot_ms * 1e-3)

    def until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Listen, for so long at most."""
        deadline = time.monotonic() + seconds
        while not condition() and (left := deadline - time.monotonic()) > 0.0:
            if select.select([self._port.fileno()], [], [], min(left, 0.1))[0]:
                before = self.decoder.accepted
                self.decoder.feed(self._port.read(), 0.0)
                if self.decoder.accepted > before:
                    self._port.confirm()

    def ask(self, codec: Codec, system: int, names: Sequence[str]) -> None:
        """Read these parameters; what it has not it does not answer for."""
        deadline = time.monotonic() + ANSWERS_S
        before = -1
        while (missing := [name for name in names if name not in self.parameters]) and time.monotonic() < deadline:
            if len(missing) == before:
                return  # a whole round without an answer: it has none of those
            before = len(missing)
            for name in missing:
                self._port.write(codec.encode("PARAM_REQUEST_READ", system, 1, name.encode(), -1))
                self.until(lambda: False, 0.005)
            self.until(lambda wanted=names: all(name in self.parameters for name in wanted), AGAIN_S)  # type: ignore[misc]


def identify_autopilot(port: str, baud: int, ask: bool) -> DiscoveredDevice:
    """Listen for an autopilot at a port; with `ask` its parameters are read. `says` holds the fault.

    Raises nothing but ValueError, for an address that is none.
    """
    settings = MavlinkSettings()
    opened = make_port(Device("autopilot", "mavlink", port, baud or 115200, 0, RATE_HZ, mavlink=settings))
    try:
        opened.open()
        ears = _Ears(opened)
        ears.until(lambda: ears.heartbeat is not None, LISTEN_S)
        if ears.heartbeat is None:
            frames = ears.decoder.frames
            says = f"{frames} MAVLink frames, none of an autopilot" if frames else "silent: no MAVLink heartbeat"
            return DiscoveredDevice(port, "", says=says)
        ears.until(lambda: len(ears.attitudes) > 1, 1.0)
        vehicle = vehicle_name(ears.heartbeat.autopilot, ears.heartbeat.type)
        system = ears.heartbeat.get_srcSystem()
        if ask and vehicle == ROVER:
            codec = Codec(ASK_AS, 190)
            functions = (f"SERVO{node}_FUNCTION" for node in range(1, 17))
            ears.ask(codec, system, [*parameter_names(()), *OF_TABLES, *functions])
            thrusters = DiscoveredAutopilot(port, "", parameters=ears.parameters).thrusters("")
            ears.ask(codec, system, parameter_names(thrusters))
        t = ears.attitudes
        rate = (len(t) - 1) / (t[-1] - t[0]) if len(t) > 1 and t[-1] > t[0] else math.nan
        signed = ears.decoder.signed > 0
        driven = "" if vehicle == ROVER else f"; only {ROVER} is driven, this is logged"
        says = f"{vehicle}, system {system}{', it signs its frames' * signed}{driven}"
        return DiscoveredAutopilot(port, "", "mavlink", baud, rate, says, "", vehicle, system, signed, ears.parameters)
    except PortError as error:
        return DiscoveredDevice(port, "", says=str(error))
    finally:
        opened.close()
