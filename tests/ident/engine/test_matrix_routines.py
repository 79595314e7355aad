"""Tests of the stages on matrices: machine code and interpreter against the formulas, in one and in several blocks."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from seatrial.ident.engine import jit
from seatrial.ident.engine.kernel import Kernel
from seatrial.ident.engine.loop_plan import (
    AddEntriesStage,
    AddOuterProductStage,
    AddProductsStage,
    AddTransposedStage,
    CombinationStage,
    MatrixStage,
    Plan,
    SingleCopyStage,
    Terms,
    TransposeStage,
    stage,
)

SIZES = (1, 3, 14, 20, 31)
GROUPS = 2


@pytest.fixture(params=[True, False], ids=["compiled", "interpreted"])
def compiled(request: pytest.FixtureRequest) -> bool:
    if request.param and not jit.AVAILABLE:
        pytest.skip("runs compiled code, which needs llvmlite")
    return bool(request.param)


def random_terms(rng: np.random.Generator, lines: int, first: int, second: int) -> Terms:
    """Return up to four pairs of indices for each line, below ``first`` and ``second``."""
    return tuple(
        tuple((int(rng.integers(first)), int(rng.integers(second))) for _ in range(rng.integers(5)))
        for _ in range(lines)
    )


def run(
    tested: MatrixStage, arrays: dict[str, np.ndarray], compiled: bool, *, single: bool = False, width: int = jit.WIDTH
) -> np.ndarray:
    """Run a stage in one row and return its result. Arrays in lanes have the shape (groups, entries, width)."""
    in_lanes = {name for name, a in arrays.items() if a.ndim == 3}
    before = []
    for names, total in ((in_lanes, "total"), (set(arrays) - in_lanes, "sum")):  # a stage that reads all arrays
        symbols = {name: ca.SX.sym(name, arrays[name].shape[-2 if name in in_lanes else -1]) for name in sorted(names)}
        if symbols:
            before.append(stage(symbols, {total: sum(s[0] for s in symbols.values())}))
    lanes = frozenset(in_lanes | ({"total", tested.result} if in_lanes else set()))
    precise = {"total", "sum"}
    kept = frozenset({*arrays, tested.result} - precise) if single else frozenset[str]()
    kernel = Kernel(Plan((*before, tested), lanes=lanes, width=width, single=kept), compiled)
    given = {name: a.astype(kernel.layout.dtype(name), order="C") for name, a in arrays.items()}  # copies
    return kernel(1, None, given, groups=GROUPS)[tested.result].copy()


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("transposed", [True, False])
@pytest.mark.parametrize("n", SIZES)
def test_combination_of_rows_in_lanes(n: int, transposed: bool, single: bool, compiled: bool) -> None:
    rng, width = np.random.default_rng(n), jit.WIDTH * (1 + single)
    lines = n if transposed else 4
    arrays = {
        "a": rng.normal(size=(GROUPS, 6, width)),
        "rows": rng.normal(size=3 * n),
        "scalars": rng.normal(size=5),
        "M": rng.normal(size=(GROUPS, 7 * n, width)),
    }
    first = tuple(tuple((i, k * n) for i, k in terms) for terms in random_terms(rng, lines, 6, 3))
    second = (*random_terms(rng, lines - 1, 5, 7), ((0, 6),))  # the last term names the last row of the matrix
    tested = CombinationStage("a", "rows", "scalars", "M", "R", n, first, second, transposed)
    found = run(tested, arrays, compiled, single=single, width=width)
    M, wanted = arrays["M"].reshape(GROUPS, 7, n, width), np.zeros((GROUPS, lines, n, width))
    for r in range(lines):
        for i, at in first[r]:
            wanted[:, r] += np.einsum("gw,n->gnw", arrays["a"][:, i], arrays["rows"][at : at + n])
        for i, k in second[r]:
            wanted[:, r] += arrays["scalars"][i] * M[:, k]
    wanted = wanted.swapaxes(1, 2) if transposed else wanted
    np.testing.assert_allclose(found.reshape(wanted.shape), wanted, rtol=0, atol=5e-6 if single else 1e-13)


@pytest.mark.parametrize("n", SIZES)
def test_product_with_a_sparse_matrix(n: int, compiled: bool) -> None:
    rng, stride = np.random.default_rng(n), -(-n // jit.WIDTH) * jit.WIDTH
    left = rng.normal(size=(n, n)) * (rng.uniform(size=(n, n)) < 0.3) + np.eye(n)
    entries = np.argwhere(left)
    terms = tuple(tuple((k, int(j)) for k, (i, j) in enumerate(entries) if i == row) for row in range(n))
    arrays = {"scalars": left[tuple(entries.T)], "M": rng.normal(size=n * stride)}
    tested = CombinationStage("", "", "scalars", "M", "R", stride, ((),) * n, terms)
    found = run(tested, arrays, compiled).reshape(n, stride)
    np.testing.assert_allclose(found, left @ arrays["M"].reshape(n, stride), rtol=0, atol=1e-13)


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("n", SIZES)
def test_symmetric_sums_in_lanes(n: int, single: bool, compiled: bool) -> None:
    rng, width, error = np.random.default_rng(n), jit.WIDTH * (1 + single), 5e-6 if single else 1e-13
    M, a, w = rng.normal(size=(GROUPS, n, n, width)), rng.normal(size=(GROUPS, n, width)), rng.normal(size=n + 2)
    M = M + M.swapaxes(1, 2)
    arrays = {"M": M.reshape(GROUPS, n * n, width), "a": a, "w": w}
    product = np.einsum("giw,j->gijw", a, w[2:])
    found = run(AddProductsStage("a", "w", 2, "M", n), arrays, compiled, single=single, width=width)
    np.testing.assert_allclose(found.reshape(M.shape), M + product + product.swapaxes(1, 2), rtol=0, atol=error)
    arrays = {"M": product.reshape(GROUPS, n * n, width)}
    found = run(AddTransposedStage("M", "R", n), arrays, compiled, single=single, width=width)
    np.testing.assert_allclose(found.reshape(M.shape), product + product.swapaxes(1, 2), rtol=0, atol=error)


@pytest.mark.parametrize("n", SIZES)
def test_changes_of_a_matrix_without_lanes(n: int, compiled: bool) -> None:
    rng, stride = np.random.default_rng(n), -(-n // jit.WIDTH) * jit.WIDTH
    M, a, w = np.zeros((n, stride)), rng.normal(size=n), np.zeros(stride)
    M[:, :n], w[:n] = rng.normal(size=(n, n)), rng.normal(size=n)
    found = run(AddOuterProductStage("a", "w", "M", n, stride), {"M": M.ravel(), "a": a, "w": w}, compiled)
    np.testing.assert_allclose(found.reshape(n, stride), M + np.outer(a, w), rtol=0, atol=1e-14)
    turned = run(TransposeStage("M", "R", n, stride), {"M": M.ravel()}, compiled).reshape(n, stride)
    np.testing.assert_array_equal(turned[:, :n], M[:, :n].T)
    mirrored = run(TransposeStage("M", "M", n, stride), {"M": M.ravel()}, compiled).reshape(n, stride)
    np.testing.assert_array_equal(mirrored[:, :n], np.triu(M[:, :n]) + np.triu(M[:, :n], 1).T)


@pytest.mark.parametrize("in_lanes", [True, False])
def test_added_entries(in_lanes: bool, compiled: bool) -> None:
    rng = np.random.default_rng(2)
    shape = (lambda n: (GROUPS, n, jit.WIDTH)) if in_lanes else (lambda n: (n,))
    arrays = {"a": rng.normal(size=shape(3)), "M": rng.normal(size=shape(5))}
    wanted = arrays["M"].copy()
    at = (slice(None),) * in_lanes
    for source, target in ((1, 4), (2, 0)):
        wanted[(*at, target)] += arrays["a"][(*at, source)]
    found = run(AddEntriesStage("a", "M", ((1, 4), (2, 0))), arrays, compiled)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-15)


def test_copy_in_single_precision(compiled: bool) -> None:
    values, v = np.random.default_rng(1).normal(size=3 * jit.WIDTH), ca.SX.sym("M", 3 * jit.WIDTH)
    plan = Plan((stage({"M": v}, {"sum": v[0]}), SingleCopyStage("M", "R", v.numel())), single=frozenset({"R"}))
    found = Kernel(plan, compiled)(1, None, {"M": values})["R"]
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, values.astype(np.float32))
