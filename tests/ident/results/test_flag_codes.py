"""Tests of flags: each has its code where it is made, and the tables of results have the codes."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from seatrial.ident.estimation.given_priors import LARGER_ERROR, agrees_with_bench, given_prior_flags
from seatrial.ident.estimation.standard_errors import (
    AT_BOUND,
    AUTOCORRELATED_TOO_LONG,
    VAGUE,
    LikelihoodInterval,
    _unidentified_parameters,
)
from seatrial.ident.model import Flag, Parameter, ParameterOrigin
from seatrial.ident.models.dead_zone import TURNS_INSIDE
from seatrial.ident.results.parts import ParameterRow
from seatrial.ident.results.tables import _flag_fields


def given(estimate: tuple[float, float], weight: float) -> list[str]:
    mass = Parameter("m_u", 30.0, "kg", "mass", prior=(30.0, 2.0), origin=ParameterOrigin.PRIOR)
    return [flag.code for flag in given_prior_flags(mass, estimate, weight)]


def test_value_of_a_bench_test_that_a_fit_keeps_has_no_flag() -> None:
    c1 = Parameter("c1", 41.8, "N", "thrust", prior=(41.8, 0.03), origin=ParameterOrigin.MEASURED)
    assert agrees_with_bench(c1, 41.81)
    for error in (0.03, 0.5):  # the second one is larger than that of the bench
        assert given_prior_flags(c1, (41.81, error), 1.0) == ()
    assert [flag.code for flag in given_prior_flags(c1, (41.9, 0.5), 1.0)] == ["prior", "larger error"]
    assert len(LARGER_ERROR) < 100


def row(*flags: Flag) -> ParameterRow:
    return ParameterRow(name="d", meaning="", unit="", value=0.0, se=None, free=True, **_flag_fields(flags))


def test_each_flag_has_its_code_where_it_is_made() -> None:
    assert [flag.code for flag in (AT_BOUND, VAGUE)] == ["at bound", "not determined"]
    assert (AUTOCORRELATED_TOO_LONG.code, TURNS_INSIDE.code) == ("no robust error", "contradicted")
    assert given((30.2, 1.9), 0.97) == ["prior"]
    assert given((30.2, 3.0), 0.97) == ["prior", "larger error"]
    assert given((30.2, 1.9), 0.5) == []
    assert LikelihoodInterval(0, 1.0, 2.0).flag.code == "flat"
    _, flags = _unidentified_parameters(np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0] * 3]), "abc", "abc")
    assert [flag.code for _, flag in flags] == ["not determined"] * 3


def test_a_row_has_text_and_codes_of_all_its_flags() -> None:
    both = row(Flag("at bound", "at its bound 0"), Flag("no mass", "the curve is none"), Flag("no mass", "again"))
    assert both.flag == "at its bound 0; the curve is none; again"
    assert (both.flag_codes, both.flag_in_table) == (("at bound", "no mass"), "at bound, no mass")
    assert both.origin_in_table == "estimated, at bound"
    none = row()
    assert (none.flag, none.flag_codes, none.flag_in_table, none.origin_in_table) == (None, (), "", "estimated")


def test_words_of_a_text_give_no_code() -> None:
    """A text that happened to have the words of another flag got its code too."""
    assert row(Flag("ambiguous", "at its bound with lag, 4 with delay")).flag_in_table == "ambiguous"


def test_a_flag_of_an_earlier_version_has_no_code() -> None:
    old = ParameterRow(name="d", meaning="", unit="", value=0.0, se=None, free=True, flag="at its bound")
    assert old.flag_in_table == "other"


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda flag: pickle.loads(pickle.dumps(flag))])
def test_a_flag_keeps_its_code_in_another_process(copied: object) -> None:
    assert callable(copied)
    found = copied(AT_BOUND)
    assert (found, found.code) == ("at its bound", "at bound")
