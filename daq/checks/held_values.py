"""Detection of held values: a faster table repeats the last value of a slow sensor in each row.

Each measurement is then in the table several times. A fit that takes each row for a measurement gives the sensor too
much weight, and takes old values as new ones.

Notes
-----
A repeated value alone proves nothing: a coarse sensor repeats its value, and so does a boat at rest. Values are held
only if all three are true:

- The value changes at a regular pace, of more than one row.
- Most changes are larger than one step of the resolution. A coarse sensor changes by one step.
- Repeats are much more frequent than changes by one step. For a measurement in each row they are about half as many.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FEWEST_RUNS = 10  # runs of equal values from which their length is judged
LEAST_REPEATED = 0.15  # share of rows that repeat, and of runs that are longer than one row
LEAST_REGULAR = 0.8  # share of the runs that have about the usual length
SLOWEST_S = 5.0  # s between measurements: what changes more rarely is a set-point, and no sensor
MOST_SINGLE_STEPS = 0.5  # share of the changes that may be one step of the resolution
TIMES_CHANCE = 4.0  # by which repeats exceed what the resolution explains
SAME_ROWS = 0.8  # share of common rows of change, from which two signals come from one sensor
WITHIN = 0.95  # share of the changes of a coarse signal that are at the changes of its sensor
# A held input is taken for a measurement of a slow sensor (a shaft speed), and not for a command, only if it changes
# often and rarely returns to a value. Interpolation would turn the steps of a command into ramps. Smallest number of
# values, smallest share of different values, longest time between two values [s].
FEWEST_LEVELS, LEAST_DIFFERENT, SLOWEST_INPUT_S = 50, 0.5, 1.05
LEAST_ROWS_OF_COMMAND = 2.0  # rows of the table for each sample of a recorded command (hold "sampled")
# Signals that one sensor measures at once: if one of them changes, the other one was measured too.
TOGETHER = (("x", "y"), ("vx", "vy"), ("u", "v"), ("ax", "ay"), ("speed_x", "speed_y"))


class HeldValues(NamedTuple):
    """Result for a slow sensor in a faster table: the rows with a measurement; all other rows repeat the last value.

    Attributes
    ----------
    rows
        Mean number of rows from one measurement to the next.
    new
        True in each row that has a measurement of its own, (n,).
    """

    rows: float
    new: Mask


def held_values(columns: Sequence[FloatArray]) -> HeldValues | None:
    """Decide whether a table repeats each measurement of a slow sensor in several rows, by the values of the sensor.

    The table does so if four conditions are fulfilled. At least 15 % of the rows repeat the row before; unusually long
    repeats of one value do not count for this. At least 15 % of the values stay for more than one row. Changes follow
    each other at a regular pace (80 % of the distances). The resolution of the sensor does not explain the repeats: at
    most half of the changes are by one step of the resolution, and the repeats are at least twice as many as these
    changes.

    Parameters
    ----------
    columns
        Values that the sensor measures at once, each (n,), row by row and without NaN.

    Returns
    -------
    HeldValues or None
        None if the rows are measurements, or if the data do not show whether values are held: for example, if the
        values change in fewer than 10 rows after the first.
    """
    changed = _rows_of_change(columns)
    first = np.flatnonzero(changed)
    lengths = np.diff(first)  # without the last run, whose end is not known
    if lengths.size < FEWEST_RUNS:
        return None
    mean = _mean_rows_between_changes(changed)
    regular = (lengths >= 0.4 * mean) & (lengths <= 1.6 * mean + 1.0)
    own = lengths[lengths <= 3.0 * mean + 1.0]  # longer runs may come from a boat at rest or a sensor that pauses
    repeated, longer = 1.0 - own.size / float(own.sum()), float(np.mean(lengths > 1))
    if min(repeated, longer) < LEAST_REPEATED or float(np.mean(regular)) < LEAST_REGULAR:
        return None
    single = _share_of_single_steps(columns, first[1:])
    by_resolution = 0.5 * single * own.size  # repeats that are expected of measurements
    if single > MOST_SINGLE_STEPS or repeated * float(own.sum()) < TIMES_CHANCE * by_resolution:
        return None
    return HeldValues(mean, _rows_of_measurement(changed, mean))


def held_signals(t: FloatArray, signals: Mapping[str, FloatArray]) -> dict[str, HeldValues]:
    """Find the signals of a table that are held: the table repeats each measurement in several rows.

    Signals that one sensor measures at once, such as x and y (TOGETHER), are judged together. Signals are also of one
    sensor if 80 % of the rows in which they change are common, and a signal too coarse to be judged alone, with at
    least 10 changes, if 95 % of its changes are in rows of the sensor. A signal that is measured less often than every
    5 s (SLOWEST_S) is taken for a set-point, and does not count as a sensor.

    Parameters
    ----------
    t
        Times of the rows (n,) [s], which increase.
    signals
        Values (n,) of each signal in the rows of the table, without NaN.

    Returns
    -------
    dict
        The held signals by name; empty if the times do not span any time, or for a single row. Signals of one sensor
        share their rows: a coarse signal that repeats its value in a row in which another signal of the sensor changes
        was measured there.
    """
    if t.size < 2 or not np.ptp(t) > 0.0:
        return {}
    slowest = SLOWEST_S * (t.size - 1) / float(np.ptp(t))  # rows
    groups = [tuple(n for n in names if n in signals) for names in TOGETHER]
    groups = [g for g in groups if g] + [(n,) for n in signals if not any(n in names for names in TOGETHER)]
    changed = {g: _rows_of_change([signals[n] for n in g]) for g in groups}
    held = []
    for g in groups:
        if (values := held_values([signals[n] for n in g])) is not None and values.rows <= slowest:
            held.append(g)
    sensors = {
        g: np.logical_or.reduce([changed[o] for o in held if _change_together(changed[g], changed[o])]) for g in held
    }
    found: dict[str, HeldValues] = {}
    for g in groups:
        sensor = sensors.get(g)
        if sensor is None and changed[g].sum() > FEWEST_RUNS:  # too coarse to be judged by itself
            within = [mask for mask in sensors.values() if np.mean(mask[changed[g]]) >= WITHIN]
            sensor = min(within, key=np.sum, default=None)
        if sensor is not None:
            mean = _mean_rows_between_changes(sensor)
            found.update(dict.fromkeys(g, HeldValues(mean, _rows_of_measurement(sensor, mean))))
    return found


def is_sampled_slower(held: HeldValues) -> bool:
    """Return whether a recorded command was sampled clearly more slowly than the table: every second row or less often.

    With fewer repeats, most of them are a command that did not change, which must not become a ramp.
    """
    return held.rows >= LEAST_ROWS_OF_COMMAND


def is_measured(levels: FloatArray, interval: float) -> bool:
    """Return whether a held input comes from a sensor or a joystick, and is not a sequence of commanded steps.

    The result is True if the input has at least 50 values, of which more than half are different, and `interval` is at
    most 1.05 s. Equal values that follow each other count once. Measurements may be interpolated; interpolation would
    turn commanded steps into ramps.

    Parameters
    ----------
    levels
        Values (n,) of the input in the rows with a measurement (`HeldValues.new`), at least one.
    interval
        Mean time between two of them [s], before equal values are joined.
    """
    levels = levels[np.append(True, levels[1:] != levels[:-1])]
    different = len(np.unique(levels)) / max(len(levels), 1)
    return len(levels) >= FEWEST_LEVELS and different > LEAST_DIFFERENT and interval <= SLOWEST_INPUT_S


def group_held_signals(found: Mapping[str, HeldValues]) -> list[tuple[str, HeldValues]]:
    """Group the held signals with equal numbers of measurements, which mostly come from one sensor.

    The user then gets one message for each group.

    Parameters
    ----------
    found
        Held signals by name.

    Returns
    -------
    list
        For each group the names, joined by commas, and the result for the first of them. Groups and names keep the
        order of `found`.
    """
    groups: dict[int, list[str]] = {}
    for name, held in found.items():
        groups.setdefault(int(held.new.sum()), []).append(name)
    return [(", ".join(names), found[names[0]]) for names in groups.values()]


def _mean_rows_between_changes(changed: Mask) -> float:
    """Return the mean number of rows from one change of a signal to the next.

    `changed` (n,) is true in rows in which the signal changes. Distances of more than three times the median are left
    out. There must be at least two changes; otherwise the result is NaN.
    """
    lengths = np.diff(np.flatnonzero(changed))
    return float(np.mean(lengths[lengths <= 3.0 * np.median(lengths)]))


def _rows_of_change(columns: Sequence[FloatArray]) -> Mask:
    """Return a mask (n,) of rows in which any of the columns (n,) differs from the previous row.

    The first row is included, if there is one. At least one column is needed.
    """
    new = np.zeros(len(columns[0]), bool)
    new[:1] = True
    for column in columns:
        new[1:] |= column[1:] != column[:-1]
    return new


def _share_of_single_steps(columns: Sequence[FloatArray], rows: npt.NDArray[np.intp]) -> float:
    """Return the share (0 to 1) of the changes of a sensor's values that are at most one step of its resolution.

    `columns` are the values (n,) of each signal of the sensor, and `rows` are the indices of the rows in which any of
    them changes. In a counted row no signal changes by more than 1.5 times its resolution, which is its smallest change
    other than zero. The share is 1 if all signals are constant, and NaN without rows.
    """
    small = np.ones(rows.size, bool)
    for column in columns:
        steps = np.abs(column[rows] - column[rows - 1])
        sizes = steps[steps > 1e-12 * max(float(np.max(np.abs(column))), 1e-300)]
        if sizes.size:
            small &= steps <= 1.5 * sizes.min()
    return float(np.mean(small))


def _rows_of_measurement(changed: Mask, period: float) -> Mask:
    """Return a mask (n,) of the rows with a measurement of a slow sensor, from the rows in which its value changes.

    `changed` (n,) is the mask of these rows, and `period` is the mean number of rows between measurements. The rows of
    changes are kept. In a run of equal values that is longer than 2.5 periods, a row in each period is added, because
    the sensor has measured the same value again, as for a boat at rest.
    """
    new = changed.copy()
    first = np.append(np.flatnonzero(changed), changed.size)
    for k in np.flatnonzero(np.diff(first) > 2.5 * period):
        new[np.rint(np.arange(first[k], first[k + 1] - 0.5 * period, period)).astype(int)] = True
    return new


def _change_together(a: Mask, b: Mask) -> bool:
    """Return whether two signals change in mostly the same rows, so that they come from one sensor.

    `a` and `b` are masks (n,) of the rows of change. At least 80 % (SAME_ROWS) of the rows in which one of them changes
    must be rows in which both change.
    """
    return float(np.sum(a & b)) >= SAME_ROWS * float(np.sum(a | b))
