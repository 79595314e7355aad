"""Tests of one linear operator per row: the compiled version equals NumPy and the formula."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.engine import jit
from seatrial.ident.engine.row_operators import MULTIPLE, NOWHERE, apply_rows, padded

N, S, M, Q = 40, 5, 3, 3  # Rows, states, outputs, and sensitivities of outputs.
TOUCHED = {"some": [1, 3, 6], "rates": [0, 1, 2, 3, 4], "outputs": [5, 7], "all": list(range(S + Q)), "none": []}


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("columns", TOUCHED)
def test_rows_equal_the_formula(columns: str, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if compiled and not jit.AVAILABLE:
        pytest.skip("compares compiled code, which needs llvmlite")
    monkeypatch.setattr(jit, "AVAILABLE", compiled)
    rng, touched, w = np.random.default_rng(3), np.array(TOUCHED[columns], np.int64), padded(11)
    B, ahead = 0.3 * rng.normal(size=(N, S + M, 2 * S + Q)), rng.uniform(size=N)
    drive, begin = rng.normal(size=(N + 1, touched.size, w)), rng.normal(size=(S, w))
    seen = rng.uniform(size=(N, M)) < 0.4
    at = np.where(seen, np.cumsum(seen).reshape(seen.shape) - 1, NOWHERE)
    rates, out = touched[touched < S], np.full((int(seen.sum()), w), np.nan)
    end = apply_rows(B, drive, touched, ahead, rates, begin, at, out)
    x, wanted = begin, []
    for k in range(N):
        both = B[k, :, :S] @ x + B[k, :, S:][:, touched] @ drive[k]
        wanted += list(both[S:][seen[k]])
        x = both[:S]
        x[rates] += ahead[k] * drive[k + 1, : rates.size]
    np.testing.assert_allclose(end, x, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(out, np.array(wanted), rtol=1e-12, atol=1e-13)


def test_columns_are_padded_to_whole_vectors() -> None:
    assert [padded(n) for n in (1, MULTIPLE, MULTIPLE + 1)] == [MULTIPLE, MULTIPLE, 2 * MULTIPLE]
