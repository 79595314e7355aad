"""Tests of the titles of candidates: the name of a curve follows its words."""

from __future__ import annotations

import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.models import disturbances, horizontal, nomoto, surge, thruster
from seatrial.ident.results.candidate_titles import FORCES, VARIABLES, candidate_title


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("psi(n_diff)", "heading error that follows the difference of the shaft speeds, psi(n_diff)"),
        ("N(u, r)", "yaw moment that follows the product of surge speed and yaw rate, N(u, r)"),
        ("X(past of n_sum)", "surge force that follows the mean of the shaft speeds with a lag, X(past of n_sum)"),
        ("X(swing after f_sum)", "surge force that oscillates after the mean of the thrusts, X(swing after f_sum)"),
        ("G(depth)", "G that follows the depth, G(depth)"),
        ("between-runs:m_v", "m_v differs between the runs"),
        ("wind", catalogue()["wind"].title),
        ("unknown", "unknown"),
    ],
)
def test_a_candidate_has_a_title_in_words(name: str, title: str) -> None:
    assert candidate_title(name) == title


def test_all_forces_and_variables_of_the_models_have_words() -> None:
    models = [
        horizontal.horizontal_model(),
        horizontal.horizontal_model("shaft"),
        nomoto.nomoto_model(),
        surge.surge_model(),
        thruster.thruster_model(),
    ]
    errors = (*disturbances.SENSOR_ERRORS, *disturbances.THRUST_LOSSES)
    assert {d.name for m in models for d in m.residuals} | {d.name for d in errors} <= set(FORCES)
    assert {v.name for m in models for v in m.variables} <= set(VARIABLES)
