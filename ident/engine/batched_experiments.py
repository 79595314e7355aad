"""Fisher information of many experiments at once, one in each lane of the vectors.

Where `filter_plans` gives one lane to each parameter of one record, here a lane is a whole experiment: its own inputs
(or the same for all) and its own values of the parameters. Data are what the model itself predicts, so innovations
are zero and sensitivities need no derivative of the filter's gain: with P, H and S of the filter along that path,

    de = H X + dh/dp,   F += de' S^-1 de,   X -= K de,   X <- d step / d (x, p) (X, 1)

which is exact for the part ``de' S^-1 de`` of the Fisher information; ``1/2 tr(S^-1 dS S^-1 dS)`` tells of noise and is
left to `filter_plans`. Without process noise (output error) P and K are zero and S is R.
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
    """The kernels of a model and the parameters to differentiate by, shared by all that differ only in values."""
    with _lock:
        key = (EkfGraphs(model, covariance=covariance).key, *free)
        return _batches.setdefault(key, ExperimentBatch(model, free, covariance))


def contest_for(model: Model, free: Sequence[str], truth: Model, *, covariance: bool) -> DiscriminationBatch:
    """The kernel of a model that explains another's data."""
    with _lock:
        key = (EkfGraphs(model, covariance=covariance).key, EkfGraphs(truth, covariance=False).key, *free)
        return _contests.setdefault(key, DiscriminationBatch(model, free, truth, covariance))


class Filter:
    """A model's symbols and its filter: ``s`` mean and covariance, ``X`` d mean / d free by columns."""

    def __init__(self, model: Model, free: Sequence[str], covariance: bool) -> None:
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
        """d expression / d free (n, q), of what depends on the mean and the parameters."""
        g = self.graphs
        if not self.q:
            return ca.SX(expression.numel(), 0)
        return ca.jtimes(expression, ca.vertcat(g.mean, g.p), ca.vertcat(self.columns, self._unit))

    @property
    def stepped(self) -> dict[str, Any]:
        g = self.graphs
        result = {"s": g.predict[0]}
        return result | {"X": ca.vec(self.slopes(g.step(g.mean)[0]))} if self.q else result

    def sensors(self) -> list[tuple[int, Sensor, int]]:
        """Bit of the mask, sensor, and its first output."""
        sensors = self.graphs.model.sensors
        firsts = [sum(len(s.outputs) for s in sensors[:k]) for k in range(len(sensors))]
        return list(zip(range(len(sensors)), sensors, firsts, strict=True))

    def update(self, sensor: Sensor, first: int, y: Any = None) -> tuple[dict[str, Any], list[Any], list[Any]]:
        """State and sensitivities after a sensor's sample, and the scaled sensitivities (1, q) and innovations of its
        outputs, one after the other. ``y``: the sample; None: as predicted."""
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
        """d output / d free (n_outputs, q) with the state held."""
        return ca.jtimes(self.z, self.graphs.p, self._unit) if self.q else ca.SX(self.z.numel(), 0)

    def bounds(self) -> LoopSegment:
        """Carries the least and the largest of what ``extremes`` names."""
        model, mean = self.graphs.model, self.graphs.mean
        names = [v.name for v in model.states]
        speed = [sum(mean[names.index(n)] ** 2 for n in ("u", "v") if n in names)] if "u" in names else []
        seen = ca.vertcat(mean, *speed)
        low, high = ca.SX.sym("low", seen.numel()), ca.SX.sym("high", seen.numel())
        return stage(
            {"s": self.graphs.s, "low": low, "high": high}, {"low": ca.fmin(low, seen), "high": ca.fmax(high, seen)}
        )


def extremes(model: Model) -> tuple[str, ...]:
    """What ``low`` and ``high`` are of: the states, and the squared speed where there is a surge speed."""
    names = tuple(s.name for s in model.states)
    return (*names, "speed2") if "u" in names else names


