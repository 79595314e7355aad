"""Tests of nonparametric effects: the curve of a force over a variable, its force in a model, and its band."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.ident.effects.nonparametric import (
    N_KNOTS,
    ROUNDING,
    between_knots,
    nonparametric_effect,
    shape,
    spline_basis,
)
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.model.structure import ForceCurve, Signals
from seatrial.ident.models.disturbances import variables_of
from seatrial.ident.models.horizontal import horizontal_model

SPAN = (-0.4, 1.2)
SPACING = (SPAN[1] - SPAN[0]) / (N_KNOTS - 1)


def hats(z: np.ndarray) -> np.ndarray:
    return np.column_stack([b * np.ones(z.size) for b in spline_basis(z, False, SPAN)])


def test_basis_functions_sum_to_one_and_are_constant_beyond_the_span() -> None:
    z = np.linspace(-2, 3, 1001)
    low, high = SPAN[0] - ROUNDING * SPACING, SPAN[1] + ROUNDING * SPACING
    B = hats(z)
    assert B.shape == (1001, N_KNOTS)
    np.testing.assert_allclose(B.sum(1), 1.0, atol=1e-12)
    assert (B > -1e-12).all()
    np.testing.assert_allclose(B[z < low], np.eye(N_KNOTS)[[0] * int((z < low).sum())], atol=1e-12)
    np.testing.assert_allclose(B[z > high], np.eye(N_KNOTS)[[-1] * int((z > high).sum())], atol=1e-12)


def test_basis_functions_interpolate_between_knots_and_round_the_corners() -> None:
    """The reference is the mean of the linear interpolation over the rounding width. Between the corners it equals the
    line.
    """
    knots = np.linspace(*SPAN, N_KNOTS)
    values = np.random.default_rng(0).normal(size=N_KNOTS)
    z = np.linspace(-1.0, 2.0, 333)
    about = np.linspace(-1, 1, 20001) * ROUNDING * SPACING
    mean = [np.trapezoid(np.interp(at + about, knots, values), about) / np.ptp(about) for at in z]
    np.testing.assert_allclose(hats(z) @ values, mean, atol=1e-7)
    middles = (knots[1:] + knots[:-1]) / 2
    np.testing.assert_allclose(hats(middles) @ values, np.interp(middles, knots, values), atol=1e-12)


def test_slope_of_a_curve_is_continuous_at_the_knots() -> None:
    """The filter linearises with this slope. A jump in the slope would cause a jump in the likelihood."""
    values = np.random.default_rng(4).normal(size=N_KNOTS)
    h = 1e-7
    for knot in np.linspace(*SPAN, N_KNOTS):
        before, after = ((hats(np.array([knot + d])) - hats(np.array([knot + d - h]))) @ values / h for d in (0.0, h))
        assert abs(after - before)[0] < 1e-3 * np.abs(np.diff(values)).max() / SPACING


def forces(force: str, variable: str, coefficients: list[float], x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the forces X, Y, N (n, 3) that an effect adds, from the rates of the horizontal model with and without
    it.
    """
    base = horizontal_model()
    effect = nonparametric_effect(base, ForceCurve(force, *variable.split(", ")), SPAN)
    model = base + effect
    names = [p.name for p in effect.parameters]
    model = model.with_values(dict(zip(names, coefficients, strict=True)))
    p = base.values
    more = [
        VectorisedModel(m)(x, u[:, : len(m.inputs)], np.array(list(m.values.values())))[:, 3:6] for m in (model, base)
    ]
    return np.asarray((more[0] - more[1]) * [p["m_u"], p["m_v"], p["m_r"]])


def test_nonparametric_effect_adds_its_curve_to_one_force() -> None:
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=(40, 6)), rng.uniform(-1, 1, (40, 3))
    table = rng.normal(size=N_KNOTS).tolist()
    z = x[:, 3]
    added = forces("Y", "u", table, x, u)
    np.testing.assert_allclose(added[:, 1], hats(z) @ table, atol=1e-9)
    np.testing.assert_allclose(added[:, [0, 2]], 0.0, atol=1e-9)
    psi = forces("N", "psi", [1.0, -0.5, 0.25, 2.0, 0.5, -1.0], x, u)[:, 2]
    h = x[:, 2]
    wanted = np.sin(h) - 0.5 * np.cos(h) + 0.25 * np.sin(2 * h) + 2 * np.cos(2 * h)
    np.testing.assert_allclose(psi, wanted + 0.5 * np.sin(3 * h) - np.cos(3 * h), atol=1e-9)
    a, b = x[:, 3], x[:, 5]
    product = forces("X", "u, r", [1.0, 2.0, -3.0], x, u)[:, 0]
    np.testing.assert_allclose(product, a * b + 2 * np.abs(a) * b - 3 * a * np.abs(b), atol=1e-9)
    mean = forces("X", "n_sum", table, x, u)[:, 0]
    np.testing.assert_allclose(mean, hats((u[:, 0] + u[:, 1]) / 2) @ table, atol=1e-9)
    late = forces("X", "t", table, x, u)[:, 0]
    np.testing.assert_allclose(late, hats(u[:, 2]) @ table, atol=1e-9)


