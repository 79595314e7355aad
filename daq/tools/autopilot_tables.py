"""Identification of an autopilot, and tables for a rig file from its parameters, for `seatrial devices tcp:...`.

The autopilot is not changed. Its parameters are read with a separate system id and without heartbeats.
"""

from __future__ import annotations

import math
import select
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from seatrial.daq.drivers import LEFT, PADDLES, RIGHT, check_parameters, parameter_names
from seatrial.daq.protocol import INVALID, ROVER, Codec, MavlinkDecoder, SampleConverter, vehicle_name
from seatrial.daq.rig import UNCHECKED, AutopilotOutput, Device, MavlinkSettings, Thruster
from seatrial.daq.tools.discovery import DiscoveredDevice
from seatrial.daq.transport import Port, PortError, make_port

# s of wall time: to wait for a heartbeat, to wait for all parameters, and between two rounds of requests
LISTEN_S, ANSWERS_S, ROUND_S = 4.0, 6.0, 0.7
REQUEST_SYSTEM_ID = 253  # system id of the requests; ground stations usually have 255
MAX_RATE_RATIO = 0.8  # largest rate of a message over SCHED_LOOP_RATE; the autopilot refuses faster messages
RATE_HZ = 25.0  # of the messages of a device
OUTPUTS_HZ = 50.0  # of the outputs, by a network; a fit knows its inputs only at their samples
STEERING, THROTTLE = 26.0, 70.0  # SERVOn_FUNCTION
MOTORS = range(33, 41)  # SERVOn_FUNCTION of ArduSub and ArduCopter
SIDES = {LEFT: ("left", -0.3), RIGHT: ("right", 0.3)}  # name, and assumed position to starboard [m]
# Parameters that appear in comments only.
COMMENTED_PARAMETERS = ("BATT_LOW_VOLT", "INS_GYRO_FILTER", "GPS1_POS_X", "GPS1_POS_Y", "GPS1_POS_Z")
PULSE_SUFFIXES = ("MIN", "TRIM", "MAX")


