"""Tests of the flag at a parameter whose estimate depends on which of several similar effects is in the model."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from seatrial.ident.diagnosis.findings import EffectAttribution, Refit, Round
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.model.structure import Effect
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.diagnosis import _physical_parameters
from seatrial.ident.results.parts import Correlation, FitSummary, ForceScale, ParameterRow
from seatrial.ident.results.rival_estimates import with_rival_values

MODEL = horizontal_model()
# The thrust is known, so that masses are reported in kg.
KNOWN = {"c1": 40.0, "c2": 1.0, "y_left": -0.3, "y_right": 0.3}
MODEL = MODEL.replace_parameters(*(MODEL.parameter(n).known(v, 0.0, ParameterOrigin.GIVEN) for n, v in KNOWN.items()))


def refit(name: str, m_r: float, m_u: float = 40.0, converged: bool = True) -> Refit:
    values = {**MODEL.values, "m_r": m_r, "m_u": m_u}
    fit = SimpleNamespace(model=MODEL, converged=converged, estimate=lambda n, _: (values[n], 0.1), parameters=())
    return Refit(Effect(name, name, {}), cast(Any, SimpleNamespace(fit=fit)), 50.0, 1, 50.0, 5.0, 3.0)


def summary(**se: float) -> FitSummary:
    rows = [
        ParameterRow(name=n, meaning="", unit="kg", value=4.1, se=error, free=True, flag="old" if n == "m_u" else None)
        for n, error in se.items()
    ]
    scale = ForceScale(thrust=None, arm=None, relative=False, relative_yaw=False, statistical_only=False)
    none = Correlation(names=(), matrix=np.zeros((0, 0)))
    return FitSummary(
        model="m", method="PE", restricted=False, second_order=False, converged=True, message="", log_likelihood=0.0,
        iterations=1, cpu=0.0, coloured=False, scale=scale, parameters=tuple(rows), correlation=none,
    )  # fmt: skip


def flagged(*refits: Refit, attribution: Any = "ambiguous", se: float = 0.1) -> dict[str, ParameterRow]:
    names = tuple(r.effect.name for r in refits[1:])
    of = EffectAttribution(refits[0].effect.name, attribution, ("close",), names)
    rounds = [Round((), (), refits, refits[0])]
    found = with_rival_values(summary(m_r=se, m_u=0.5), _physical_parameters(MODEL), [of], rounds)
    return {row.name: row for row in found.parameters}


def test_a_parameter_has_its_values_with_the_names_that_are_not_excluded() -> None:
    found = flagged(refit("yaw-bias", 4.1), refit("thrust-angle", 4.6))
    assert found["m_r"].flag == (
        "depends on which of the similar effects is in the model: 4.1 with yaw-bias, 4.6 with thrust-angle"
    )
    assert found["m_r"].flag_codes == ("ambiguous",)
    assert found["m_u"].flag == "old"  # its value is the same


@pytest.mark.parametrize(
    ("attribution", "se", "converged"), [("identified", 0.1, True), ("ambiguous", 0.6, True), ("ambiguous", 0.1, False)]
)
def test_a_sure_name_a_small_difference_and_a_failed_fit_give_no_flag(
    attribution: str, se: float, converged: bool
) -> None:
    pair = refit("yaw-bias", 4.1), refit("thrust-angle", 4.6, converged=converged)
    assert flagged(*pair, attribution=attribution, se=se)["m_r"].flag is None


def test_physical_parameters_are_masses_damping_and_thrust() -> None:
    found = _physical_parameters(horizontal_model())
    assert {"m_u", "m_v", "m_r", "d_u", "d_rr", "c1"} <= set(found)
    assert not {"q_u", "e_psi", "V_x", "y_left"} & set(found)
