"""Checks of held signals: each row of a table repeats the value of a slower sensor.

A fit would take each repeated value for a new measurement.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from seatrial.daq.checks import WARNING, Finding, group_held_signals, held_signals, is_measured
from seatrial.ident.checks.inputs import INPUTS
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.model import is_of_thruster

LEAST_LATE_S = 0.1  # average delay of a held input; a smaller one gives no warning
SENSED = ("psi", "r", "ax", "ay", "x", "y", "vx", "vy", "u", "v", "speed", "phi", "theta", "p", "q", "force")


def check_held_inputs(c: Channels) -> Iterator[Finding]:
    """Yield a warning for each thruster input whose table repeats a slower measurement in its rows.

    A fit uses the value of each row at the time of the row. A held input is therefore late by half its sample interval
    on average.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Only commands, shaft speeds and thrusts of one thruster that an import map
        declares with the hold ``zero`` or ``linear`` are examined. An average delay below 0.1 s gives no warning. Nor
        does an input whose values are commanded steps and not measurements (`seatrial.daq.checks.is_measured`).
    """
    inputs = sorted(n for n in c if is_of_thruster(n, *INPUTS))
    for name in (n for n in inputs if c[n].hold in ("zero", "linear")):
        held = held_signals(c[name].t, {name: c[name].value}).get(name)
        interval = 0.0 if held is None else held.rows * float(np.median(np.diff(c[name].t)))
        if held is None or interval < 2.0 * LEAST_LATE_S or not is_measured(c[name].value[held.new], interval):
            continue
        text = (
            f"each value repeats for {interval:.3g} s until the next one, so that the signal is "
            f"{interval / 2.0:.2g} s late on average"
        )
        advice = (
            'in the import map, set hold = "linear" (measured shaft speed) or "sampled" (command), and remove '
            'repeats = "keep"'
        )
        yield Finding(WARNING, "input-held", "repeats", name, text, advice)


def check_held(c: Channels) -> Iterator[Finding]:
    """Yield a warning for sensors whose values are held from one measurement to the next.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Only motion signals and ``force`` (`SENSED`) are examined. Signals with the
        same times that are held together share one warning.

    Notes
    -----
    The import with a map leaves repeated values out. They remain if a device repeats its last value, or if the map has
    ``repeats = "keep"``.
    """
    tables: list[list[str]] = []  # names of signals with the same times
    for name in (n for n in SENSED if n in c):
        same = next((table for table in tables if np.array_equal(c[table[0]].t, c[name].t)), None)
        if same is None:
            tables.append([name])
        else:
            same.append(name)
    for table in tables:
        t = c[table[0]].t
        found = held_signals(t, {name: c[name].value for name in table})
        for names, held in group_held_signals(found):
            interval, n_again = held.rows * float(np.median(np.diff(t))), t.size - int(held.new.sum())
            text = (
                f"{n_again} of {t.size} values only repeat the value before (the sensor measures every "
                f"{interval:.3g} s), but a fit takes each for a new measurement"
            )
            advice = 'raise the output rate of the device, or remove repeats = "keep" from the import map'
            yield Finding(WARNING, "values-held", "repeats", names, text, advice)