@dataclass(frozen=True)
class DiscoveredAutopilot(DiscoveredDevice):
    """Autopilot that was found at a port, with the parameters that it reported.

    Attributes
    ----------
    vehicle : str
        Name of the firmware and vehicle, for example "ArduPilot Rover". Thrusters are driven only behind this one; the
        telemetry of the others can be logged.
    system_id : int
        MAVLink system id.
    signed : bool
        Whether it signs its MAVLink frames.
    parameters : dict
        Parameters that it reported, by name; empty if none were read.
    """

    vehicle: str = ""  # such as "ArduPilot Rover"
    system_id: int = 1
    signed: bool = False  # whether it signs its frames
    parameters: Mapping[str, float] = field(default_factory=dict)

    def toml(self, name: str, alone: bool = True) -> str:
        """Return the tables of the autopilot for a rig file, as text: a [[device]], and a [[thruster]] for each side.

        Caveats, for example of outputs that cannot be driven or of parameters that forbid a run, become comments. The
        rate of the samples is 25 Hz, or 80 % of the autopilot's loop rate if this is less. There are no [[thruster]]
        tables if the vehicle is not an ArduPilot Rover, or if it reported no parameters.

        Parameters
        ----------
        name
            Name of the device in the rig file.
        alone
            Whether no other device in the rig file has [[thruster]] tables. Otherwise the names of the thrusters
            begin with the name of the device.
        """
        p = self.parameters
        loop = MAX_RATE_RATIO * p.get("SCHED_LOOP_RATE", math.inf)
        own = int(p.get("MAV_GCS_SYSID", p.get("SYSID_MYGCS", 255.0)))
        lines = [f"# {self.vehicle}", "[[device]]", f'name = "{name}"', 'protocol = "mavlink"', f'port = "{self.port}"']
        lines += [f"baud = {self.baud}"] if self.baud else []
        lines += [f"rate_hz = {min(RATE_HZ, loop):.1f}", f"system_id = {self.system_id}", f"own_system_id = {own}"]
        lines += ['# caveat: it signs its frames; add key_file = "signing.key"'] if self.signed else []
        lever = [p.get(f"GPS1_POS_{axis}", 0.0) for axis in "XYZ"]
        if any(lever):
            lines.append(f"# caveat: its GNSS antenna is set to {lever} m; only fused fixes are corrected for this")
        if not self.baud and RATE_HZ < loop < math.inf:
            lines += ["[device.rates]", f"SERVO_OUTPUT_RAW = {min(OUTPUTS_HZ, loop):.1f}"]
        if self.vehicle != ROVER:
            return "\n".join([*lines, f"# caveat: only {ROVER} is driven: no [[thruster]] of {self.vehicle}", ""])
        if not p:
            return "\n".join([*lines, "# caveat: it reported no parameters: write each [[thruster]] yourself", ""])
        thrusters = self.thrusters(name, "" if alone else f"{name}_")
        for thruster in thrusters:
            lines += _thruster_lines(thruster)
        lines += self._undriven_output_lines(thrusters)
        lines += [f"# caveat: {finding}" for finding in check_parameters(p, thrusters, own)]
        if p.get("BATT_LOW_VOLT", 0.0) > 0.0:
            lines += [f"# for [limits]: voltage_min_v = {p['BATT_LOW_VOLT']:.1f}, its BATT_LOW_VOLT"]
        if p.get("INS_GYRO_FILTER", 0.0) > 0.0:
            # Delay of a second-order Butterworth low-pass at low frequencies: sqrt(2) / (2 pi f).
            delay_ms = 1e3 / (2.0 * math.pi * p["INS_GYRO_FILTER"] / math.sqrt(2.0))
            lines += [f"# INS_GYRO_FILTER {p['INS_GYRO_FILTER']:g} Hz delays its yaw rate by about {delay_ms:.0f} ms"]
        return "\n".join([*lines, ""])

    def thrusters(self, device: str, prefix: str = "") -> list[Thruster]:
        """Return a thruster of the rig for each RC channel with which the autopilot drives one side of the boat.

        Such a channel is a left or right throttle. The thruster is named "left" or "right". Its node is the first
        output from 1 to 16 that the channel drives. Its position is assumed (0.3 m to the side), and its pulse widths
        come from the parameters. A reversed output is not taken into account. The thrusters are in the order of their
        nodes. The list is empty without such outputs.

        Parameters
        ----------
        device
            Name of the device in the rig file.
        prefix
            Text before the name of each thruster.
        """
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
            pulses = [_pulse_range(p, f"{kind}{k}") for kind, k in (("RC", channel), ("SERVO", node))]
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

    def _undriven_output_lines(self, thrusters: Sequence[Thruster]) -> list[str]:
        """Return a comment for the rig file for each output of the autopilot that cannot be driven or is not monitored.

        Outputs that cannot be driven are rudders, throttles of both sides, and motors of omni frames. Outputs that are
        not monitored are the further ones of the RC channels of `thrusters`. Outputs 1 to 16 are examined, and the
        comments are in their order. If `thrusters` is empty, a last comment states that there is no [[thruster]].
        """
        p = self.parameters
        functions = {node: p.get(f"SERVO{node}_FUNCTION", 0.0) for node in range(1, 17)}
        driven = {thruster.node for thruster in thrusters}
        lines = []
        for node, function in functions.items():
            if function in PADDLES and node not in driven:
                side, channel = SIDES[function][0], int(p.get(*PADDLES[function]))
                lines.append(f"# caveat: output {node} ({side}) turns with channel {channel}, too: it is not monitored")
            elif function == STEERING:
                lines.append(f"# caveat: output {node} steers (SERVO{node}_FUNCTION 26): rudders cannot be driven")
            elif function == THROTTLE:
                lines.append(
                    f"# caveat: output {node} is the throttle of both sides (SERVO{node}_FUNCTION 70): only 73 (left) "
                    "and 74 (right) can be driven"
                )
            elif int(function) in MOTORS:
                lines.append(f"# caveat: output {node} is motor {int(function) - 32}: omni frames cannot be driven")
        if not thrusters:
            lines.append("# caveat: no SERVOn_FUNCTION is 73 (left throttle) or 74 (right throttle): no [[thruster]]")
        return lines


