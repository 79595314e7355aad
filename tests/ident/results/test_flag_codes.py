"""Tests of the short codes of flags: each flag that a fit gives has one."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.estimation.given_priors import given_prior_remark
from seatrial.ident.estimation.standard_errors import (
    AT_BOUND,
    AUTOCORRELATED_TOO_LONG,
    FROM_PRIOR,
    VAGUE,
    LikelihoodInterval,
    _unidentified_parameters,
)
from seatrial.ident.model import Parameter, ParameterOrigin
from seatrial.ident.models.dead_zone import TURNS_INSIDE
from seatrial.ident.results.parts import NO_MASS, flag_codes


def given(estimate: tuple[float, float], weight: float) -> str:
    mass = Parameter("m_u", 30.0, "kg", "mass", prior=(30.0, 2.0), origin=ParameterOrigin.PRIOR)
    return given_prior_remark(mass, estimate, weight)


@pytest.mark.parametrize(
    ("flag", "codes"),
    [
        ("", ""),
        (f"{AT_BOUND} 0.0017, the lowest possible value: the data show less noise than this", "at bound"),
        (VAGUE, "not determined"),
        (f"97 % {FROM_PRIOR}", "prior"),
        (AUTOCORRELATED_TOO_LONG, "no robust error"),
        ("its error is 2.3 times as large because q may leave its bound", "larger error"),
        (TURNS_INSIDE, "contradicted"),
        (f"the curve X(u) has the form of m_u u': {NO_MASS}", "no mass"),
        (f"{AT_BOUND} 0; the curve X(u) has the form of m_u u': {NO_MASS}", "at bound, no mass"),
        ("a flag of a later version", "other"),
    ],
)
def test_a_flag_has_a_short_code(flag: str, codes: str) -> None:
    assert flag_codes(flag) == codes


def test_flags_with_numbers_have_codes() -> None:
    assert flag_codes(given((30.2, 1.9), 0.97)) == "prior"
    assert flag_codes(given((30.2, 3.0), 0.97)) == "prior, larger error"
    assert flag_codes(LikelihoodInterval(0, 1.0, 2.0).remark) == "flat"
    _, flags = _unidentified_parameters(np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0] * 3]), "abc", "abc")
    assert {flag_codes(text) for _, text in flags} == {"not determined"}
    assert len(flags) == 3
