"""Fisher information of many experiments at once, with one experiment in each lane of the vector registers.

In `filter_plans`, each lane holds one parameter of the same record. Here, each lane holds a whole experiment. Each
experiment has its own parameter values. Its inputs are its own or common to all experiments.

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
from seatrial.ident.engine.loop_plan import LoopSegment, Plan, stage
from seatrial.ident.model import Model, Sensor

_batches: dict[tuple[Any, ...], ExperimentBatch] = {}
_contests: dict[tuple[Any, ...], DiscriminationBatch] = {}
_lock = threading.RLock()  # CasADi and LLVM build one kernel at a time


def batch_for(model: Model, free: Sequence[str], *, covariance: bool) -> ExperimentBatch:
    """Return the information kernels of a model. Models that differ only in parameter values share them.

    Parameters
    ----------
    model : Model
        Model of the experiments.
    free : Sequence[str]
        Names of the parameters to differentiate by.
    covariance : bool
        True for prediction error (Kalman filter), False for output error.

    Returns
    -------
    ExperimentBatch
        Kernels, compiled on first use.
    """
    with _lock:
        key = (EkfGraphs(model, covariance=covariance).key, *free)
        return _batches.setdefault(key, ExperimentBatch(model, free, covariance))


def discrimination_batch_for(
    model: Model, free: Sequence[str], truth: Model, *, covariance: bool
) -> DiscriminationBatch:
    """Return the kernel that fits one model to the data of another model, for T-optimal discrimination.

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
        If the models have different sensors.
    """
    with _lock:
        key = (EkfGraphs(model, covariance=covariance).key, EkfGraphs(truth, covariance=False).key, *free)
        return _contests.setdefault(key, DiscriminationBatch(model, free, truth, covariance))


class Filter:
    """Symbols of a model and of its filter.

    ``s`` is the mean and covariance. ``X`` is the derivative of the mean by the free parameters, column by column.
    """

    def __init__(self, model: Model, free: Sequence[str], covariance: bool) -> None:
        """Build the symbols of the model and the unit vectors of the free parameters."""
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

    def slopes(self, expression: Any) -> Any:
        """Return the derivative of an expression by the free parameters, shape (n, q).

        The expression depends on the mean and on the parameters.
        """
        g = self.graphs
        if not self.q:
            return ca.SX(expression.numel(), 0)
        return ca.jtimes(expression, ca.vertcat(g.mean, g.p), ca.vertcat(self.columns, self._unit))

    @property
    def stepped(self) -> dict[str, Any]:
        """State and sensitivities at the end of the interval, by name."""
        g = self.graphs
        result = {"s": g.predict[0]}
        return result | {"X": ca.vec(self.slopes(g.step(g.mean)[0]))} if self.q else result

    def sensors(self) -> list[tuple[int, Sensor, int]]:
        """Return a tuple (bit of the mask, sensor, index of its first output) for each sensor."""
        sensors = self.graphs.model.sensors
        firsts = [sum(len(s.outputs) for s in sensors[:k]) for k in range(len(sensors))]
        return list(zip(range(len(sensors)), sensors, firsts, strict=True))

    def update(self, sensor: Sensor, first: int, y: Any = None) -> tuple[dict[str, Any], list[Any], list[Any]]:
        """Update the state and its sensitivities by the sample of one sensor.

        The outputs of the sensor are processed one after the other.

        Parameters
        ----------
        sensor : Sensor
            Sensor that is sampled.
        first : int
            Index of its first output.
        y : SX (n_outputs of the sensor, 1), optional
            Sample. None: the sample equals its prediction.

        Returns
        -------
        dict[str, SX]
            State ``s`` and sensitivities ``X`` after the update. Empty without a covariance.
        list[SX]
            For each output, the sensitivities (1, q) of the innovation, divided by its standard deviation.
        list[SX]
            For each output, the innovation divided by its standard deviation.
        """
        g, P, X, dx = self.graphs, None, self.columns, 0 * self.graphs.mean
        slopes, innovations = [], []
        H = ca.jacobian(self.z, g.mean) if g.covariance else None
        P = g.P if g.covariance else None
        direct = self._direct()
        for i, output in enumerate(sensor.outputs, start=first):
            R = g._parameter(output.noise) ** 2
            e = ca.SX(0) if y is None else y[i - first] - self.z[i]
            if H is None or P is None:
                S, de = R, self.slopes(self.z[i])
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

    def _direct(self) -> Any:
        """Return the derivative of the outputs by the free parameters with the state held, shape (n_outputs, q)."""
        return ca.jtimes(self.z, self.graphs.p, self._unit) if self.q else ca.SX(self.z.numel(), 0)

    def bounds(self) -> LoopSegment:
        """Return the stage that carries the minimum ``low`` and maximum ``high`` of the quantities in `extremes`."""
        model, mean = self.graphs.model, self.graphs.mean
        names = [v.name for v in model.states]
        speed = [sum(mean[names.index(n)] ** 2 for n in ("u", "v") if n in names)] if "u" in names else []
        values = ca.vertcat(mean, *speed)
        low, high = ca.SX.sym("low", values.numel()), ca.SX.sym("high", values.numel())
        return stage(
            {"s": self.graphs.s, "low": low, "high": high}, {"low": ca.fmin(low, values), "high": ca.fmax(high, values)}
        )


def extremes(model: Model) -> tuple[str, ...]:
    """Return the names of the quantities in the arrays ``low`` and ``high``.

    The quantities are the states, then the squared speed ``speed2`` if the model has a surge speed.
    """
    names = tuple(s.name for s in model.states)
    return (*names, "speed2") if "u" in names else names


class ExperimentBatch:
    """Kernels of one model with one experiment in each lane, compiled on first use.

    In each pair of kernels, the first has common inputs for all lanes. The second has separate inputs for each lane.
    """

    def __init__(self, model: Model, free: Sequence[str], covariance: bool) -> None:
        self.model, self.free, self.covariance = model, tuple(free), covariance
        self._tracks_in_noise: dict[int, Kernel] = {}

    @cached_property
    def information(self) -> tuple[Kernel, Kernel]:
        """Pair of kernels of the Fisher information.

        Results: ``fisher``, the upper triangle of the information (q (q + 1) / 2 entries), summed over the rows;
        ``low`` and ``high``, the bounds of `extremes`.
        """
        with _lock:
            f = Filter(self.model, self.free, self.covariance)
            stages: list[LoopSegment] = []
            for bit, sensor, first in f.sensors():
                after, slopes, _ = f.update(sensor, first)
                stages.append(stage(f.inputs, after | {"fisher": _triangle(ca.vertcat(*slopes))}, bit))
            stages += [f.bounds(), stage(f.inputs, f.stepped)]
            return _pair(stages, frozenset({"s", "X", "p", "fisher", "low", "high"}))

    @cached_property
    def tracks(self) -> tuple[Kernel, Kernel]:
        """Pair of kernels that simulate without an update. Results: only ``low`` and ``high``."""
        with _lock:
            f = Filter(self.model, (), covariance=False)
            inputs = {n: v for n, v in f.inputs.items() if n != "X"}
            return _pair([f.bounds(), stage(inputs, f.stepped)], frozenset({"s", "p", "low", "high"}))

    def tracks_in_noise(self, n_common: int) -> Kernel:
        """Return a kernel like ``tracks`` with common and separate inputs.

        Parameters
        ----------
        n_common : int
            The first `n_common` inputs (``u``, ``u_next``) are common to all lanes.
            Each lane has its own values of the remaining inputs (``w``, ``w_next``).

        Notes
        -----
        A command model has dozens of inputs. Copying all of them for each lane would take ten times as long as the
        simulation.
        """
        with _lock:
            if n_common not in self._tracks_in_noise:
                f = Filter(self.model, (), covariance=False)
                ends, symbols = ("", "_next"), dict[str, Any]()
                for end in ends:
                    symbols[f"u{end}"] = ca.SX.sym(f"u{end}", n_common)
                    symbols[f"w{end}"] = ca.SX.sym(f"w{end}", f.inputs["u"].numel() - n_common)
                all_inputs = [ca.vertcat(symbols[f"u{end}"], symbols[f"w{end}"]) for end in ends]
                (after,) = ca.substitute([f.stepped["s"]], [f.inputs["u"], f.inputs["u_next"]], all_inputs)
                inputs = {name: f.inputs[name] for name in ("s", "p", "h")} | symbols
                stages = (f.bounds(), stage(inputs, {"s": after}))
                rows, lanes = {*symbols, "h"}, {"s", "p", "low", "high", "w", "w_next"}
                self._tracks_in_noise[n_common] = Kernel(Plan(stages, frozenset(rows), frozenset(lanes)))
            return self._tracks_in_noise[n_common]


def _pair(stages: list[LoopSegment], lanes: frozenset[str]) -> tuple[Kernel, Kernel]:
    """Return the kernels with common inputs for all lanes, and with separate inputs for each lane."""
    rows = frozenset({"u", "u_next", "h"})
    return Kernel(Plan(tuple(stages), rows, lanes)), Kernel(Plan(tuple(stages), rows, lanes | {"u", "u_next"}))


class DiscriminationBatch:
    """Filter of one model on the noise-free data of another model, with one experiment in each lane.

    Its innovations are the part of the data that the model cannot explain.
    """

    def __init__(self, model: Model, free: Sequence[str], truth: Model, covariance: bool) -> None:
        if [(s.name, [o.name for o in s.outputs]) for s in model.sensors] != [
            (s.name, [o.name for o in s.outputs]) for s in truth.sensors
        ]:
            raise ValueError(f"models {model.name} and {truth.name} have different sensors")
        self.model, self.free, self.truth, self.covariance = model, tuple(free), truth, covariance

    @cached_property
    def unexplained(self) -> Kernel:
        """Kernel of the innovations of the model on the data of the other model.

        Results, summed over the rows: ``ee``, the sum of ``e' S^-1 e``; ``score`` (q,), the sum of ``de' S^-1 e``;
        ``fisher``, as in `ExperimentBatch.information`. ``low`` and ``high`` are the bounds of the model's states.
        The arrays of the model that generates the data end in ``_true``.
        """
        with _lock:
            f, true = Filter(self.model, self.free, self.covariance), Filter(self.truth, (), covariance=False)
            true_inputs = {f"{n}_true": v for n, v in true.inputs.items() if n not in ("X", "h")}
            inputs: Mapping[str, Any] = f.inputs | true_inputs
            stages: list[LoopSegment] = []
            for bit, sensor, first in f.sensors():
                after, slopes, e = f.update(sensor, first, true.z[first : first + len(sensor.outputs)])
                V, r = ca.vertcat(*slopes), ca.vertcat(*e)
                stages.append(stage(inputs, after | {"fisher": _triangle(V), "score": V.T @ r, "ee": r.T @ r}, bit))
            h = {"h": true.graphs.h}
            stages += [f.bounds(), stage(f.inputs, f.stepped), stage(true_inputs | h, {"s_true": true.stepped["s"]})]
            rows = frozenset({"u", "u_next", "u_true", "u_next_true", "h"})
            lanes = frozenset({*inputs, "fisher", "score", "ee", "low", "high"}) - {"h"}
            return Kernel(Plan(tuple(stages), rows, lanes))


def _triangle(v: Any) -> Any:
    """Return the upper triangle of v'v by rows, as a column. v (n, q) has scaled rows."""
    q = v.shape[1]
    return ca.vertcat(*[ca.dot(v[:, i], v[:, j]) for i in range(q) for j in range(i, q)])
