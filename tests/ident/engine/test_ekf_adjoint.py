"""Tests of adjoint gradients against tangents by CasADi, on every model, and of the parts of the adjoint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.engine import ekf_adjoint, jit
from seatrial.ident.engine.ekf_graph import EkfGraphs, pack, unpack
from seatrial.ident.engine.expressions import reverse_mode, simplified
from seatrial.ident.engine.filter_plans import Plans
from seatrial.ident.engine.kernel import Kernel
from seatrial.ident.engine.loop_plan import Factor, Plan, ProductStage, stage
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.outlier_density import with_outlier_model
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.engine.test_kernel import operations, points
from tests.ident.toys import turning


def linear() -> Model:
    """Return a model of speed with linear damping, whose rates have no second derivatives."""
    return plain_model(
        "linear",
        f=lambda x, u, p: {"v": (u.X - p.d * x.v) / p.m},
        h=lambda x, u, p: {"v": x.v},
        states=(State("v", "m/s", noise="q", x0=0.2, sd0=0.3),),
        inputs=(Input("X", "N"),),
        sensors=(Sensor("log", (Output("v", "m/s", "e_v"),)),),
        parameters=(
            Parameter("m", 9.7, transform="log"),
            Parameter("d", 4.0),
            Parameter("q", 0.05, transform="log"),
            Parameter("e_v", 0.02, transform="log"),
        ),
    )


needs_llvm = pytest.mark.skipif(not jit.AVAILABLE, reason="compares compiled code, which needs llvmlite")
MODELS: dict[str, Callable[[], Model]] = {
    **{
        name: lambda name=name: make_model(name)
        for name in (
            "surge",
            "surge:shaft:both",
            "yaw",
            "yaw:both",
            "thruster",
            "thruster:slow",
            "horizontal:shaft",
            "horizontal:force:no-current",
            "kinematic:shaft",
            "kinematic:shaft:yaw",
        )
    },
    "turning": turning,
    "robust": lambda: with_outlier_model(turning()),
    "second order, linear": lambda: replace(linear(), second_order=True),
    "second order": lambda: replace(make_model("horizontal:shaft"), second_order=True),
    "with disturbance forces": lambda: with_disturbances(horizontal_model("shaft")),
}


def record_of(model: Model, n_rows: int = 40) -> Record:
    """Simulate a record of the model with random inputs, its noise, irregular rows and missing samples."""
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.02, 0.1, n_rows))
    u = np.repeat(rng.uniform(0.2, 1.0, (n_rows // 8, len(model.inputs))), 8, axis=0)
    u_next = np.vstack([u[1:], u[-1:]])
    held = [i.hold == "zero" for i in model.inputs]
    names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
    empty = Record("drawn", t, u, np.where(held, u, u_next), np.zeros((n_rows, len(model.outputs))), *names)
    noise = [model.values[o.noise] if isinstance(o.noise, str) else o.noise for o in model.outputs]
    y = simulate(model, empty).y + rng.normal(size=(n_rows, len(noise))) * noise
    there = [np.repeat(rng.random((n_rows, 1)) < 0.7, len(s.outputs), axis=1) for s in model.sensors]
    return replace(empty, y=np.where(np.hstack(there), y, np.nan))


def check_gradient(likelihood: Likelihood) -> None:
    model = likelihood.model
    record, v = record_of(model), np.array(list(model.values.values()))
    value, gradient = likelihood.gradient(record, v)
    tangents = likelihood.scores(record, v, list(model.values), double=True)
    assert np.isfinite(value)
    assert value == pytest.approx(tangents.value, rel=1e-12)
    scale = np.sqrt(np.diag(tangents.information)) + 1e-6  # Standard deviation of a gradient.
    assert np.abs((gradient - tangents.gradient) / scale).max() < 1e-7
    single = likelihood.scores(record, v, list(model.values))
    assert single.value == pytest.approx(value, rel=1e-12)
    assert 1e-12 < np.abs((gradient - single.gradient) / scale).max() < 1e-4
    assert np.abs((single.information - tangents.information) / np.outer(scale, scale)).max() < 1e-4
    assert np.count_nonzero(gradient) > len(model.values) // 2


@pytest.mark.parametrize("name", MODELS)
def test_adjoint_gradient_of_every_model(name: str) -> None:
    with jit.quick_compilation(0):  # The test below compiles three of the models as a fit does.
        check_gradient(Likelihood(MODELS[name]()))


@pytest.mark.parametrize("name", ["turning", "robust", "horizontal:shaft"])
def test_adjoint_gradient_of_the_joseph_form_and_of_output_error(name: str) -> None:
    check_gradient(Likelihood(MODELS[name](), joseph=True))
    check_gradient(Likelihood(MODELS[name](), process_noise=False))


@pytest.mark.parametrize("width", [2, 4, 8])
def test_adjoints_of_the_stages_are_independent_of_the_vector_width(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Products by matrices and by scalars must give the same slopes."""
    monkeypatch.setattr(jit, "WIDTH", width)
    g = EkfGraphs(make_model("horizontal:shaft"))
    bar = ca.SX.sym("bar", g.s.numel())
    rng = np.random.default_rng(width)
    root = rng.normal(size=(g.n, g.n))
    s = np.append(rng.normal(size=g.n), np.array(pack(ca.SX(root @ root.T)).elements(), float))
    values = {
        "s": s,
        "h": 0.1,
        "p": list(g.model.values.values()),
        "bar": rng.normal(size=s.size),
        **{name: rng.normal(size=v.numel()) for name, v in g.inputs.items() if name in ("u", "u_next", "y")},
    }
    update, predicted = g.updates[-1], {"s": g.predict[0]}
    pairs = [
        (ekf_adjoint.adjoint_of_update(g, update, "tape", bar), {"s": update.s, "ll": update.ll}),
        (ekf_adjoint.adjoint_of_prediction(g, "tape", bar), predicted),
    ]
    for ours, effect in pairs:
        plain = ekf_adjoint.adjoint_of_stage(g, effect, "tape", bar)
        np.testing.assert_allclose(_run(ours, g, bar, values), _run(plain, g, bar, values), rtol=1e-9, atol=1e-9)
    assert pairs[1][0].products  # This stage has matrix products.


