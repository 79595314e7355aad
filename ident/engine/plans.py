"""The plans of a filter's kernels: likelihood, its adjoint, its tangents, all it knows row by row, and simulation."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ident.engine.graphs import Graphs, Update
from ident.engine.plan import Gram, Plan, Stage, split, stage, without_slow

ROWS = frozenset({"u", "u_next", "y", "h"})


class Plans:
    """Each made when it is asked for."""

    def __init__(self, graphs: Graphs) -> None:
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
        """Like ``value``; rows tape0, tape1, ... keep what the adjoint of each stage needs of the state before it."""
        stages = [stage(self.graphs.inputs, self._effect(u) | {tape: kept}, bit)
                  for (tape, u, bit), (_, _, kept) in zip(self._sweep(), self._adjoints, strict=True)]
        return Plan(tuple(stages), ROWS | self.tapes)

    def backward(self) -> Plan:
        """The adjoints of the stages in reverse: ``g`` by the parameters, ``bar`` by the state at the start."""
        stages: list[Stage] = []
        for (tape, _, bit), (both, needed, _) in zip(self._sweep(), self._adjoints, strict=True):
            inputs = self.graphs.inputs | {tape: needed, "bar": self._bar}
            del inputs["s"]
            stages.append(stage(inputs, {"bar": both[:self.n_s], "g": both[self.n_s:]}, bit))
        return Plan(tuple(stages[::-1]), ROWS | self.tapes, backward=True)

    @cached_property
    def _adjoints(self) -> list[tuple[Any, Any, Any]]:
        """Of each stage: adjoint by state and parameters; the symbols on its tape, and what they stand for.

        On the tape are sines and the like, and the entries of the state that the adjoint depends on: in a filter less
        than half of them, and a tape of all of them costs a sixth of the way forward in memory alone.
        """
        g, found = self.graphs, []
        for _, u, _ in self._sweep():
            effect = self._effect(u)
            weight = ca.vertcat(self._bar, *[1] * ("ll" in effect))
            both = ca.jtimes(ca.vertcat(*effect.values()), ca.vertcat(g.s, g.p), weight, True)
            early = ca.vertcat(*[v for name, v in g.inputs.items() if name != "p"])
            both, symbols, values = without_slow(both, g.p, early, self._bar)
            kept = [entry for entry, used in zip(ca.vertsplit(g.s), ca.which_depends(both, g.s), strict=True) if used]
            found.append((both, *(ca.vertcat(ca.SX(0, 1), *kept, *more) for more in (symbols, values))))
        return found

    def tangent(self) -> Plan:
        """One lane for each chosen parameter: ``ds`` carried, ``dp`` constant; ``dll`` and ``fisher`` summed.

        The Fisher information of Gaussian innovations: ``de de' / S + dS dS' / (2 S^2)``; a little less of both
        where outliers are allowed.
        """
        g, lanes = self.graphs, {"ds", "dp", "dll"}
        stages: list[Stage | Gram] = []
        ds, dp = ca.SX.sym("ds", self.n_s), ca.SX.sym("dp", self.n_parameters)
        for q, (_, u, bit) in enumerate(self._sweep()):
            seeds = {"ds": ds, "dp": dp}
            results = {"ds": _tangent(g, u.s, ds, dp)}
            if u.e is not None:
                de, dS = _tangent(g, u.e, ds, dp), _tangent(g, u.S, ds, dp)
                results["dll"] = ca.sum1(0.5 * dS * (u.e * u.slope - 1) / u.S - u.slope * de)
                part = ca.sqrt(u.known)
                results[f"v{q}"] = ca.vertcat(part[:, 0] * de / ca.sqrt(u.S),
                                              np.sqrt(0.5) * part[:, 1] * dS / u.S)
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
        return frozenset(f"tape{q}" for q in range(len(self.graphs.updates) + 1))

    def _sweep(self) -> list[tuple[str, Update, int | None]]:
        """Tape, what happens, and the mask's bit, for each stage in order."""
        g = self.graphs
        steps: list[tuple[Update, int | None]] = [(u, bit) for bit, u in enumerate(g.updates)]
        steps.append((Update(g.predict[0], None, None, None), None))
        return [(f"tape{q}", u, bit) for q, (u, bit) in enumerate(steps)]

    @staticmethod
    def _effect(u: Update) -> dict[str, Any]:
        return {"s": u.s} if u.ll is None else {"s": u.s, "ll": u.ll}


def _tangent(g: Graphs, expression: Any, ds: Any, dp: Any) -> Any:
    return ca.jtimes(expression, ca.vertcat(g.s, g.p), ca.vertcat(ds, dp))
