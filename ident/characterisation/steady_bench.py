"""Steady-state table of a bench log, its electrical efficiency, and the settings that autopilots derive from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array, mean_error, steady_segments, welch_spectrum

# s: time that is left out after a change of command, and least time before the next change over which is averaged
SETTLED_S, AVERAGED_S = 1.0, 0.6
AVERAGED_SHARE = 0.5  # of a longer command; its first half may still have a transient of the flow in the pool
MIN_SAMPLES = 4  # of a signal in that time; with fewer it has no mean
EXPO_BOUNDS = (-1.0, 1.0)  # range of MOT_THST_EXPO: -1 is a root, 0 a line, 1 a square
LEAST_W = 1.0  # W, smallest electrical power with an efficiency
TURNS = 0.01  # of full speed; a slower shaft is at rest, and has no efficiency
COHERENT = 0.8  # smallest coherence of command and shaft speed at which the measured response is used
SEGMENT_S = 20.0  # length of the segments of the measured response
CYCLE_GAIN = 1e-3  # smallest part of the command's largest spectral density at which the response is used


@dataclass(frozen=True)
class SteadyRow:
    """Means over the end of one constant command. Quantities that were not measured are NaN.

    Attributes
    ----------
    command, n : float
        Command and normalised shaft speed, -1 to 1.
    force, force_se : float
        Force and its standard error [N], without the offset of the load cell.
    voltage, current, power : float
        Voltage [V], current [A] and electrical power [W] of the supply.
    torque : float
        Torque of the shaft [N m].
    """

    command: float
    n: float
    force: float
    force_se: float
    voltage: float
    current: float
    power: float
    torque: float


def steady_rows(channels: Mapping[str, Channel], command: str, speed: str, bias: float = 0.0) -> list[SteadyRow]:
    """Return the steady-state table of a bench log: a row for each command that was held for 1.6 s or longer.

    A row has means over the second half of its command, or its last 0.6 s if this is longer. A quantity with fewer than
    four samples in this time is NaN, and a row without a shaft speed is left out.

    Parameters
    ----------
    channels : mapping
        Signals of the log: the command, the shaft speed, and as far as measured ``force``, ``voltage``, ``current``
        (both of the supply), ``power`` and ``torque``.
    command, speed : str
        Names of the command and of the shaft speed.
    bias : float
        Offset of the load cell [N], which is subtracted from the force.
    """
    held = channels[command]
    end_of_log = max(float(held.t[-1]), float(channels[speed].t[-1]))
    rows = []
    for steady in steady_segments(held.t, held.value, end_of_log):
        if steady.duration < SETTLED_S + AVERAGED_S:
            continue
        begin = steady.end - max(AVERAGED_S, AVERAGED_SHARE * steady.duration)
        names = (speed, "force", "voltage", "current", "power", "torque")
        inside = {n: _inside(channels.get(n), begin, steady.end) for n in names}
        mean = {n: float(v.mean()) if v.size >= MIN_SAMPLES else np.nan for n, v in inside.items()}
        if np.isnan(mean[speed]):
            continue
        force = inside["force"]
        error = float(mean_error(force)[0]) if force.size >= MIN_SAMPLES else np.nan
        value = float(held.value[np.searchsorted(held.t, steady.end - AVERAGED_S, side="right") - 1])
        rows.append(
            SteadyRow(
                value, mean[speed], mean["force"] - bias, error, mean["voltage"], mean["current"], mean["power"],
                mean["torque"],
            )
        )  # fmt: skip
    return rows


def _inside(channel: Channel | None, begin: float, end: float) -> Array:
    """Return the finite values of a channel from ``begin`` [s] to before ``end`` [s]; empty for None."""
    if channel is None:
        return np.empty(0)
    found: Array = channel.value[(channel.t >= begin) & (channel.t < end)]
    return found[np.isfinite(found)]


def newtons_per_watt(n: Array, force: Array, power: Array) -> Array:
    """Return the efficiency of each row of a steady-state table: absolute force over electrical power [N/W].

    It is NaN for a shaft at rest (below 1 % of full speed), for a power below 1 W, and where a quantity is unknown.

    Parameters
    ----------
    n, force, power : Array (n_rows,)
        Normalised shaft speed, force [N] and electrical power [W].
    """
    turns = (np.abs(n) >= TURNS) & (power >= LEAST_W)
    found: Array = np.where(turns, np.abs(force) / np.maximum(power, LEAST_W), np.nan)
    return found


def thrust_expo(command: Array, force: Array) -> float:
    """Return the exponent of ArduPilot's thrust curve, its parameter MOT_THST_EXPO, by least squares.

    The curve is ``thrust = (1 - expo) throttle + expo throttle^2``. The throttle is a part of the largest command, and
    the thrust a part of the mean force at that command.

    Parameters
    ----------
    command, force : Array (n,)
        Commands and forces, of which the positive commands are used.

    Returns
    -------
    float
        Exponent, within -1 to 1. NaN for fewer than three different positive commands with a force, or if the mean
        force at the largest command is not positive.
    """
    ahead = (command > 0.0) & np.isfinite(force)
    if np.unique(command[ahead]).size < 3:
        return np.nan
    top = command[ahead].max()
    x, largest = command[ahead] / top, float(force[ahead][command[ahead] == top].mean())
    if not largest > 0.0:
        return np.nan
    bend = x * x - x
    return float(np.clip(bend @ (force[ahead] / largest - x) / (bend @ bend), *EXPO_BOUNDS))


def measured_response(command: Channel, speed: Channel, rate: float) -> tuple[Array, Array, Array]:
    """Return the measured frequency response of the shaft speed to its command, by Welch's method.

    Frequencies at which the command is weak, or at which command and shaft speed are hardly coherent, are left out.

    Parameters
    ----------
    command, speed : Channel
        Command, which holds until its next sample, and shaft speed, which is interpolated.
    rate : float
        Rate to which both are sampled [Hz].

    Returns
    -------
    tuple of Array (n_frequencies,)
        Frequencies [Hz], gains, and phases [rad]. They are empty for a record that is too short.
    """
    length = int(SEGMENT_S * rate)
    t = np.arange(max(command.t[0], speed.t[0]), min(float(speed.t[-1]), float(command.t[-1]) + SEGMENT_S), 1.0 / rate)
    if t.size < 2 * length:
        return np.empty(0), np.empty(0), np.empty(0)
    x = command.value[np.searchsorted(command.t, t, side="right") - 1]
    y = np.interp(t, speed.t, speed.value)
    f = np.fft.rfftfreq(length, 1.0 / rate)
    cross = welch_spectrum(x, length, y)
    input_density, output_density = welch_spectrum(x, length), welch_spectrum(y, length)
    coherence = np.abs(cross) ** 2 / np.maximum(input_density * output_density, np.finfo(float).tiny)
    used = (f > 0.0) & (coherence > COHERENT) & (input_density > CYCLE_GAIN * input_density.max())
    ratio = cross[used] / input_density[used]
    return f[used], np.abs(ratio), np.unwrap(np.angle(ratio))
