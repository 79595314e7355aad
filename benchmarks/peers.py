"""Other implementations of the likelihood for the comparison: a numpy filter, and a CasADi script.

The numpy filter updates with all outputs of a row at once. Its Jacobians are written by hand for this model, or are
forward differences, as in a filter for arbitrary models. The CasADi script maps one row over all rows (``mapaccum``)
and computes the gradient in reverse mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data.record import Record
from seatrial.ident.engine.ekf_graph import EkfGraphs
from seatrial.ident.model.structure import Model

Array = NDArray[np.float64]
SD0 = 0.01  # initial standard deviation of all states, as in benchmarks.sde
H_OUT = np.zeros((4, 6))  # output matrix: psi, r, x, y
H_OUT[[0, 1, 2, 3], [2, 5, 0, 1]] = 1.0


def numpy_value(p: dict[str, float], record: Record, *, by_hand: bool = True) -> float:
    """Return ln L of the horizontal model with force and moment as inputs (``benchmarks.sde.model``).

    Parameters
    ----------
    p : dict of str to float
        Values of all parameters.
    record : Record
        Record whose rows have samples of all sensors.
    by_hand : bool
        Whether to use Jacobians written for this model instead of forward differences.
    """
    q = np.diag([0.0, 0.0, 0.0, p["s_u"] ** 2, p["s_v"] ** 2, p["s_r"] ** 2])
    R = np.diag([p["e_psi"] ** 2, p["e_r"] ** 2, p["e_xy"] ** 2, p["e_xy"] ** 2])
    x, P, ll, identity = np.zeros(6), SD0**2 * np.eye(6), 0.0, np.eye(6)
    for y, u, h in zip(record.y, record.u, record.h, strict=True):
        H = H_OUT if by_hand else _forward_jacobian(lambda z: H_OUT @ z, x)
        e = y - H_OUT @ x
        e[0] = (e[0] + math.pi) % (2 * math.pi) - math.pi
        PH = P @ H.T
        S = H @ PH + R
        K = np.linalg.solve(S, PH.T)
        ll -= 0.5 * (e @ np.linalg.solve(S, e) + math.log(np.linalg.det(S)) + 4 * math.log(2 * math.pi))
        x, P = x + K.T @ e, P - PH @ K
        P = (P + P.T) / 2  # without this, rounding makes P indefinite within a few hundred rows
        k1 = _state_rates(p, u, x)
        k2 = _state_rates(p, u, x + h / 2 * k1)
        x3 = x + h / 2 * k2
        k3 = _state_rates(p, u, x3)
        A = h * (_state_jacobian(p, x3) if by_hand else _forward_jacobian(partial(_state_rates, p, u), x3))
        A2 = A @ A
        Phi, half = identity + A + A2 / 2 + A @ A2 / 6, identity + A / 2 + A2 / 8
        Q = h / 6 * q
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + _state_rates(p, u, x + h * k3))
        P = Phi @ (P + Q) @ Phi.T + 4 * half @ Q @ half.T + Q
    return float(ll)


def _forward_jacobian(f: Callable[[Array], Array], x: Array) -> Array:
    """Return the Jacobian (n_values, n) of the function ``f`` at ``x`` (n,) by forward differences of 1e-7."""
    base, step = f(x), 1e-7
    return np.column_stack([(f(x + step * unit) - base) / step for unit in np.eye(x.size)])


def _state_rates(p: dict[str, float], inputs: Array, s: Array) -> Array:
    """Return the time derivative (6,) of the state ``s`` = (x, y, psi, u, v, r).

    ``p`` has masses and damping by name. ``inputs`` are the surge force X [N] and the yaw moment N [N m].
    """
    _, _, psi, u, v, r = s.tolist()
    X, N = inputs.tolist()
    cos, sin = math.cos(psi), math.sin(psi)
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


def _state_jacobian(p: dict[str, float], s: Array) -> Array:
    """Return the Jacobian (6, 6) of the time derivatives of the state by the state ``s``, written by hand."""
    _, _, psi, u, v, r = s.tolist()
    cos, sin = math.cos(psi), math.sin(psi)
    m_u, m_v, m_r = p["m_u"], p["m_v"], p["m_r"]
    return np.array(
        [
            [0.0, 0.0, -sin * u - cos * v, cos, -sin, 0.0],
            [0.0, 0.0, cos * u - sin * v, sin, cos, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 0.0, -(p["d_u"] + 2 * p["d_uu"] * abs(u)) / m_u, m_v * r / m_u, m_v * v / m_u],
            [0.0, 0.0, 0.0, -m_u * r / m_v, -(p["d_v"] + 2 * p["d_vv"] * abs(v)) / m_v, -m_u * u / m_v],
            [0.0, 0.0, 0.0, (m_u - m_v) * v / m_r, (m_u - m_v) * u / m_r, -(p["d_r"] + 2 * p["d_rr"] * abs(r)) / m_r],
        ]
    )


def casadi_gradient(model: Model, record: Record) -> Callable[[Array], tuple[float, Array]]:
    """Return a function that computes ln L and its gradient (n_parameters,) with the virtual machine of CasADi.

    The argument of the function is the array of all parameter values (n_parameters,), in the order of ``model``.
    """
    g, n = EkfGraphs(model), record.n_rows
    s, ll = g.s, ca.SX(0)
    for update in g.updates:
        s, part = ca.Function("update", [g.s, g.u, g.y, g.p], [update.s, update.ll])(s, g.u, g.y, g.p)
        ll = ll + part
    step = ca.Function("step", [g.s, g.u, g.u_next, g.h, g.p], [g.predict[0]])(s, g.u, g.u_next, g.h, g.p)
    row = ca.Function("row", [g.s, g.u, g.u_next, g.y, g.h, g.p], [step, ll])
    p: Any = ca.MX.sym("p", g.p.numel())
    start = np.append(np.zeros(g.n), SD0**2 * np.eye(g.n)[np.triu_indices(g.n)])
    data = [ca.DM(a) for a in (record.u.T, record.u_next.T, record.y.T, record.h[None, :])]
    total = ca.sum2(row.mapaccum("rows", n)(start, *data, ca.repmat(p, 1, n))[1])
    both = ca.Function("both", [p], [total, ca.gradient(total, p)])

    def evaluate(values: Array) -> tuple[float, Array]:
        """Return ln L and its gradient (n_parameters,) at the parameter values (n_parameters,)."""
        value, gradient = both(values)
        return float(value), np.array(gradient).ravel()

    return evaluate
