"""Fisher information of many experiments at once, with one experiment in each lane of the vector registers.

A lane is one element of the processor's vector registers. In `filter_plans`, each lane holds the derivatives by one
parameter for the same record. Here, each lane holds a whole experiment. Each experiment has its own parameter values.
Its inputs are its own or common to all experiments.

The data are the predictions of the model, so all innovations are zero. The sensitivities therefore need no derivative
of the Kalman gain. With P, H and S of the filter along the predicted path,

    de = H X + dh/dp,   F += de' S^-1 de,   X -= K de,   X <- d step / d (x, p) (X, 1)

The recursion is exact for the part ``de' S^-1 de`` of the Fisher information. The part ``1/2 tr(S^-1 dS S^-1 dS)``
informs the noise parameters; only `filter_plans` computes it. Without process noise (output error), P and K are zero
and S is R.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca

from seatrial.ident.engine.ekf_graph import EkfGraphs, pack
from seatrial.ident.engine.kernel import Kernel
from seatrial.ident.engine.loop_plan import ExpressionStage, Plan, stage
from seatrial.ident.model import Model, Sensor

# by the keys of the filters' graphs and the names of the free parameters
_batches: dict[tuple[Any, ...], ExperimentBatch] = {}
_discrimination_batches: dict[tuple[Any, ...], DiscriminationBatch] = {}
_lock = threading.RLock()  # CasADi and LLVM build one kernel at a time


def batch_for(model: Model, free: Sequence[str], *, covariance: bool) -> ExperimentBatch:
    """Return the kernels (compiled programs) that compute the Fisher information of many experiments with one model.

    A repeated call returns the same object, which is kept until the process ends. Models that differ only in parameter
    values share it.

    Parameters
    ----------
    model : Model
        Model of the experiments.
    free : Sequence[str]
        Names of the parameters to differentiate by, in the order of the information matrix.
    covariance : bool
        True for prediction error (Kalman filter), False for output error.

    Returns
    -------
    ExperimentBatch
        Kernels, each compiled on first use.

    Raises
    ------
    ValueError
        If the filter of the model cannot be built, for example if the model has more than 32 sensors.
    """
    with _lock:
        key = (EkfGraphs(model, covariance=covariance).key, *free)
        return _batches.setdefault(key, ExperimentBatch(model, free, covariance))


def discrimination_batch_for(
    model: Model, free: Sequence[str], truth: Model, *, covariance: bool
) -> DiscriminationBatch:
    """Return the kernel (compiled program) that runs the filter of one model on noise-free data of another model.

    T-optimal discrimination of two models uses it.

    A repeated call returns the same object, which is kept until the process ends. Models that differ only in parameter
    values share it.

    Parameters
    ----------
    model : Model
        Model whose filter processes the data.
    free : Sequence[str]
        Names of the parameters of `model` to differentiate by.
    truth : Model
        Model that generates the data, without noise.
    covariance : bool
        True for prediction error (Kalman filter), False for output error.

    Returns
    -------
    DiscriminationBatch
        Kernel, compiled on first use.

    Raises
    ------
    ValueError
        If the models have different sensors, or if a filter cannot be built.
    """
    with _lock:
        key = (EkfGraphs(model, covariance=covariance).key, EkfGraphs(truth, covariance=False).key, *free)
        return _discrimination_batches.setdefault(key, DiscriminationBatch(model, free, truth, covariance))


class FilterSymbols:
    """CasADi expressions of a model's filter and of its sensitivities to the q free parameters, for one experiment.

    Attributes
    ----------
    graphs : EkfGraphs
        Expressions of the filter.
    q : int
        Number of free parameters.
    X : SX (n q, 1)
        Symbols of the sensitivities: derivatives of the n entries of the mean by the free parameters, one parameter
        after the other.
    columns : SX (n, q)
        `X` as a matrix.
    z : SX (n_outputs, 1)
        Predicted outputs at the mean.
    inputs : dict[str, SX]
        Symbols by name: filter state ``s`` (mean, then upper triangle of the covariance), sensitivities ``X``, inputs
        ``u`` and ``u_next`` at both ends of the interval between two rows, parameters ``p``, and length ``h`` of the
        interval [s].
    """

    def __init__(self, model: Model, free: Sequence[str], covariance: bool) -> None:
        """Build the symbols and expressions of the filter.

        Parameters
        ----------
        model : Model
            Model of the experiment.
        free : Sequence[str]
            Names of the parameters to differentiate by; may be empty, for a filter without sensitivities. ValueError is
            raised for a name that the model lacks.
        covariance : bool
            True for prediction error (Kalman filter), False for output error.
        """
        g = self.graphs = EkfGraphs(model, covariance=covariance)
        names = [p.name for p in model.parameters]
        self.q = len(free)
        self.X = ca.SX.sym("X", g.n * self.q)
        self.columns = ca.reshape(self.X, g.n, self.q)
        self._unit = ca.SX(len(names), self.q)
        for lane, name in enumerate(free):
            self._unit[names.index(name), lane] = 1.0
        self.z = g.output(g.mean, g.u, g.p)
        self.inputs = {"s": g.s, "X": self.X, "u": g.u, "u_next": g.u_next, "p": g.p, "h": g.h}

    def parameter_derivatives(self, expression: Any) -> Any:
        """Return the total derivative (m, q) of a column of expressions (m, 1) by the q free parameters.

        It includes the dependence of the filter's mean on the parameters, by the sensitivities ``X``. The expressions
        may contain the symbols of the mean, the parameters, the inputs and the length of the interval. The result has
        the shape (m, 0) if q is 0.
        """
        g = self.graphs
        if not self.q:
            return ca.SX(expression.numel(), 0)
        return ca.jtimes(expression, ca.vertcat(g.mean, g.p), ca.vertcat(self.columns, self._unit))

    @property
    def end_of_interval(self) -> dict[str, Any]:
        """Expressions of filter state ``s`` and sensitivities ``X`` at the end of the interval to the next row.

        The mapping has no ``X`` if q is 0. Without a covariance, ``s`` is the mean alone.
        """
        g = self.graphs
        result = {"s": g.predict[0]}
        return result | {"X": ca.vec(self.parameter_derivatives(g.step(g.mean)[0]))} if self.q else result

    def sensor_stages(self) -> list[tuple[int, Sensor, int]]:
        """Return a tuple for each sensor: its number, the sensor, and the index of its first output in the model.

        The number, counted from zero, is the bit that is set in the mask of a row if the sensor has a sample in it.
        """
        sensors = self.graphs.model.sensors
        firsts = [sum(len(s.outputs) for s in sensors[:k]) for k in range(len(sensors))]
        return list(zip(range(len(sensors)), sensors, firsts, strict=True))

    def update(self, sensor: Sensor, first: int, y: Any = None) -> tuple[dict[str, Any], list[Any], list[Any]]:
        """Return the expressions of the update of the filter and its sensitivities by the sample of one sensor.

        The outputs of the sensor are processed one after the other; each innovation and its variance are given the
        outputs before it. The innovation of an angle is wrapped to -pi to pi. The density of the noise is normal, even
        for an output with the outlier model. The derivative of the Kalman gain is neglected, which is exact if all
        innovations are zero.

        Parameters
        ----------
        sensor : Sensor
            Sensor that is sampled.
        first : int
            Index of its first output in the model.
        y : SX (n_outputs of the sensor, 1), optional
            Sample. None: the sample equals its prediction, so that all innovations are zero.

        Returns
        -------
        dict[str, SX]
            Filter state ``s`` and sensitivities ``X`` after the update; no ``X`` if q is 0. Empty without a covariance,
            because the sample does not change the filter then.
        list[SX]
            For each output, the sensitivities (1, q) of its prediction, divided by the standard deviation of the
            innovation. They are the negative of the sensitivities of the innovation.
        list[SX]
            For each output, the innovation (measured minus predicted) divided by its standard deviation.
        """
        g, P, X, dx = self.graphs, None, self.columns, 0 * self.graphs.mean
        slopes, innovations = [], []
        H = ca.jacobian(self.z, g.mean) if g.covariance else None
        P = g.P if g.covariance else None
        direct = self._output_parameter_derivatives()
        for i, output in enumerate(sensor.outputs, start=first):
            R = g.parameter_symbol(output.noise) ** 2
            e = ca.SX(0) if y is None else y[i - first] - self.z[i]
            if H is None or P is None:
                S, de = R, self.parameter_derivatives(self.z[i])
            else:
                PH = P @ H[i, :].T
                S, de = H[i, :] @ PH + R, H[i, :] @ X + direct[i, :]
                e = e - H[i, :] @ dx
            if output.angle and y is not None:
                e = e - 2 * ca.pi * ca.floor(e / (2 * ca.pi) + 0.5)
            if H is not None and P is not None:
                K = PH / S
                X, P, dx = X - K @ de, P - K @ PH.T, dx + K * e
            slopes.append(de / ca.sqrt(S))
            innovations.append(e / ca.sqrt(S))
        if P is None:
            return {}, slopes, innovations
        after = {"s": ca.vertcat(g.mean + dx, pack(P))}
        return after | {"X": ca.vec(X)} if self.q else after, slopes, innovations

    def _output_parameter_derivatives(self) -> Any:
        """Return the partial derivatives (n_outputs, q) of the outputs by the free parameters, at constant mean."""
        return ca.jtimes(self.z, self.graphs.p, self._unit) if self.q else ca.SX(self.z.numel(), 0)

    def extremes_stage(self) -> ExpressionStage:
        """Return the stage (step of a kernel in each row) that updates the arrays ``low`` and ``high``.

        These pass from row to row, and hold the least and the largest value so far of the quantities that the function
        `extremes` lists: the states and the squared speed. Their values before the first row count too, so that the
        caller starts them from plus and minus infinity. The end of the last interval does not count.
        """
        model, mean = self.graphs.model, self.graphs.mean
        names = [v.name for v in model.states]
        speed = [sum(mean[names.index(n)] ** 2 for n in ("u", "v") if n in names)] if "u" in names else []
        values = ca.vertcat(mean, *speed)
        low, high = ca.SX.sym("low", values.numel()), ca.SX.sym("high", values.numel())
        return stage(
            {"s": self.graphs.s, "low": low, "high": high}, {"low": ca.fmin(low, values), "high": ca.fmax(high, values)}
        )


def extremes(model: Model) -> tuple[str, ...]:
    """Return the names of the quantities whose least and largest values a simulation of experiments records.

    The kernels of this module return these values in the arrays ``low`` and ``high``. The quantities are the states in
    the order of the model. If the model has the state ``u`` (surge speed), ``speed2`` follows, the squared speed
    through the water [m2/s2]: ``u^2 + v^2``, or ``u^2`` without a sway speed.
    """
    names = tuple(s.name for s in model.states)
    return (*names, "speed2") if "u" in names else names


class ExperimentBatch:
    """Kernels of one model that process many experiments at once, one in each lane. They are compiled on first use.

    A kernel is a program that runs over all rows of a record. A lane is one element of the processor's vector
    registers. In each pair of kernels, the first has the same inputs for all experiments, and the second has separate
    inputs for each.

    Attributes
    ----------
    model : Model
        Model of the experiments.
    free : tuple[str, ...]
        Names of the q parameters to differentiate by.
    covariance : bool
        True for prediction error (Kalman filter), False for output error.
    """

    def __init__(self, model: Model, free: Sequence[str], covariance: bool) -> None:
        """Store model, free parameters and ``covariance``, which the class describes. Nothing is compiled yet."""
        self.model, self.free, self.covariance = model, tuple(free), covariance
        self._tracks_in_noise: dict[int, Kernel] = {}

    @cached_property
    def information(self) -> tuple[Kernel, Kernel]:
        """Pair of kernels of the Fisher information: with common inputs, and with separate inputs for each experiment.

        The results for each experiment (lane) are ``fisher``, ``low`` and ``high``. ``fisher`` is the upper triangle of
        the information matrix of the free parameters, by matrix rows (q (q + 1) / 2 entries), summed over the rows of
        the record. ``low`` and ``high`` are the least and largest values of the quantities that the function `extremes`
        lists: the states and the squared speed. The caller passes initial values of the filter state ``s``, of the
        sensitivities ``X``, and of ``low`` and ``high`` (plus and minus infinity).
        """
        with _lock:
            f = FilterSymbols(self.model, self.free, self.covariance)
            stages: list[ExpressionStage] = []
            for bit, sensor, first in f.sensor_stages():
                after, slopes, _ = f.update(sensor, first)
                stages.append(stage(f.inputs, after | {"fisher": _gram_upper_triangle(ca.vertcat(*slopes))}, bit))
            stages += [f.extremes_stage(), stage(f.inputs, f.end_of_interval)]
            return _kernel_pair(stages, frozenset({"s", "X", "p", "fisher", "low", "high"}))

    @cached_property
    def tracks(self) -> tuple[Kernel, Kernel]:
        """Pair of kernels that simulate the model without process noise: with common inputs, and with separate inputs.

        The results for each experiment (lane) are ``low`` and ``high``, the least and largest values of the quantities
        that the function `extremes` lists: the states and the squared speed. The caller passes their initial values,
        plus and minus infinity, and the initial states ``s``.
        """
        with _lock:
            f = FilterSymbols(self.model, (), covariance=False)
            inputs = {n: v for n, v in f.inputs.items() if n != "X"}
            return _kernel_pair(
                [f.extremes_stage(), stage(inputs, f.end_of_interval)], frozenset({"s", "p", "low", "high"})
            )

    def tracks_in_noise(self, n_common: int) -> Kernel:
        """Return a simulation kernel like ``tracks``, in which some inputs are common to all experiments.

        A lane holds one experiment. A repeated call with the same argument returns the same kernel.

        Parameters
        ----------
        n_common : int
            The first `n_common` inputs are common to all lanes (arrays ``u`` and ``u_next``, at both ends of an
            interval). Each lane has its own values of the other inputs (arrays ``w`` and ``w_next``), for example
            noise.

        Notes
        -----
        A command model has dozens of inputs. Copying all of them for each lane would take ten times as long as the
        simulation.
        """
        with _lock:
            if n_common not in self._tracks_in_noise:
                f = FilterSymbols(self.model, (), covariance=False)
                ends, symbols = ("", "_next"), dict[str, Any]()
                for end in ends:
                    symbols[f"u{end}"] = ca.SX.sym(f"u{end}", n_common)
                    symbols[f"w{end}"] = ca.SX.sym(f"w{end}", f.inputs["u"].numel() - n_common)
                all_inputs = [ca.vertcat(symbols[f"u{end}"], symbols[f"w{end}"]) for end in ends]
                (after,) = ca.substitute([f.end_of_interval["s"]], [f.inputs["u"], f.inputs["u_next"]], all_inputs)
                inputs = {name: f.inputs[name] for name in ("s", "p", "h")} | symbols
                stages = (f.extremes_stage(), stage(inputs, {"s": after}))
                rows, lanes = {*symbols, "h"}, {"s", "p", "low", "high", "w", "w_next"}
                self._tracks_in_noise[n_common] = Kernel(Plan(stages, frozenset(rows), frozenset(lanes)))
            return self._tracks_in_noise[n_common]


def _kernel_pair(stages: list[ExpressionStage], lanes: frozenset[str]) -> tuple[Kernel, Kernel]:
    """Return two kernels with the same stages: one with inputs common to all lanes, one with separate inputs for each.

    A lane holds one experiment, and a stage is a step of the computation in each row. ``lanes`` are the names of all
    other arrays with a separate value for each lane.
    """
    rows = frozenset({"u", "u_next", "h"})
    return Kernel(Plan(tuple(stages), rows, lanes)), Kernel(Plan(tuple(stages), rows, lanes | {"u", "u_next"}))


class DiscriminationBatch:
    """Filter of one model on the noise-free data of another model, for many experiments at once, one in each lane.

    A lane is one element of the processor's vector registers. The innovations of the filter are the part of the data
    that its model cannot explain.

    Attributes
    ----------
    model, truth : Model
        Model of the filter, and model that generates the data. ValueError is raised if their sensors differ.
    free : tuple[str, ...]
        Names of the q parameters of `model` to differentiate by.
    covariance : bool
        True for prediction error (Kalman filter), False for output error.
    """

    def __init__(self, model: Model, free: Sequence[str], truth: Model, covariance: bool) -> None:
        """Store the arguments, which the class describes. Nothing is compiled yet.

        ValueError is raised if the models have different sensors or different outputs of a sensor.
        """
        if [(s.name, [o.name for o in s.outputs]) for s in model.sensors] != [
            (s.name, [o.name for o in s.outputs]) for s in truth.sensors
        ]:
            raise ValueError(
                f"models {model.name} and {truth.name} have different sensors; use models with the same sensors"
            )
        self.model, self.free, self.truth, self.covariance = model, tuple(free), truth, covariance

    @cached_property
    def unexplained(self) -> Kernel:
        """Kernel that computes the innovations of the filter of ``model`` on noise-free data of ``truth``.

        e are the innovations, S their variances and de their derivatives by the q free parameters. The results for each
        experiment (lane) are sums over the rows of the record: ``ee`` of ``e' S^-1 e``, ``score`` (q,) of
        ``de' S^-1 e``, and ``fisher`` of ``de' S^-1 de``, its upper triangle by matrix rows. Here de has the sign of
        the derivatives of the prediction. Further results are
        ``low`` and ``high``, the least and largest values of the states (and squared speed) of the filter; the caller
        starts them from plus and minus infinity. The names of the arrays of the model ``truth`` end in ``_true``. Both
        models have separate inputs for each experiment.
        """
        with _lock:
            f, true = (
                FilterSymbols(self.model, self.free, self.covariance),
                FilterSymbols(self.truth, (), covariance=False),
            )
            true_inputs = {f"{n}_true": v for n, v in true.inputs.items() if n not in ("X", "h")}
            inputs: Mapping[str, Any] = f.inputs | true_inputs
            stages: list[ExpressionStage] = []
            for bit, sensor, first in f.sensor_stages():
                after, slopes, e = f.update(sensor, first, true.z[first : first + len(sensor.outputs)])
                V, r = ca.vertcat(*slopes), ca.vertcat(*e)
                stages.append(
                    stage(inputs, after | {"fisher": _gram_upper_triangle(V), "score": V.T @ r, "ee": r.T @ r}, bit)
                )
            h = {"h": true.graphs.h}
            stages += [
                f.extremes_stage(),
                stage(f.inputs, f.end_of_interval),
                stage(true_inputs | h, {"s_true": true.end_of_interval["s"]}),
            ]
            rows = frozenset({"u", "u_next", "u_true", "u_next_true", "h"})
            lanes = frozenset({*inputs, "fisher", "score", "ee", "low", "high"}) - {"h"}
            return Kernel(Plan(tuple(stages), rows, lanes))


def _gram_upper_triangle(v: Any) -> Any:
    """Return the upper triangle of ``v' v`` for v (n, q), by matrix rows, as a column (q (q + 1) / 2, 1)."""
    q = v.shape[1]
    return ca.vertcat(*[ca.dot(v[:, i], v[:, j]) for i in range(q) for j in range(i, q)])
