"""CasADi expressions of a model's extended Kalman filter: rates, outputs, prediction and measurement updates.

The filter state ``s`` passes from row to row. It holds the mean of the n model states, followed by the n (n + 1) / 2
entries of the upper triangle of their covariance, one matrix row after the other. Without a covariance (output error),
it holds the mean alone.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine.expressions import simplified
from seatrial.ident.engine.kernel import MAX_BITS
from seatrial.ident.model import Model, Output, outlier_density

ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic


@dataclass(frozen=True)
class Update:
    """Expressions of the filter's update by the sample of one sensor, which has n_outputs outputs.

    Attributes
    ----------
    s : SX (n_s, 1)
        Filter state after the update. Without a covariance, the mean is not changed.
    ll : SX
        Log-likelihood of the sample, with its constant. None if this object describes a prediction.
    e, S : SX (n_outputs, 1)
        Innovations (measured minus predicted) and their variances, each given the outputs before it. None for a
        prediction.
    slope : SX (n_outputs, 1)
        -d ll / d e of each output: e / S, or smaller in absolute value if the density of the noise includes outliers.
    information : DM (n_outputs, 2)
        Fisher information of a sample about its mean and about its scale, as ratios to those of normal noise: 1 and 1
        for normal noise, less if the density includes outliers.
    corrections : tuple[ScalarUpdate, ...]
        The updates by single outputs, in the order in which they are applied.
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
    """CasADi expressions of one scalar measurement, before any output of the same sensor has changed the filter state.

    Attributes
    ----------
    output : Output
        Output of the model that is measured.
    e : SX
        Measured minus predicted value, by the mean before the row. If it is an angle, it is not wrapped yet.
    H : SX (1, n) or None
        Derivative of the predicted value by the model states; None without a covariance.
    R : SX
        Variance of the measurement noise.
    """

    output: Output
    e: Any
    H: Any
    R: Any


