"""CasADi graphs of a model's extended Kalman filter: rates, outputs, prediction and measurement updates.

The state ``s`` passes from row to row. It holds the mean, followed by the upper triangle of the covariance by rows.
Without a covariance (output error), it holds the mean alone.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine.expressions import simplified
from seatrial.ident.engine.kernel import MAX_BITS
from seatrial.ident.model import Model, Output, Sensor, outlier_density

ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic


@dataclass(frozen=True)
class Update:
    """Update of the filter by the sample of one sensor.

    Attributes
    ----------
    s : SX (n_s, 1)
        State after the update.
    ll : SX
        Log-likelihood of the sample.
    e, S : SX (n_outputs, 1)
        Innovations and their variances.
    slope : SX (n_outputs, 1)
        -d ll / d e of each output: e / S, or less if outliers are allowed.
    information : DM (n_outputs, 2)
        Information of a sample about its mean and about its scale, relative to normal noise.
    corrections : tuple[ScalarUpdate, ...]
        The scalar updates, one for each output in order.
    """

    s: Any
    ll: Any
    e: Any
    S: Any
    slope: Any = None
    information: Any = None
    corrections: tuple[ScalarUpdate, ...] = ()


@dataclass(frozen=True)
class Sample:
    """One scalar measurement of a sensor.

    Attributes
    ----------
    e : SX
        Measured minus predicted.
    H : SX (1, n) or None
        Derivative of the prediction by the state; None without a covariance.
    R : SX
        Variance of the measurement noise.
    """

    output: Output
    e: Any
    H: Any
    R: Any


@dataclass(frozen=True)
class ScalarUpdate:
    """Update of the filter by one scalar measurement.

    Attributes
    ----------
    e, S, slope, ll : SX
        As in `Update`.
    dx : SX (n, 1) or None
        Change of the mean since the prediction.
    P : SX (n, n) or None
        Covariance after the update: ``P - inverse_variance PH PH'``.
    PH : SX (n, 1) or None
        ``P H'``.
    inverse_variance : SX or None
        1 / S, or less for an outlier.
    """

    sample: Sample
    e: Any
    S: Any
    slope: Any
    ll: Any
    dx: Any = None
    P: Any = None
    PH: Any = None
    inverse_variance: Any = None


@dataclass(frozen=True)
class IntervalTransition:
    """Matrices of the transition over one interval of length h.

    Attributes
    ----------
    A : SX (n, n)
        h / 2 times the Jacobian of the rates at the midpoint.
    T : SX (n, n)
        Twice the transition from the midpoint to the end, of second order in A.
    Phi : SX (n, n)
        Transition over the whole interval, of third order in A.
    Q : SX (n, n)
        A sixth of the covariance of the process noise.
    """

    A: Any
    T: Any
    Phi: Any
    Q: Any


def pack(P: Any) -> Any:
    """Return the upper triangle of a symmetric matrix by rows, as a column."""
    n = P.shape[0]
    return ca.vertcat(*[P[i, j] for i in range(n) for j in range(i, n)])


def unpack(p: Any, n: int) -> Any:
    """Return the symmetric matrix (n, n) of an upper triangle."""
    P = ca.SX(n, n)
    for k, (i, j) in enumerate(zip(*np.triu_indices(n), strict=True)):
        P[int(i), int(j)] = P[int(j), int(i)] = p[k]
    return P


class EkfGraphs:
    """Graphs of a model's filter.

    Parameters
    ----------
    model : Model
        Model to filter.
    covariance : bool
        False: no process noise and an exactly known initial state (output error).
    joseph : bool
        Whether to update the covariance in Joseph's form, which keeps it positive in spite of rounding.

    Raises
    ------
    ValueError
        If the model has too many sensors, or if its functions do not return one scalar for each rate and output.
    """

    def __init__(self, model: Model, *, covariance: bool = True, joseph: bool = False) -> None:
        """Trace the functions of the model with symbols."""
        if len(model.sensors) > MAX_BITS:
            raise ValueError(f"model {model.name} has {len(model.sensors)} sensors; the engine takes {MAX_BITS}")
        self.model, self.covariance, self.joseph = model, covariance, joseph
        self.n = len(model.states)
        n_s = self.n + self.n * (self.n + 1) // 2 if covariance else self.n
        sym = ca.SX.sym
        self.s, self.p, self.h = sym("s", n_s), sym("p", len(model.parameters)), sym("h")
        self.u, self.u_next = sym("u", len(model.inputs)), sym("u_next", len(model.inputs))
        self.y = sym("y", len(model.outputs))
        self.rate, self.output = _trace(model)
        self.inputs = {"s": self.s, "u": self.u, "u_next": self.u_next, "y": self.y, "p": self.p, "h": self.h}

    @cached_property
    def key(self) -> str:
        """Hash of the graphs. Models with the same key have the same kernels.

        Values of parameters are not part of the key.
        """
        model = self.model
        noise = ([s.noise for s in model.states], [(s.name, s.outputs) for s in model.sensors])
        names = [p.name for p in model.parameters]
        content = (
            self.rate.serialize(),
            self.output.serialize(),
            noise,
            names,
            self.covariance,
            self.joseph,
            model.second_order,
        )
        return hashlib.sha256(repr(content).encode()).hexdigest()

    @property
    def mean(self) -> Any:
        return self.s[: self.n]

    @cached_property
    def P(self) -> Any:
        return unpack(self.s[self.n :], self.n)

    def step(self, x: Any) -> tuple[Any, Any, Any]:
        """Take one Runge-Kutta step of fourth order.

        Returns
        -------
        tuple[SX, SX, SX]
            Mean at the end of the interval; state and inputs at its midpoint.
        """
        h, end, middle = self.h, self.u_next, (self.u + self.u_next) / 2
        k1 = self.rate(x, self.u, self.p)
        k2 = self.rate(x + h / 2 * k1, middle, self.p)
        x3 = x + h / 2 * k2
        k3 = self.rate(x3, middle, self.p)
        k4 = self.rate(x + h * k3, end, self.p)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), x3, middle

    @cached_property
    def predict(self) -> tuple[Any, Any]:
        """State at the end of the interval, and the transition matrix Phi of the mean (None without a covariance).

        Phi is the Taylor series of third order of the Jacobian at the midpoint of the interval. The process noise is
        integrated by Simpson's rule; a trapezoidal rule would change the estimates by a standard error. The
        second-order filter adds ``1/2 tr(P f_xx)`` at the midpoint to the mean (Jazwinski 1970). The reason: for an
        uncertain u, the mean of u |u| exceeds u |u| at the mean.
        """
        end = self.stepped[0]
        if not self.covariance:
            return end, None
        t = self.transition
        P = t.Phi @ (self.P + t.Q) @ t.Phi.T + t.T @ t.Q @ t.T.T + t.Q
        if self.model.second_order:
            end = end + self.h * self._curvature_term((self.P + P) / 2)
        return ca.vertcat(end, pack(P)), t.Phi

    @cached_property
    def stepped(self) -> tuple[Any, Any, Any]:
        """Step of the mean, computed once: a derivative through two copies of the step would process the step twice."""
        return self.step(self.mean)

    @cached_property
    def transition(self) -> IntervalTransition:
        """Transition of the covariance over the interval."""
        A = self.h / 2 * self._at_midpoint(lambda slopes, _: slopes)
        identity, A2 = ca.SX.eye(self.n), A @ A
        T = 2 * identity + 2 * A + A2  # scaled so that few multiplications are needed; these dominate the run time
        Phi = T - identity + A2 + 4 / 3 * (A @ A2)
        Q = self.h / 6 * ca.diag(self._diffusion)
        return IntervalTransition(A, T, Phi, Q)

    def _curvature_term(self, P: Any) -> Any:
        """Return ``1/2 tr(P f_xx)``: the mean change of the rates for states with covariance P."""
        return self._at_midpoint(
            lambda slopes, x: ca.vertcat(
                *[ca.sum1(ca.sum2(ca.jacobian(slopes[i, :].T, x) * P)) / 2 for i in range(self.n)]
            )
        )

    def _at_midpoint(self, expression: Callable[[Any, Any], Any]) -> Any:
        """Return ``expression(Jacobian of the rates, state x)`` at the midpoint of the interval."""
        x, (_, x3, middle) = ca.SX.sym("x", self.n), self.stepped
        slopes: Any = ca.jacobian(self.rate(x, middle, self.p), x)
        slopes = ca.SX(slopes.sparsity(), simplified(ca.vertcat(ca.SX(0, 1), *slopes.nonzeros())))
        return ca.substitute(expression(slopes, x), x, x3)

    @property
    def _diffusion(self) -> Any:
        return ca.vertcat(*[self._parameter(s.noise) ** 2 for s in self.model.states])

    def _parameter(self, value: float | str) -> Any:
        """Return the symbol of a named parameter, or a constant for a number."""
        if not isinstance(value, str):
            return ca.SX(float(value))
        return self.p[[p.name for p in self.model.parameters].index(value)]

    @property
    def residual(self) -> Any:
        """Measured minus predicted for all outputs. Angles are wrapped to -pi to pi."""
        e = self.y - self.output(self.mean, self.u, self.p)
        return ca.vertcat(*[_wrap(e[i]) if o.angle else e[i] for i, o in enumerate(self.model.outputs)])

    @cached_property
    def updates(self) -> tuple[Update, ...]:
        """Updates of the sensors, one for each sensor in order."""
        z = self.output(self.mean, self.u, self.p)
        H = ca.jacobian(z, self.mean) if self.covariance else None
        result, first = [], 0
        for sensor in self.model.sensors:
            rows = slice(first, first + len(sensor.outputs))
            result.append(self._update(sensor, self.y[rows], z[rows], None if H is None else H[rows, :]))
            first = rows.stop
        return tuple(result)

    def _update(self, sensor: Sensor, y: Any, z: Any, H: Any) -> Update:
        """Update by one scalar after the other, which is exact for independent noises. No matrix is inverted."""
        dx, P, ll, steps = 0 * self.mean, self.P if self.covariance else None, 0, []
        for i, output in enumerate(sensor.outputs):
            sample = Sample(output, y[i] - z[i], None if H is None else H[i, :], self._parameter(output.noise) ** 2)
            steps.append(self.correct(sample, dx, P))
            dx, P, ll = steps[-1].dx, steps[-1].P, ll + steps[-1].ll
        s = ca.vertcat(self.mean + dx, pack(P)) if H is not None else self.mean
        information = ca.DM([[*outlier_density.INFORMATION] if o.robust else [1.0, 1.0] for o in sensor.outputs])
        e, S, slope = (ca.vertcat(*column) for column in zip(*[(c.e, c.S, c.slope) for c in steps], strict=True))
        return Update(s, ll, e, S, slope, information, tuple(steps))

    def correct(self, sample: Sample, dx: Any, P: Any) -> ScalarUpdate:
        """Update the filter by one scalar measurement.

        Without a covariance, only the innovation and the log-likelihood are computed.

        Parameters
        ----------
        sample : Sample
            Scalar measurement.
        dx : SX (n, 1)
            Change of the mean since the prediction, by the scalars before this one.
        P : SX (n, n) or None
            Covariance before this scalar.
        """
        output, e, H, S = sample.output, sample.e, sample.H, sample.R
        PH = None
        if H is not None:
            e, PH = e - H @ dx, P @ H.T
            S = H @ PH + S
        if output.angle:
            e = _wrap(e)
        scaled, inverse_variance = e / ca.sqrt(S), 1 / S
        slope = outlier_density.score(scaled) / ca.sqrt(S) if output.robust else e / S
        ll = (
            outlier_density.log_density(scaled) - 0.5 * ca.log(S)
            if output.robust
            else -0.5 * (e * slope + ca.log(2 * math.pi * S))
        )
        if output.robust:
            inverse_variance = outlier_density.score_slope(scaled) / S
        if H is None:
            return ScalarUpdate(sample, e, S, slope, ll)
        P_after = self._updated_covariance(sample, P, PH, S, inverse_variance)
        return ScalarUpdate(sample, e, S, slope, ll, dx + PH * slope, P_after, PH, inverse_variance)

    def _updated_covariance(self, sample: Sample, P: Any, PH: Any, S: Any, inverse_variance: Any) -> Any:
        """Return the covariance after the update by one scalar.

        If outliers are allowed, the reduction of the covariance is scaled by the weight of the sample.
        """
        if not self.joseph:
            return P - (PH * inverse_variance) @ PH.T
        K = PH / S
        rest = ca.SX.eye(self.n) - K @ sample.H
        full_update = rest @ P @ rest.T + sample.R * K @ K.T
        return P + inverse_variance * S * (full_update - P) if sample.output.robust else full_update


def _wrap(angle: Any) -> Any:
    """Wrap an angle [rad] to -pi to pi."""
    return angle - 2 * math.pi * ca.floor(angle / (2 * math.pi) + 0.5)


def _trace(model: Model) -> tuple[Any, Any]:
    """Return the model's rates and outputs as CasADi functions of (x, u, p)."""
    x, u, p = (
        ca.SX.sym(name, len(of)) for name, of in (("x", model.states), ("u", model.inputs), ("p", model.parameters))
    )
    signals = model.signals(*[ca.vertsplit(v) if v.numel() else [] for v in (x, u, p)])
    rates = _collect(model, signals.rate, [s.name for s in model.states], "rate of the state")
    outputs = _collect(model, signals.y, [o.name for o in model.outputs], "value of the output")
    return (
        ca.Function("rate", [x, u, p], [simplified(rates)]),
        ca.Function("output", [x, u, p], [simplified(outputs)]),
    )


def _collect(model: Model, values: Mapping[str, Any], names: list[str], role: str) -> Any:
    """Return the named values as a dense column. Raise ValueError if one of them is missing or is not a scalar."""
    column = []
    for name in names:
        if name not in values:
            raise ValueError(f"model {model.name} gives no {role} {name}; it gives {', '.join(values) or 'none'}")
        value = ca.SX(values[name])
        if value.numel() != 1:
            raise ValueError(f"model {model.name}: the {role} {name} is not a scalar")
        if _has_nan(value):
            raise ValueError(
                f"model {model.name}: the {role} {name} has lost its symbols (math.sin, float() and assignment "
                "into np.zeros convert symbols to numbers; use numpy's functions)"
            )
        column.append(ca.densify(value))
    return ca.densify(ca.vertcat(*column))


def _has_nan(expression: Any) -> bool:
    """Return whether the expression contains the constant NaN. CasADi inserts NaN for a symbol that became a number."""
    f = ca.Function("f", ca.symvar(expression), [expression])
    return any(
        f.instruction_id(k) == ca.OP_CONST and math.isnan(f.instruction_constant(k)) for k in range(f.n_instructions())
    )
