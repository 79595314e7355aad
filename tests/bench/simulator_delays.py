"""Delays of heading, yaw rate and fixes in a BIN, relative to the state that ArduPilot's simulator writes beside them.

The model `nomoto` assumes that the heading is exact at its time stamps and that the velocity is along the heading. It
therefore estimates the delays of the other signals relative to the heading, which is itself 0.9 ms late. The velocity
of the simulator is one integration step, 0.83 ms, ahead of its own heading. The gyro passes a low-pass filter of second
order. The receiver truncates its speed to whole mm/s, which lowers the speed by half a mm/s on average and appears as a
spread in turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pymavlink import DFReader
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from seatrial.daq.log import open_log
from seatrial.ident.data import Channel, channels

Array = NDArray[np.float64]
COARSE_S, MARGIN_S = 0.1, 5.0  # grid on which clocks are matched; time that is left out at both ends
PASSED_S = 1.0  # time scale that separates delay from the slower error of the estimator's heading
FILTER_S = 1e-3  # time step of the gyro's filter


def simulated(path: Path) -> tuple[Array, Array, Array, Array]:
    """Return times [s], heading [rad], and the velocity along the heading, north and east [m/s], of the simulator."""
    log = DFReader.DFReader_binary(str(path))
    rows: dict[str, list[tuple[float, ...]]] = {"SIM": [], "SIM2": []}
    while (m := log.recv_match(type=list(rows))) is not None:
        values = (m.Q1, m.Q4) if m.get_type() == "SIM" else (m.VN, m.VE)
        rows[m.get_type()].append((1e-6 * m.TimeUS, *values))
    (t, q1, q4), (t_v, north, east) = (np.array(rows[name]).T for name in rows)
    psi = np.unwrap(2 * np.arctan2(q4, q1))
    ahead = np.cos(psi) * np.interp(t, t_v, north) + np.sin(psi) * np.interp(t, t_v, east)
    return t, psi, ahead * np.cos(psi), ahead * np.sin(psi)


def delays(log: Path, bin_log: Path) -> dict[str, float]:
    """Return T_r, tau_gnss and sigma_gnss [s] of an imported BIN, by the simulator's state in the same BIN."""
    with open_log(log) as opened:
        c = channels(opened)
    t, psi, north, east = simulated(bin_log)
    heading = CubicSpline(t, psi)
    first = _matched(c["psi"], t, psi)
    inside = (t[0] + MARGIN_S, t[-1] - MARGIN_S)

    def part(channel: Channel) -> tuple[Array, Array]:
        moved = channel.t - first
        keep = (moved > inside[0]) & (moved < inside[1])
        return moved[keep], channel.value[keep]

    t_psi, measured = part(Channel(c["psi"].t, np.unwrap(c["psi"].value)))
    passed = round(PASSED_S / float(np.median(np.diff(t_psi))))

    def quick(x: Array) -> Array:
        return x - np.convolve(x, np.full(passed, 1 / passed), mode="same")

    late = _best(lambda p: quick(measured - heading(t_psi - p[0])), [0.0])[0]
    t_r, rate = part(c["r"])
    fine = np.arange(t[0], t[-1], FILTER_S)
    turning = heading(fine, 1)
    gyro = _best(lambda p: rate - p[1] - np.interp(t_r, fine, _filtered(turning, p[0])), [0.05, 0.0])[0]
    (t_v, v_n), (_, v_e) = part(c["vx"]), part(c["vy"])
    speed = np.hypot(v_n, v_e)
    both = [(CubicSpline(t, of), v, v / np.where(speed > 0, speed, 1.0)) for of, v in ((north, v_n), (east, v_e))]

    def of_fix(p: Array) -> Array:
        then = [(of(t_v - p[0] - p[1]) + of(t_v - p[0] + p[1])) / 2 - v - p[2] * way for of, v, way in both]
        return np.concatenate(then)

    age, spread, _ = _best(of_fix, [0.1, 0.1, 0.0])
    return {"T_r": gyro - late, "tau_gnss": age - late, "sigma_gnss": abs(spread)}


def _matched(channel: Channel, t: Array, psi: Array) -> float:
    """Return the offset from times of the BIN to times of the channel [s], to within a step of the grid."""
    span = channel.t[-1] - channel.t[0], t[-1] - t[0]
    grids = [np.arange(0.0, s, COARSE_S) for s in span]
    rates = [np.diff(np.interp(x0 + g, x, y)) for x0, g, x, y in (
        (channel.t[0], grids[0], channel.t, np.unwrap(channel.value)), (t[0], grids[1], t, psi))]  # fmt: skip
    lag = int(np.argmax(np.correlate(rates[0], rates[1], mode="full"))) - (rates[1].size - 1)
    return float(channel.t[0] - t[0] + COARSE_S * lag)


def _filtered(rate: Array, delay: float) -> Array:
    """Filter a rate by a Butterworth filter of second order, whose delay of slow motion is `delay` [s].

    The step is ``FILTER_S``.
    """
    corner = math.sqrt(2.0) / delay
    continuous = ([corner**2], [1.0, math.sqrt(2.0) * corner, corner**2])
    ahead, back, _ = cont2discrete(continuous, FILTER_S, method="foh")
    return np.asarray(lfilter(np.ravel(ahead), back, rate))


def _best(residuals: Callable[[Array], Array], start: list[float]) -> list[float]:
    found: list[float] = least_squares(residuals, start, x_scale=0.01).x.tolist()
    return found
