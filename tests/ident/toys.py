"""Small models, records and an independent extended Kalman filter for the tests of the estimators."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from types import ModuleType

import numpy as np

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model.parameter import INF, Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model


def turning() -> Model:
    """Return a model of heading and yaw rate with quadratic damping. Its two sensors have different rates, and one is
    an angle.
    """
    return plain_model(
        "turning",
        f=lambda x, u, p: {"psi": x.r, "r": (u.N - p.d * x.r - p.dd * abs(x.r) * x.r) / p.m},
        h=lambda x, u, p: {"psi": x.psi, "gyro": x.r + p.bias, "second": 2.0 * x.r + 0.1 * u.N},
        states=(
            State("psi", "rad", noise=0.02, x0="psi0", sd0=0.1),
            State("r", "rad/s", noise="q", x0=0.1, sd0="sd0"),
        ),
        inputs=(Input("N", "N m", hold="linear"),),
        sensors=(
            Sensor("compass", (Output("psi", "rad", "e_psi", angle=True),)),
            Sensor("gyros", (Output("gyro", "rad/s", "e_r"), Output("second", "rad/s", "e_r"))),
        ),
        parameters=(
            Parameter("m", 9.7, transform="log"),
            Parameter("d", 4.0, bounds=(0, INF)),
            Parameter("dd", 6.0, bounds=(0, INF)),
            Parameter("bias", 0.02, per_record=True),
            Parameter("q", 0.05, transform="log"),
            Parameter("e_psi", 0.02, transform="log"),
            Parameter("e_r", 0.01, transform="log"),
            Parameter("psi0", 3.0),
            Parameter("sd0", 0.3),
        ),
    )


def values_of(model: Model) -> np.ndarray:
    return np.array([p.value for p in model.parameters])


def turning_record(seed: int = 0, n_rows: int = 120, name: str = "run") -> Record:
    """Return a record with irregular rows, missing samples of both sensors, and a heading that passes pi."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.02, 0.15, n_rows))
    u = 4.0 * np.sin(0.9 * t + seed)[:, None] + 2.0
    model = turning()
    p = dict(zip(model.values, values_of(model), strict=True))
    psi, r, y = p["psi0"], 0.3, np.full((n_rows, 3), np.nan)
    for k in range(n_rows):
        if rng.random() < 0.5:
            y[k, 0] = math.remainder(psi + p["e_psi"] * rng.normal(), 2 * math.pi)
        if rng.random() < 0.7:
            y[k, 1:] = r + p["bias"] + 0.01 * rng.normal(), 2 * r + 0.1 * u[k, 0] + 0.01 * rng.normal()
        h = t[k + 1] - t[k] if k + 1 < n_rows else 0.0
        for _ in range(10):
            r += h / 10 * (u[k, 0] - p["d"] * r - p["dd"] * abs(r) * r) / p["m"]
            r += p["q"] * math.sqrt(h / 10) * rng.normal()
            psi += h / 10 * r + 0.02 * math.sqrt(h / 10) * rng.normal()
    u_next = np.vstack([u[1:], u[-1:]])
    return Record(name, t, u, u_next, y, ("N",), ("psi", "gyro", "second"))


def reference_filter() -> ModuleType:
    """Return the filter in plain NumPy that the documentation shows (docs/examples/reference_ekf.py)."""
    path = Path(__file__).resolve().parents[2] / "docs/examples/reference_ekf.py"
    spec = importlib.util.spec_from_file_location("reference_ekf", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # The named tuple of the module looks up its module.
    spec.loader.exec_module(module)
    return module


def best_start(model: Model, records: Sequence[Record], grid: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Return the grid point with the largest likelihood. All other parameters keep the values of the model.

    A likelihood takes milliseconds. The product of the grid axes should stay below some hundred points.
    """
    likelihood = Likelihood(model)
    base = np.array([p.value for p in model.parameters])
    names = [p.name for p in model.parameters]
    columns = [names.index(name) for name in grid]
    best, found = -np.inf, {name: model.parameter(name).value for name in grid}
    for point in product(*grid.values()):
        values = base.copy()
        values[columns] = point
        total = sum(likelihood.value(record, values) for record in records)
        if total > best:
            best, found = total, dict(zip(grid, point, strict=True))
    return found


def follower(time_constant: float, order: int = 1) -> Model:
    """Return a model of a sensor behind one or two first-order lags."""
    names = ("z", "w")[:order]
    return plain_model(
        f"follower{order}",
        f=lambda x, u, p: {
            name: (of - getattr(x, name)) / p.T for name, of in zip(names, (u.n_cmd, x.z), strict=False)
        },
        h=lambda x, u, p: {"y": getattr(x, names[-1])},
        states=tuple(State(name, sd0=0.1) for name in names),
        inputs=(Input("n_cmd"),),
        sensors=(Sensor("meter", (Output("y", "", "e"),)),),
        parameters=(Parameter("T", time_constant, "s", step=0.01), Parameter("e", 0.1, free=False)),
    )