def _run(found: ekf_adjoint.Adjoint, g: EkfGraphs, bar: ca.SX, values: dict[str, object]) -> np.ndarray:
    """Return the slopes, computed from the intermediate results that the stage keeps."""
    kept = ca.Function("ahead", list(g.inputs.values()), list(found.tape_values.values()))
    known = dict(zip(found.tape_values, kept.call([values[n] for n in g.inputs]), strict=True)) | values
    for product in found.products:
        left = [[float(known[f.array][f.entry]) * (1 + f.twice) for f in line] for line in product.left]
        right = np.array(ca.DM(known[product.right])).reshape(-1, product.stride)
        known[product.result] = (np.array(left) @ right).ravel()
    inputs = {n: v for n, v in g.inputs.items() if n != "s"} | dict(found.tape_symbols) | {"bar": bar}
    back = ca.Function("back", list(inputs.values()), [found.derivatives])
    return np.array(back.call([known[n] for n in inputs])[0]).ravel()


@needs_llvm
@pytest.mark.parametrize("width", [2, 4, 8])
def test_compiled_products_equal_interpreted_products(width: int) -> None:
    a, kept, b = ca.SX.sym("a", 3), ca.SX.sym("kept", 2 * width), ca.SX.sym("b", 2)
    left = ((Factor("a", 0), Factor("b", 1, twice=True)), (Factor("a", 2, twice=True), Factor("a", 1)))
    plan = Plan(
        (
            stage({"a": a}, {"b": a[:2] * a[1:]}, 1),
            ProductStage(left, "kept", "made", width, width, 0),
            stage({"made": kept, "b": b}, {"sum": ca.sum1(kept), "b": -b}),
        ),
        frozenset({"a", "kept"}),
    )
    rng = np.random.default_rng(1)
    arrays = {"a": rng.normal(size=(7, 3)), "kept": rng.normal(size=(7, 2 * width))}
    mask = np.array([3, 1, 2, 3, 0, 2, 1], np.uint32)
    fast, slow = (Kernel(plan, compiled=way)(7, mask, arrays) for way in (True, False))
    assert abs(slow["sum"][0]) > 1e-3
    for name in ("sum", "b", "made"):
        np.testing.assert_allclose(fast[name], slow[name], rtol=1e-12, err_msg=name)


