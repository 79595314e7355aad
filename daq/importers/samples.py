"""Tables of decoded samples: logs of autopilots (tlog, BIN) and of CAN buses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from seatrial.daq.config import load_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.mavlink import mismatches, read_autopilot, vehicle_type
from seatrial.daq.importers.table import SourceOptions, Table, clock_remark
from seatrial.daq.samples import MEASURED, Event, Frame, Gnss

FIX_2D = 2  # Gnss.fix; the position of a lower kind of fix is invalid


def sample_tables(path: Path, rows: Sequence[tuple[str, float, Frame]]) -> list[Table]:
    """Sort decoded samples into one table for each kind of sample and node: `ahrs`, `gnss`, `esc_1`.

    Parameters
    ----------
    path
        The source file.
    rows
        Device, time [s] and decoded sample (with its times of receipt and of the device), in the order of the file.
        Samples of other kinds than `MEASURED`, for example events, are left out.

    Returns
    -------
    list of Table
        The tables, each in the order of time. Columns without any value are left out. If there are several devices,
        topics begin with the name of the device. The position of a fix below 2D is NaN.
    """
    found: dict[str, tuple[str, list[float], list[list[float]], list[str]]] = {}
    several = len({device for device, _, _ in rows}) > 1
    for device, t, frame in rows:
        sample = frame.sample
        if not isinstance(sample, MEASURED):
            continue
        kind = type(sample).__name__
        node = f"_{sample.node}" if hasattr(sample, "node") else ""
        topic = f"{device}_{kind.lower()}{node}" if several else f"{kind.lower()}{node}"
        names = [field.name for field in fields(sample) if field.name != "node"]
        _, times, values, _ = found.setdefault(topic, (kind, [], [], names))
        times.append(t)
        row = [float(getattr(sample, name)) for name in names]
        if isinstance(sample, Gnss) and sample.fix < FIX_2D:
            row[names.index("lat")] = row[names.index("lon")] = float("nan")
        values.append(row)
    tables = []
    for topic, (kind, times, values, names) in found.items():
        clock, block = np.array(times), np.array(values)
        order = np.argsort(clock, kind="stable")
        columns = {name: block[order, k] for k, name in enumerate(names) if np.isfinite(block[:, k]).any()}
        tables.append(Table(path, topic, columns, clock[order], kind, clock=clock_remark(clock)))
    return tables


def read_autopilot_log(path: Path, options: SourceOptions) -> list[Table]:
    """Read a tlog or a DataFlash log of an autopilot as tables, for an import map.

    Parameters
    ----------
    path
        The log of an autopilot.
    options
        `rig` is the rig file that names and scales the outputs, and `system` selects a MAVLink system.

    Returns
    -------
    list of Table
        One table for each kind of sample and node, with the parameters and the type of the vehicle. The first has the
        events of the log. Differences of the parameters from the rig are remarks of the table of their output.

    Raises
    ------
    SeatrialError
        If the log cannot be read or contains no measurements.
    """
    rig = None if options.rig is None else load_rig(options.rig)
    rows, _, parameters = read_autopilot(path, rig, options.system)
    if not (tables := sample_tables(path, [("", row.t, row.frame) for row in rows])):
        raise SeatrialError(
            f"{path}: contains no attitudes, fixes or outputs; check the message rates of the autopilot, and record "
            "again"
        )
    vehicle, wrong = vehicle_type(path, rows, options.system), mismatches(parameters, rig)
    for table in tables:
        table.vehicle, table.parameters = vehicle, parameters
        prefix = f"{table.topic.upper().replace('_', '')}_"  # SERVO1_ for the topic servo_1
        found = [str(mismatch) for mismatch in wrong if mismatch.name.startswith(prefix)]
        remarks = [
            *([table.remark] if table.remark else []),
            *(f"differs from the rig: {mismatch}" for mismatch in found),
        ]
        table.remark = "; ".join(remarks)
    tables[0].events = [(row.t, row.frame.sample) for row in rows if isinstance(row.frame.sample, Event)]
    return tables
