"""Mock missions and bench runs without ports and clocks: as channels in memory, and as logs of daq's recorder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.bench.mission_generators import bench_plan, make_mission
from seatrial.daq.config.mission_file import Mission, dump_mission
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.geometry import local_ned
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Ahrs, Frame, LoadCell
from seatrial.ident.data.record import Channel
from seatrial.mocks.hidden_effects.catalogue import make_effect
from seatrial.mocks.offline_simulation import Recording, simulate, simulate_bench, tables
from seatrial.mocks.plant.bench import Bench
from seatrial.mocks.plant.boat import Boat, draw_boat
from seatrial.mocks.world import Reading

T0 = 1_750_000_000.0  # run time (s since 1970) at which these logs begin
RPM_MAX = 4500.0


class StandingClock:
    """Run clock that stands still, for a recorder whose samples bring their own times."""

    speed = 1.0
    origin = (0.0, T0)

    def now(self) -> float:
        """Return the start time."""
        return T0


@cache
def rig_of(kind: str) -> Rig:
    """Return the packaged rig of the mocks: ``boat`` or ``bench``."""
    text = files("seatrial.mocks").joinpath("rigs", f"{kind}.toml").read_text(encoding="utf-8")
    return parse_rig(text, Path(f"{kind}.toml"))


def boat_with(effect: str | None, seed: int, scale: float = 1.0) -> Boat:
    """Return the boat of a seed, with a hidden effect or without one."""
    return draw_boat(seed, [make_effect(effect, seed, scale)] if effect else [])


def sail(boat: Boat, seconds: float, mission_seed: int, run: int = 1, kind: str = "mixed") -> tuple[Recording, Mission]:
    """Simulate a random mission of a boat and return the recording."""
    mission = make_mission(kind, seconds, mission_seed)
    t, n = mission.setpoints()
    return simulate(boat, t, n, seconds, run), mission


def push(bench: Bench, run: int = 0, kind: str = "all", **plan: Any) -> tuple[Recording, Mission]:
    """Simulate a bench plan and return the recording. ``plan`` contains the other arguments of `bench_plan`."""
    mission = bench_plan(kind, "thruster", **plan)
    t, n = mission.setpoints()
    return simulate_bench(bench, t, n, mission.end, run), mission


def channels_of(recording: Recording) -> dict[str, Channel]:
    """Return the channels that ``seatrial.ident.data.loading`` would find in the boat's log."""
    table, found = tables(recording.readings), {}
    for name, column in (("psi", "yaw"), ("r", "r"), ("ax", "ax"), ("ay", "ay")):
        found[name] = _channel(table["ahrs"], column)
    x, y = local_ned(table["gnss"]["lat"], table["gnss"]["lon"])
    t = table["gnss"]["t"].copy()
    found |= {"x": Channel(t, x), "y": Channel(t, y)}
    found |= {"vx": _channel(table["gnss"], "vel_n"), "vy": _channel(table["gnss"], "vel_e")}
    for node, side in ((1, "left"), (2, "right")):
        shaft = _channel(table[f"esc/{node}/state"], "rpm")
        found[f"n_{side}"] = Channel(shaft.t, shaft.value / RPM_MAX)
    return found


def bench_channels_of(recording: Recording) -> dict[str, Channel]:
    """Return command, shaft speed and force of a bench run, under the names of the bench's log."""
    table = tables(recording.readings)
    shaft = _channel(table["esc/1/state"], "rpm")
    calibration = rig_of("bench").device("loadcell").calibration
    assert calibration is not None
    cell = _channel(table["loadcell"], "counts")
    return {
        "n_cmd_thruster": _channel(table["esc/1/command"], "n_cmd"),
        "n_thruster": Channel(shaft.t, shaft.value / RPM_MAX),
        "force": Channel(cell.t, calibration.force(cell.value)),
    }


def write_log(
    path: Path, kind: str, readings: Sequence[Reading], mission: Mission | None = None, events: Sequence[str] = ()
) -> Path:
    """Record readings as the acquisition of the packaged rig ``kind`` would. ``events`` are marks at the end."""
    attachments = {} if mission is None else {"mission.toml": dump_mission(mission).encode()}
    return record(path, rig_of(kind), readings, attachments, events)


def record(
    path: Path,
    rig: Rig,
    readings: Sequence[Reading],
    attachments: Mapping[str, bytes] | None = None,
    events: Sequence[str] = (),
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Record readings as the acquisition of a rig would."""
    recorder = Recorder(path, rig=rig, clock=StandingClock(), attachments=attachments, metadata=metadata)
    force = {d.name: d.calibration.force for d in rig.devices if d.calibration is not None}
    for device, sample, t in readings:
        if isinstance(sample, LoadCell):
            sample = replace(sample, force=float(force[device](sample.counts)))
        t_device = t if isinstance(sample, Ahrs) else NAN
        recorder.write(device, Frame(sample, T0 + t + 1e-3, t_device), T0 + t)
    for text in events:
        recorder.event(T0 + readings[-1].t, "mark", text)
    recorder.close()
    return path


def boat_log(path: Path, boat: Boat, seconds: float, mission_seed: int, run: int = 1, kind: str = "mixed") -> Path:
    """Simulate a mission and record it at ``path``."""
    recording, mission = sail(boat, seconds, mission_seed, run, kind)
    return write_log(path, "boat", recording.readings, mission)


def bench_log(path: Path, bench: Bench, run: int = 0, kind: str = "all", **plan: Any) -> Path:
    """Simulate a bench plan and record it at ``path``."""
    recording, mission = push(bench, run, kind, **plan)
    return write_log(path, "bench", recording.readings, mission)


def _channel(table: NDArray[np.void], column: str) -> Channel:
    good = np.isfinite(table[column])
    return Channel(table["t"][good].copy(), table[column][good].copy())