def test_nonparametric_effect_is_neutral_at_zero_and_has_a_name() -> None:
    rng = np.random.default_rng(2)
    x, u = rng.normal(size=(10, 6)), rng.uniform(-1, 1, (10, 3))
    assert not forces("X", "v", [0.0] * N_KNOTS, x, u).any()
    effect = nonparametric_effect(horizontal_model(), ForceCurve("N", "u", "r"), SPAN)
    assert effect.name == "unknown N(u, r)"
    assert [p.name for p in effect.parameters] == ["N_ur_0", "N_ur_1", "N_ur_2"]
    assert {p.unit for p in effect.parameters} == {"kg m"}
    assert nonparametric_effect(horizontal_model(), ForceCurve("X", "t"), SPAN).inputs[0].name == "t"


def test_coefficients_of_a_curve_say_where_their_knots_lie() -> None:
    """Card, table and terminal show this meaning. The name of a coefficient has the number of the knot alone."""
    model = horizontal_model()

    def meanings(curve: ForceCurve, span: tuple[float, float]) -> list[str]:
        return [p.meaning for p in nonparametric_effect(model, curve, span).parameters]

    of_speed = meanings(ForceCurve("X", "u"), (-0.4, 1.2))
    assert (len(of_speed), of_speed[0], of_speed[2], of_speed[-1]) == (
        N_KNOTS, "X at u = -0.4 m/s", "X at u = 0 m/s", "X at u = 1.2 m/s"
    )  # fmt: skip
    rate = np.radians(20.0)
    assert meanings(ForceCurve("N", "r"), (-rate, rate))[3:5] == ["N at r = -5 deg/s", "N at r = 0 deg/s"]
    assert meanings(ForceCurve("X", "n_sum"), (-1.0, 1.0))[-1] == "X at n_sum = 1"
    assert meanings(ForceCurve("N", "psi"), SPAN)[0] == "N with sin psi"


@pytest.mark.parametrize(
    ("name", "wanted"), [("psi", 0.3), ("t", 7.0), ("n_sum", 0.4), ("n_diff", 0.6), ("f_sum", 15.0), ("f_diff", -10.0)]
)
def test_variables_are_read_from_the_signals(name: str, wanted: float) -> None:
    s: Any = Signals(
        x=SimpleNamespace(psi=0.3), u=SimpleNamespace(t=7.0, n_left=0.7, n_right=0.1, f_left=10.0, f_right=20.0)
    )
    model = horizontal_model("force" if name.startswith("f_") else "shaft")
    assert next(v for v in variables_of(model) if v.name == name).read(s) == pytest.approx(wanted)


def test_unknown_force_of_a_curve_is_rejected() -> None:
    with pytest.raises(ValueError, match="no 'F' for a nonparametric curve; it has X, Y, N"):
        nonparametric_effect(horizontal_model(), ForceCurve("F", "u"), SPAN)


@pytest.mark.parametrize("variable", ["u", "psi"])
def test_curve_is_centred_and_its_band_comes_from_the_covariance(variable: str) -> None:
    effect = nonparametric_effect(horizontal_model(), ForceCurve("X", variable), SPAN)
    names = ["d_u", *(p.name for p in effect.parameters)]
    rng = np.random.default_rng(3)
    root = 0.2 * rng.normal(size=(len(names), len(names)))
    P = root @ root.T
    values = dict(zip(names, rng.normal(size=len(names)), strict=True))
    drawn = shape(horizontal_model(), effect, values, names, P)
    assert drawn is not None
    assert (drawn.force, drawn.variable, drawn.unit) == ("X", variable, "N")
    assert drawn.value.mean() == pytest.approx(0.0, abs=1e-12)
    table = np.column_stack([b * np.ones(drawn.grid.size) for b in spline_basis(drawn.grid, variable == "psi", SPAN)])
    mean = table @ [values[n] for n in names[1:]]
    np.testing.assert_allclose(drawn.value, mean - mean.mean(), atol=1e-12)
    samples = rng.multivariate_normal([values[n] for n in names], P, size=20000)[:, 1:] @ table.T
    missed = 0.0 if variable == "psi" else between_knots(np.array([values[n] for n in names[1:]]), drawn.grid, SPAN)
    about = samples - samples.mean(1, keepdims=True)
    np.testing.assert_allclose(drawn.sd, about.std(0), rtol=0.03)
    inside = (np.abs(about - drawn.value) <= drawn.band - missed).all(1)
    assert inside.mean() == pytest.approx(0.95, abs=0.01)


def test_bound_of_the_interpolation_error_covers_smooth_curves() -> None:
    knots, grid = np.linspace(*SPAN, N_KNOTS), np.linspace(*SPAN, 500)
    for bend in (lambda z: z**2, np.sin, lambda z: np.exp(-z)):
        allowed = between_knots(bend(knots), grid, SPAN)
        missed = np.abs(bend(grid) - np.interp(grid, knots, bend(knots)))
        assert (missed <= 1.5 * allowed + 0.2 * allowed.max()).all()
        assert allowed.max() < 3 * missed.max()
    assert between_knots(2 * knots, grid, SPAN).max() < 1e-12


def test_products_have_no_curve() -> None:
    effect = nonparametric_effect(horizontal_model(), ForceCurve("X", "u", "r"), SPAN)
    names = [p.name for p in effect.parameters]
    assert shape(horizontal_model(), effect, dict.fromkeys(names, 1.0), names, np.eye(3)) is None