def test_reverse_mode_of_every_operation() -> None:
    table = operations()
    x, y = table.pop("x"), table.pop("y")
    v, bar = ca.vertcat(*table.values()), ca.SX.sym("bar", len(table))
    by = ca.vertcat(x, y)
    ours, casadi = (ca.Function("f", [by, bar], [e]) for e in (reverse_mode(v, by, bar), ca.jtimes(v, by, bar, True)))
    for j, name in enumerate(table):
        for point in np.transpose([a.ravel() for a in points()])[3:40]:
            unit = np.eye(len(table))[j]
            np.testing.assert_allclose(
                np.array(ours(point, unit)), np.array(casadi(point, unit)), rtol=1e-9, atol=1e-12, err_msg=name
            )


def test_quotients_by_one_number_need_one_product_each() -> None:
    x, m, bar = ca.SX.sym("x", 4), ca.SX.sym("m"), ca.SX.sym("bar", 4)
    ours, casadi = (
        ca.Function("f", [x, m, bar], [e]) for e in (reverse_mode(x / m, m, bar), ca.jtimes(x / m, m, bar, True))
    )
    point = np.arange(1.0, 5.0), 2.0, np.array([1.0, -3.0, 0.5, 2.0])
    assert float(ours(*point)) == pytest.approx(float(casadi(*point)))
    products = [
        sum(f.instruction_id(k) in (ca.OP_MUL, ca.OP_DIV, ca.OP_SQ) for k in range(f.n_instructions()))
        for f in (ours, casadi)
    ]
    assert products[0] < products[1]


def test_drag_is_simplified_for_short_slopes() -> None:
    u, d = ca.SX.sym("u"), ca.SX.sym("d")
    forms = [d * ca.fabs(u) * u, u * d * ca.fabs(u), -d * u * ca.fabs(u), u * ca.sign(u) * d, d * ca.sign(u) * u]
    for form in forms:
        ours = simplified(form)
        for point in (-1.7, -0.0, 0.0, 0.4):
            f, g = (ca.Function("f", [u, d], [e]) for e in (form, ours))
            assert float(g(point, 3.0)) == pytest.approx(float(f(point, 3.0)), rel=1e-14, abs=0)
    slope = simplified(ca.jacobian(simplified(forms[0]), u))
    assert "sign" not in str(slope)
    assert float(ca.Function("f", [u, d], [slope])(-1.5, 2.0)) == 6.0


def test_slopes_by_a_triangle_are_doubled_off_the_diagonal() -> None:
    """L is defined by f = sum of a_ij P_ij over the upper triangle of P = A A'."""
    n, rng = 3, np.random.default_rng(2)
    A, a = rng.normal(size=(n, n)), rng.normal(size=6)
    X = ca.SX.sym("X", n, n)
    f = ca.dot(ca.SX(a), pack(X @ X.T))
    wanted = np.array(ca.Function("f", [X], [ca.gradient(f, X)])(A))
    L = np.array(ca.DM(ekf_adjoint._doubled_diagonal(unpack(ca.SX(a), n))))
    np.testing.assert_allclose(L @ A, wanted, rtol=1e-12)


def test_tape_contains_what_the_adjoint_reads() -> None:
    plans = Plans(EkfGraphs(make_model("horizontal:shaft")))
    forward, backward = plans.forward(), plans.backward()
    for name in plans.tapes:
        assert forward.sizes[name] == backward.sizes[name] > 0
