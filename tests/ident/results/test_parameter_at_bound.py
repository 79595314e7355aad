"""Tests of the sentence on a parameter at its bound: which bound it is, what that means, and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import seatrial as st
from seatrial.api.messages import in_python
from seatrial.daq.errors import SeatrialWarning
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import AT_BOUND, ReportedEstimates
from seatrial.ident.models import estimator_error
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.tables import _flag_text, fit_summary
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.usefixtures("quick_compilation")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> st.FittedVehicle:
    log = boat_log(tmp_path_factory.mktemp("bound") / "run.mcap", boat_with(None, 5), 60.0, 101, 1)
    with pytest.warns(SeatrialWarning):
        return st.fit(log, fixed={"c1": 40.0, "c2": 1.1}, score_tests=False)


def flag_at(fitted: st.FittedVehicle, name: str, bounds: tuple[float, float], value: float) -> str:
    """Return the flag in the result if the estimate of a parameter is ``value``, which is one of its bounds."""
    fit = fitted.fitted.fit
    k, bounded = (
        fit.names.index(name),
        [replace(p, bounds=bounds, value=value) for p in fit.parameters if p.name == name],
    )
    parameters = tuple(bounded[0] if p.name == name else p for p in fit.parameters)
    model = replace(fit.model, parameters=tuple(bounded[0] if p.name == name else p for p in fit.model.parameters))
    values = fit.values.copy()
    values[k] = value
    moved = replace(fit, model=model, parameters=parameters, values=values, flags=((name, AT_BOUND),))
    (row,) = (row for row in fit_summary(moved, {}).parameters if row.name == name)
    assert row.flag is not None
    return row.flag


def test_a_damping_at_zero_is_not_shown_by_the_data(fitted: st.FittedVehicle) -> None:
    flag = flag_at(fitted, "d_rr", (0.0, np.inf), 0.0)
    assert flag == (
        "at its bound 0, the lowest possible value: the data do not show quadratic yaw damping. Fix it (--fix d_rr=0), "
        "or add logs that excite it"
    )
    assert "Fix it (fixed={'d_rr': 0})" in in_python(flag)


def test_a_noise_at_its_bound_names_the_bound(fitted: st.FittedVehicle) -> None:
    flag = flag_at(fitted, "e_psi", (0.01, np.inf), 0.01)
    assert flag.startswith("at its bound 0.01 rad, the lowest possible value: the data show less noise than this. ")
    assert flag.endswith("(--fix e_psi=VALUE)")


def test_a_noise_beside_lasting_errors_needs_nothing(fitted: st.FittedVehicle) -> None:
    with_states = horizontal_model() + estimator_error([s.name for s in horizontal_model().sensors])
    p = replace(with_states.parameter("e_psi"), bounds=(0.0002, np.inf), value=0.0002)
    flag = _flag_text(AT_BOUND, p, 0.0002, ReportedEstimates(replace(fitted.fitted.fit, model=with_states)))
    assert flag == (
        "at its bound 0.0002 rad, the lowest possible value: the errors of this signal last, and are states of the "
        "model. Nothing has to be done"
    )


def test_a_dead_zone_at_zero_beside_a_dead_band_needs_nothing(fitted: st.FittedVehicle) -> None:
    model = horizontal_model("command") + catalogue()["dead-band"]
    reported = ReportedEstimates(replace(fitted.fitted.fit, model=model))
    flag = _flag_text(AT_BOUND, model.parameter("dead_zone"), 0.0, reported)
    assert flag == (
        "at its bound 0, the lowest possible value: the effect dead-band describes this in another form. Nothing has "
        "to be done"
    )


def test_a_pure_line_is_not_taken_for_waves_of_wind(fitted: st.FittedVehicle) -> None:
    """A nearly periodic motion of yaw alone puts the width of the peak, and two of three forces, at their bounds."""
    model = horizontal_model() + catalogue()["waves"]
    reported = ReportedEstimates(replace(fitted.fitted.fit, model=model))
    flag = _flag_text(AT_BOUND, model.parameter("zeta_wave"), 0.01, reported)
    assert flag.startswith(
        "at its bound 0.01, the lowest possible value: the motion at this frequency is nearly periodic"
    )
    assert "mounting" in flag
    assert "Check the logs" not in flag
    flag = _flag_text(AT_BOUND, model.parameter("A_X"), 0.0, reported)
    assert "If only one of A_X, A_Y and A_N is larger than zero, the cause may be a machine" in flag
    assert "the best estimate is beyond it" in _flag_text(AT_BOUND, model.parameter("zeta_wave"), 0.7, reported)


def test_an_upper_bound_is_called_the_highest_value(fitted: st.FittedVehicle) -> None:
    flag = flag_at(fitted, "d_uu", (0.0, 9.0), 9.0)
    assert flag.startswith("at its bound 9 kg/m, the highest possible value: the best estimate is beyond it. ")