def _pulse_range(p: Mapping[str, float], prefix: str) -> tuple[float, float, float]:
    """Return the lowest, neutral and highest pulse [us] of an RC channel or output of an autopilot.

    `prefix` is the beginning of the names of its parameters in `p`, for example "SERVO1". The names end with _MIN,
    _TRIM and _MAX. If one of the parameters is missing, its pulse is 1000, 1500 or 2000 us.
    """
    low, neutral, high = (
        p.get(f"{prefix}_{end}", us) for end, us in zip(PULSE_SUFFIXES, (1000.0, 1500.0, 2000.0), strict=True)
    )
    return low, neutral, high


def _thruster_lines(thruster: Thruster) -> list[str]:
    """Return the lines of the [[thruster]] table of a rig file for a thruster behind an autopilot.

    The first line is empty. A comment asks the user to measure the assumed position. A time-out below 0.1 s is written
    as 0.1 s. `thruster.output` must not be None.
    """
    assert thruster.output is not None
    out = thruster.output
    return [
        *("", "[[thruster]]", f'name = "{thruster.name}"', f'device = "{thruster.device}"', f"node = {thruster.node}"),
        *(f"rc_channel = {out.rc_channel}", f"rc_us = {list(out.rc_us)}", f"pwm_us = {list(out.pwm_us)}"),
        f"position_m = {list(thruster.position_m)}  # {UNCHECKED}: forward, starboard, down of the reference, m",
        f"timeout_s = {max(thruster.timeout_s, 0.1):.3g}",
    ]


