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
    """Each made when it is asked for."""

    def __init__(self, graphs: EkfGraphs) -> None:
        self.graphs = graphs
        self.n_s = int(graphs.s.numel())
        self.n_parameters = int(graphs.p.numel())
        self._bar = ca.SX.sym("bar", self.n_s)

    def value(self) -> Plan:
        """s carried, p constant; ll summed."""
        g = self.graphs
        updates = [stage(g.inputs, self._effect(u), bit) for bit, u in enumerate(g.updates)]
        return Plan((*updates, stage(g.inputs, {"s": g.predict[0]})), ROWS)

    def forward(self) -> Plan:
        """Like ``value``; rows tape0, tape1, ... and others keep what the adjoint of each stage needs of it."""
        stages = [
            stage(self.graphs.inputs, self._effect(u) | dict(adjoint.keeps), bit)
            for (_, u, bit), adjoint in zip(self._sweep(), self._adjoints, strict=True)
        ]
        return Plan(tuple(stages), ROWS | self.tapes)

    def backward(self) -> Plan:
        """The adjoints of the stages in reverse: ``g`` by the parameters, ``bar`` by the state at the start."""
        stages: list[LoopSegment | Gram | Product] = []
        for (_, _, bit), adjoint in zip(self._sweep(), self._adjoints, strict=True):
            stages = [*adjoint.stages(self.graphs, self._bar, bit), *stages]
        return Plan(tuple(stages), ROWS | self.tapes, backward=True)

    @cached_property
    def _adjoints(self) -> list[Adjoint]:
        g, bar = self.graphs, self._bar
        return [
            of_prediction(g, tape, bar) if u.ll is None else of_update(g, u, tape, bar) for tape, u, _ in self._sweep()
        ]

    def tangent(self) -> Plan:
        """One lane for each chosen parameter: ``ds`` carried, ``dp`` constant; ``dll`` and ``fisher`` summed.

        The Fisher information of Gaussian innovations: ``de de' / S + dS dS' / (2 S^2)``; a little less of both
        where outliers are allowed.
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
                part = ca.sqrt(u.known)
                results[f"v{q}"] = ca.vertcat(part[:, 0] * de / ca.sqrt(u.S), np.sqrt(0.5) * part[:, 1] * dS / u.S)
                lanes.add(f"v{q}")
            stages += split(g.inputs, self._effect(u), seeds, results, bit, f"w{q}")
            if u.e is not None:
                stages.append(Gram(f"v{q}", "fisher", int(results[f"v{q}"].numel()), bit))
        return Plan(tuple(stages), ROWS, frozenset(lanes))

    def filter(self) -> Plan:
        """Everything in rows: predicted and filtered state, Phi (by columns), e (all outputs, by the prediction),
        then by sensor, given those before it, e0, S0, e1, ... ; ll summed."""
        g, rows = self.graphs, {"predicted", "filtered", "Phi", "e"}
        s, Phi = g.predict
        stages = [stage(g.inputs, {"predicted": g.s, "e": g.residual})]
        for bit, u in enumerate(g.updates):
            stages.append(stage(g.inputs, self._effect(u) | {f"e{bit}": u.e, f"S{bit}": u.S}, bit))
            rows |= {f"e{bit}", f"S{bit}"}
        stages.append(stage(g.inputs, {"filtered": g.s, "s": s, "Phi": ca.vec(Phi)}))
        return Plan(tuple(stages), ROWS | rows)

    def simulate(self) -> Plan:
        """Rows ``x`` and ``z`` (outputs), s carried; of graphs without a covariance."""
        g = self.graphs
        z = g.output(g.s, g.u, g.p)
        inputs = {name: v for name, v in g.inputs.items() if name != "y"}
        return Plan((stage(inputs, {"x": g.s, "z": z, "s": g.step(g.s)[0]}),), ROWS - {"y"} | {"x", "z"})

    @property
    def tapes(self) -> frozenset[str]:
        return frozenset(name for adjoint in self._adjoints for name in adjoint.keeps)

    def _sweep(self) -> list[tuple[str, Update, int | None]]:
        """Tape, what happens, and the mask's bit, for each stage in order."""
        g = self.graphs
        steps: list[tuple[Update, int | None]] = [(u, bit) for bit, u in enumerate(g.updates)]
        steps.append((Update(g.predict[0], None, None, None), None))
        return [(f"tape{q}", u, bit) for q, (u, bit) in enumerate(steps)]

    @staticmethod
    def _effect(u: Update) -> dict[str, Any]:
        return {"s": u.s} if u.ll is None else {"s": u.s, "ll": u.ll}


def _tangent(g: EkfGraphs, expression: Any, ds: Any, dp: Any) -> Any:
    """Directional derivative. What depends on inputs and parameters alone, and not on the state, comes in by its
    derivatives by the parameters, which are the same for all lanes: a delayed command has fifty copies, each with a
    weight, and two parameters."""
    known = ca.vertcat(g.u, g.u_next, g.y, g.p, g.h)
    (rest,), symbols, parts = ca.extract_parametric([expression], known, {})
    q, part = ca.vertcat(ca.SX(0, 1), *symbols), ca.vertcat(ca.SX(0, 1), *parts)
    moved = ca.jtimes(rest, ca.vertcat(g.s, g.p, q), ca.vertcat(ds, dp, ca.jacobian(part, g.p) @ dp))
    return ca.substitute(moved, q, part)
