"""Tests of the sentence on added effects that act like a change of a given parameter."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation import Fit
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.answers import _acting_alike


@pytest.mark.parametrize(
    ("left", "right", "alike"),
    [(-0.97, -0.94, "rho_left and rho_right"), (0.97, 0.2, "rho_left"), (0.8, np.nan, None)],
)
def test_parameters_of_effects_that_act_like_a_given_one_are_named(
    left: float, right: float, alike: str | None
) -> None:
    model = horizontal_model() + catalogue()["reverse-mismatch"]
    correlation = np.array([[1.0, -0.99, left, right], [-0.99, 1.0, 0.0, 0.0], [left, 0, 1, 0], [right, 0, 0, 1]])
    fit = cast(
        "Fit", SimpleNamespace(names=("c2", "m_u", "rho_left", "rho_right"), correlation=correlation, model=model)
    )
    c2 = replace(model.parameter("c2"), prior=(5.0, 1.06))
    found = _acting_alike(fit, c2)
    assert (found == "") == (alike is None)
    assert alike is None or found == (
        f"The data hardly tell a change of c2 from one of {alike}, of an added effect: to hold the given value, fit "
        "and diagnose again with --fix c2=5. "
    )
    assert _acting_alike(fit, replace(c2, name="c1")) == ""
