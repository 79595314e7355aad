"""Reference extended Kalman filter in plain numpy: the log-likelihood of a record (docs/theory/estimation.md)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class ReferenceModel(NamedTuple):
    """Model of the filter: functions and noise."""

    f: Callable[[np.ndarray, np.ndarray], np.ndarray]  # rates f(x, u)
    h: Callable[[np.ndarray, np.ndarray], np.ndarray]  # outputs h(x, u)
    Q: np.ndarray  # (n_states, n_states) spectral density of the process noise
    R: np.ndarray  # (n_outputs,) variances of the measurement noise
    sensors: list[list[int]]  # the outputs that each sensor measures at the same time
    angles: set[int]  # outputs whose innovation is taken modulo 2 pi


def jacobian(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Return df/dx by central differences with Richardson's extrapolation."""

    def central(step: float) -> np.ndarray:
        return np.column_stack([(f(x + step * d) - f(x - step * d)) / (2 * step) for d in np.eye(x.size)])

    return (4 * central(5e-4) - central(1e-3)) / 3


def predict(model: ReferenceModel, x: np.ndarray, P: np.ndarray, u: np.ndarray, u_next: np.ndarray, h: float):
    """Propagate mean and covariance over h seconds. The inputs change linearly from u to u_next."""
    middle = (u + u_next) / 2
    k1 = model.f(x, u)
    k2 = model.f(x + h / 2 * k1, middle)
    x_middle = x + h / 2 * k2
    k3 = model.f(x_middle, middle)
    k4 = model.f(x + h * k3, u_next)
    A = h * jacobian(lambda z: model.f(z, middle), x_middle)
    eye = np.eye(x.size)
    whole, half = eye + A + A @ A / 2 + A @ A @ A / 6, eye + A / 2 + A @ A / 8
    Q = h / 6 * (whole @ model.Q @ whole.T + 4 * half @ model.Q @ half.T + model.Q)  # Simpson's rule
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), whole @ P @ whole.T + Q


def update(model: ReferenceModel, x: np.ndarray, P: np.ndarray, y: np.ndarray, u: np.ndarray, sensor: list[int]):
    """Update mean and covariance by one sample of a sensor. Return both and the log-likelihood of the sample."""
    e = y - model.h(x, u)[sensor]
    e = np.array([math.remainder(a, 2 * math.pi) if i in model.angles else a for i, a in zip(sensor, e, strict=True)])
    H = jacobian(lambda z: model.h(z, u)[sensor], x)
    S = H @ P @ H.T + np.diag(model.R[sensor])
    K = np.linalg.solve(S, H @ P).T
    ll = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1] + e.size * math.log(2 * math.pi))
    return x + K @ e, P - K @ S @ K.T, ll


def log_likelihood(model: ReferenceModel, t: np.ndarray, u: np.ndarray, y: np.ndarray, x: np.ndarray, P: np.ndarray):
    """Return ln L of a record with times t (n_rows,), inputs u (n_rows, n_inputs) and outputs y (n_rows, n_outputs).

    Outputs without a sample are NaN. x and P are the initial mean and covariance.
    """
    total = 0.0
    for k in range(t.size):
        for sensor in model.sensors:
            if np.isfinite(y[k, sensor]).all():
                x, P, ll = update(model, x, P, y[k, sensor], u[k], sensor)
                total += ll
        if k + 1 < t.size:
            x, P = predict(model, x, P, u[k], u[k + 1], t[k + 1] - t[k])
    return total
