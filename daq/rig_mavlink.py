"""The part of rig.toml that is about MAVLink: the link to an autopilot, and thrusters behind its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from daq.toml_table import Table

NET_KINDS = ("udp", "udpin", "udpout", "tcp")
# Messages that are asked for, with their rate [Hz]; None is the device's rate_hz. In the order of their weight, so
# that the last ones are refused on a link that cannot carry all.
RATES: dict[str, float | None] = {
    "ATTITUDE": None,
    "SERVO_OUTPUT_RAW": None,
    "RAW_IMU": None,
    "GPS_RAW_INT": 5.0,
    "EKF_STATUS_REPORT": 2.0,
    "SYSTEM_TIME": 1.0,
    "BATTERY_STATUS": 2.0,
    "ESC_TELEMETRY_1_TO_4": 10.0,
}
OTHER_RATES = (
    "SCALED_IMU",
    "HIGHRES_IMU",
    "GLOBAL_POSITION_INT",
    "SYS_STATUS",
    "ESC_TELEMETRY_5_TO_8",
    "ESC_STATUS",
)
HIGHEST_ID = 255


@dataclass(frozen=True)
class MavlinkSettings:
    """How to talk to an autopilot: who it is, who we are, what it is asked for."""

    system_id: int = 1
    component_id: int = 1
    own_system_id: int = 255
    own_component_id: int = 190
    key_file: Path | None = None  # 32 bytes or 64 hexadecimal digits; signs what we send, and unsigned is ignored
    gnss: str = "raw"  # raw: the receiver's fixes; fused: the autopilot's estimate
    rates: Mapping[str, float] = field(default_factory=dict)  # Hz by message name, other than RATES

    def requested(self, rate_hz: float) -> dict[str, float]:
        """What is asked for [Hz], by message name, in the order of RATES."""
        rates = {name: rate_hz if rate is None else rate for name, rate in RATES.items()}
        if self.gnss == "fused":
            rates["GLOBAL_POSITION_INT"] = rates.pop("GPS_RAW_INT")
        return {name: rate for name, rate in (rates | dict(self.rates)).items() if rate > 0.0}


@dataclass(frozen=True)
class Output:
    """How a thruster hangs on an autopilot: the channel that commands it and the pulses of both ends."""

    rc_channel: int  # RC_CHANNELS_OVERRIDE, from 1
    rc_us: tuple[float, float, float]  # full astern, neutral, full ahead: RCn_MIN, RCn_TRIM, RCn_MAX
    pwm_us: tuple[float, float, float]  # of the servo output: SERVOn_MIN, SERVOn_TRIM, SERVOn_MAX

    def command(self, n: float) -> int:
        """The pulse [us] that commands n, -1..1; neutral for what is no number."""
        low, neutral, high = self.rc_us
        if not -1.0 <= n <= 1.0:
            return round(neutral)
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))

    def applied(self, pwm: float) -> float:
        """What a pulse [us] at the output is as n, beyond -1..1 where the pulse is; NaN while there is none."""
        low, neutral, high = self.pwm_us
        if pwm <= 0.0:
            return float("nan")
        return (pwm - neutral) / (high - neutral if pwm > neutral else neutral - low)


def read_settings(table: Table, folder: Path) -> MavlinkSettings:
    """The MAVLink keys of a [[device]]; relative paths count from `folder`."""
    key = table.text("key_file", "")
    system = table.integer("system_id", 1, low=1, high=HIGHEST_ID)
    own = table.integer("own_system_id", 255, low=1, high=HIGHEST_ID)
    if own == system:
        raise table.error("own_system_id", f"{own} is the autopilot's own; give another")
    return MavlinkSettings(
        system,
        table.integer("component_id", 1, low=1, high=HIGHEST_ID),
        own,
        table.integer("own_component_id", 190, low=1, high=HIGHEST_ID),
        folder / key if key else None,
        table.text("gnss", "raw", choices=("raw", "fused")),
        _rates(table),
    )


def _rates(table: Table) -> dict[str, float]:
    rates: dict[str, float] = {}
    own = table.table("rates")
    if own is not None:
        for name in own.values:
            if name not in RATES and name not in OTHER_RATES:
                raise own.error(name, f"no message that is understood; known: {', '.join((*RATES, *OTHER_RATES))}")
            rates[name] = own.number(name, low=0.0, high=1000.0)
        own.done()
    return rates


def read_output(table: Table, node: int) -> Output:
    """The MAVLink keys of a [[thruster]] at servo output `node`."""
    if not 1 <= node <= 16:
        raise table.error("node", f"is the number of a servo output, 1 .. 16, not {node}")
    return Output(
        table.integer("rc_channel", low=1, high=18),
        _pulses(table, "rc_us", (1000.0, 1500.0, 2000.0)),
        _pulses(table, "pwm_us", (1100.0, 1500.0, 1900.0)),
    )


def _pulses(table: Table, key: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
    low, neutral, high = table.numbers(key, default, length=3)
    if not 500.0 <= low < neutral < high <= 2500.0:
        raise table.error(key, "must be [full astern, neutral, full ahead] in us, ascending, within 500 .. 2500")
    return low, neutral, high