class ExperimentBatch:
    """Kernels of one model, each made when first asked for; lanes: experiments.

    Of each pair the first has the same inputs in all lanes, the second each lane its own.
    """

    def __init__(self, model: Model, free: Sequence[str], covariance: bool) -> None:
        self.model, self.free, self.covariance = model, tuple(free), covariance
        self._tracks_in_noise: dict[int, Kernel] = {}

    @cached_property
    def information(self) -> tuple[Kernel, Kernel]:
        """``fisher``: upper triangle (q (q + 1) / 2), summed; low, high."""
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
        """Only ``low`` and ``high`` of a simulation."""
        with _lock:
            f = Filter(self.model, (), covariance=False)
            inputs = {n: v for n, v in f.inputs.items() if n != "X"}
            return _pair([f.bounds(), stage(inputs, f.stepped)], frozenset({"s", "p", "low", "high"}))

    def tracks_in_noise(self, n_common: int) -> Kernel:
        """``tracks``, where the first inputs, so many, are the same in all lanes, and each lane has its own others.

        The others are the arrays ``w`` and ``w_next``. A command model has dozens of inputs: a copy of them for each
        lane would take ten times as long as the simulation.
        """
        with _lock:
            if n_common not in self._tracks_in_noise:
                f = Filter(self.model, (), covariance=False)
                ends, symbols = ("", "_next"), dict[str, Any]()
                for end in ends:
                    symbols[f"u{end}"] = ca.SX.sym(f"u{end}", n_common)
                    symbols[f"w{end}"] = ca.SX.sym(f"w{end}", f.inputs["u"].numel() - n_common)
                whole = [ca.vertcat(symbols[f"u{end}"], symbols[f"w{end}"]) for end in ends]
                (after,) = ca.substitute([f.stepped["s"]], [f.inputs["u"], f.inputs["u_next"]], whole)
                inputs = {name: f.inputs[name] for name in ("s", "p", "h")} | symbols
                stages = (f.bounds(), stage(inputs, {"s": after}))
                rows, lanes = {*symbols, "h"}, {"s", "p", "low", "high", "w", "w_next"}
                self._tracks_in_noise[n_common] = Kernel(Plan(stages, frozenset(rows), frozenset(lanes)))
            return self._tracks_in_noise[n_common]


def _pair(stages: list[LoopSegment], lanes: frozenset[str]) -> tuple[Kernel, Kernel]:
    rows = frozenset({"u", "u_next", "h"})
    return Kernel(Plan(tuple(stages), rows, lanes)), Kernel(Plan(tuple(stages), rows, lanes | {"u", "u_next"}))


class DiscriminationBatch:
    """A model's filter on the undisturbed data of another: what it cannot explain. Lanes: experiments."""

    def __init__(self, model: Model, free: Sequence[str], truth: Model, covariance: bool) -> None:
        if [(s.name, [o.name for o in s.outputs]) for s in model.sensors] != [
            (s.name, [o.name for o in s.outputs]) for s in truth.sensors
        ]:
            raise ValueError(f"models {model.name} and {truth.name} have different sensors")
        self.model, self.free, self.truth, self.covariance = model, tuple(free), truth, covariance

    @cached_property
    def unexplained(self) -> Kernel:
        """``ee``: sum e' S^-1 e of the model's innovations; ``score`` (q,): sum de' S^-1 e; ``fisher``. The truth's
        arrays end in ``_true``; low, high: of the model's states."""
        with _lock:
            f, true = Filter(self.model, self.free, self.covariance), Filter(self.truth, (), covariance=False)
            theirs = {f"{n}_true": v for n, v in true.inputs.items() if n not in ("X", "h")}
            inputs: Mapping[str, Any] = f.inputs | theirs
            stages: list[LoopSegment] = []
            for bit, sensor, first in f.sensors():
                after, slopes, e = f.update(sensor, first, true.z[first : first + len(sensor.outputs)])
                V, r = ca.vertcat(*slopes), ca.vertcat(*e)
                stages.append(stage(inputs, after | {"fisher": _triangle(V), "score": V.T @ r, "ee": r.T @ r}, bit))
            h = {"h": true.graphs.h}
            stages += [f.bounds(), stage(f.inputs, f.stepped), stage(theirs | h, {"s_true": true.stepped["s"]})]
            rows = frozenset({"u", "u_next", "u_true", "u_next_true", "h"})
            lanes = frozenset({*inputs, "fisher", "score", "ee", "low", "high"}) - {"h"}
            return Kernel(Plan(tuple(stages), rows, lanes))


def _triangle(v: Any) -> Any:
    """Upper triangle by rows of v'v, as a column; v (n, q), its rows scaled already."""
    q = v.shape[1]
    return ca.vertcat(*[ca.dot(v[:, i], v[:, j]) for i in range(q) for j in range(i, q)])
