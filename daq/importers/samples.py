"""Samples of our own decoders -> tables: autopilots' logs (tlog, BIN) and CAN buses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from seatrial.daq.config import load_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.mavlink import mismatches, read_autopilot, vehicle_type
from seatrial.daq.importers.table import SourceOptions, Table, ran_back
from seatrial.daq.samples import MEASURED, Event, Frame, Gnss

FIX_2D = 2


def sample_tables(path: Path, rows: Sequence[tuple[str, float, Frame]]) -> list[Table]:
    """A table for each kind of sample and node, `ahrs`, `gnss`, `esc_1`, from (device, time, frame); several devices
    have their names in front."""
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
        tables.append(Table(path, topic, columns, clock[order], kind, clock=ran_back(clock)))
    return tables


def read_autopilot_log(path: Path, options: SourceOptions) -> list[Table]:
    """The samples of a tlog or a DataFlash log. Raises SeatrialError."""
    rig = None if options.rig is None else load_rig(options.rig)
    rows, _, parameters = read_autopilot(path, rig, options.system)
    if not (tables := sample_tables(path, [("", row.t, row.frame) for row in rows])):
        raise SeatrialError(f"{path}: no attitude, fixes or outputs in it")
    vehicle, wrong = vehicle_type(path, rows, options.system), mismatches(parameters, rig)
    for table in tables:
        table.vehicle, table.parameters = vehicle, parameters
        own = f"{table.topic.upper().replace('_', '')}_"  # SERVO1_ of servo_1
        found = [str(one) for one in wrong if one.name.startswith(own)]
        remarks = [*([table.remark] if table.remark else []), *(f"not as the rig has it: {one}" for one in found)]
        table.remark = "; ".join(remarks)
    tables[0].events = [(row.t, row.frame.sample) for row in rows if isinstance(row.frame.sample, Event)]
    return tables