class _AutopilotListener:
    """Receiver that stores heartbeat, parameters and attitude times of the autopilot at one open port.

    Attributes
    ----------
    decoder : MavlinkDecoder
        Decoder of the port.
    heartbeat : message or None
        Newest heartbeat of an autopilot; None before the first.
    parameters : dict
        Parameters received so far, by name.
    attitudes : list of float
        Times of the attitudes received so far [s since the start of the autopilot].
    """

    def __init__(self, port: Port) -> None:
        """Prepare the decoder of MAVLink messages at an open port. Nothing is received yet."""
        self._port = port
        self.decoder = MavlinkDecoder(SampleConverter({}), 0, 1)
        self.decoder.listener = self._store_message
        self.heartbeat: Any = None  # the newest heartbeat of an autopilot
        self.parameters: dict[str, float] = {}
        self.attitudes: list[float] = []  # times of the attitudes, s since the start of the autopilot

    def _store_message(self, m: Any) -> None:
        """Store a decoded MAVLink message: the newest heartbeat, a parameter, or the time of an attitude.

        A heartbeat or parameter replaces the earlier one; the time of an attitude is appended. Other messages, and
        heartbeats of a sender that is no autopilot, such as a ground station, are ignored.
        """
        if m.get_type() == "HEARTBEAT" and m.autopilot != INVALID:
            self.heartbeat = m
        elif m.get_type() == "PARAM_VALUE":
            self.parameters[m.param_id] = float(m.param_value)
        elif m.get_type() == "ATTITUDE":
            self.attitudes.append(m.time_boot_ms * 1e-3)

    def until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Receive messages at the port and store them until `condition()` is true, at most for `seconds` of wall time.

        The attributes of this object hold what was received. A time-out is not an error. An error of the port raises
        PortError.
        """
        deadline = time.monotonic() + seconds
        while not condition() and (left := deadline - time.monotonic()) > 0.0:
            if select.select([self._port.fileno()], [], [], min(left, 0.1))[0]:
                before = self.decoder.accepted
                self.decoder.feed(self._port.read(), 0.0)
                if self.decoder.accepted > before:
                    self._port.confirm()

    def ask(self, codec: Codec, system: int, names: Sequence[str]) -> None:
        """Request parameters of the autopilot until all have arrived, or until a round of requests brings no answer.

        Autopilots do not answer requests for parameters that they do not have. The received values are stored in
        `parameters`; missing ones are not an error. Parameters that were received before are not requested again. After
        `ANSWERS_S` (6 s) of wall time no further round begins. An error of the port raises PortError.

        Parameters
        ----------
        codec
            Encoder of the requests.
        system
            MAVLink system id of the autopilot.
        names
            Names of the parameters.
        """
        deadline = time.monotonic() + ANSWERS_S
        n_before = -1
        while (missing := [name for name in names if name not in self.parameters]) and time.monotonic() < deadline:
            if len(missing) == n_before:
                return  # a whole round without an answer: the autopilot has none of the missing parameters
            n_before = len(missing)
            for name in missing:
                self._port.write(codec.encode("PARAM_REQUEST_READ", system, 1, name.encode(), -1))
                self.until(lambda: False, 0.005)
            self.until(lambda wanted=names: all(name in self.parameters for name in wanted), ROUND_S)  # type: ignore[misc]


def identify_autopilot(port: str, baud: int, ask: bool) -> DiscoveredDevice:
    """Identify the autopilot at a port by its heartbeat, for which it waits 4 s at most.

    The port is opened and closed here. Bytes are sent only to read parameters.

    Parameters
    ----------
    port
        Serial port or network address.
    baud
        Baud rate of a serial port; 0 for a network address. A serial port with 0 is opened at 115200 baud.
    ask
        Whether to read the parameters of an ArduPilot Rover. Those of other vehicles are not read.

    Returns
    -------
    DiscoveredDevice
        `DiscoveredAutopilot` if an autopilot was found; its `rate` is that of its attitudes, NaN if two of them did not
        arrive within 1 s. Otherwise a `DiscoveredDevice` with an empty protocol; its `says` has the reason, such as an
        error of the port, which is not raised.

    Raises
    ------
    ValueError
        If `port` is not a valid address.
    """
    settings = MavlinkSettings()
    opened = make_port(Device("autopilot", "mavlink", port, baud or 115200, 0, RATE_HZ, mavlink=settings))
    try:
        opened.open()
        listener = _AutopilotListener(opened)
        listener.until(lambda: listener.heartbeat is not None, LISTEN_S)
        if listener.heartbeat is None:
            frames = listener.decoder.frames
            says = (
                f"{frames} MAVLink frames, but no heartbeat of an autopilot; give the port of the autopilot itself, "
                "and try again when it has started"
                if frames
                else "silent: no MAVLink frames; check address, baud rate, power and cable"
            )
            return DiscoveredDevice(port, "", says=says)
        listener.until(lambda: len(listener.attitudes) > 1, 1.0)
        vehicle = vehicle_name(listener.heartbeat.autopilot, listener.heartbeat.type)
        system = listener.heartbeat.get_srcSystem()
        if ask and vehicle == ROVER:
            codec = Codec(REQUEST_SYSTEM_ID, 190)
            functions = (f"SERVO{node}_FUNCTION" for node in range(1, 17))
            listener.ask(codec, system, [*parameter_names(()), *COMMENTED_PARAMETERS, *functions])
            thrusters = DiscoveredAutopilot(port, "", parameters=listener.parameters).thrusters("")
            listener.ask(codec, system, parameter_names(thrusters))
        t = listener.attitudes
        rate = (len(t) - 1) / (t[-1] - t[0]) if len(t) > 1 and t[-1] > t[0] else math.nan
        signed = listener.decoder.signed > 0
        driven = "" if vehicle == ROVER else f"; only {ROVER} can be driven, this vehicle is only logged"
        says = f"{vehicle}, system {system}{', it signs its frames' * signed}{driven}"
        return DiscoveredAutopilot(
            port, "", "mavlink", baud, rate, says, "", vehicle, system, signed, listener.parameters
        )
    except PortError as error:
        return DiscoveredDevice(port, "", says=str(error))
    finally:
        opened.close()
