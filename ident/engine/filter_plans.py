"""Plans of a filter's kernels: likelihood, adjoint, forward sensitivities, filter output by row, and simulation.

A kernel is a program that runs over all rows (instants) of a record. A plan describes it before compilation: the stages
(steps of the computation in each row) and the kinds of the arrays. A carried array passes from row to row, a summed
result is the sum over all rows, and an array in rows has separate entries for each row.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine import jit
from seatrial.ident.engine.array_layout import ROWS
from seatrial.ident.engine.ekf_adjoint import Adjoint, adjoint_of_prediction, adjoint_of_update
from seatrial.ident.engine.ekf_graph import EkfGraphs, Update
from seatrial.ident.engine.filter_stages import FilterStages, directional_derivative
from seatrial.ident.engine.loop_plan import (
    ExpressionStage,
    GramStage,
    Plan,
    ProductStage,
    Stage,
    split_by_lanes,
    stage,
)


class Plans:
    """Plans of the kernels of one filter. Each method builds one plan, a description of a kernel before compilation.

    Most plans use these arrays. In rows: the inputs ``u`` and ``u_next`` at both ends of the interval to the next row,
    the samples ``y``, and the length ``h`` of the interval [s]. Carried from row to row: the filter state, which is
    ``m`` (mean) and ``P`` (covariance, with further numbers at the end of each row), or ``s`` (mean, and upper triangle
    of the covariance) in the adjoint, in Joseph's form and without a covariance. Constant: the parameters ``p``.

    Attributes
    ----------
    graphs : EkfGraphs
        Expressions of the filter.
    n_s, n_parameters : int
        Number of entries of the filter state, and number of parameters of the model.
    """

    def __init__(self, graphs: EkfGraphs) -> None:
        """Store the expressions of the filter for which the methods build plans."""
        self.graphs = graphs
        self.n_s = int(graphs.s.numel())
        self.n_parameters = int(graphs.p.numel())
        self._bar = ca.SX.sym("bar", self.n_s)

    def value(self) -> Plan:
        """Return the plan of the kernel of the log-likelihood.

        The filter state is carried from row to row, the parameters ``p`` are constant, and the log-likelihood ``ll`` is
        summed over the rows.
        """
        g = self.graphs
        if self.graphs.has_matrix_form:
            made = FilterStages(g)
            return Plan((*[s for q in range(len(g.samples)) for s in made.update(q)], *made.prediction()), ROWS)
        updates = [stage(g.inputs, self._stage_results(u), bit) for bit, u in enumerate(g.updates)]
        return Plan((*updates, stage(g.inputs, {"s": g.predict[0]})), ROWS)

    def forward(self) -> Plan:
        """Return the plan of the forward pass: the log-likelihood, and the values that the backward pass needs.

        It computes what ``value`` does. In addition, the arrays ``tape0``, ``tape1``, ... (one for each stage) and, for
        matrix columns, ``moved`` and ``spread`` store for each row the values that the adjoint of the stage reads. A
        stage is the update by one sensor or the prediction.
        """
        stages = [
            stage(self.graphs.inputs, self._stage_results(u) | dict(adjoint.tape_values), bit)
            for (_, u, bit), adjoint in zip(self._forward_steps(), self._adjoints, strict=True)
        ]
        return Plan(tuple(stages), ROWS | self.tapes)

    def backward(self) -> Plan:
        """Return the plan of the backward pass: the gradient of the log-likelihood, by the adjoints of all stages.

        It runs from the last row to the first, and through the stages (updates and prediction) of a row in reverse
        order. Results: ``g``, the derivatives by the parameters, summed over the rows, and ``bar``, the derivatives by
        the initial filter state. ``bar`` is carried; after the last row it has the values that the caller passes, zero
        if none.
        """
        stages: list[ExpressionStage | GramStage | ProductStage] = []
        for (_, _, bit), adjoint in zip(self._forward_steps(), self._adjoints, strict=True):
            stages = [*adjoint.stages(self.graphs, self._bar, bit), *stages]
        return Plan(tuple(stages), ROWS | self.tapes, backward=True)

    @cached_property
    def _adjoints(self) -> list[Adjoint]:
        """Adjoints of the filter's stages in forward order: of the update by each sensor, then of the prediction."""
        g, bar = self.graphs, self._bar
        return [
            adjoint_of_prediction(g, tape, bar) if u.ll is None else adjoint_of_update(g, u, tape, bar)
            for tape, u, _ in self._forward_steps()
        ]

    def tangent_double(self) -> Plan:
        """Return the plan of ``tangent`` in double precision, for derivatives outside the range of single precision."""
        return self.tangent(double=True)

    def tangent(self, double: bool = False) -> Plan:
        """Return the plan of the forward sensitivities, with one lane for each chosen parameter.

        A lane is one element of the processor's vector registers. Arrays in lanes: ``dm`` and ``dP`` (carried), the
        derivatives of mean and covariance, which start from those of the initial state, or ``ds``, those of ``s``;
        ``dp`` (constant), the unit vector of the chosen parameter; ``dll`` (summed over the rows), the derivative of
        the log-likelihood. ``fisher`` (summed) is the expected Fisher information between all lanes, of which only
        blocks on and above the diagonal are written. ``ll`` and the filter state are those of ``value``.

        Parameters
        ----------
        double : bool
            Whether the derivatives are in double precision. Otherwise they are in single precision, and only their sums
            over the rows are in double precision. ``ll`` and the filter state are always in double precision.

        Notes
        -----
        A vector register holds twice as many numbers in single precision. Rounding then matters only where a sample
        reduces the derivative of a variance by orders of magnitude: the rounding error of the derivative before the
        sample remains. The array ``lost`` of a plan in single precision (in lanes) is therefore the sum over all
        samples of the squared ratio ``dS / R``, with the variance R of the noise. The square root of ``lost``, times
        the relative rounding error, is about the error of ``dll``.

        The Fisher information of Gaussian innovations e with variance S is the sum of
        ``de de' / S + dS dS' / (2 S^2)``. If the density of the noise includes outliers, both terms are reduced by a
        few per cent.
        """
        g = self.graphs
        if g.has_matrix_form:
            return self._tangent_by_matrices(double)
        lanes, single = {"ds", "dp", "dll", "lost"}, {"ds", "dp"}
        stages: list[ExpressionStage | GramStage] = []
        ds, dp = ca.SX.sym("ds", self.n_s), ca.SX.sym("dp", self.n_parameters)
        for q, (_, u, bit) in enumerate(self._forward_steps()):
            seeds = {"ds": ds, "dp": dp}
            results = {"ds": directional_derivative(g, u.s, ds, dp)}
            if u.e is not None:
                de, dS = directional_derivative(g, u.e, ds, dp), directional_derivative(g, u.S, ds, dp)
                results["dll"] = ca.sum1(0.5 * dS * (u.e * u.slope - 1) / u.S - u.slope * de)
                part = ca.sqrt(u.information)
                results[f"v{q}"] = ca.vertcat(part[:, 0] * de / ca.sqrt(u.S), np.sqrt(0.5) * part[:, 1] * dS / u.S)
                lanes.add(f"v{q}")
                single.add(f"v{q}")
                if g.covariance and not double:
                    results["lost"] = ca.sumsqr(dS / ca.vertcat(*[c.sample.R for c in u.corrections]))
            single.add(f"w{q}")
            stages += split_by_lanes(g.inputs, self._stage_results(u), seeds, results, bit, f"w{q}")
            if u.e is not None:
                stages.append(GramStage(f"v{q}", "fisher", int(results[f"v{q}"].numel()), bit))
        if double:
            return Plan(tuple(stages), ROWS, frozenset(lanes))
        return Plan(tuple(stages), ROWS, frozenset(lanes), 2 * jit.WIDTH, single=frozenset(single))

    def _tangent_by_matrices(self, double: bool) -> Plan:
        """Return the plan of `tangent` for a filter with the covariance as a matrix (`FilterStages`)."""
        made = FilterStages(self.graphs, derivatives=True, single=not double)
        stages = [s for q in range(len(self.graphs.samples)) for s in made.update(q)] + made.prediction()
        if double:
            return Plan(tuple(stages), ROWS, frozenset(made.lanes))
        single = frozenset((made.lanes | made.scalars) - {"dll", "lost"})
        return Plan(tuple(stages), ROWS, frozenset(made.lanes), 2 * jit.WIDTH, single=single)

    def filter(self) -> Plan:
        """Return the plan of the kernel that returns the filter output for each row.

        Results for each row: ``predicted`` and ``filtered``, the filter state before and after the samples of the row;
        ``Phi``, the transition matrix to the next row, one matrix column after the other; ``e``, measured minus
        predicted for all outputs. For sensor k (from zero), ``e<k>`` and ``S<k>`` are the innovations and their
        variances, given the sensors before it. They are written only in rows in which the sensor has a sample. The
        log-likelihood ``ll`` is summed over the rows. The filter must have a covariance.
        """
        g, rows = self.graphs, {"predicted", "filtered", "Phi", "e"}
        if g.has_matrix_form:
            return self._filter_by_matrices()
        s, Phi = g.predict
        stages = [stage(g.inputs, {"predicted": g.s, "e": g.residual})]
        for bit, u in enumerate(g.updates):
            stages.append(stage(g.inputs, self._stage_results(u) | {f"e{bit}": u.e, f"S{bit}": u.S}, bit))
            rows |= {f"e{bit}", f"S{bit}"}
        stages.append(stage(g.inputs, {"filtered": g.s, "s": s, "Phi": ca.vec(Phi)}))
        return Plan(tuple(stages), ROWS | rows)

    def _filter_by_matrices(self) -> Plan:
        """Return the plan of `filter` for a filter with the covariance as a matrix (`FilterStages`)."""
        g, made, rows = self.graphs, FilterStages(self.graphs), {"predicted", "filtered", "Phi", "e"}
        stages: list[Stage] = [stage(made.inputs | made.state_inputs, {"predicted": made.state, "e": g.residual})]
        for q in range(len(g.samples)):
            stages += made.update(q, innovations=True)
            rows |= {f"e{q}", f"S{q}"}
        stages += made.prediction({"filtered": made.state, "Phi": ca.vec(g.transition.Phi)})
        return Plan(tuple(stages), ROWS | rows)

    def simulate(self) -> Plan:
        """Return the plan of a simulation without process noise.

        Results for each row: states ``x`` and outputs ``z`` without noise. The array ``s``, which is carried from row
        to row, holds the model states. The filter must have no covariance; this is not checked.
        """
        g = self.graphs
        z = g.output(g.s, g.u, g.p)
        inputs = {name: v for name, v in g.inputs.items() if name != "y"}
        return Plan((stage(inputs, {"x": g.s, "z": z, "s": g.step(g.s)[0]}),), ROWS - {"y"} | {"x", "z"})

    @property
    def tapes(self) -> frozenset[str]:
        """Names of the arrays, with values for each row, that the forward pass stores for the backward pass.

        They are ``tape0``, ``tape1``, ... and, if they are used, ``moved`` and ``spread``.
        """
        return frozenset(name for adjoint in self._adjoints for name in adjoint.tape_values)

    def _forward_steps(self) -> list[tuple[str, Update, int | None]]:
        """Return a tuple (name of the tape array, expressions, number of the sensor) for each stage in forward order.

        The updates by the sensors come first. The prediction follows, as an `Update` without a log-likelihood; its
        number is None, because it runs in every row. The tape array stores values for the adjoint of the stage.
        """
        g = self.graphs
        steps: list[tuple[Update, int | None]] = [(u, bit) for bit, u in enumerate(g.updates)]
        steps.append((Update(g.predict[0], None, None, None), None))
        return [(f"tape{q}", u, bit) for q, (u, bit) in enumerate(steps)]

    @staticmethod
    def _stage_results(u: Update) -> dict[str, Any]:
        """Return the results of a stage by name: filter state ``s`` after it, and log-likelihood ``ll`` of an update.

        A prediction has no ``ll``.
        """
        return {"s": u.s} if u.ll is None else {"s": u.s, "ll": u.ll}
