"""Tests of effects with a less obvious formula: their force, and their alternatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.diagnosis.candidates import wave_peak_score
from seatrial.ident.effects.environment.waves import EFFECT as WAVES
from seatrial.ident.effects.environment.waves import FORCES, waves_at
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import fit_and_evaluate, fit_nominal_model, nominal_model
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.missions import boat_with, channels_of, sail


def model_with(name: str, **values: float) -> Model:
    return (with_disturbances(horizontal_model()) + catalogue()[name]).with_values(values)


def rates(model: Model, **x: float) -> dict[str, float]:
    """Return rates and outputs by name. States that are not given are zero."""
    names = [s.name for s in model.states]
    state = np.array([[x.get(n, 0.0) for n in names]])
    row = VectorisedModel(model)(state, np.zeros((1, len(model.inputs))), np.array(list(model.values.values())))[0]
    return dict(zip([*names, *(f"y_{o.name}" for o in model.outputs)], row.tolist(), strict=True))


def force(name: str, x: dict[str, float], **values: float) -> float:
    """Return the force X [N] that the effect adds."""
    added = rates(model_with(name, **values), **x)["u"] - rates(model_with(name), **x)["u"]
    return 37.0 * added


def test_hump_is_largest_at_its_speed_and_opposes_the_motion() -> None:
    def hump(u: float) -> float:
        return force("hump", {"u": u}, A_hump=7.0, u_hump=0.8, w_hump=0.15)

    assert hump(0.8) == pytest.approx(-7.0, rel=1e-6)
    assert hump(-0.8) == pytest.approx(7.0, rel=1e-6)
    assert hump(0.65) == pytest.approx(-7.0 * np.exp(-0.5), rel=1e-4)
    assert abs(hump(1.6)) < 1e-5


def test_tether_drag_grows_with_its_length_and_opposes_the_motion_over_ground() -> None:
    def drag(x: float, u: float) -> float:
        return force("tether", {"x": x, "u": u}, k_tether=0.05)

    assert drag(40.0, 1.0) == pytest.approx(-2.0, rel=1e-4)
    assert drag(20.0, 1.0) == pytest.approx(-1.0, rel=1e-4)
    assert drag(40.0, -0.5) == pytest.approx(0.5, rel=1e-4)
    against = force("tether", {"x": 40.0, "u": 1.0}, k_tether=0.05, V_x=-1.0) - force(
        "tether", {"x": 40.0, "u": 1.0}, V_x=-1.0
    )
    assert against == pytest.approx(0.0, abs=1e-4)  # The boat is at rest over ground.


def test_accelerometer_scale_acts_on_the_specific_force() -> None:
    x = {"u": 1.0, "r": 0.3, "v": 0.1}
    plain = rates(model_with("accelerometer-scale"), **x)
    scaled = rates(model_with("accelerometer-scale", k_acc=0.1), **x)
    for axis in ("y_ax", "y_ay"):
        assert scaled[axis] == pytest.approx(1.1 * plain[axis])
    assert scaled["u"] == plain["u"]


def test_waves_have_the_size_of_their_parameters() -> None:
    """The stationary covariance of the filter (Lyapunov's equation) is compared with A."""
    model = model_with("waves", A_X=3.0, f_wave=0.4, zeta_wave=0.07)
    names = [s.name for s in model.states]
    at = [names.index(n) for n in ("wave_X", "wave_X_rate")]
    values = np.array(list(model.values.values()))
    jacobian = VectorisedModel(model).rate_jacobian(
        np.zeros((1, len(names))), np.zeros((1, len(model.inputs))), values
    )[0]
    A = jacobian[np.ix_(at, at)]
    noise = np.array([model.states[i].noise for i in at], dtype=float)
    P = solve_continuous_lyapunov(A, -np.diag(noise**2))
    gain = 37.0 * jacobian[names.index("u"), at[0]]
    assert gain * np.sqrt(P[0, 0]) == pytest.approx(3.0, rel=1e-6)
    frequency = np.abs(np.linalg.eigvals(A))[0] / (2 * np.pi)
    assert frequency == pytest.approx(0.4)
    assert {p.name for p in waves_at(0.7).parameters if p.value > 0} >= {f"A_{f}" for f in FORCES}


@pytest.mark.study
def test_waves_are_found_in_the_innovations_and_fitted() -> None:
    """No waves are found on a boat without waves."""
    runs = {name: LogSegment("run", channels_of(sail(boat_with(name, 4), 130.0, 3)[0])) for name in ("waves", None)}
    assert wave_peak_score(fit_nominal_model(horizontal_model(), [runs[None]], [])) is None
    before = fit_nominal_model(horizontal_model(), [runs["waves"]], [])
    score = wave_peak_score(before)
    assert score is not None
    assert score.p < 1e-6
    assert score.scan["f_wave"] == pytest.approx(0.45, abs=0.15)
    start = replace(
        WAVES, parameters=tuple(p.at(score.scan.get(p.name, score.step.get(p.name, p.value))) for p in WAVES.parameters)
    )
    model = nominal_model(horizontal_model()) + start
    after = fit_and_evaluate(model, [make_record(model, runs["waves"], 10.0)], [])
    assert after.fit.log_posterior - before.fit.log_posterior > 100.0
    assert after.fit.estimate("f_wave")[0] == pytest.approx(0.45, abs=0.1)


def test_every_vehicle_effect_names_its_alternatives() -> None:
    for name, effect in catalogue().items():
        if "bench" not in effect.requires:
            assert effect.alternatives, name
            assert name not in effect.alternatives
