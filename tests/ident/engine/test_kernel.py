"""Tests of compiled kernels against CasADi, operation by operation, and against the interpreter."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from seatrial.ident.engine import jit, llvm_emitter
from seatrial.ident.engine.filter_kernels import FilterKernels, filter_kernels_for
from seatrial.ident.engine.kernel import Arena, Kernel
from seatrial.ident.engine.llvm_operations import FLUSH_TO_ZERO, FlushToZero, rewritten
from seatrial.ident.engine.loop_plan import GramStage, Plan, stage
from seatrial.ident.estimation.prepared_record import Preparer
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Model, Output, Sensor, State, plain_model
from tests.ident.toys import turning, turning_record, values_of

ca.GlobalOptions.setNumpyMode(-1)
needs_llvm = pytest.mark.skipif(not jit.AVAILABLE, reason="compares compiled code, which needs llvmlite")
WIDTH = 4


def operations() -> dict[str, ca.SX]:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    unary = "sin cos tan tanh sinh cosh arctan arcsinh exp floor ceil abs sign square negative expm1 rint sinc"
    inside = "arcsin arccos arctanh"
    positive = "sqrt log log10 log1p arccosh cbrt"
    binary = (
        "hypot arctan2 minimum maximum fmod copysign add multiply divide less less_equal equal not_equal logaddexp mod"
    )
    found = {n: getattr(np, n)(x) for n in unary.split()}
    found |= {n: getattr(np, n)(0.9 * ca.sin(x)) for n in inside.split()}
    found |= {n: getattr(np, n)(1 + x * x) for n in positive.split()}
    found |= {n: getattr(np, n)(x, y) for n in binary.split()}
    return {"x": x, "y": y, **found} | {
        "power": (1 + x * x) ** y,
        "constpow": (1 + x * x) ** 2.5,
        "cube": x**3,
        "inverse": 1 / x,
        "erf": ca.erf(x),
        "where": np.where(x > y, x * y, ca.cos(y)),
        "masked root": np.where(x > 0, ca.sqrt(x), 0.0),
        "not": ca.logic_not(x > y),
        "and": ca.logic_and(x > 0, y > 0),
        "or": ca.logic_or(x > 0, y > 0),
        "remainder": ca.remainder(x, y),
        "clip": np.clip(x, -1, 1),
        "derivative of x|x|": ca.jacobian(ca.fabs(x) * x * ca.tanh(y * x) / (1 + ca.exp(x)), x),
        "derivative of a masked root": ca.jacobian(ca.if_else(x > 0, ca.sqrt(x), 0), x),
        "derivative of hypot": ca.jacobian(ca.hypot(x, y), x),
        "sine of many turns": ca.sin(1e4 * x),
        "cosine of many turns": ca.cos(1e4 * x),
    }


def test_sine_and_cosine_of_many_turns_need_no_fused_multiplication() -> None:
    """CasADi rounds after each operation, as a processor without fused multiplication does."""
    x = np.random.default_rng(3).uniform(-1e5, 1e5, 4000)
    for code, exact in ((ca.OP_SIN, np.sin), (ca.OP_COS, np.cos)):
        found = np.array(rewritten()[code](x[None], np.zeros_like(x)[None])).ravel()
        np.testing.assert_allclose(found, exact(x), rtol=3e-15, atol=3e-16)


def points() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 50, WIDTH)) * 3
    x[0], y[1], x[2] = 0.0, x[1], np.round(x[2] * 2) / 2
    return x, y


@needs_llvm
@pytest.mark.parametrize("compilation", [nullcontext, jit.quick_kernel])
@pytest.mark.parametrize("where", ["scalars", "lanes", "a constant in lanes"])
def test_every_operation_equals_casadi(where: str, compilation: Callable[[], AbstractContextManager[None]]) -> None:
    table = operations()
    x, y = table.pop("x"), table.pop("y")
    v = ca.vertcat(*table.values())
    X, Y = points()
    inputs, results = {"x": x, "y": y}, {"v": v}
    rows, lanes = frozenset({"x", "y", "v"}), frozenset({"x", "y", "v"})
    if where == "a constant in lanes":
        Y = np.full_like(Y, Y[3, 3])
        rows, lanes = frozenset({"x", "v"}), frozenset({"x", "v"})
    wanted = np.array(ca.Function("f", [x, y], [v])(X.ravel()[None], Y.ravel()[None])).T
    plan = Plan((stage(inputs, results),), rows, lanes if where != "scalars" else frozenset(), WIDTH)
    with compilation():
        kernel = Kernel(plan)
    if where == "scalars":
        got = kernel(X.size, None, {"x": X.ravel().copy(), "y": Y.ravel().copy()})["v"]
    else:
        arrays = {"x": X, "y": Y if "y" in rows else Y[0, :1].copy()}
        got = kernel(len(X), None, arrays)["v"][:, 0].swapaxes(1, 2).reshape(X.size, -1)
    for j, name in enumerate(table):
        close = np.isclose(got[:, j], wanted[:, j], rtol=3e-13, atol=3e-16, equal_nan=True)
        assert close.all(), (name, X.ravel()[~close], got[~close, j], wanted[~close, j])


def data_of(kernel: Kernel, seed: int = 0) -> tuple[int, np.ndarray, dict[str, np.ndarray]]:
    data = Preparer(turning())(turning_record(seed, 30))
    return data.n_rows, data.mask, {n: a for n, a in data.rows.items() if n in kernel.plan.sizes}


@needs_llvm
@pytest.mark.parametrize("block_lines", [3, llvm_emitter.BLOCK_LINES])
@pytest.mark.parametrize("name", ["value", "forward", "tangent", "tangent_double", "filter", "simulate"])
def test_interpreted_and_compiled_kernels_agree(name: str, block_lines: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm_emitter, "BLOCK_LINES", block_lines)
    programs: FilterKernels = filter_kernels_for(turning(), covariance=name != "simulate")
    fast = Kernel(getattr(programs, name).plan)
    slow = Kernel(fast.plan, compiled=False)
    chosen = [0, 1, 2, 4, 5, 6, 7, 8, 3]
    results = []
    for kernel in (fast, slow):
        n, mask, arrays = data_of(kernel)
        s = np.array([3.0, 0.1, 0.01, 0.0, 0.09])[: None if name != "simulate" else 2]
        groups = kernel.groups(len(chosen)) if name.startswith("tangent") else 1
        arrays |= {"p": values_of(turning()), **kernel.layout.state_arrays(s)}
        if name.startswith("tangent"):
            arrays["dp"] = kernel.seeds(9, chosen)
        rows = {r: np.zeros((n, kernel.plan.sizes[r])) for r in kernel.plan.rows & set(kernel.plan.sizes) - set(arrays)}
        per_row = frozenset({"ll"} & set(kernel.plan.summed))
        results.append(kernel(n, mask, {**arrays, **rows}, groups=groups, per_row=per_row))
    for key, found in results[0].items():
        rounding = (
            1e-5 if kernel.layout.single and key in kernel.layout.lanes | {"fisher"} | kernel.layout.single else 1e-9
        )
        atol = rounding * (1e-2 if rounding == 1e-9 else np.abs(found).max())
        np.testing.assert_allclose(found, results[1][key], rtol=rounding, atol=atol, err_msg=key)


@needs_llvm
@pytest.mark.parametrize("lanes", [frozenset[str](), frozenset({"s", "total"})])
def test_results_are_stored_after_all_arguments_are_read(
    lanes: frozenset[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(llvm_emitter, "BLOCK_LINES", 1)  # each operation is in a block of its own
    s, x = ca.SX.sym("s", 3), ca.SX.sym("x")
    turned = ca.vertcat(s[1] + 0 * ca.sin(x), s[2], s[0])
    plan = Plan((stage({"s": s, "x": x}, {"s": turned, "total": s[0]}),), frozenset({"x"}), lanes, 2)
    start = np.array([1.0, 2.0, 3.0])
    given = np.repeat(start[None, :, None], 2, axis=2) if lanes else start
    found = Kernel(plan)(4, None, {"s": given.copy(), "x": np.arange(4.0)})
    np.testing.assert_array_equal(found["s"].reshape(3, -1)[:, 0], [2.0, 3.0, 1.0])
    assert found["total"].flat[0] == 1.0 + 2.0 + 3.0 + 1.0  # the first entry before each row


@needs_llvm
def test_gram_sums_the_products_of_all_lanes() -> None:
    v = ca.SX.sym("v", 3)
    plan = Plan(
        (stage({"x": v}, {"v": 2 * v}, 0), GramStage("v", "G", 3, 0)), frozenset({"x"}), frozenset({"x", "v"}), 4
    )
    rng = np.random.default_rng(1)
    x = rng.normal(size=(7, 3, 3, 4))  # Dimensions: rows, groups, entries, width.
    mask = np.array([1, 1, 0, 1, 0, 1, 1], np.uint32)
    for compiled in (True, False):
        G = Kernel(plan, compiled)(7, mask, {"x": x}, groups=3)["G"]
        flat = 2 * x[mask == 1].transpose(0, 2, 1, 3).reshape(-1, 12)
        full = np.triu(G.swapaxes(1, 2).reshape(12, 12))
        np.testing.assert_allclose(full, np.triu(flat.T @ flat), rtol=1e-12)


@needs_llvm
def test_kernel_accepts_any_number_of_groups_and_sums_or_keeps_rows() -> None:
    x, a = ca.SX.sym("x"), ca.SX.sym("a")
    plan = Plan((stage({"x": x, "a": a}, {"total": x * a}),), frozenset({"x"}), frozenset({"a", "total"}), 2)
    kernel = Kernel(plan)
    x_rows = np.arange(5.0)
    for groups in (1, 3):
        a_lanes = np.arange(2.0 * groups).reshape(groups, 1, 2)
        arrays = {"x": x_rows, "a": a_lanes}
        np.testing.assert_allclose(kernel(5, None, arrays, groups=groups)["total"], 10.0 * a_lanes)
        kept = kernel(5, None, arrays, groups=groups, per_row={"total"})["total"]
        np.testing.assert_allclose(kept, x_rows[:, None, None, None] * a_lanes)


@needs_llvm
@pytest.mark.skipif(FlushToZero() == FLUSH_TO_ZERO, reason="the control register of this processor is unknown")
def test_subnormal_numbers_are_zero_only_within_a_kernel() -> None:
    """A processor is a hundred times slower with subnormal numbers."""
    p = ca.SX.sym("p")
    kernel = Kernel(Plan((stage({"p": p}, {"p": 0.5 * p}),), frozenset()))
    smallest = np.finfo(float).tiny
    assert kernel(9, None, {"p": np.array([1024 * smallest])})["p"].item() == 2 * smallest
    assert kernel(20, None, {"p": np.array([1024 * smallest])})["p"].item() == 0.0
    assert np.array([smallest])[0] * 0.25 > 0.0


def test_arrays_are_aligned_to_cache_lines_and_reused() -> None:
    arena = Arena()
    a = arena.take("a", (3, 5))
    assert a.ctypes.data % 64 == 0
    a[...] = 7.0
    again = arena.take("a", (5, 2))
    assert again.ctypes.data == a.ctypes.data
    assert not again.any()


@needs_llvm
def test_invalid_arrays_are_rejected() -> None:
    x = ca.SX.sym("x")
    kernel = Kernel(Plan((stage({"x": x}, {"y": x}),), frozenset({"x", "y"})))
    with pytest.raises(ValueError, match="x: expected contiguous float64 of shape"):
        kernel(3, None, {"x": np.zeros(4)})
    with pytest.raises(ValueError, match="mask"):
        kernel(3, np.ones(3, np.uint8), {"x": np.zeros(3)})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="mask"):
        kernel(0, None, {"x": np.zeros(0)})


@needs_llvm
def test_corrupt_cache_file_is_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path))
    x = ca.SX.sym("x")
    plan = Plan((stage({"x": x}, {"y": ca.sin(x) + 41.5}),), frozenset({"x", "y"}))

    def run() -> float:
        return float(Kernel(plan)(1, None, {"x": np.ones(1)})["y"][0, 0])

    first = run()
    (file,) = tmp_path.iterdir()
    good = file.read_bytes()
    for bad in (b"", good[:100], good[:-1] + bytes([good[-1] ^ 1])):
        file.write_bytes(bad)
        assert run() == first == math.sin(1.0) + 41.5
        assert file.read_bytes()[:32] == good[:32]


@needs_llvm
def test_cache_that_cannot_be_written_is_not_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("SEATRIAL_CACHE", str(blocked / "cache"))
    x = ca.SX.sym("x")
    kernel = Kernel(Plan((stage({"x": x}, {"y": x + 77.25}),), frozenset({"x", "y"})))
    assert kernel(1, None, {"x": np.ones(1)})["y"][0, 0] == 78.25


def bad_model(rate: object) -> Model:
    return plain_model(
        "bad",
        f=lambda x, u, p: {"a": rate(x.a)},
        h=lambda x, u, p: {"y": x.a},  # type: ignore[operator]
        states=(State("a"),),
        inputs=(),
        sensors=(Sensor("s", (Output("y", noise="e"),)),),
        parameters=(Parameter("e", 1.0),),
    )


@pytest.mark.parametrize("rate", [math.sin, float, lambda a: np.array([0.0, float(a)])[1]])
def test_numbers_in_place_of_symbols_are_reported(rate: object) -> None:
    with pytest.raises(ValueError, match="model bad: the rate of the state a is a number and not a symbolic"):
        filter_kernels_for(bad_model(rate))


def test_missing_and_misshapen_results_are_reported() -> None:
    with pytest.raises(ValueError, match="model bad: the rate of the state a is not a scalar"):
        filter_kernels_for(bad_model(lambda a: ca.vertcat(a, a)))
    model = plain_model(
        "empty",
        f=lambda x, u, p: {},
        h=lambda x, u, p: {"y": x.a},
        states=(State("a"),),
        inputs=(),
        sensors=(Sensor("s", (Output("y", noise="e"),)),),
        parameters=(Parameter("e", 1.0),),
    )
    with pytest.raises(ValueError, match="model empty returns no rate of the state a"):
        filter_kernels_for(model)


def test_models_that_differ_only_in_values_share_their_kernels() -> None:
    model = turning()
    assert filter_kernels_for(model) is filter_kernels_for(model.with_values({"m": 5.0}))
    assert filter_kernels_for(model) is not filter_kernels_for(model, joseph=True)


@pytest.mark.parametrize("compiled", [pytest.param(True, marks=needs_llvm), False])
def test_segments_equal_separate_calls(compiled: bool) -> None:
    """The state x is carried, the input u and the results are rows, and p is shared."""
    x, u, p, none = (ca.SX.sym(n, size) for n, size in (("x", 2), ("u", 1), ("p", 1), ("none", 0)))
    plan = Plan((stage({"x": x, "u": u, "p": p, "none": none}, {"z": ca.vertcat(x, u * p), "x": 0.5 * x + u * p}),),
                frozenset({"u", "z", "none"}))  # fmt: skip
    kernel, rng = Kernel(plan, compiled), np.random.default_rng(0)
    arrays = {"u": rng.normal(size=(20, 1)), "p": np.array([3.0]), "none": np.zeros((20, 0))}
    start, stop, begin = [0, 7, 7, 19], [1, 12, 20, 20], rng.normal(size=(4, 2))
    kept = begin.copy()
    ends = kernel.segments(start, stop, arrays, begin, ("z",))["z"]
    for k, (first, last) in enumerate(zip(start, stop, strict=True)):
        rows = {name: arrays[name][first:last] for name in ("u", "none")}
        alone = kernel(last - first, None, arrays | rows | {"x": begin[k].copy()})
        np.testing.assert_array_equal(ends[k], alone["z"][-1])
    np.testing.assert_array_equal(begin, kept)
    assert kernel.segments([], [], arrays, np.zeros((0, 2)), ("z",))["z"].shape == (0, 3)
    with pytest.raises(ValueError, match="u: expected contiguous doubles"):
        kernel.segments([0], [1], arrays | {"u": np.ones(3, np.float32)}, begin[:1], ("z",))
    for first, last in ((0, 21), (5, 5), (-1, 3)):
        with pytest.raises(ValueError, match=r"each segment of rows needs one initial value .* 20 rows"):
            kernel.segments([first], [last], arrays, begin[:1], ("z",))
