"""Plans of a filter's kernels: likelihood, adjoint, forward sensitivities, filter output by row, and simulation."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine.array_layout import ROWS
from seatrial.ident.engine.ekf_adjoint import Adjoint, of_prediction, of_update
from seatrial.ident.engine.ekf_graph import EkfGraphs, Update
from seatrial.ident.engine.loop_plan import Gram, LoopSegment, Plan, Product, split, stage


class Plans:
    """Plans of the kernels of one filter. Each method builds one plan."""

    def __init__(self, graphs: EkfGraphs) -> None:
        self.graphs = graphs
        self.n_s = int(graphs.s.numel())
        self.n_parameters = int(graphs.p.numel())
        self._bar = ca.SX.sym("bar", self.n_s)

    def value(self) -> Plan:
        """Return the plan of the log-likelihood. ``s`` is carried, ``p`` is constant, ``ll`` is summed."""
        g = self.graphs
        updates = [stage(g.inputs, self._effect(u), bit) for bit, u in enumerate(g.updates)]
        return Plan((*updates, stage(g.inputs, {"s": g.predict[0]})), ROWS)

    def forward(self) -> Plan:
        """Return the plan of the forward pass of the adjoint.

        The plan is like ``value``. In addition, the rows of tape0, tape1, ... and of other arrays store the values that
        the adjoint of each stage reads.
        """
        stages = [
            stage(self.graphs.inputs, self._effect(u) | dict(adjoint.keeps), bit)
            for (_, u, bit), adjoint in zip(self._sweep(), self._adjoints, strict=True)
        ]
        return Plan(tuple(stages), ROWS | self.tapes)

    def backward(self) -> Plan:
        """Return the plan of the backward pass: the adjoints of the stages in reverse order.

        Results: ``g``, the derivatives by the parameters, and ``bar``, the derivatives by the initial state.
        """
        stages: list[LoopSegment | Gram | Product] = []
        for (_, _, bit), adjoint in zip(self._sweep(), self._adjoints, strict=True):
            stages = [*adjoint.stages(self.graphs, self._bar, bit), *stages]
        return Plan(tuple(stages), ROWS | self.tapes, backward=True)

    @cached_property
    def _adjoints(self) -> list[Adjoint]:
        """Adjoints of the stages in order."""
        g, bar = self.graphs, self._bar
        return [
            of_prediction(g, tape, bar) if u.ll is None else of_update(g, u, tape, bar) for tape, u, _ in self._sweep()
        ]

    def tangent(self) -> Plan:
        """Return the plan of the forward sensitivities, with one lane for each chosen parameter.

        ``ds`` is carried and ``dp`` is constant. ``dll`` and ``fisher`` are summed.

        Notes ----- The Fisher information of Gaussian innovations is the sum of ``de de' / S + dS dS' / (2 S^2)``. If
        outliers are allowed, both terms are reduced by a few per cent.
        """
        g, lanes = self.graphs, {"ds", "dp", "dll"}
        stages: list[LoopSegment | Gram] = []
        ds, dp = ca.SX.sym("ds", self.n_s), ca.SX.sym("dp", self.n_parameters)
        for q, (_, u, bit) in enumerate(self._sweep()):
            seeds = {"ds": ds, "dp": dp}
            results = {"ds": _tangent(g, u.s, ds, dp)}
            if u.e is not None:
                de, dS = _tangent(g, u.e, ds, dp), _tangent(g, u.S, ds, dp)
                results["dll"] = ca.sum1(0.5 * dS * (u.e * u.slope - 1) / u.S - u.slope * de)
                part = ca.sqrt(u.information)
                results[f"v{q}"] = ca.vertcat(part[:, 0] * de / ca.sqrt(u.S), np.sqrt(0.5) * part[:, 1] * dS / u.S)
                lanes.add(f"v{q}")
            stages += split(g.inputs, self._effect(u), seeds, results, bit, f"w{q}")
            if u.e is not None:
                stages.append(Gram(f"v{q}", "fisher", int(results[f"v{q}"].numel()), bit))
        return Plan(tuple(stages), ROWS, frozenset(lanes))

    def filter(self) -> Plan:
        """Return the plan of the filter output, row by row.

        Rows: predicted and filtered state; Phi by columns; ``e``, the residuals of all outputs by the prediction. For
        sensor k, ``e<k>`` and ``S<k>`` are the innovations and their variances, given the sensors before it. ``ll`` is
        summed.
        """
        g, rows = self.graphs, {"predicted", "filtered", "Phi", "e"}
        s, Phi = g.predict
        stages = [stage(g.inputs, {"predicted": g.s, "e": g.residual})]
        for bit, u in enumerate(g.updates):
            stages.append(stage(g.inputs, self._effect(u) | {f"e{bit}": u.e, f"S{bit}": u.S}, bit))
            rows |= {f"e{bit}", f"S{bit}"}
        stages.append(stage(g.inputs, {"filtered": g.s, "s": s, "Phi": ca.vec(Phi)}))
        return Plan(tuple(stages), ROWS | rows)

    def simulate(self) -> Plan:
        """Return the plan of a simulation. Rows: states ``x`` and outputs ``z``. ``s`` is carried.

        The graphs have no covariance.
        """
        g = self.graphs
        z = g.output(g.s, g.u, g.p)
        inputs = {name: v for name, v in g.inputs.items() if name != "y"}
        return Plan((stage(inputs, {"x": g.s, "z": z, "s": g.step(g.s)[0]}),), ROWS - {"y"} | {"x", "z"})

    @property
    def tapes(self) -> frozenset[str]:
        """Names of the arrays that the forward pass writes for the backward pass."""
        return frozenset(name for adjoint in self._adjoints for name in adjoint.keeps)

    def _sweep(self) -> list[tuple[str, Update, int | None]]:
        """Return a tuple (tape, update, bit of the mask or None) for each stage in order. The prediction has no bit."""
        g = self.graphs
        steps: list[tuple[Update, int | None]] = [(u, bit) for bit, u in enumerate(g.updates)]
        steps.append((Update(g.predict[0], None, None, None), None))
        return [(f"tape{q}", u, bit) for q, (u, bit) in enumerate(steps)]

    @staticmethod
    def _effect(u: Update) -> dict[str, Any]:
        """Return the results of a stage by name: the state, and the log-likelihood if the stage is an update."""
        return {"s": u.s} if u.ll is None else {"s": u.s, "ll": u.ll}


def _tangent(g: EkfGraphs, expression: Any, ds: Any, dp: Any) -> Any:
    """Return the directional derivative of an expression along ``ds`` and ``dp``.

    Subexpressions of inputs and parameters alone are differentiated by the parameters once for all lanes. For example,
    a delayed command has fifty copies, each with a weight that depends on two parameters.
    """
    data = ca.vertcat(g.u, g.u_next, g.y, g.p, g.h)
    (rest,), symbols, parts = ca.extract_parametric([expression], data, {})
    q, part = ca.vertcat(ca.SX(0, 1), *symbols), ca.vertcat(ca.SX(0, 1), *parts)
    moved = ca.jtimes(rest, ca.vertcat(g.s, g.p, q), ca.vertcat(ds, dp, ca.jacobian(part, g.p) @ dp))
    return ca.substitute(moved, q, part)
