"""Checks of each device in a log: rate, time stamps, clock, noise, plausible values, stuck sensors, port counters.

Whether devices agree with each other is checked from the motion (seatrial.ident.checks.sensors,
seatrial.ident.checks.shafts).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from seatrial.daq.checks.boat_numbers import check_boat_numbers
from seatrial.daq.checks.findings import FAULT, OK, WARNING, Finding, joined
from seatrial.daq.checks.import_checks import check_missing_inputs, check_rows_left_out
from seatrial.daq.checks.run_end import check_run_end
from seatrial.daq.checks.thruster_coverage import check_thruster_coverage
from seatrial.daq.clock import ClockMap
from seatrial.daq.errors import counted
from seatrial.daq.log import Log, armed_intervals, schema
from seatrial.daq.rig import Device, Rig
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Command, Esc, Gnss, LoadCell, PortHealth, Scalar
from seatrial.daq.sensor_limits import FLAGGED_SHARE, STUCK_IN_LOG, can_be_stuck

Tables = list[tuple[type, str, Any]]  # kind of sample, name in findings, table
FloatArray = npt.NDArray[np.float64]
RATE_TOLERANCE = 0.2  # part of the expected rate by which the measured rate may differ
WRONG_RATE = "check the device's output rate, its baud rate, and rate_hz of the rig"
# An autopilot sends at its own rates until it receives our request after its first heartbeat. This part of a log, at
# most this many seconds, is left out of its rate.
UNASKED, UNASKED_S = 1.0 / 3.0, 10.0
AT_REST = 5.0  # a load cell is at rest if its counts are within this many of their smallest steps
MOST_DIGITS = 6  # digits of counts after the decimal point, at most
# White noise of a sample above which an AHRS is too noisy for a fit: a few times that of a VN-100 on a boat.
NOISE = {"yaw": (math.radians(2.0), "rad"), "r": (0.05, "rad/s")}
GRAVITY, GRAVITY_PART = 9.81, 0.15  # m/s2, and the part of it by which the specific force may differ
LARGE_COMMAND_CHANGE = 0.1  # of full command; a larger change must change the shaft speed
NO_FIX = 0.05  # part of the samples that may lack a position
FEW_SATELLITES = 6
REPEATED = 0.02  # part of the samples of an imported signal that may not be later than the previous one
BUNCHED, BUNCHES = 0.1, 5  # the same part for a device without a clock, and the smallest number of such samples
FEW_STILL = 0.05  # part of the samples that suffices to check gravity
TURNING = 0.1  # rad/s; in a faster turn the specific force is not gravity alone
GAP_S, GAP_PERIODS = 1.0, 10.0  # s, and median sample periods; a pause longer than both is a missing section
SILENT_S = 5.0  # s before the end of the log; a device that ends earlier has fallen silent
TICK_S = 1e-3  # s; rounding of one time to ms and to us differs by less, and a restarted clock runs back by more
# Length of a block [s], and its number of samples, at least. The earliest arrival in each block gives the clock offset.
BLOCK_S, BLOCK_SAMPLES = 2.0, 5.0
JUMP_S, SPREAD_S, DRIFT = 0.1, 0.1, 500e-6  # largest jump [s], delay [s] and drift (no unit) of a good clock
WALL_JITTER_S = 0.05  # wall s by which any busy machine may be late
LEAST = 200  # smallest number of time stamps whose digits are checked


def check_devices(log: Log) -> Iterator[Finding]:
    """Check all devices in an open log, and the log itself for damage and clocks that ran back. Yield all findings.

    They are in the order of the checks, not of severity. Without a rig in the log, the checks against its values
    (rates, voltage, charge, missing devices and thrusters) are left out, and times are checked as those of imported
    signals.
    """
    rig = log.rig
    for text in log.warnings:
        yield Finding(
            WARNING,
            "log-damaged",
            "log",
            log.path.name,
            text,
            "`seatrial recover` writes a complete log from what is readable",
        )
    for text in (text for _, kind, text in log.events() if kind == "clock"):
        source, _, text = text.partition(": ")
        yield Finding(
            FAULT,
            "clock-ran-back",
            "clock",
            source,
            text,
            "its clock was set back: import the data before and after this step separately",
        )
    for topic, (n, longest) in log.clock_steps.items():
        text = f"its times ran back {counted(n, 'time')}, by up to {longest:.1f} s"
        yield Finding(
            FAULT,
            "clock-ran-back",
            "clock",
            topic,
            text,
            "the times come from two clocks, or from one that was set: import the data of each clock separately",
        )
    last_samples: list[tuple[str, float]] = []
    armed = armed_intervals(log)
    for source, tables in _tables_by_device(log).items():
        tables = [row for row in tables if len(row[2])]  # a part of a log may contain no sample of a kind
        last_samples += [(name, float(table["t"][-1])) for _, name, table in tables]
        device = next((d for d in rig.devices if d.name == source), None) if rig else None
        timing: list[Finding] = []
        for _, name, table in tables:
            timing += check_timestamps(
                name, table, log.end if rig else None, rig.speed if rig else 1.0, armed.get(source, ()), log.skipped
            )
        yield from _check_rate(source, device, log, tables, any(f.code == "sections-missing" for f in timing))
        yield from timing
        for kind, name, table in tables:
            yield from _check_stuck(kind, name, table)
            yield from _VALUE_CHECKS.get(kind, _no_findings)(name, table, rig)
        yield from _check_port_counters(source, log)
    yield from check_boat_numbers(log.vehicle)
    yield from check_run_end(log, last_samples)
    yield from _check_devices_present(log, rig)
    yield from check_thruster_coverage(log)
    yield from _check_shaft_speeds(log)
    yield from _check_imported_signals(log, next(iter(armed.values()), ()))


def _tables_by_device(log: Log) -> dict[str, Tables]:
    """Return the tables of samples in a log, by name of the device, each as (kind of sample, name in findings, table).

    Only attitudes, fixes, load cells, batteries and speed controllers are included. Speed controllers have a table for
    each node. The name in findings is that of the device for its first table, "DEVICE KIND" for others, and "DEVICE
    node N" for a speed controller. An autopilot that sends only its state has an empty list.
    """
    found: dict[str, Tables] = {}
    for kind in (Ahrs, Gnss, LoadCell, Battery):
        for source in log.sources(kind):
            name = f"{source} {kind.__name__.lower()}" if source in found else source
            found.setdefault(source, []).append((kind, name, log.table(kind, source)))
    for source in log.sources(Esc):
        for node in log.nodes(Esc, source):
            found.setdefault(source, []).append((Esc, f"{source} node {node}", log.table(Esc, source, node)))
    for source in log.sources(Autopilot):
        found.setdefault(source, [])
    return found


def _check_devices_present(log: Log, rig: Rig | None) -> Iterator[Finding]:
    """Yield a fault for each device of the rig without a sample in the log; none if the log has no rig (`rig` None).

    A topic of the device with a message suffices. Commands to a device do not count as samples.
    """
    topics = [name.split("/")[1:] for name in log.counts]
    present = {parts[0] for parts in topics if len(parts) > 1 and parts[-1] != "command"}
    for device in rig.devices if rig else ():
        if device.name not in present:
            yield Finding(
                FAULT,
                "device-not-in-log",
                "alive",
                device.name,
                "the log contains no sample of it",
                "check power, cable, port and baud rate",
            )


def _check_rate(source: str, device: Device | None, log: Log, tables: Tables, gaps_known: bool) -> Iterator[Finding]:
    """Compare the rate of the samples of one device with `rate_hz` of the rig, and yield the finding.

    A fault is a difference of more than 20 %, fewer than three samples, or samples of one time only. Of an autopilot or
    NMEA 2000 bus not all samples count (`_rated_times`). Of an autopilot only the attitudes count. Its attitudes in the
    first third of their time, at most in the first 10 s, are left out, because the autopilot then still sends at its
    own rates. The rates of an autopilot in an imported log are reported for each kind of sample, and not compared. The
    samples of all controllers of a bus count together. A device without tables has no finding, except an autopilot
    whose rate is compared.

    Parameters
    ----------
    source : str
        Name of the device.
    device : Device or None
        Device of the rig; None if the rig lacks it. The rate is then reported and not compared.
    log : Log
        The log.
    tables : Tables
        Tables of samples of the device: kind of sample, name in findings, table.
    gaps_known : bool
        Whether another finding reports missing sections. If the rate without these sections is as expected, that rate
        is then used.
    """
    # In an imported tlog the ground station has set the rates, so that `rate_hz` does not apply.
    ours = device is not None and (device.protocol != "mavlink" or log.metadata.get("import") != "mavlink")
    t = _rated_times(device if ours else None, tables)
    if device is not None and device.protocol == "mavlink" and ours and t.size < 3:
        text = f"{counted(t.size, 'attitude') if t.size else 'no attitudes'}, expected {device.rate_hz:g} per second"
        yield Finding(FAULT, "rate-off", "rate", source, text, WRONG_RATE)
        return
    if t.size < 3 or t[-1] == t[0]:
        if tables:
            yield Finding(
                FAULT,
                "too-few-samples",
                "rate",
                source,
                f"only {t.size} samples in the log",
                "check power, cable and protocol",
            )
        return
    if device is not None and device.protocol == "mavlink" and ours:
        requested = t[t >= t[0] + min(UNASKED * (t[-1] - t[0]), UNASKED_S)]
        t = requested if requested.size > 1 and requested[-1] > requested[0] else t
    # The times of all nodes of a bus are checked together, so that only a gap common to all nodes counts.
    pauses = np.diff(t)
    missing_s = float(pauses[pauses > max(1.0, 20.0 * float(np.median(pauses)))].sum())
    span = float(t[-1] - t[0])
    rate = (t.size - 1) / span
    rate_without_gaps = (t.size - 1) / max(span - missing_s, 1e-9)
    if device is not None and gaps_known and abs(rate_without_gaps / device.rate_hz - 1.0) < RATE_TOLERANCE:
        rate = rate_without_gaps  # samples lost in gaps are reported as missing sections
    if device is None or not ours:
        yield Finding(OK, "rate-measured", "rate", source, _rates_text(tables))
    elif abs(rate - device.rate_hz) > RATE_TOLERANCE * device.rate_hz:
        yield Finding(FAULT, "rate-off", "rate", source, f"{rate:.4g} Hz, expected {device.rate_hz:g}", WRONG_RATE)
    else:
        yield Finding(OK, "rate-as-expected", "rate", source, f"{rate:.4g} Hz, expected {device.rate_hz:g}")


def _rates_text(tables: Tables) -> str:
    """Return the mean rates of the samples of one device as text, such as ``imu 10 Hz, gnss 5 Hz, state 25 Hz each``.

    A rate is that of one topic as `seatrial info` defines it: number of samples minus one, over the time from the first
    to the last one. The topics of several controllers have the mean of their rates, with the word "each". The name of
    the topic is left out if there is only one.
    """
    rates: dict[str, list[float]] = {}
    for kind, _, table in tables:
        span = float(np.ptp(table["t"])) if len(table) else 0.0
        if span > 0.0:
            rates.setdefault(schema.topic(kind, source="", node=0).rpartition("/")[2], []).append(
                (len(table) - 1) / span
            )
    texts = [(name, f"{np.mean(found):.4g} Hz{' each' if len(found) > 1 else ''}") for name, found in rates.items()]
    return texts[0][1] if len(texts) == 1 else ", ".join(f"{name} {text}" for name, text in texts)


def _rated_times(device: Device | None, tables: Tables) -> FloatArray:
    """Return the sorted times (n,) [s] of the samples that count for the rate of a device.

    They are the samples of the kind to which `rate_hz` of the rig applies (`Device.is_rated`), for example the
    attitudes of an autopilot. If `device` is None, all samples count. `tables` has kind, name and table of the samples
    of the device.
    """
    with_attitudes = any(kind is Ahrs and np.isfinite(table["yaw"]).any() for kind, _, table in tables)
    found = [np.empty(0)]
    for kind, _, table in tables:
        rated = device is None or device.is_rated(kind, table["yaw"] if kind is Ahrs else None, with_attitudes)
        found.append(table["t"][np.broadcast_to(rated, len(table))])
    return np.sort(np.concatenate(found))


def _check_stuck(kind: type, name: str, table: Any) -> Iterator[Finding]:
    """Yield a fault if a sensor is stuck: all its values stay exactly the same for too many samples and too long.

    `table` has the samples of one device, `kind` is their class, and `name` the device in the finding. The limits are
    in STUCK_IN_LOG (daq/sensor_limits.py), for example 10 attitudes and 0.5 s; kinds without limits there are not
    checked. Only the longest such interval is reported. Samples that repeat without a fault do not count, for example
    those of a load cell without load.
    """
    if kind not in STUCK_IN_LOG:
        return
    start = float(table["t"][0])
    alive = _rows_that_can_be_stuck(kind, table)
    table = table if alive.all() else table[alive]
    # An autopilot sends attitudes and accelerations in different rows. Each row is compared only with rows that lack
    # the same columns. A bit mask stands for the missing columns, since np.unique of rows takes sixty times as long.
    form = np.zeros(len(table), np.uint8)
    for k, column in enumerate(STUCK_IN_LOG[kind].fields):
        form |= np.isnan(table[column]).view(np.uint8) << k
    forms = np.flatnonzero(np.bincount(form))
    found = [run for f in forms for run in _constant_intervals(kind, table if forms.size == 1 else table[form == f])]
    if found:
        since, until = max(found, key=lambda run: run[1] - run[0])
        text = f"the same values for {until - since:.1f} s, from {since - start:.1f} s on"
        yield Finding(
            FAULT,
            "sensor-stuck",
            "stuck",
            name,
            text,
            "the sensor is stuck: switch it off and on, and check its firmware and the settings of its filter",
        )


def _rows_that_can_be_stuck(kind: type, table: Any) -> Any:
    """Return a mask (n,) of the samples in a table whose values would change from sample to sample if the sensor works.

    `kind` is the class of the samples. For a load cell these are the samples with counts of at least 5 of their
    smallest steps (AT_REST), because under load even coarse counts flicker. For other kinds `can_be_stuck` decides: an
    AHRS with a roll rate, or with heading and specific force, and a GNSS sample with a time.
    """
    if kind is not LoadCell:
        return can_be_stuck(kind, table.view(np.recarray))
    counts = table["counts"]
    return np.abs(counts) >= AT_REST * _smallest_step(counts)


def _smallest_step(counts: Any) -> float:
    """Return the smallest step other than zero between two successive counts (n,) of a load cell, in counts.

    The step is positive. If all counts are equal, return the unit of their last decimal digit, such as 0.01 for 12.34
    and 1 for 12.
    """
    steps = np.abs(np.diff(counts))
    if (steps := steps[steps > 0.0]).size:
        return float(steps.min())
    digits = (d for d in range(MOST_DIGITS) if np.round(counts[0], d) == counts[0])
    return 10.0 ** -next(digits, MOST_DIGITS)


def _constant_intervals(kind: type, table: Any) -> Iterator[tuple[float, float]]:
    """Yield begin and end [s] of each interval in which all compared values of a sensor stay the same for too long.

    `kind` is the class of the samples in `table`. The compared columns, the smallest number of repeats and the shortest
    duration come from STUCK_IN_LOG in daq/sensor_limits.py. All rows of the table must lack (NaN) the same columns;
    such columns count as equal. The interval begins at the first of the equal samples and ends at the last.
    """
    columns, samples, seconds = STUCK_IN_LOG[kind]
    same = np.ones(max(len(table) - 1, 0), dtype=bool)
    for column in columns:
        values = table[column]
        same &= (values[1:] == values[:-1]) | np.isnan(values[1:])  # all rows lack the same columns
        if not same.any():
            return  # a working sensor; mostly its first column is sufficient
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        since, until = float(table["t"][a]), float(table["t"][b])
        if b - a >= samples and until - since >= seconds:
            yield since, until


def _check_ahrs(name: str, table: Any, rig: Rig | None) -> Iterator[Finding]:
    """Check noise, specific force and mounting of an AHRS in a log, and yield the findings.

    Faults are white noise above 2 deg in yaw or 0.05 rad/s in yaw rate. If there is no such fault, the noise is
    reported, provided that of the yaw rate is known. Warnings are a median specific force that differs from 9.81 m/s2
    by more than 15 %, and a median roll or pitch beyond 20 deg. Samples in turns above 0.1 rad/s do not count for the
    specific force if more than 5 % others remain. Quantities that the AHRS does not report, and noise of fewer than 23
    values, are not checked. `table` has the samples of the AHRS, `name` is the device in the findings, and `rig` is not
    used.
    """
    is_quiet, noises = True, dict[str, float]()
    for column, (limit, unit) in NOISE.items():
        noise = noises[column] = white_noise_sd(_finite_values(table, column))
        if noise > limit:
            is_quiet = False
            text = f"{column} has white noise of {noise:.2g} {unit}, expected below {limit:.2g}"
            yield Finding(
                FAULT,
                "sensor-noisy",
                "noise",
                name,
                text,
                "check vibration, mounting and interference, and the unit of the value",
            )
    yaw, rate = noises["yaw"], noises["r"]
    if is_quiet and math.isfinite(rate):
        yaw_text = f"yaw {math.degrees(yaw):.2g} deg, " if math.isfinite(yaw) else ""
        text = f"{yaw_text}yaw rate {rate:.2g} rad/s a sample"
        yield Finding(OK, "sensor-noise-as-expected", "noise", name, text)
    force = np.sqrt(sum(table[c] ** 2 for c in ("ax", "ay", "az")))
    finite = np.isfinite(force)
    still = finite & ~(np.abs(table["r"]) > TURNING)
    finite = still if np.count_nonzero(still) > FEW_STILL * np.count_nonzero(finite) else finite
    g = float(np.median(force[finite])) if finite.any() else GRAVITY
    if abs(g / GRAVITY - 1.0) > GRAVITY_PART:
        cause = ": is it in g?" if abs(g - 1.0) < 0.2 else ": is it without gravity?" if g < 1.0 else ""
        yield Finding(
            WARNING,
            "specific-force-not-gravity",
            "units",
            name,
            f"specific force is {g:.3g} m/s2 and not 9.81{cause}",
            "set the sensor to send the specific force with gravity, in m/s2",
        )
    tilt = max(abs(float(np.nanmedian(table[c]))) if np.isfinite(table[c]).any() else 0.0 for c in ("roll", "pitch"))
    if tilt > 0.35:
        text = f"roll or pitch is {math.degrees(tilt):.0f} deg in the median"
        yield Finding(
            WARNING,
            "sensor-not-level",
            "mounting",
            name,
            text,
            "its axes must be forward, starboard, down: check its mounting and its reference frame",
        )


def _finite_values(table: Any, column: str) -> FloatArray:
    """Return the finite values (n,) of one column of a table of samples, in order. Yaw angles [rad] are unwrapped.

    The array is shorter than the table if values are NaN or infinite.
    """
    values: FloatArray = table[column][np.isfinite(table[column])]
    return np.unwrap(values) if column == "yaw" else values


def white_noise_sd(values: FloatArray) -> float:
    """Estimate the standard deviation of the white noise of a signal that changes slowly.

    Parameters
    ----------
    values : Array (n_samples,)
        The signal, in any unit.

    Returns
    -------
    float
        Robust estimate, in the unit of the signal, from the median of the second differences; NaN if fewer than 21 of
        these are finite.
    """
    second = np.diff(values, 2)
    second = second[np.isfinite(second)]
    return float(np.median(np.abs(second)) / 0.6745 / math.sqrt(6.0)) if second.size > 20 else math.nan


def _check_gnss(name: str, table: Any, rig: Rig | None) -> Iterator[Finding]:
    """Check the fixes and satellites of a GNSS receiver in a log, and yield the findings.

    Warnings are positions at 0 N 0 E, more than 5 % of the samples without a position, and a median below 6 satellites.
    It is a fault if no sample has a position. A sample has a position if its `fix` is 2 or more and it is not at 0 N 0
    E. The median of the satellites is over samples with a position that report a number of satellites (not -1). `table`
    has the samples of the receiver, `name` is the device in the findings, and `rig` is not used.
    """
    at_zero = (table["fix"] >= 2) & (table["lat"] == 0.0) & (table["lon"] == 0.0)
    if at_zero.any():
        first = float(table["t"][int(np.argmax(at_zero))] - table["t"][0])
        text = f"{counted(int(at_zero.sum()), 'position')} at 0 N 0 E left out, the first at {first:.1f} s"
        yield Finding(
            WARNING,
            "fixes-at-zero",
            "fix",
            name,
            text,
            "the receiver reports a fix that it does not have: check its antenna and firmware; a fit ignores them",
        )
    fixes = (table["fix"] >= 2) & ~at_zero
    if np.mean(~fixes) > NO_FIX:
        text = f"no position in {100 * np.mean(~fixes):.0f} % of the epochs"
        yield Finding(
            WARNING if fixes.any() else FAULT,
            "position-missing",
            "fix",
            name,
            text,
            "check the antenna, its cable, and its view of the sky",
        )
    used = table["n_sat"][(table["n_sat"] >= 0) & fixes]
    if used.size and np.median(used) < FEW_SATELLITES:
        yield Finding(
            WARNING,
            "few-satellites",
            "fix",
            name,
            f"{np.median(used):.0f} satellites in the median, expected at least {FEW_SATELLITES}",
            "check the antenna, its cable, and its view of the sky",
        )


def _check_esc_voltage(name: str, table: Any, rig: Rig | None) -> Iterator[Finding]:
    """Compare the voltage of a speed controller in a log with `limits.voltage_min_v` of the rig, and yield the finding.

    The voltage is the median of its last 20 values that are not NaN. There is no finding without a rig, a limit or a
    voltage. `table` has the samples of the controller, and `name` is its name in the finding.
    """
    lowest = None if rig is None else rig.limits.voltage_min_v
    volts = table["voltage"][np.isfinite(table["voltage"])]
    if lowest is not None and volts.size:
        yield _voltage_finding(name, float(np.median(volts[-20:])), lowest)


def _voltage_finding(name: str, volts: float, lowest: float) -> Finding:
    """Compare a voltage [V] of the device `name` with its lower limit [V] and return the finding.

    It is a fault below the limit, a warning from the limit to less than 5 % above it, and in order otherwise.
    """
    if volts < lowest:
        return Finding(FAULT, "voltage-low", "battery", name, f"{volts:.1f} V, limit {lowest:g}", "charge the battery")
    near = volts < 1.05 * lowest
    level, code, advice = (
        (WARNING, "voltage-near-limit", "charge the battery soon") if near else (OK, "voltage-as-expected", "")
    )
    return Finding(level, code, "battery", name, f"{volts:.1f} V, limit {lowest:g}", advice)


def _check_load_cell(name: str, table: Any, rig: Rig | None) -> Iterator[Finding]:
    """Yield a warning if more than 1 % of the samples of a load cell are flagged as saturated or as spikes.

    Otherwise there is no finding. `table` has the samples, `name` is the device in the finding, and `rig` is not used.
    """
    bad = float(np.mean(table["flags"] != 0))
    if bad > FLAGGED_SHARE:
        text = f"{100 * bad:.0f} % of the samples are saturated or spikes"
        yield Finding(
            WARNING,
            "load-cell-saturated",
            "load cell",
            name,
            text,
            "check its supply and wires, and whether the load is beyond its range",
        )


def _check_battery(name: str, table: Any, rig: Rig | None) -> Iterator[Finding]:
    """Compare the remaining charge in the last sample of a battery with `limits.battery_min` of the rig.

    Charge and limit are parts of the full charge, 0 to 1. Yield a fault if the charge is below the limit, and otherwise
    a finding that it is in order. There is no finding without a rig or a limit, or if the charge is NaN. `table` has
    the samples, at least one, and `name` is the device in the finding.
    """
    left, least = table["remaining"][-1], None if rig is None else rig.limits.battery_min
    if least is not None and np.isfinite(left):
        low = left < least
        level, code, advice = (FAULT, "battery-low", "charge the battery") if low else (OK, "battery-as-expected", "")
        yield Finding(level, code, "battery", name, f"{100 * left:.0f} % left, limit {100 * least:.0f}", advice)


_VALUE_CHECKS = {
    Ahrs: _check_ahrs,
    Gnss: _check_gnss,
    Esc: _check_esc_voltage,
    LoadCell: _check_load_cell,
    Battery: _check_battery,
}


def _no_findings(name: str, table: Any, rig: Rig | None) -> Iterator[Finding]:
    """Return no finding. This is the check of kinds of samples whose values are not checked."""
    return iter(())


def _check_port_counters(source: str, log: Log) -> Iterator[Finding]:
    """Check the last counters of the port of the device `source` in a log, and yield the findings.

    Warnings are checksum errors, more than one and more than 0.1 % of the frames; unparsed bytes, more than 200 plus
    1 % of the received ones; any dropped sample; and any reopening of the port after a loss. A log without counters of
    the port has no finding.
    """
    if source not in log.sources(PortHealth) or not (rows := log.health(source)):
        return
    last = rows[-1][1]
    if last.checksum_errors > max(1, 0.001 * last.frames):
        text = f"{last.checksum_errors} checksum errors in {last.frames} frames"
        yield Finding(
            WARNING,
            "checksum-errors",
            "link",
            source,
            text,
            "check ground and cable, and that only one program uses the port",
        )
    if last.unparsed_bytes > 0.01 * last.bytes_in + 200:
        text = f"{last.unparsed_bytes} of {last.bytes_in} received bytes not understood"
        yield Finding(
            WARNING,
            "bytes-not-understood",
            "link",
            source,
            text,
            "check the baud rate, and which messages the device sends",
        )
    if last.dropped:
        text = f"{counted(last.dropped, 'sample')} dropped, because the disk was too slow"
        yield Finding(WARNING, "samples-dropped", "link", source, text, "use a faster disk")
    if last.reconnects:
        text = f"its port was lost {counted(last.reconnects, 'time')}"
        yield Finding(WARNING, "port-lost", "link", source, text, "check plug and cable")


def _check_shaft_speeds(log: Log) -> Iterator[Finding]:
    """Yield a finding for each speed controller whose shaft speed stays exactly equal while its command changes.

    The speed must stay equal for more than 2 s, and the commands within this time must differ by more than 0.1 of full
    command. Those of its last second do not count, because the shaft responds with a delay. Not checked are a speed of
    zero, controllers without commands in the log, and those with fewer than 20 samples. A controller has at most one
    finding: a warning if its telemetry saturates (`_is_limit`), otherwise a fault.
    """
    for source in log.sources(Esc):
        for node in log.nodes(Esc, source):
            if node not in log.nodes(Command, source):
                continue
            table, commands = log.table(Esc, source, node), log.table(Command, source, node)
            rpm, t = table["rpm"], table["t"]
            if len(t) < 20 or np.isnan(rpm).all():
                continue
            edges = np.flatnonzero(np.concatenate([[True], rpm[1:] != rpm[:-1], [True]]))
            first, last = edges[:-1], edges[1:] - 1
            held = (rpm[first] != 0.0) & (t[last] - t[first] > 2.0)
            order = np.argsort(commands["t"], kind="stable")
            t_cmd, n_cmd = commands["t"][order], commands["n_cmd"][order]
            for a, b in zip(first[held], last[held], strict=True):
                # Commands of the last second do not count, because the shaft responds with a delay.
                during = n_cmd[np.searchsorted(t_cmd, t[a], "right") : np.searchsorted(t_cmd, t[b] - 1.0)]
                if during.size > 1 and np.ptp(during) > LARGE_COMMAND_CHANGE:
                    text = f"{rpm[a]:.0f} rev/min for {t[b] - t[a]:.1f} s while its command changed"
                    level, code = FAULT, "shaft-speed-stuck"
                    advice = (
                        "check its speed sensor and the CAN bus; or fit by the commands (--model horizontal:command)"
                    )
                    if _is_limit(rpm[a], rpm[first[held]], rpm, during):
                        text += f" from {during.min():.2g} to {during.max():.2g}: its telemetry reports no larger speed"
                        level, code = WARNING, "shaft-speed-saturated"
                        advice = (
                            "raise the limit of the telemetry; until then fit by the commands "
                            "(--model horizontal:command), or with --effect shaft-clip"
                        )
                    yield Finding(level, code, "stuck", f"{source} node {node}", text, advice)
                    break


def _is_limit(value: float, held: Any, rpm: Any, commands: Any) -> bool:
    """Return whether a shaft speed that stays equal is the limit of the telemetry, and no stuck sensor.

    It is the limit if it is the largest magnitude in the log, if the speed stays there at least twice, and if all
    commands in this time have its sign and are not near zero.

    Parameters
    ----------
    value : float
        The speed that stays equal [rev/min].
    held : Array (n_held,)
        Speeds [rev/min] of all times in which the speed stays equal for more than 2 s.
    rpm : Array (n,)
        All speeds of the controller [rev/min].
    commands : Array (n_commands,)
        Commands (-1 to 1) in the time of ``value``.
    """
    at_limit = abs(value) >= float(np.nanmax(np.abs(rpm)))
    return (
        at_limit and int(np.sum(np.abs(held) == abs(value))) > 1 and bool(np.all(commands * value > 0.1 * abs(value)))
    )


def _check_imported_signals(log: Log, armed: Sequence[tuple[float, float]]) -> Iterator[Finding]:
    """Check the imported signals of a log, and yield the findings.

    They are, for example, about rows that the import left out, unknown inputs, damaged or repeated time stamps, missing
    sections of outputs, and outputs with the same value in all of more than 20 samples. The same finding about several
    signals is one finding. A log that was not imported has no finding, except about the signals of transducers, which
    are checked like outputs. ``armed`` are the times [s] in which the autopilot of the log was armed.
    """
    by_map = log.attachments.get("import.toml", b"").replace(b"'", b'"')
    yield from check_rows_left_out(log.metadata)
    yield from check_missing_inputs(log)
    if b"unpadded-ns" in by_map:
        text = "the nanoseconds of time stamps had lost their leading zeros; the import map has restored them"
        advice = "repair the logger that wrote the time stamps"
        yield Finding(WARNING, "lost-zeros-restored", "time", log.path.name, text, advice)
    yield from joined(f for source in log.sources(Scalar) for f in _check_signal(log, source, armed))


def _check_signal(log: Log, source: str, armed: Sequence[tuple[float, float]]) -> Iterator[Finding]:
    """Check the time stamps of a signal, and whether an output is constant, and yield the findings.

    ``armed`` are the times [s] in which the autopilot of the log was armed.
    """
    table = log.table(Scalar, source)
    # An imported command holds until the next one, so that a pause between commands is not a missing section.
    here = check_timestamps(source, table, None, armed=armed, skipped=log.skipped)
    yield from (f for f in here if f.check != "gap" or log.role(source) == "output")
    yield from check_lost_zeros(source, table["t"])
    if len(table) > 20 and log.role(source) == "output" and np.nanstd(table["value"]) == 0.0:
        text = f"its value is {table['value'][0]:g} in all samples"
        yield Finding(
            WARNING,
            "signal-constant",
            "stuck",
            source,
            text,
            "check whether the sensor was connected, and its column in the import map",
        )


def check_timestamps(
    name: str,
    table: Any,
    end: float | None,
    speed: float = 1.0,
    armed: Sequence[tuple[float, float]] = (),
    skipped: float = 0.0,
) -> Iterator[Finding]:
    """Check the times of the samples of one device or signal, and yield the findings.

    Of an imported signal, times that do not increase for more than 2 % of the samples are a fault; its gaps are then
    not checked. Of a device, more than 10 % such samples (at least 5), which have arrived in bunches, are a warning,
    and an end more than 5 s of the run clock, and more than 1 s of wall time, before that of the log is a fault. Gaps
    (`_check_gaps`) and the device's clock (`_check_clock`) are checked too. Fewer than three samples are not checked.

    Parameters
    ----------
    name : str
        Name of the device or signal.
    table : structured array
        Table with the columns t, t_rx and t_device [s].
    end : float or None
        End of the log [s]; None for an imported signal. An imported signal may be a command, which ends with its last
        change.
    speed : float
        Run seconds per wall second.
    armed : sequence of tuple
        Begin and end [s] of the times in which the device, an autopilot, was armed. Empty: not known, or never.
    skipped : float
        Time [s] of the log before the first of these samples, if only a window of the log is checked.
    """
    t, imported = table["t"], end is None
    if len(t) < 3:
        return
    pauses = np.diff(t)
    repeated = float(np.mean(pauses <= 0.0))
    if imported and repeated > REPEATED:
        text = f"{100 * repeated:.0f} % of the samples are not later than the one before"
        yield Finding(
            FAULT,
            "times-not-increasing",
            "time",
            name,
            text,
            "its clock runs back or stands still: import it with rate_hz in place of these times",
        )
    elif repeated > BUNCHED and np.count_nonzero(pauses <= 0.0) >= BUNCHES:
        text = f"{100 * repeated:.0f} % of the samples came in bunches, so that their times of receipt are inexact"
        yield Finding(
            WARNING,
            "samples-bunched",
            "time",
            name,
            text,
            "set latency_timer of the USB adapter to 1 ms, and end other programs",
        )
        yield from _check_gaps(
            name, t[:-1][pauses > 0.0], pauses[pauses > 0.0], speed, imported, armed, skipped
        )  # from bunch to bunch
    else:
        yield from _check_gaps(name, t, pauses, speed, imported, armed, skipped)
    if end is not None and end - t[-1] > SILENT_S * max(1.0, 0.2 * speed):
        text = f"nothing for the last {end - t[-1]:.0f} s of the log"
        yield Finding(FAULT, "device-fell-silent", "silent", name, text, "check power, cable and bus")
    yield from _check_clock(name, table, speed)


def _check_gaps(
    name: str,
    t: FloatArray,
    pauses: FloatArray,
    speed: float,
    imported: bool,
    armed: Sequence[tuple[float, float]],
    skipped: float,
) -> Iterator[Finding]:
    """Yield a warning if pauses between samples are so long that sections of the data are missing.

    A pause is too long if it exceeds the longest of 1 s, 10 median sample periods and 0.2 s of wall time. Of an
    autopilot that was armed for a part of the log, this time counts in the armed part of a pause: others are reported
    as in order, because it may stop its log while it is disarmed.

    Parameters
    ----------
    name : str
        Name of the device or signal.
    t : Array (n,)
        Times of the samples [s], at which the pauses begin. It may have one item more than `pauses`.
    pauses : Array (n - 1,) or (n,)
        Times between successive samples [s].
    speed : float
        Run seconds per wall second.
    imported : bool
        Whether the signal is imported. An imported signal of n samples with 0.02 n + 1 long pauses or more is written
        only when it changes, and gives no warning.
    armed : sequence of tuple
        Begin and end [s] of the times in which the device was armed. Empty: all pauses count.
    skipped : float
        Time [s] of the log before the first sample, added to the time in the finding.
    """
    least = max(GAP_S, GAP_PERIODS * float(np.median(pauses)), 4.0 * WALL_JITTER_S * speed)
    long = np.flatnonzero(pauses > least)
    # An imported signal that is written only when it changes has many long pauses without a missing section.
    if not long.size or (imported and not long.size < 0.02 * t.size + 1.0):
        return
    begin, end = t[long], t[long] + pauses[long]
    in_arms = sum((np.maximum(np.minimum(end, b) - np.maximum(begin, a), 0.0) for a, b in armed), np.zeros(long.size))
    counts = in_arms > least if armed else np.ones(long.size, dtype=bool)
    disarmed = f"{counted(int(np.sum(~counts)), 'section')}, {pauses[long[~counts]].sum():.1f} s in all, while disarmed"
    if not counts.any():
        yield Finding(OK, "sections-missing", "gap", name, f"data missing: {disarmed}")
        return
    long = long[counts]
    k = int(long[np.argmax(pauses[long])])
    missing = f"data missing: {counted(long.size, 'section')}, {pauses[long].sum():.1f} s in all"
    text = (
        f"{missing}, the longest ({pauses[k]:.1f} s) from {t[k] - t[0] + skipped:.1f} s on (pauses above {least:.3g} s)"
    )
    text += f"; beside them {disarmed}" if not counts.all() else ""
    advice = "check the cable, the range of the link, and the load of the computer"
    yield Finding(WARNING, "sections-missing", "gap", name, text, advice)


def _check_clock(name: str, table: Any, speed: float) -> Iterator[Finding]:
    """Check a device's clock for jumps, delays and drift against the run clock, and yield the findings.

    A clock that ran back by more than 1 ms (TICK_S), or jumps by more than 0.1 s, gives one fault, and nothing else is
    checked then. Samples of which 5 % are more than 0.1 s late give a warning. So does a drift above 500 ppm that adds
    up to more than 0.1 s, in a table of more than 60 s. A clock without them is reported as in order. On a run clock
    faster than wall time, 0.1 s of wall time take the place of each 0.1 s. `table` has the columns t_rx and t_device
    [s]. With fewer than 50 times of the device nothing is checked. With fewer than two blocks of `_earliest_arrivals`,
    only running back is checked. `name` is the device in the findings, and `speed` the number of run seconds per wall
    second.
    """
    has_clock = np.isfinite(table["t_device"])
    if np.count_nonzero(has_clock) < 50:
        return
    device, received = table["t_device"][has_clock], table["t_rx"][has_clock]
    if back := int(np.count_nonzero(np.diff(device) < -TICK_S)):
        text = f"its clock ran back {counted(back, 'time')}"
        yield Finding(
            FAULT,
            "clock-ran-back",
            "clock",
            name,
            text,
            "the device restarted (check its power), or GNSS set its clock (start the log after the first fix)",
        )
        return
    offset = received - device
    earliest = _earliest_arrivals(received, offset)
    if earliest[0].size < 2:
        return
    jitter = 2.0 * WALL_JITTER_S * max(speed, 1.0)
    late = float(np.quantile(offset - np.interp(received, *earliest), 0.95))
    steps = np.abs(np.diff(earliest[1]))
    if steps.size and steps.max() > max(JUMP_S, jitter):
        text = f"its clock jumps by {steps.max():.2f} s against the computer's"
        yield Finding(
            FAULT,
            "clock-jumps",
            "clock",
            name,
            text,
            "its clock was set during the run: leave that part of the log out, or begin the log later",
        )
        return
    if late > max(SPREAD_S, jitter):
        text = f"one sample in twenty arrives {late:.2f} s late"
        yield Finding(
            WARNING,
            "samples-late",
            "clock",
            name,
            text,
            "set latency_timer of the USB adapter to 1 ms, and end other programs; the times are those of the device",
        )
    span = float(received[-1] - received[0])
    drift = float(np.polyfit(earliest[0] - received[0], earliest[1], 1)[0]) if earliest[0].size > 3 else 0.0
    if span > 60.0 and abs(drift) > max(DRIFT, jitter / span):
        text = f"its clock drifts by {1e6 * drift:.0f} ppm"
        advice = f"replace it, if it is no simulator; beyond {1e6 * ClockMap.SKEW_MAX:.0f} ppm its times jump"
        yield Finding(WARNING, "clock-drifts", "clock", name, text, advice)
    elif late <= max(SPREAD_S, jitter):
        yield Finding(
            OK,
            "clock-steady",
            "clock",
            name,
            f"the delays of the samples agree within {1e3 * max(late, 0.0):.0f} ms",
        )


def _earliest_arrivals(received: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return receive times and clock offsets [s] of the samples with the smallest offset in each block of time.

    The offset of a sample is its receive time minus its device time, so that the smallest one belongs to the sample
    with the shortest delay. The two arrays have one item per block, in order of time. A block lasts 2 s, or 5 median
    sample periods if that is longer. Blocks with fewer than three samples are left out. `received` (n,) are receive
    times, and `offset` (n,) is receive time minus device time [s].
    """
    long = max(BLOCK_S, BLOCK_SAMPLES * float(np.median(np.diff(received))))
    block = ((received - received[0]) / long).astype(int)
    order = np.lexsort((offset, block))  # the earliest of each block first
    _, first, count = np.unique(block[order], return_index=True, return_counts=True)
    best = order[first[count > 2]]
    return received[best], offset[best]


def check_lost_zeros(name: str, t: FloatArray) -> Iterator[Finding]:
    """Yield a fault if a logger wrote the fractions of time stamps without leading zeros (12.5 for 12.005).

    No such time stamp lies in the first tenth of its second: it is a fault if fewer than 0.2 % of all do, and more than
    3 % lie in each other tenth. Fewer than 200 time stamps are not checked.

    Parameters
    ----------
    name : str
        Name of the signal.
    t : Array (n_samples,)
        Times [s].
    """
    tenth = np.floor(np.mod(t, 1.0) * 10.0).astype(int)
    share = np.bincount(tenth, minlength=10)[:10] / max(t.size, 1)
    if t.size >= LEAST and share[0] < 0.002 and share[1:].min() > 0.03:
        text = f"none of {t.size} time stamps is in the first tenth of its second: leading zeros were lost"
        yield Finding(
            FAULT,
            "lost-zeros",
            "time",
            name,
            text,
            'write `fraction = "unpadded-ns"` into [time] of the import map, and import again',
        )
