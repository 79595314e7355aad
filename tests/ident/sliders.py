"""A sliding mass: a linear model small enough for Monte Carlo tests, with records and candidate effects."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from seatrial.ident.data.record import Record
from seatrial.ident.diagnosis.candidates import TrajectoryLinearisation
from seatrial.ident.diagnosis.score_test import (
    NormalEquations,
    PriorTerms,
    Score,
    SensitivityColumns,
    SensitivityFilter,
    assign_columns,
    block_index,
    score_tests,
)
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import Fit, SearchSettings, fit
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Effect, Input, Model, Output, Sensor, Signals, State, plain_model

H = 0.1  # Unit: s
M, D, Q, E_V, E_S = 2.0, 1.0, 0.05, 0.05, 0.1


def slider() -> Model:
    """Return the model of position s and speed v of a mass m with damping d under a force w. Both states are
    measured.
    """
    return plain_model(
        "slider",
        f=lambda x, u, p: {"s": x.v, "v": (u.w - p.d * x.v) / p.m},
        h=lambda x, u, p: {"speed": x.v, "place": x.s},
        states=(State("s", "m", noise=0.0, sd0=0.3), State("v", "m/s", noise="q", sd0=0.3)),
        inputs=(Input("w", "N"),),
        sensors=(Sensor("log", (Output("speed", "m/s", "e_v"),)), Sensor("tape", (Output("place", "m", "e_s"),))),
        parameters=(
            Parameter("m", M, "kg"),
            Parameter("d", D, "kg/s"),
            Parameter("q", Q, free=False),
            Parameter("e_v", E_V, free=False),
            Parameter("e_s", E_S, free=False),
        ),
    )


def _rate(name: str, change: str) -> Effect:
    def hook(s: Signals) -> None:
        v, k = s.x.v, getattr(s.p, f"k_{name}")
        s.rate["v"] = s.rate["v"] + k * {"push": 1.0, "drag": -abs(v) * v, "cube": v * v * v}[change]

    return Effect(name, name, {"rate": hook}, (Parameter(f"k_{name}", 0.0, step=0.01),))


def _output(name: str) -> Effect:
    def hook(s: Signals) -> None:
        s.y["place"] = s.y["place"] + getattr(s.p, f"k_{name}")

    return Effect(name, name, {"output": hook}, (Parameter(f"k_{name}", 0.0, step=0.01),))


PUSH, DRAG, CUBE, TAPE = _rate("push", "push"), _rate("drag", "drag"), _rate("cube", "cube"), _output("tape")


def slide(seed: int, n_rows: int = 300, push: float = 0.0, drag: float = 0.0) -> Record:
    """Simulate the slider at 10 Hz. The speed is measured in every row and the position in every fifth row.

    ``push`` and ``drag`` are the sizes of these effects. Drag is integrated in 50 substeps per row.
    """
    rng = np.random.default_rng(seed)
    A = np.array([[0.0, 1.0], [0.0, -D / M]])
    n_sub = 50 if drag else 1
    h = H / n_sub
    Phi = expm(A * h)
    gain = expm(np.block([[A, np.eye(2)], [np.zeros((2, 4))]]) * h)[:2, 2:]
    L = np.diag([0.0, Q * Q])
    # Covariance of the process noise in one step (Van Loan 1978).
    block = expm(np.block([[-A, L], [np.zeros((2, 2)), A.T]]) * h)
    root = np.linalg.cholesky(block[2:, 2:].T @ block[:2, 2:] + 1e-18 * np.eye(2))
    w = np.repeat(rng.uniform(-2, 2, n_rows // 10 + 1), 10)[:n_rows]
    x = rng.normal(size=2) * 0.3
    y = np.full((n_rows, 2), np.nan)
    for k in range(n_rows):
        y[k, 0] = x[1] + E_V * rng.normal()
        if k % 5 == 0:
            y[k, 1] = x[0] + E_S * rng.normal()
        for _ in range(n_sub):
            force = np.array([0.0, w[k] / M + push - drag * abs(x[1]) * x[1]])
            x = Phi @ x + gain @ force + root @ rng.normal(size=2)
    t = H * np.arange(n_rows)
    return Record(f"slide {seed}", t, w[:, None], w[:, None], y, ("w",), ("speed", "place"))


def score_of(record: Record, effects: list[Effect], model: Model | None = None) -> tuple[Fit, list[Score]]:
    """Fit the slider to one record and test the effects."""
    fitted = fit(model or slider(), [record], settings=SearchSettings(threads=1))
    return fitted, scores_at(fitted, record, effects)


def scores_at(fitted: Fit, record: Record, effects: list[Effect]) -> list[Score]:
    values = fitted.record_values[0]
    run = Likelihood(fitted.model).filter(record, values)
    path = TrajectoryLinearisation(fitted.model, values, record, run.x_pred)
    columns = [c for effect in effects for c in path.effect(effect)]
    return scores_of_columns(path, run, [path.parameter(n) for n in fitted.names], columns)


def scores_of_columns(
    path: TrajectoryLinearisation, run: object, fitted: list[np.ndarray], columns: list[SensitivityColumns]
) -> list[Score]:
    """Return the scores of given columns. The columns of the fitted parameters (n_rows, n_states + n_outputs) are
    projected out.
    """
    own = np.stack(fitted, 2)
    carrier = SensitivityFilter(run, path.own, path.jacobian)  # type: ignore[arg-type]
    g, e, t = carrier([SensitivityColumns("fitted", own), *columns]), carrier.e, carrier.t
    normal = NormalEquations([str(k) for k in range(g.shape[1])])
    normal.add(range(g.shape[1]), g, e, block_index(t))
    placed, _ = assign_columns(columns, len(fitted), 1)
    return score_tests(normal, no_priors(len(fitted)), placed)


def no_priors(n_fitted: int) -> PriorTerms:
    """Return zero prior information for the fitted parameters."""
    return PriorTerms(np.zeros(n_fitted), np.zeros(n_fitted))


def whole(path: TrajectoryLinearisation, columns: SensitivityColumns) -> np.ndarray:
    """Return all rates and outputs (n_rows, n_states + n_outputs, n_parameters), also those that a candidate does not
    change.
    """
    assert columns.touched is not None
    n, m = len(path.model.states), len(path.model.outputs)
    found = np.zeros((len(columns.delta), n + m, columns.delta.shape[2]))
    found[:, columns.touched] = columns.delta
    return found
