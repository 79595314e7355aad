"""Logs of other rigs: a table of rigs, each with a function from simulated readings to log files.

A rig with an autopilot uses the messages of the emulated autopilot and the clock of the decoder, over a link with
random delay. Tables are written as CSV and imported. All other rigs use the recorder.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial import command_line
from seatrial.bench.mission_generators import make_mission
from seatrial.daq.clock import ClockMap
from seatrial.daq.geometry import local_ned
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.protocol import Codec, dialect
from seatrial.daq.protocol.mavlink import MavlinkDecoder, make_sample_converter
from seatrial.daq.samples import NAN, Ahrs, Command, Esc, Frame, Gnss
from seatrial.mocks.devices.autopilot import AutopilotEmulator
from seatrial.mocks.hidden_effects.catalogue import make_effect
from seatrial.mocks.offline_simulation import BOAT, Recording, simulate, tables
from seatrial.mocks.plant.boat import Boat, draw_boat
from seatrial.mocks.plant.thruster import draw_thruster
from seatrial.mocks.random_streams import random_stream
from seatrial.mocks.world import DeviceSpecs, EscSpec, Reading
from tests.missions import RPM_MAX, T0, StandingClock, rig_of, write_log
from tests.recovery.kinds import DECLARED, NONE

Array = NDArray[np.float64]
Log = Callable[[Path, Sequence[Reading]], Path]  # Write the readings of one mission and return the path of the log.
# Smallest delay [s] of a message on a telemetry link, and mean of its further delay [s].
LINK_DELAY, LINK_JITTER = 0.005, 0.01
LINK = 900  # Stream of random numbers for the delays of the link.
SHAFTS = ("n_left", "n_right")  # Commands, if no shaft speed is measured.
AUTOPILOT = DeviceSpecs(
    {"autopilot": 50.0},
    {"autopilot": 5.0},
    (),
    tuple(EscSpec("autopilot", k, 25.0, name=side) for k, side in ((1, "left"), (3, "right"))),
)
TEN_HERTZ = replace(BOAT, ahrs={"ahrs": 10.0}, gnss={"gnss": 10.0})


@dataclass(frozen=True)
class Rig:
    """Devices of a boat, signals in its logs, and the options that its owner gives to the commands.

    Attributes
    ----------
    description
        Description of the rig as a phrase.
    log
        Function that writes the readings of a mission as a log.
    gear
        Devices on board.
    estimation, validation
        Duration of each mission [s].
    declared
        Given standard deviations of the sensors, divided by those of the data sheets. None if they are estimated.
    scale_known
        Whether the owner knows the thrust coefficients and gives them.
    payload
        Payload in each mission [kg], validation last. Empty for no payload.
    blind
        Effects that these logs cannot show.
    there
        Effects of the catalogue that every log of this rig has.
    brings
        Effects that the rig adds to another effect.
    called
        Names of the catalogue for another effect on this rig.
    """

    name: str
    description: str
    log: Log
    gear: DeviceSpecs = BOAT
    estimation: tuple[float, ...] = (400.0,)
    validation: tuple[float, ...] = (250.0,)
    declared: float | None = None
    scale_known: bool = True
    payload: tuple[float, ...] = ()
    blind: frozenset[str] = field(default_factory=frozenset)
    there: frozenset[str] = field(default_factory=frozenset)
    brings: Mapping[str, frozenset[str]] = field(default_factory=dict)
    called: Mapping[str, str] = field(default_factory=dict)

    def boat(self, effect: str | None, seed: int) -> Boat:
        """Return the boat of a seed with its own thrusters. If the scale is unknown, their thrust is between half and
        twice the usual one.
        """
        thruster = draw_thruster(seed)
        if not self.scale_known:
            factor = float(2.0 ** random_stream(seed, LINK, index=1).uniform(-1.0, 1.0))
            thruster = replace(thruster, c1=factor * thruster.c1, c2=factor * thruster.c2)
        return draw_boat(seed, [make_effect(effect, seed)] if effect else [], thruster)

    def sail(self, boat: Boat, folder: Path) -> tuple[list[Path], list[Path]]:
        """Write the logs of random missions for estimation and validation."""
        paths = []
        payload = self.payload or (0.0,) * len((*self.estimation, *self.validation))
        for run, (seconds, kg) in enumerate(zip((*self.estimation, *self.validation), payload, strict=True), 1):
            t, n = make_mission("mixed", seconds, 100 * run + boat.seed).setpoints()
            loaded = replace(boat, hull=replace(boat.hull, mass=boat.hull.mass + kg))
            recording: Recording = simulate(loaded, t, n, seconds, run, gear=self.gear)
            paths.append(self.log(folder / f"run{run}.mcap", recording.readings))
        return paths[: len(self.estimation)], paths[len(self.estimation) :]

    def options(self, boat: Boat) -> list[str]:
        """Return the knowledge of the owner as options of `seatrial ident vehicle`."""
        known = {"y_left": -0.15, "y_right": 0.15}
        if self.scale_known:
            known |= {"c1": boat.thruster.c1, "c2": boat.thruster.c2}
        if self.declared is not None:
            known |= {name: self.declared * float(sd) for name, sd in DECLARED.items()}
        return [word for name, value in known.items() for word in ("--fix", f"{name}={value!r}")]


def vesc_log(path: Path, readings: Sequence[Reading]) -> Path:
    """Write the log of the simulated boat: AHRS, receiver and VESC controllers, by the recorder."""
    return write_log(path, "boat", readings)


class Output:
    """State of a speed controller for the emulated autopilot: the command that it follows."""

    duty = 0.0


def autopilot_log(path: Path, readings: Sequence[Reading], *, signed: bool) -> Path:
    """Write a log through the messages of an autopilot: attitude and outputs at 25 Hz, fixes at 5 Hz.

    If ``signed``, a DroneCAN bus gives signed shaft speeds with their times at 25 Hz. Otherwise they are unsigned
    ESC_TELEMETRY at 10 Hz with the time of arrival.
    """
    rig = rig_of("mavboat")
    device = rig.device("autopilot")
    assert device.mavlink is not None
    outputs = {thruster.node: Output() for thruster in rig.thrusters}
    autopilot = AutopilotEmulator(rig, device, outputs)  # type: ignore[arg-type]
    ground, decoder = Codec(device.mavlink.own_system_id, 190), MavlinkDecoder(make_sample_converter(device, rig))
    rates = device.mavlink.requested(device.rate_hz)
    rates |= {"ESC_TELEMETRY_1_TO_4": 0.0} if signed else {}
    for name, rate in rates.items():
        if rate:
            autopilot.receive(interval(ground, name, rate), 0.0)
    rng, clock = np.random.default_rng([len(readings), LINK]), ClockMap()
    recorder, arrived = Recorder(path, rig=rig, clock=StandingClock()), 0.0
    for _, sample, t in readings:
        if isinstance(sample, Command):
            outputs[sample.node].duty = sample.n_cmd
            recorder.write("autopilot", Frame(sample, T0 + t, NAN), T0 + t)
            continue
        if signed and isinstance(sample, Esc):
            recorder.write("autopilot", Frame(sample, T0 + t + 1e-3, NAN), T0 + t + 1e-3)
        data = autopilot.encode(sample, t)  # type: ignore[arg-type]
        arrived = max(arrived, t + LINK_DELAY + float(rng.exponential(LINK_JITTER)))  # Messages stay in order.
        for frame in decoder.feed(data, T0 + arrived):
            t = clock.estimate(frame.t_device, frame.t_rx, True, type(frame.sample))
            recorder.write("autopilot", frame, t)
    recorder.close()
    return path


def interval(ground: Codec, name: str, rate: float) -> bytes:
    """Return the message MAV_CMD_SET_MESSAGE_INTERVAL."""
    number = getattr(dialect(), f"MAVLINK_MSG_ID_{name}")
    return ground.encode("COMMAND_LONG", 1, 1, 511, 0, number, 1e6 / rate, 0, 0, 0, 0, 0)


Columns = dict[str, tuple[Array, Array]]  # Times (n,) [s] and values (n,), by name.


def csv_log(
    path: Path, readings: Sequence[Reading], *, of: Callable[[Sequence[Reading]], Columns], hold: str = "linear"
) -> Path:
    """Write a table with one column per signal and empty cells without samples, and import it by a map.

    ``hold`` is that of the inputs: zero for commands, linear for measured shaft speeds.
    """
    columns, rows = of(readings), dict[float, dict[str, float]]()
    for name, (t, values) in columns.items():
        for at, value in zip(t.tolist(), values.tolist(), strict=True):
            rows.setdefault(round(at, 4), {})[name] = value
    table, how = path.with_suffix(".csv"), path.with_suffix(".toml")
    with table.open("w", newline="", encoding="ascii") as file:
        writer = csv.DictWriter(file, ["t", *columns], restval="")
        writer.writeheader()
        for at in sorted(rows):
            writer.writerow({"t": f"{at:.4f}"} | {name: f"{value:.7g}" for name, value in rows[at].items()})
    how.write_text(csv_map(columns, hold), encoding="utf-8")
    import_files(how, table, path)
    return path


def import_files(how: Path, table: Path, path: Path) -> None:
    """Run `seatrial import` without output. Raise RuntimeError if it fails."""
    with redirect_stdout(StringIO()):
        try:
            command_line.main(["import", str(how), str(table), "-o", str(path), "--force"])
        except SystemExit as left:
            if left.code:
                raise RuntimeError(f"{table.name} cannot be imported") from None


def csv_map(columns: Iterable[str], hold: str) -> str:
    """Return the text of an import map. ``hold`` is that of the inputs."""
    units = {"x": "m", "y": "m", "psi": "rad", "r": "rad/s", "ax": "m/s2", "ay": "m/s2"}
    text = 'format = "seatrial-import-csv 1"\n[csv]\nnan = "drop"\n[time]\ncolumn = "t"\n'
    for name in columns:
        text += f'[[signal]]\nname = "{name}"\ncolumn = "{name}"\n'
        if name in SHAFTS:
            text += f'unit = "1"\nrole = "input"\nhold = "{hold}"\n'
        else:
            text += f'unit = "{units.get(name, "m/s")}"\n' + 'angle = "unwrap"\n' * (name == "psi")
    return text


def measured_columns(readings: Sequence[Reading]) -> Columns:
    """Return all sensor signals and shaft speeds of the boat by the names of an import."""
    table = tables(readings)
    ahrs, gnss = table["ahrs"], table["gnss"]
    x, y = local_ned(gnss["lat"], gnss["lon"])
    found = {name: (ahrs["t"], ahrs[of]) for name, of in (("psi", "yaw"), ("r", "r"), ("ax", "ax"), ("ay", "ay"))}
    found |= {"x": (gnss["t"], x), "y": (gnss["t"], y), "vx": (gnss["t"], gnss["vel_n"])}
    found |= {"vy": (gnss["t"], gnss["vel_e"])}
    for node, side in ((1, "left"), (2, "right")):
        state = table[f"esc/{node}/state"]
        found[f"n_{side}"] = (state["t"], state["rpm"] / RPM_MAX)
    return found


def commands_only(readings: Sequence[Reading], *, rate: float) -> Columns:
    """Return the signals without shaft speeds. The held commands are sampled ``rate`` times a second."""
    table, found = tables(readings), measured_columns(readings)
    at = np.arange(0.0, found["psi"][0][-1], 1.0 / rate)
    sent = {}
    for node, name in zip((1, 2), SHAFTS, strict=True):
        command = table[f"esc/{node}/command"]
        held = np.append(0.0, command["n_cmd"])[np.searchsorted(command["t"], at, side="right")]
        sent[name] = (at, held)
    return sent | {name: column for name, column in found.items() if name not in SHAFTS}


def position_and_compass(readings: Sequence[Reading]) -> Columns:
    """Return the signals of a receiver and a compass, without gyro and accelerometer."""
    return {name: column for name, column in measured_columns(readings).items() if name not in ("r", "ax", "ay")}


def navigation_filter(readings: Sequence[Reading]) -> Columns:
    """Return the output of the estimator of an autopilot from the same sensors, at 10 Hz.

    Acceleration is integrated in NED and corrected by the fixes. The heading is integrated from the gyro and corrected
    by the compass.
    """
    rows, psi, r, turning = [], None, 0.0, 0.0
    # Position [m], velocity [m/s] and error of the acceleration [m/s2].
    p, v, b = np.zeros(2), np.zeros(2), np.zeros(2)
    origin, last, due, pushing = None, 0.0, 0.0, np.zeros(2)
    for _, sample, t in readings:
        if isinstance(sample, Ahrs):
            dt, last = t - last, t
            psi = sample.yaw if psi is None else psi + (turning + sample.r) / 2.0 * dt
            psi += dt / 2.0 * ((sample.yaw - psi + np.pi) % (2.0 * np.pi) - np.pi)
            turning = sample.r
            r += min(1.0, dt / 0.05) * (sample.r - r)
            c, s = np.cos(psi), np.sin(psi)
            push = np.array([c * sample.ax - s * sample.ay, s * sample.ax + c * sample.ay])
            step = dt * ((pushing + push) / 2.0 - b)
            p, v, pushing = p + dt * (v + step / 2.0), v + step, push
            if t >= due:
                due += 0.1
                rows.append((t, *p, psi, r, c * v[0] + s * v[1], c * v[1] - s * v[0]))
        elif isinstance(sample, Gnss):
            origin = (sample.lat, sample.lon) if origin is None else origin
            north, east = local_ned(np.array([origin[0], sample.lat]), np.array([origin[1], sample.lon]))
            off, error = np.array([north[1], east[1]]) - p, np.array([sample.vel_n, sample.vel_e]) - v
            p, v, b = p + 0.2 * off, v + 0.1 * error + 0.05 * off, b - 0.005 * error
    table = np.array(rows)
    table = table[table[:, 0] > 10.0]  # The estimator has converged.
    found = {name: (table[:, 0], table[:, k]) for k, name in enumerate(("x", "y", "psi", "r", "u", "v"), start=1)}
    return found | {name: column for name, column in measured_columns(readings).items() if name in SHAFTS}


NO_RATES = frozenset({"gyro-scale", "accelerometer-tilt", "accelerometer-scale", "mount", "waves", "pendulum"})
SHAFT = frozenset({"delay", "lag", "dead-band"})  # Effects of the shaft that need a measured shaft speed.
VESC = Rig("vesc", "shaft speeds measured and signed, AHRS, GNSS, thrust known", vesc_log)
RIGS: dict[str, Rig] = {
    rig.name: rig
    for rig in (
        VESC,
        Rig(
            "mavlink-signed",
            "an autopilot, and signed shaft speeds from a DroneCAN bus",
            partial(autopilot_log, signed=True),
            AUTOPILOT,
        ),
        Rig(
            "mavlink-unsigned",
            "an autopilot, and its unsigned ESC telemetry at the time of arrival",
            partial(autopilot_log, signed=False),
            AUTOPILOT,
        ),
        *(
            Rig(
                f"commands-{rate}hz",
                f"CSV: commands held at {rate} Hz, no shaft speed",
                partial(csv_log, of=partial(commands_only, rate=float(rate)), hold="zero"),
                blind=SHAFT,
            )
            for rate in (5, 10, 20, 50)
        ),
        Rig(
            "gnss-compass",
            "CSV: GNSS and compass at 10 Hz, no gyro, shaft speeds measured",
            partial(csv_log, of=position_and_compass),
            TEN_HERTZ,
            blind=NO_RATES,
        ),
        Rig(
            "ekf",
            "CSV: position, heading, yaw rate and body velocities smoothed by an estimator, 10 Hz",
            partial(csv_log, of=navigation_filter),
            blind=NO_RATES | {"gnss-latency"},
            there=frozenset({"filter-lag"}),  # The yaw rate is late by 50 ms.
            brings={"lever-arm": frozenset({"velocity-point"})},  # The velocity is corrected to that of the antenna.
            called={"compass-filtered": "compass"},
        ),  # The heading follows the compass within two seconds.
        replace(
            VESC, name="noise-third", description="sensor noise declared as a third of the true noise", declared=1 / 3
        ),
        replace(
            VESC, name="noise-triple", description="sensor noise declared as three times the true noise", declared=3.0
        ),
        replace(VESC, name="scale-unknown", description="thrust not given", scale_known=False),
        replace(VESC, name="no-validation", description="one log, no validation log", validation=()),
        replace(
            VESC, name="short", description="60 s to estimate, 60 s to validate", estimation=(60.0,), validation=(60.0,)
        ),
        replace(
            VESC,
            name="payload",
            description="5 kg more on board in the second of two runs, and 20 kg to validate",
            estimation=(300.0, 300.0),
            payload=(0.0, 5.0, 20.0),
        ),
        replace(VESC, name="eight-runs", description="eight runs of 100 s", estimation=(100.0,) * 8),
        replace(VESC, name="thirty-two-runs", description="thirty-two runs of 60 s", estimation=(60.0,) * 32),
    )
}


@dataclass(frozen=True)
class Plant:
    """Runs of an independent simulator, in the folder of the environment variable SEATRIAL_DATA.

    Attributes
    ----------
    folder
        Folder of the runs.
    effect
        Effect that was switched on, by its name in the catalogue.
    there
        Effects of the catalogue that the simulator always has.
    diagnosed
        Whether the model can be diagnosed.
    """

    name: str
    folder: str
    effect: str = NONE
    there: frozenset[str] = frozenset()
    diagnosed: bool = True

    @property
    def path(self) -> Path:
        """Return the folder of the runs. Raise FileNotFoundError if the data sets are absent."""
        path = Path(os.environ.get("SEATRIAL_DATA", "SEATRIAL_DATA is not set"), self.folder)
        if not path.exists():
            raise FileNotFoundError(f"{path}")
        return path

    def logs(self, folder: Path) -> tuple[list[Path], list[Path]]:
        """Return the logs for estimation and validation."""
        if not self.diagnosed:
            return [import_tlog(self.path, folder / "steps.mcap")], []
        how = folder / "otter.toml"
        with (self.path / "run1.csv").open(encoding="ascii") as file:
            names = [n for n in next(csv.reader(file)) if n != "t" and not n.startswith("cmd_")]
        how.write_text(csv_map(names, "linear"), encoding="utf-8")
        logs = [folder / f"run{k}.mcap" for k in (1, 2, 3)]
        for log in logs:
            import_files(how, self.path / f"{log.stem}.csv", log)
        return logs[:2], logs[2:]

    @property
    def options(self) -> list[str]:
        """Return the knowledge of the owner as options: the thrusters, or a user model."""
        if not self.diagnosed:
            return ["--model", f"{ARDUROVER / 'steered_boat.py'}:boat", "--rate", "25"]
        true = json.loads((self.path / "truth.json").read_text(encoding="utf-8"))
        known = {"c1": true["c1"], "c2": true["c2"], "y_left": -OTTER_ARM, "y_right": OTTER_ARM}
        return [word for name, value in known.items() for word in ("--fix", f"{name}={value!r}")]

    def truth(self) -> dict[str, float]:
        """Return the true parameters that have the same meaning in the simulator and here."""
        if not self.diagnosed:
            return {"m_u": 2.0, "d_uu": 0.5}
        mass = json.loads((self.path / "truth.json").read_text(encoding="utf-8"))["M"]
        return {name: mass[k][k] for name, k in (("m_u", 0), ("m_v", 1), ("m_r", 5))}


def import_tlog(tlog: Path, path: Path) -> Path:
    """Run `seatrial import mavlink` with the rig of the example, without output."""
    with redirect_stdout(StringIO()), suppress(SystemExit):
        command_line.main(["import", "mavlink", str(tlog), "--rig", str(ARDUROVER / "rig.toml"), "-o", str(path)])
    return path


ARDUROVER = Path(__file__).parents[2] / "docs" / "examples" / "ardurover"
OTTER_ARM = 0.395  # Unit: m
# The cross-flow drag of the Otter is a strip integral, and its centre of gravity is ahead of its origin.
STRIPS = frozenset({"cross-flow", "cg-offset", "sway-yaw"})
PLANTS: dict[str, Plant] = {
    plant.name: plant
    for plant in (
        Plant("otter-none-full", "otter/none_full", there=STRIPS),
        Plant("otter-none", "otter/none_pos", there=STRIPS),
        Plant("otter-current", "otter/current_pos", there=STRIPS),
        Plant("otter-mismatch", "otter/weak_left_full", "mismatch", STRIPS),
        Plant("otter-payload", "otter/payload_side_pos", "cg-offset", STRIPS | {"yaw-bias"}),
        Plant("otter-latency", "otter/gps_latency_pos", "gnss-latency", STRIPS),
        Plant("otter-advance", "otter/advance_pos", "advance-ratio", STRIPS),
        Plant("ardurover", "ardurover/steps_boat.tlog", diagnosed=False),
    )
}
