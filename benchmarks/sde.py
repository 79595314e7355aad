"""Benchmark of the estimation of a horizontal model with process noise on 12,000 rows.

The data are simulated by this file. A second data set, simulated by an independent program, is used if it is available.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import Figure, best_ms
from seatrial.ident.data.record import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import Fit, fit
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model

Array = NDArray[np.float64]
N_ROWS, H, SUBSTEPS = 12_000, 0.05, 20  # H [s]: time between rows; SUBSTEPS: integration steps per row
DIFFUSION = 0.01  # m/s/sqrt(s), rad/s/sqrt(s)
NOISE = {"psi": 0.01, "r": 0.005, "x": 0.05, "y": 0.05}
# ctsmTMB 1.1.1 on data/sde_bench/horizontal.csv, on another processor: likelihood [ms], likelihood with gradient [ms],
# optimiser [s], process with compilation [s], and the optimum of -ln L
PEER = {"value": 93.0, "gradient": 288.0, "estimate": 58.0, "cold": 197.0, "optimum": -119375.3959}
NAMES = {"value": "likelihood", "gradient": "likelihood and gradient", "scores": "likelihood, gradient, information"}
START = {"m_u": 60.0, "d_v": 30.0}  # initial values of the fit, far from the optimum


def model() -> Model:
    """Return the horizontal model without current, with a known initial state and inputs that are constant in a row.

    The model has 15 free parameters.
    """
    base = horizontal_model("general", ("attitude", "gyro", "position"), current=False, hold="zero")
    return replace(base, states=tuple(replace(s, from_output="", x0=0.0, sd0=0.01) for s in base.states))


def simulated(seed: int) -> Record:
    """Simulate a record of 12,000 rows by Euler-Maruyama, with the parameters of table 1 of the thesis.

    Force X and moment N are random steps. The outputs are psi, r, x and y with noise. The seed selects steps and noise.
    """
    rng = np.random.default_rng(seed)
    p = model().values
    X = np.repeat(rng.uniform(-20.0, 60.0, N_ROWS // 100), 100)
    N = np.repeat(rng.uniform(-6.0, 6.0, N_ROWS // 60), 60)
    s, y, h = np.zeros(6), np.empty((N_ROWS, 4)), H / SUBSTEPS
    shake = DIFFUSION * np.sqrt(h) * rng.normal(size=(N_ROWS, SUBSTEPS, 3))
    for k in range(N_ROWS):
        y[k] = s[2], s[5], s[0], s[1]
        for j in range(SUBSTEPS):
            s = s + h * rates(p, s, X[k], N[k])
            s[3:] += shake[k, j]
    y += rng.normal(size=y.shape) * list(NOISE.values())
    u = np.column_stack([X, N])
    t: Array = H * np.arange(N_ROWS, dtype=np.float64)
    return Record("simulated", t, u, u, y, ("X", "N"), tuple(NOISE))


def rates(p: dict[str, float], s: Array, X: float, N: float) -> Array:
    """Return the time derivative (6,) of the state ``s`` = (x, y, psi, u, v, r) under force X [N] and moment N [N m].

    ``p`` has masses and damping by name. The equations are written independently of the model, so that an error in the
    model can be detected.
    """
    _, _, psi, u, v, r = s.tolist()
    cos, sin = np.cos(psi), np.sin(psi)
    return np.array(
        [
            cos * u - sin * v,
            sin * u + cos * v,
            r,
            (X + p["m_v"] * v * r - p["d_u"] * u - p["d_uu"] * abs(u) * u) / p["m_u"],
            (-p["m_u"] * u * r - p["d_v"] * v - p["d_vv"] * abs(v) * v) / p["m_v"],
            (N + (p["m_u"] - p["m_v"]) * u * v - p["d_r"] * r - p["d_rr"] * abs(r) * r) / p["m_r"],
        ]
    )


def measured() -> Record | None:
    """Return the record of the data set sde_bench, which was simulated by an independent program.

    None is returned if the folder in the environment variable SEATRIAL_DATA does not contain the data set.
    """
    path = Path(os.environ.get("SEATRIAL_DATA", "")) / "sde_bench" / "horizontal.csv"
    if not os.environ.get("SEATRIAL_DATA") or not path.is_file():
        return None
    data = np.genfromtxt(path, delimiter=",", names=True)
    u, y = (np.column_stack([data[n] for n in names.split()]) for names in ("X N", "ypsi yr yx yy"))
    return Record("sde_bench", data["t"], u, u, y, ("X", "N"), ("psi", "r", "x", "y"))


def figures(seed: int) -> Iterator[Figure]:
    """Yield the times of one evaluation and of an estimate, and the optimum, with those of ctsmTMB as the peer.

    They are measured on the record that ``seed`` simulates, and on the data set sde_bench if it is available. Only the
    data set has a peer.
    """
    for record, peer in ((simulated(seed), {}), (measured(), PEER)):
        if record is None:
            continue
        group = f"estimation, {record.name}: {N_ROWS} rows, 6 states, 15 parameters"
        likelihood = Likelihood(model())
        values = np.array(list(model().values.values()))
        for name in ("value", "gradient", "scores"):
            took = best_ms(partial(getattr(likelihood, name), record, values))
            yield Figure(group, NAMES[name], took, "ms", peer.get(name))
        found = fit(model(), [record], start=START)  # compiles missing kernels
        found = fit(model(), [record], start=START)
        yield Figure(group, "estimate, kernels compiled before", found.cpu_seconds, "s CPU", peer.get("estimate"))
        yield Figure(group, "-ln L at the optimum", -found.log_likelihood, "", peer.get("optimum"))
        if record.name == "simulated":
            yield Figure(group, "largest parameter error", largest_error(found), "std. errors")


def largest_error(found: Fit) -> float:
    """Return the largest error of estimated masses and damping, in units of their standard errors.

    The true values are those of `model`. Estimates without a finite standard error are skipped.
    """
    truth = {n: v for n, v in model().values.items() if n[:2] in ("m_", "d_")}
    estimates = {n: found.estimate(n) for n in truth}
    return max(abs(value - truth[n]) / error for n, (value, error) in estimates.items() if np.isfinite(error))
