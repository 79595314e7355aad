"""Tests of the motion that a mission did not excite: constant and equal commands, and a boat that drifts."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.bench.mission_generators import make_mission
from seatrial.ident.data.record import LogSegment
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY
from seatrial.ident.diagnosis.search import _reservations
from seatrial.ident.engine import quick_compilation
from seatrial.ident.estimation.excitation import unexcited_motion
from seatrial.ident.estimation.fitted_model import FittedModel, fit_nominal_model
from seatrial.ident.models.components import estimator_error
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.answers import estimation_warnings
from seatrial.mocks.offline_simulation import simulate
from tests.missions import boat_with, channels_of


def fit_to_mission(kind: str, seconds: float = 100.0, estimator_errors: bool = False) -> FittedModel:
    """Return the fit to a mission: ``mixed``, ``constant`` and equal commands, or at ``rest``.

    With ``estimator_errors``, the errors of a navigation filter are states.
    """
    t, commands = make_mission("mixed", seconds, 103).setpoints()
    commands = {"mixed": 1.0, "constant": 0.0, "rest": 0.0}[kind] * np.asarray(commands)
    commands = commands + (0.4 if kind == "constant" else 0.0)
    run = LogSegment("run", channels_of(simulate(boat_with(None, 3), t, commands, seconds, 1)))
    model = horizontal_model()
    model = model.replace_parameters(*(model.parameter(n).at(v).fixed() for n, v in (("c1", 40.05), ("c2", 1.11))))
    return fit_nominal_model(
        model + estimator_error([s.name for s in model.sensors]) if estimator_errors else model, [run], []
    )


def test_states_of_a_filter_may_explain_the_motion_in_place_of_the_boat() -> None:
    with quick_compilation(0):  # No other module fits this model.
        fitted = fit_to_mission("rest", 40.0, estimator_errors=True)
    (text,) = [w.text for w in estimation_warnings(fitted.fit, fitted.records) if w.code == "motion-not-excited"]
    assert "which are states of this fit, explain the motion in place of the boat" in text
    for option in ("--fix e_xy=0.3", "--fix e_psi=0.03", "--fix e_vxy=0.05"):
        assert option in text


@pytest.mark.parametrize(
    ("kind", "least", "reason"),
    [
        ("constant", {"m_r"}, "both thrusters always did the same, so that nothing turned the boat"),
        ("rest", {"m_u", "m_v", "m_r"}, "the thrusters never changed"),
    ],
)
def test_masses_without_excitation_are_named_with_the_reason(kind: str, least: set[str], reason: str) -> None:
    fitted = fit_to_mission(kind)
    found = unexcited_motion(fitted.fit, fitted.records)
    assert found is not None
    assert set(found.parameters) >= least
    assert found.reason == reason
    (text,) = [w.text for w in estimation_warnings(fitted.fit, fitted.records) if w.code == "motion-not-excited"]
    assert text.startswith(f"The data do not determine {', '.join(found.parameters)}: {reason}. ")
    assert text.endswith("(seatrial mission generate --kind mixed).")
    # No effect is identified on such data.
    assert f"the data do not determine {', '.join(found.parameters)}: {reason}" in _reservations(
        fitted, fitted, DEFAULT_POLICY
    )


def test_a_mixed_mission_excites_all_motion() -> None:
    fitted = fit_to_mission("mixed")
    assert unexcited_motion(fitted.fit, fitted.records) is None
    assert "motion-not-excited" not in {w.code for w in estimation_warnings(fitted.fit, fitted.records)}