@dataclass(frozen=True)
class ScalarUpdate:
    """CasADi expressions of the filter's update by one scalar measurement.

    The fields that may be None are so without a covariance (output error).

    Attributes
    ----------
    sample : Sample
        The measurement.
    e, S : SX
        Innovation (measured minus predicted, given the measurements before) and its variance.
    slope : SX
        -d ll / d e: e / S, or smaller in absolute value if the density of the noise includes outliers.
    ll : SX
        Log-likelihood of the measurement, with its constant.
    dx : SX (n, 1) or None
        Change of the mean since the prediction, by this measurement and by those before.
    P : SX (n, n) or None
        Covariance after the update: covariance before it minus ``inverse_variance PH PH'``.
    PH : SX (n, 1) or None
        Covariance before the update times H'.
    inverse_variance : SX
        1 / S for normal noise. If the density includes outliers: about 1 / S for a good sample, about 0 for an outlier,
        and negative for a sample that may be either.
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
    """Matrices that propagate the filter's covariance over one interval of length h [s] between two rows.

    Attributes
    ----------
    A : SX (n, n)
        h / 2 times the Jacobian of the rates (derivatives of the states by time) at the midpoint of the interval.
    T : SX (n, n)
        Twice the transition matrix from the midpoint to the end, a Taylor polynomial of second order in A.
    Phi : SX (n, n)
        Transition matrix over the whole interval, a Taylor polynomial of third order in A.
    Q : SX (n, n)
        Diagonal matrix: h / 6 times the squared diffusion of the process noise of each state.
    """

    A: Any
    T: Any
    Phi: Any
    Q: Any


def pack(P: Any) -> Any:
    """Return the upper triangle of a symmetric matrix P (n, n) as a column (n (n + 1) / 2, 1), by matrix rows."""
    n = P.shape[0]
    return ca.vertcat(*[P[i, j] for i in range(n) for j in range(i, n)])


def unpack(p: Any, n: int) -> Any:
    """Return the symmetric matrix (n, n) with the upper triangle ``p``, the inverse of `pack`.

    ``p`` is a column (n (n + 1) / 2, 1) that has the entries of the upper triangle row by row.
    """
    P = ca.SX(n, n)
    for k, (i, j) in enumerate(zip(*np.triu_indices(n), strict=True)):
        P[int(i), int(j)] = P[int(j), int(i)] = p[k]
    return P


class EkfGraphs:
    """CasADi expressions of a model's extended Kalman filter, from one row (instant of a record) to the next.

    Parameters
    ----------
    model : Model
        Model to filter.
    covariance : bool
        True: extended Kalman filter. False: no process noise and an exactly known initial state (output error).
    joseph : bool
        Whether to update the covariance in Joseph's form, which keeps it positive in spite of rounding.

    Attributes
    ----------
    s, p : SX
        Symbols of the filter state (n_s, 1), which holds the mean and the upper triangle of the covariance, and of the
        parameters (n_parameters, 1).
    h : SX
        Symbol of the length of the interval to the next row [s].
    u, u_next : SX (n_inputs, 1)
        Symbols of the inputs at the start and at the end of the interval.
    y : SX (n_outputs, 1)
        Symbols of the samples at the start of the interval.
    rate, output : casadi.Function
        Rates (n, 1) and outputs (n_outputs, 1) of the model, as functions of (states, inputs, parameters).
    inputs : dict[str, SX]
        The symbols s, u, u_next, y, p and h, by these names.
    n : int
        Number of model states.

    Raises
    ------
    ValueError
        If the model has more than 32 sensors, or if its functions do not return one scalar without NaN for each rate
        and output.
    """

    def __init__(self, model: Model, *, covariance: bool = True, joseph: bool = False) -> None:
        """Call the functions of the model with CasADi symbols, which gives the expressions of rates and outputs."""
        if len(model.sensors) > MAX_BITS:
            raise ValueError(
                f"model {model.name} has {len(model.sensors)} sensors, more than the limit of {MAX_BITS}; "
                "combine outputs that are sampled together in one sensor"
            )
        self.model, self.covariance, self.joseph = model, covariance, joseph
        self.n = len(model.states)
        n_s = self.n + self.n * (self.n + 1) // 2 if covariance else self.n
        sym = ca.SX.sym
        self.s, self.p, self.h = sym("s", n_s), sym("p", len(model.parameters)), sym("h")
        self.u, self.u_next = sym("u", len(model.inputs)), sym("u_next", len(model.inputs))
        self.y = sym("y", len(model.outputs))
        self.rate, self.output = _trace_model(model)
        self.inputs = {"s": self.s, "u": self.u, "u_next": self.u_next, "y": self.y, "p": self.p, "h": self.h}

    @cached_property
    def key(self) -> str:
        """SHA-256 hash (hexadecimal) of the expressions and of all else that the compiled kernels depend on.

        Models with the same key have the same kernels. Names of parameters are part of the key, but not their values.
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
    def has_matrix_form(self) -> bool:
        """Whether the kernels of the filter have the covariance as a matrix, with stages of `filter_stages`."""
        return self.covariance and not self.joseph

    @property
    def mean(self) -> Any:
        """Mean of the model states (n, 1): the first n symbols of the filter state ``s``."""
        return self.s[: self.n]

    @cached_property
    def P(self) -> Any:
        """Covariance of the model states (n, n), made of the last symbols of the filter state ``s``.

        It is defined only for a filter with a covariance.
        """
        return unpack(self.s[self.n :], self.n)

    def step(self, x: Any) -> tuple[Any, Any, Any]:
        """Return the expressions of one Runge-Kutta step of fourth order over the interval to the next row.

        Parameters
        ----------
        x : SX (n, 1)
            Model states at the start of the interval.

        Returns
        -------
        tuple[SX, SX, SX]
            Model states (n, 1) at the end of the interval; model states and inputs at its midpoint. The inputs are
            linear in time between ``u`` and ``u_next``.
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
        """Filter state at the end of the interval to the next row, and transition matrix Phi (n, n) of the interval.

        The filter state is the mean, followed by the upper triangle of the covariance. Without a covariance, it is the
        mean alone, and Phi is None.

        Phi is the Taylor series of third order of the Jacobian at the midpoint of the interval. The process noise is
        integrated by Simpson's rule; a trapezoidal rule would change the estimates by a standard error. The
        second-order filter adds ``1/2 tr(P f_xx)`` at the midpoint to the rates of the mean (Jazwinski 1970). The
        reason: for an uncertain u > 0, the mean of u |u| exceeds u |u| at the mean.
        """
        end = self.mean_step[0]
        if not self.covariance:
            return end, None
        t = self.transition
        P = t.Phi @ (self.P + t.Q) @ t.Phi.T + t.T @ t.Q @ t.T.T + t.Q
        if self.model.second_order:
            end = end + self.h * self._curvature_term((self.P + P) / 2)
        return ca.vertcat(end, pack(P)), t.Phi

    @cached_property
    def mean_step(self) -> tuple[Any, Any, Any]:
        """Result of `step` from the mean: mean at the end of the interval, states and inputs at its midpoint.

        It is computed once: a derivative through two copies of the step would process the step twice.
        """
        return self.step(self.mean)

    @cached_property
    def transition(self) -> IntervalTransition:
        """Matrices that propagate the covariance over the interval, linearised at its midpoint."""
        A = self.h / 2 * self._evaluate_at_midpoint(lambda slopes, _: slopes)
        identity, A2 = ca.SX.eye(self.n), A @ A
        T = 2 * identity + 2 * A + A2  # scaled so that few multiplications are needed; these dominate the run time
        Phi = T - identity + A2 + 4 / 3 * (A @ A2)
        Q = self.h / 6 * ca.diag(self._diffusion_squared)
        return IntervalTransition(A, T, Phi, Q)

    def _curvature_term(self, P: Any) -> Any:
        """Return ``1/2 tr(P f_xx)`` for each rate f, shape (n, 1), at the midpoint of the interval.

        f_xx is the matrix of second derivatives of f by the states. The term is the amount by which the mean of the
        rate exceeds the rate at the mean, for states with the covariance P (n, n), to second order.
        """
        term = ca.SX.zeros(self.n)
        for i, j, k, curvature in self.curvatures:
            term[i] += curvature * P[j, k]
        return term

    @cached_property
    def curvatures(self) -> tuple[tuple[int, int, int, Any], ...]:
        """Second derivatives of the rates by the states at the midpoint of the interval, without those that are zero.

        They are (i, j, k, expression) with j <= k: the factor of the element (j, k) of a covariance P in
        ``1/2 tr(P f_xx)`` for the rate i.
        """
        found: list[tuple[int, int, int]] = []

        def second_derivatives(slopes: Any, x: Any) -> Any:
            """Return the factors as a column, and append their indices to ``found``."""
            values = []
            for i in range(self.n):
                by_states = ca.jacobian(slopes[i, :].T, x)
                for k in range(self.n):
                    for j in range(k + 1):
                        value = by_states[j, k] / 2 if j == k else (by_states[j, k] + by_states[k, j]) / 2
                        if not value.is_zero():
                            found.append((i, j, k))
                            values.append(value)
            return ca.vertcat(ca.SX(0, 1), *values)

        values = self._evaluate_at_midpoint(second_derivatives)
        return tuple((*indices, values[k]) for k, indices in enumerate(found))

    def _evaluate_at_midpoint(self, expression: Callable[[Any, Any], Any]) -> Any:
        """Return ``expression(J, x)`` at the midpoint of the interval.

        J (n, n) is the Jacobian of the rates by the model states, and x (n, 1) are symbols of these states. After the
        call of ``expression``, the symbols are replaced by the states at the midpoint.
        """
        x, (_, x3, middle) = ca.SX.sym("x", self.n), self.mean_step
        slopes: Any = ca.jacobian(self.rate(x, middle, self.p), x)
        slopes = ca.SX(slopes.sparsity(), simplified(ca.vertcat(ca.SX(0, 1), *slopes.nonzeros())))
        return ca.substitute(expression(slopes, x), x, x3)

    @property
    def _diffusion_squared(self) -> Any:
        """Squared diffusion of the process noise of each model state (n, 1) [unit^2/s]; a number or an expression."""
        return ca.vertcat(*[self.parameter_symbol(s.noise) ** 2 for s in self.model.states])

    def parameter_symbol(self, value: float | str) -> Any:
        """Return the symbol of the parameter with the name ``value``; if ``value`` is a number, return a constant.

        ValueError is raised for a name that the model lacks.
        """
        if not isinstance(value, str):
            return ca.SX(float(value))
        return self.p[[p.name for p in self.model.parameters].index(value)]

    @property
    def residual(self) -> Any:
        """Measured minus predicted value of all outputs (n_outputs, 1), before any update of the row by a sensor.

        Angles are wrapped to [-pi, pi).
        """
        e = self.y - self.output(self.mean, self.u, self.p)
        return ca.vertcat(*[_wrap_angle(e[i]) if o.angle else e[i] for i, o in enumerate(self.model.outputs)])

    @cached_property
    def updates(self) -> tuple[Update, ...]:
        """Expressions of the filter's update by each sensor, in the order of ``model.sensors``.

        Each update starts from the symbols of the filter state ``s``.
        """
        return tuple(self._sensor_update(samples) for samples in self.samples)

    @cached_property
    def samples(self) -> tuple[tuple[Sample, ...], ...]:
        """Scalar measurements of each sensor, in the order of ``model.sensors``."""
        z = self.output(self.mean, self.u, self.p)
        H = ca.jacobian(z, self.mean) if self.covariance else None
        numbers = iter(range(z.numel()))
        return tuple(
            tuple(
                Sample(
                    output, self.y[i] - z[i], None if H is None else H[i, :], self.parameter_symbol(output.noise) ** 2
                )
                for output, i in zip(sensor.outputs, numbers, strict=False)
            )
            for sensor in self.model.sensors
        )

    def _sensor_update(self, samples: Sequence[Sample]) -> Update:
        """Return the expressions of the filter's update by the sample of one sensor, a scalar for each of its outputs.

        The scalars are applied one after the other, which is exact for independent noises. No matrix is inverted.
        """
        dx, P, ll, steps = 0 * self.mean, self.P if self.covariance else None, 0, []
        for sample in samples:
            steps.append(self.correct(sample, dx, P))
            dx, P, ll = steps[-1].dx, steps[-1].P, ll + steps[-1].ll
        s = ca.vertcat(self.mean + dx, pack(P)) if self.covariance else self.mean
        outputs = [sample.output for sample in samples]
        information = ca.DM([[*outlier_density.INFORMATION] if o.robust else [1.0, 1.0] for o in outputs])
        e, S, slope = (ca.vertcat(*column) for column in zip(*[(c.e, c.S, c.slope) for c in steps], strict=True))
        return Update(s, ll, e, S, slope, information, tuple(steps))

    def correct(self, sample: Sample, dx: Any, P: Any) -> ScalarUpdate:
        """Return the expressions of the filter's update by one scalar measurement.

        Without a covariance, only the innovation, its variance, the slope and the log-likelihood are computed. The
        innovation of an angle is wrapped to -pi to pi. If the density of the output's noise includes outliers
        (``Output.robust``), an outlier changes the mean only a little.

        Parameters
        ----------
        sample : Sample
            Scalar measurement.
        dx : SX (n, 1)
            Change of the mean since the prediction, by the measurements before this one.
        P : SX (n, n) or None
            Covariance before this measurement; None without a covariance.
        """
        PH = None if sample.H is None else P @ sample.H.T
        c = self.innovation(sample, dx, PH)
        if PH is None:
            return c
        P_after = self._updated_covariance(sample, P, PH, c.S, c.inverse_variance)
        return replace(c, dx=dx + PH * c.slope, P=P_after, PH=PH)

    def innovation(self, sample: Sample, dx: Any, PH: Any) -> ScalarUpdate:
        """Return the expressions of the innovation of one scalar measurement, without those of the state after it.

        Parameters
        ----------
        sample : Sample
            Scalar measurement.
        dx : SX (n, 1)
            Change of the mean since the prediction, by the measurements before this one.
        PH : SX (n, 1) or None
            Covariance before this measurement times H'; None without a covariance.
        """
        output, e, S = sample.output, sample.e, sample.R
        if PH is not None:
            e, S = e - sample.H @ dx, sample.H @ PH + S
        if output.angle:
            e = _wrap_angle(e)
        slope, inverse_variance = self.gain_factors(output, e, S)
        ll = (
            outlier_density.log_density(e / ca.sqrt(S)) - 0.5 * ca.log(S)
            if output.robust
            else -0.5 * (e * slope + ca.log(2 * math.pi * S))
        )
        return ScalarUpdate(sample, e, S, slope, ll, inverse_variance=inverse_variance)

    @staticmethod
    def gain_factors(output: Output, e: Any, S: Any) -> tuple[Any, Any]:
        """Return ``slope`` and ``inverse_variance`` of `ScalarUpdate` for an innovation e and its variance S."""
        if not output.robust:
            return e / S, 1 / S
        scaled = e / ca.sqrt(S)
        return outlier_density.score(scaled) / ca.sqrt(S), outlier_density.score_slope(scaled) / S

    def _updated_covariance(self, sample: Sample, P: Any, PH: Any, S: Any, inverse_variance: Any) -> Any:
        """Return the covariance (n, n) after the update by one scalar measurement, in Joseph's form if that is chosen.

        The reduction of the covariance by the update for normal noise is multiplied by ``inverse_variance S``, which is
        1 for normal noise.

        Parameters
        ----------
        sample : Sample
            Scalar measurement.
        P : SX (n, n)
            Covariance before the update.
        PH : SX (n, 1)
            P times the transposed derivative of the predicted value by the model states.
        S : SX
            Variance of the innovation.
        inverse_variance : SX
            1 / S for normal noise; less, even negative, if the density of the noise includes outliers.
        """
        if not self.joseph:
            return P - (PH * inverse_variance) @ PH.T
        K = PH / S
        rest = ca.SX.eye(self.n) - K @ sample.H
        full_update = rest @ P @ rest.T + sample.R * K @ K.T
        return P + inverse_variance * S * (full_update - P) if sample.output.robust else full_update


def _wrap_angle(angle: Any) -> Any:
    """Return the expression of an angle [rad] wrapped to [-pi, pi)."""
    return angle - 2 * math.pi * ca.floor(angle / (2 * math.pi) + 0.5)


def _trace_model(model: Model) -> tuple[Any, Any]:
    """Call the functions of the model with symbols. Return its rates and its outputs as CasADi functions of (x, u, p).

    The arguments are the states, the inputs and the parameters, and the rates are the derivatives of the states by
    time. ValueError is raised if a rate or an output is missing, is not a scalar, or has lost its symbols.
    """
    x, u, p = (
        ca.SX.sym(name, len(of)) for name, of in (("x", model.states), ("u", model.inputs), ("p", model.parameters))
    )
    signals = model.signals(*[ca.vertsplit(v) if v.numel() else [] for v in (x, u, p)])
    rates = _scalar_column(model, signals.rate, [s.name for s in model.states], "rate of the state")
    outputs = _scalar_column(model, signals.y, [o.name for o in model.outputs], "value of the output")
    return (
        ca.Function("rate", [x, u, p], [simplified(rates)]),
        ca.Function("output", [x, u, p], [simplified(outputs)]),
    )


def _scalar_column(model: Model, values: Mapping[str, Any], names: list[str], role: str) -> Any:
    """Return the values with these names as a dense column (n, 1), in the order of ``names``.

    Parameters
    ----------
    model : Model
        Model that computed the values, for the messages.
    values : Mapping[str, SX or float]
        Expressions by name.
    names : list[str]
        Names of the wanted values.
    role : str
        What the values are, for the messages: "rate of the state", "value of the output".

    Raises
    ------
    ValueError
        If a value is missing, is not a scalar, or contains NaN (it has lost its symbols).
    """
    column = []
    for name in names:
        if name not in values:
            raise ValueError(
                f"model {model.name} returns no {role} {name}; it returns {', '.join(values) or 'none'}; correct the "
                "name, or add the entry"
            )
        value = ca.SX(values[name])
        if value.numel() != 1:
            raise ValueError(
                f"model {model.name}: the {role} {name} is not a scalar; return one number for each state and output"
            )
        if _contains_nan(value):
            raise ValueError(
                f"model {model.name}: the {role} {name} is a number and not a symbolic expression (math.sin, float() "
                "and assignment into np.zeros convert symbols to numbers); use numpy's functions"
            )
        column.append(ca.densify(value))
    return ca.densify(ca.vertcat(*column))


def _contains_nan(expression: Any) -> bool:
    """Return whether the expression contains the constant NaN. CasADi inserts NaN for a symbol that became a number."""
    f = ca.Function("f", ca.symvar(expression), [expression])
    return any(
        f.instruction_id(k) == ca.OP_CONST and math.isnan(f.instruction_constant(k)) for k in range(f.n_instructions())
    )
