"""Figures 4.1-4.3 and 6.1-6.6 of the paper with simulated data, as input of ``benchmarks.thesis.figures``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.figures import Chart, Curve, Drawing, Part
from benchmarks.thesis.fits import Both, Plane, Rest, predicted
from seatrial.ident.characterisation.sensor_noise import welch
from seatrial.ident.numerics.linear_algebra import Array

Z95 = 1.96
START = 5.0  # s, initial transient of the filter, which the figures leave out


def noise_part(rest: Mapping[str, Rest]) -> Part:
    """Return the section with figures 4.1 and 4.2, on sensor noise. ``rest`` has the sensors at rest by channel."""
    return Part(
        "noise",
        "Sensor noise",
        [
            Drawing(
                "Figure 4.1: accelerometer at rest",
                "Hz",
                [_density_chart(rest[n]) for n in ("ax", "ay")],
                "The curves are Welch's periodogram, the identified model (white noise plus random walk) and the true "
                "density.",
            ),
            Drawing("Figure 4.2: magnetometer at rest", "Hz", [_density_chart(rest[n]) for n in ("mx", "my", "mz")]),
        ],
    )


def _density_chart(rest: Rest) -> Chart:
    """Return a panel with the spectral densities of a sensor at rest: periodogram, identified model and truth."""
    f, power = _logarithmic_means(*welch(rest.channel))
    (white, walk), dt = rest.truth, rest.found.interval
    truth = 2 * dt * (white**2 + walk**2 * dt / (4 * np.sin(np.pi * f * dt) ** 2))
    curves = [
        Curve("periodogram", f, power, "measured"),
        Curve("identified", f, rest.found.psd(f)),
        Curve("truth", f, truth, "other"),
    ]
    return Chart(f"{rest.channel.source} [({rest.channel.unit})²/Hz]", curves, log=True)


def _logarithmic_means(f: Array, power: Array, per_decade: int = 60) -> tuple[Array, Array]:
    """Return means of frequency and power over bins of equal width in the logarithm of the frequency.

    Parameters
    ----------
    f : Array (n,)
        Frequencies [Hz], above zero.
    power : Array (n,)
        Spectral density at these frequencies.
    per_decade : int
        Number of bins in each decade. Empty bins are left out.

    Returns
    -------
    tuple of Array (n_bins,)
        Mean frequency [Hz] and mean spectral density of each bin.
    """
    index = np.unique(np.floor(per_decade * np.log10(f)), return_inverse=True)[1]
    count = np.bincount(index)
    return np.bincount(index, f) / count, np.bincount(index, power) / count


def bench_part(both: Both) -> Part:
    """Return the section with figure 4.3: measured and predicted response of the thruster of ``both``."""
    record = both.record
    t, free, late = record.t, predicted(both), record.t > 35
    late &= record.t < 50

    def charts(rows: NDArray[np.bool_], outputs: Sequence[tuple[int, str]]) -> list[Chart]:
        """Return a panel for each of ``outputs`` (column and title), with the selected ``rows``."""
        return [
            Chart(
                title,
                [Curve("measured", t[rows], record.y[rows, j], "measured"), Curve("model", t[rows], free[rows, j])],
            )
            for j, title in outputs
        ]

    command = Curve("command", t, record.u[:, 0], "other")
    whole = charts(np.ones(t.size, dtype=bool), [(0, "shaft speed, normalised"), (1, "force [N]")])
    whole[0] = Chart(whole[0].title, [command, *whole[0].curves])
    return Part(
        "bench",
        "Thruster",
        [
            Drawing(
                "Figure 4.3, left: response to the steps and chirps",
                "s",
                whole,
                "The model predicts shaft speed and force from the command alone.",
            ),
            Drawing("Figure 4.3, right: the last steps", "s", charts(late, [(1, "force [N]")])),
        ],
    )


def predictor_part(turn: Both, run: Both) -> Part:
    """Return the section with figures 6.1 (yaw, ``turn``) and 6.2 (surge, ``run``).

    They compare predictions by output error and by prediction error with the measurement.
    """
    t, r = turn.record.t, turn.record.y[:, 0]
    ahead = r - turn.filtered.e[:, 0]
    yaw = Drawing(
        "Figure 6.1: yaw rate, measured and predicted",
        "s",
        [
            Chart(
                "yaw rate [rad/s]",
                [
                    Curve("measured", t, r, "measured"),
                    Curve("OE: from the moment alone", t, turn.simulated.y[:, 0], "other"),
                    Curve("PE: one sample ahead", t, ahead),
                ],
            ),
            Chart(
                "measured minus predicted [rad/s]",
                [
                    Curve("OE: from the moment alone", t, r - turn.simulated.y[:, 0], "other"),
                    Curve("PE: one sample ahead", t, r - ahead),
                ],
            ),
        ],
        "The residuals of output error are coloured, since its model has no process noise.",
    )
    t, x = run.record.t, run.record.y[:, 0]
    oe, pe = run.simulated.y[:, 0], x - run.filtered.e[:, 0]
    h = np.diff(t)
    speed = [
        Curve("measured", t[1:], np.diff(x) / h, "measured"),
        Curve("OE", t[1:], np.diff(oe) / h, "other"),
        Curve("PE: one sample ahead", t[1:], np.diff(pe) / h),
    ]
    surge = Drawing(
        "Figure 6.2: position, and its first differences",
        "s",
        [
            Chart(
                "position [m]",
                [
                    Curve("measured", t, x, "measured"),
                    Curve("OE", t, oe, "other"),
                    Curve("PE: one sample ahead", t, pe),
                ],
            ),
            Chart(
                "measured minus predicted [m]",
                [Curve("OE", t, x - oe, "other"), Curve("PE: one sample ahead", t, x - pe)],
            ),
            Chart("first differences [m/s]", speed),
        ],
    )
    return Part("predictors", "Output error and prediction error", [yaw, surge])


def innovation_part(three: Plane, six: Plane) -> Part:
    """Return the section with figures 6.3 to 6.6, on the innovations of 3DOF (``three``) and 6DOF K (``six``)."""
    return Part(
        "innovations",
        "Innovations of the models in the plane",
        [
            _innovation_drawing("Figure 6.3: surge acceleration, 3DOF", three, ("ax",), "m/s2"),
            _innovation_drawing("Figure 6.4: surge acceleration, 6DOF K", six, ("ax",), "m/s2"),
            _innovation_drawing("Figure 6.5: position, 3DOF", three, ("x", "y"), "m"),
            _innovation_drawing("Figure 6.6: position, 6DOF K", six, ("x", "y"), "m"),
            correlations(three, six),
        ],
    )


def _innovation_drawing(title: str, plane: Plane, channels: Sequence[str], unit: str) -> Drawing:
    """Return a figure of the innovations of some channels, with their predicted 95 % interval and a mean over 2 s.

    The first 5 s are left out. ``unit`` is the unit of all channels.
    """
    charts = []
    for name in channels:
        t, e, sd = (z[plane.innovations(name)[0] > START] for z in plane.innovations(name))
        charts.append(
            Chart(
                f"{name} [{unit}]",
                [
                    Curve("95 % interval of the filter", t, -Z95 * sd, "band", Z95 * sd),
                    Curve("innovation", t, e, "measured"),
                    Curve("mean over 2 s", t, _moving_mean(t, e, 2.0)),
                ],
            )
        )
    return Drawing(title, "s", charts)


def _moving_mean(t: Array, e: Array, seconds: float) -> Array:
    """Return the moving mean (n,) of ``e`` (n,) over ``seconds``, at least three samples; ``t`` (n,) are times [s]."""
    width = max(3, round(seconds / float(np.median(np.diff(t)))))
    return np.convolve(e, np.ones(width) / width, mode="same")


def correlations(three: Plane, six: Plane) -> Drawing:
    """Return a figure of the autocorrelations of the innovations of both models, for lags of 1 to 40 samples.

    The channels are ax and x. The difference of the models is hard to see in the other figures.
    """
    charts = []
    for name in ("ax", "x"):
        curves = []
        for label, plane in (("3DOF", three), ("6DOF K", six)):
            t, e, sd = plane.innovations(name)
            z = e / sd - np.mean(e / sd)
            acf = np.array([z[k:] @ z[: z.size - k] for k in range(1, 41)]) / (z @ z)
            lags: Array = np.asarray(np.arange(1, 41) * float(np.median(np.diff(t))))
            curves.append(Curve(label, lags, acf, "other" if plane is three else "model"))
            if plane is six:
                half = np.full(40, Z95 / np.sqrt(z.size))
                curves.append(Curve("95 % of white noise", lags, -half, "band", half))
        charts.append(Chart(f"autocorrelation of {name}", curves))
    return Drawing("Autocorrelation of the innovations", "lag, s", charts, "This figure is not in the paper.")
