"""Tests of weak effects on boats of an independent simulator. They are found with their sizes, and a nominal boat has
no effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pytest

from seatrial.ident.data.record import make_record
from seatrial.ident.diagnosis.findings import Diagnosis
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.diagnosis.search import diagnose, score_all
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import fit_with_rescaling, nominal_model, with_all_candidates
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.scaling import scale_priors, size_of
from tests.ident.effects.independent_boat import Force, IndependentBoat, Loss, Moment, Slosh, sail

SECONDS = (300.0, 150.0)  # Durations of the estimation run and of the validation run.


def model_of(boat: IndependentBoat, gyro: bool = True) -> Model:
    """Return the horizontal model with the thrust of this boat and suitable initial values."""
    w, length = boat.weight, boat.scale
    sensors = ("attitude", "gyro", "accelerometer", "position", "ground_velocity")
    model = horizontal_model(sensors=sensors if gyro else ("attitude", "position", "ground_velocity"))
    start = {
        "m_u": 37.0 * w,
        "m_v": 47.0 * w,
        "m_r": 9.7 * w * length**2,
        "d_v": 50 * length**2,
        "d_uu": 25 * length**2,
    }
    thrust = {"c1": boat.full_thrust, "c2": 0.0, "y_left": -boat.arm, "y_right": boat.arm}
    return model.with_values(start | thrust | {"d_r": 4.1 * w * length, "d_rr": 6.2 * w * length})


def found_on(boat: IndependentBoat, gyro: bool = True) -> Diagnosis:
    """Return the diagnosis of one run, validated by another."""
    runs = [sail(boat, seconds, seed, gyro) for seed, seconds in zip((12, 11), SECONDS, strict=True)]
    return diagnose(model_of(boat, gyro), runs[:1], runs[1:])


def scores_of(boat: IndependentBoat, gyro: bool = True) -> tuple[list[Score], list[Score]]:
    """Return all score tests of the first round, best first, and those that pass."""
    run, full = sail(boat, SECONDS[0], 12, gyro), nominal_model(model_of(boat, gyro))
    wanted = {n: e for n, e in catalogue().items() if full.accepts(e)}
    everything, candidates = with_all_candidates(full, wanted, [run])
    records = [make_record(everything, run, 10.0)]
    fitted = fit_with_rescaling(full, records, ())
    size = size_of(fitted.fit.model)
    return score_all(fitted, records, {n: scale_priors(e, size) for n, e in candidates.items()})


def estimates(found: Diagnosis, names: Sequence[str]) -> Mapping[str, tuple[float, float]]:
    return {n: found.after.fit.estimate(n) for n in names}


def spring(stiffness: float, slack: float, north: float, east: float) -> Force:
    """Return the force of an elastic line to a fixed point. The line is slack up to its length."""

    def force(now: Moment) -> tuple[float, float, float]:
        dn, de = now.north - north, now.east - east
        away = math.hypot(dn, de)
        tension = stiffness * max(away - slack, 0.0) / (away + 1e-9)
        return *now.into_body(-tension * dn, -tension * de), 0.0

    return force


def line(k: float, north: float, east: float) -> Force:
    """Return the force of a line that is paid out from a fixed point and dragged through the water."""

    def force(now: Moment) -> tuple[float, float, float]:
        pull = k * math.hypot(now.north - north, now.east - east) * math.hypot(now.vn, now.ve)
        return *now.into_body(-pull * now.vn, -pull * now.ve), 0.0

    return force


def wind(north: float, east: float, k: float, arm: float) -> Force:
    """Return a force that is quadratic in the relative wind. ``arm`` is the position of the lateral force ahead of the
    origin.
    """

    def force(now: Moment) -> tuple[float, float, float]:
        along, across = now.into_body(north - now.vn, east - now.ve)
        speed = math.hypot(along, across)
        return 0.9 * k * speed * along, k * speed * across, arm * k * speed * across

    return force


def stalled(*sides: str) -> Loss:
    """Return a thrust loss of these sides that grows with the square of the yaw rate, up to one half."""
    return lambda side, now: 1 - 0.5 * min(abs(now.r) / 0.8, 1.0) ** 2 * (side in sides)


def partly_linear(share: float) -> Loss:
    """Return a thrust of which this share is linear in the shaft speed. The rest is quadratic."""
    return lambda side, now: 1 - share + share / max(abs(now.n[side]), 1e-3)


def powered(exponent: float) -> Loss:
    """Return a thrust with this power of the shaft speed."""
    return lambda side, now: max(abs(now.n[side]), 1e-3) ** (exponent - 2)


def rudder(k: float) -> Force:
    """Return a yaw moment that is proportional to the difference of the sides and to the speed squared."""
    return lambda now: (0.0, 0.0, k * abs(now.u) * now.u * (now.n["left"] - now.n["right"]) / 2)


def turned(left: float, right: float, stern: float) -> Force:
    """Return the side force of thrusters at these angles [rad], this far [m] forward of the origin."""

    def force(now: Moment) -> tuple[float, float, float]:
        side = sum(a * 34.0 * now.n[s] * abs(now.n[s]) for s, a in (("left", left), ("right", right)))
        return 0.0, side, stern * side

    return force


def walking(ahead: float, astern: float, stern: float) -> Force:
    """Return the side force of propellers that turn the same way, over their thrust ahead and astern."""

    def force(now: Moment) -> tuple[float, float, float]:
        thrust = sum(34.0 * n * abs(n) * (ahead if n > 0 else astern) for n in now.n.values())
        return 0.0, thrust, stern * thrust

    return force


def quay(bearing: float, force_0: float, per_metre: float, lever: float) -> Force:
    """Return the suction of a quay, which grows linearly towards it, and its moment away from the quay."""

    def force(now: Moment) -> tuple[float, float, float]:
        towards = now.north * math.cos(bearing) + now.east * math.sin(bearing)
        suction = (force_0 + per_metre * towards) * now.u * now.u * math.sin(bearing - now.psi)
        return 0.0, suction, -lever * suction

    return force


def shoal(north: float, east: float) -> Force:
    """Return a quadratic drag that grows with the distance to the north and to the east."""
    return lambda now: (-(north * now.north + east * now.east) * now.u * abs(now.u), 0.0, 0.0)


SMALL = 0.6  # Factor of the length, for a boat of 9 kg.
FOUND: dict[str, tuple[IndependentBoat, bool, str, dict[str, float]]] = {
    "spring": (
        IndependentBoat(force=spring(0.9, 6.0, 4.0, -3.0)),
        True,
        "mooring",
        {"k_m": 0.9, "l_slack": 6.0, "F_mx": 3.6, "F_my": -2.7},
    ),
    "line": (
        IndependentBoat(force=line(0.08, 8.0, -6.0)),
        True,
        "tether",
        {"k_tether": 0.08, "x_tether": 8.0, "y_tether": -6.0},
    ),
    "surge": (IndependentBoat(force=lambda now: (-6.4, 0.0, 0.0)), True, "steady-force", {"X_0": -6.4, "Y_0": 0.0}),
    "sway": (IndependentBoat(force=lambda now: (0.0, 4.0, 0.0)), True, "steady-force", {"X_0": 0.0, "Y_0": 4.0}),
    "pull": (
        IndependentBoat(force=lambda now: (*now.into_body(3.0, -4.0), 0.0)),
        True,
        "steady-pull",
        {"F_north": 3.0, "F_east": -4.0},
    ),
    "wind": (IndependentBoat(SMALL, wind(3.0, -2.5, 0.1, -0.15)), False, "wind", {"w_x": 0.9, "w_n": -0.15}),
    "linear": (IndependentBoat(loss=partly_linear(0.6)), True, "thrust-linearity", {"lambda_n": 0.6}),
    "power": (IndependentBoat(loss=powered(1.6)), True, "thrust-power", {"p_n": -0.4}),
    "speed": (IndependentBoat(receiver_error=(1.05, 0.0)), True, "velocity-scale", {"k_V": 0.05}),
    "course": (IndependentBoat(receiver_error=(1.0, 0.07)), True, "velocity-course", {"chi_0": 0.07}),
    "rudder": (IndependentBoat(force=rudder(12.0)), True, "steering", {"N_delta": 12.0}),
    "angle": (
        IndependentBoat(force=turned(0.0, 0.09, -0.6)),
        True,
        "thrust-angle",
        {"delta_L": 0.0, "delta_R": 0.09, "x_delta": -0.6},
    ),
    "walk": (
        IndependentBoat(force=walking(0.06, 0.2, -0.6)),
        True,
        "propeller-walk",
        {"k_ahead": 0.06, "k_astern": 0.2, "x_walk": -0.6},
    ),
    "quay": (
        IndependentBoat(force=quay(1.0, 6.0, 0.3, 0.4)),
        True,
        "bank",
        {"Y_bank": 6.0, "Y_slope": 0.3, "N_bank": 2.4, "N_slope": 0.12, "psi_bank": 1.0},
    ),
    "shoal": (IndependentBoat(force=shoal(0.2, -0.3)), True, "shallow-water", {"d_north": 0.2, "d_east": -0.3}),
    "stall": (IndependentBoat(loss=stalled("left")), True, "unknown T_left(r)", {}),
    "both": (IndependentBoat(loss=stalled("left", "right")), True, "unknown T(r)", {}),
}


@pytest.mark.study
@pytest.mark.parametrize("case", FOUND)
def test_weak_effect_is_found_with_its_size(case: str) -> None:
    boat, gyro, name, truth = FOUND[case]
    found = found_on(boat, gyro)
    assert [q.effect.name for q in found.effects] == [name]
    assert found.attributions[0].attribution == ("nonparametric" if name.startswith("unknown") else "identified")
    for parameter, (value, error) in estimates(found, list(truth)).items():
        assert value == pytest.approx(truth[parameter], abs=4 * error), parameter
        assert error < max(0.15 * abs(truth[parameter]), 0.1) or parameter.endswith("_tether"), parameter
    for mass, full in (("m_u", 42.0), ("m_v", 58.0)):
        value, error = found.after.fit.estimate(mass)
        assert value == pytest.approx(full * boat.weight, abs=4 * error)


@pytest.mark.study
def test_curve_of_a_thrust_loss_equals_the_true_loss() -> None:
    """Over the yaw rates of the run, no thrust is lost straight ahead and half is lost in the tightest turns."""
    (curve,) = found_on(IndependentBoat(loss=stalled("left"))).curves
    assert (curve.force, curve.variable, curve.unit) == ("T_left", "r", "")
    wanted = [-0.5 * min(abs(r) / 0.8, 1.0) ** 2 for r in curve.grid]
    assert curve.value == pytest.approx(wanted, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["surge", pytest.param("sway", marks=pytest.mark.study)])
def test_sloshing_mass_passes_the_score_test_along_either_axis(axis: str) -> None:
    scores, passed = scores_of(IndependentBoat(slosh=Slosh(9.0, 0.5, 0.05, axis)))
    name = {"surge": "pendulum", "sway": "sway-slosh"}[axis]
    assert name in [s.name for s in passed]
    best = next(s for s in scores if s.name == name)
    (frequency,) = best.scan.values()
    assert frequency == pytest.approx(0.5, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=pytest.mark.study), SMALL])
def test_nominal_boat_gives_no_effect(scale: float) -> None:
    assert not found_on(IndependentBoat(scale)).effects
