"""Tests of scaling: priors, steps and disturbance forces follow the size of the boat."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, LogSegment, make_record
from seatrial.ident.diagnosis.score_test import Score, score_threshold
from seatrial.ident.diagnosis.search import score_all
from seatrial.ident.effects.nonparametric import input_response_effects, nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import fit_with_rescaling, nominal_model, with_all_candidates
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.model.structure import ForceCurve
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.scaling import VesselScale, dimension, rescale, rescale_effects, scale_priors, size_of
from tests.ident.carriers import carrier
from tests.missions import boat_with, channels_of, sail

pytestmark = pytest.mark.usefixtures("quick_compilation")

FERRY = 50.0  # Factor of mass, inertia, damping and thrust.


# Exponents of kg, m and s of every unit in the catalogue, written by hand. A radian has no dimension.
DIMENSIONS = {
    "": (0, 0, 0),
    "rad": (0, 0, 0),
    "kg": (1, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "Hz": (0, 0, -1),
    "1/s": (0, 0, -1),
    "m/s": (0, 1, -1),
    "s/m": (0, -1, 1),
    "s/rad": (0, 0, 1),
    "rad s2/m": (0, -1, 2),
    "N": (1, 1, -2),
    "N m": (1, 2, -2),
    "N/m": (1, 0, -2),
    "rad/N": (-1, -1, 2),
    "N s2/m2": (1, -1, 0),
    "kg m": (1, 1, 0),
    "kg/m": (1, -1, 0),
    "kg/m2": (1, -2, 0),
    "kg/s": (1, 0, -1),
    "kg m/s": (1, 1, -1),
    "kg s/m2": (1, -2, 1),
}
# Parameters that do not scale with the boat, because they belong to a sensor, a link, a shaft, a bench or the water.
OTHERS = {
    "T_creep",
    "T_cell",
    "T_wash",
    "T_late",
    "n_slew",
    "f_rod",
    "T_dev",
    "T_head",
    "tau_delay",
    "T_lag",
    "T_lag_left",
    "T_lag_right",
    "dT_n",
    "tau_heat",
    "T_psi",
    "T_r",
    "T_uv",
    "tau_gnss",
    "V_dx",
    "V_dy",
    "V_xx",
    "V_xy",
    "V_yx",
    "V_yy",
    "t_shift",
    "t_foul",
    "f_wave",
}
LENGTH = 4.0  # Factor of the length of the catalogue's boat.
COPY = VesselScale(LENGTH**3, LENGTH)


def froude(unit: str) -> float:
    """Return the factor of a geometrically similar boat by Froude's law: mass scales with length cubed, time with its
    root.
    """
    kg, m, s = DIMENSIONS[unit]
    return float(LENGTH ** (3 * kg + m + s / 2))


@pytest.mark.parametrize("name", catalogue())
def test_scaled_effect_has_the_factor_of_its_dimension(name: str) -> None:
    effect = catalogue()[name]
    large = scale_priors(effect, COPY)
    for p, q in zip(effect.parameters, large.parameters, strict=True):
        factor = 1.0 if p.name in OTHERS else froude(p.unit)
        assert p.prior is not None
        assert q.prior == pytest.approx(tuple(factor * z for z in p.prior)), p.name
        assert (q.value, q.step) == pytest.approx((factor * p.value, factor * p.step)), p.name
        assert q.bounds == pytest.approx(tuple(factor * z for z in p.bounds)), p.name
        tried = effect.scan.get(p.name, ())
        assert large.scan.get(p.name, ()) == pytest.approx(tuple(factor * z for z in tried)), p.name
    for original, scaled in zip(effect.states, large.states, strict=True):
        for before, after in ((original.sd0, scaled.sd0), (original.noise, scaled.noise), (original.x0, scaled.x0)):
            factor = 1.0 if isinstance(before, str) else froude(original.unit)
            assert after == (before if isinstance(before, str) else pytest.approx(factor * before)), original.name


@pytest.mark.parametrize("name", catalogue())
def test_effects_of_the_reference_boat_are_unchanged(name: str) -> None:
    assert scale_priors(catalogue()[name], size_of(horizontal_model())) == catalogue()[name]


@pytest.mark.parametrize(
    "name",
    [n for n, e in catalogue().items() if "bench" not in e.requires and not OTHERS & {p.name for p in e.parameters}],
)
def test_scaled_model_moves_similarly(name: str) -> None:
    """This checks the units against the use of the parameters: N_delta [kg] belongs to a moment. The lag of the shafts
    belongs to the motors, and does not scale.
    """
    rng, effect = np.random.default_rng(1), catalogue()[name]
    small = carrier(effect) + effect
    moved = {p.name: 0.5 * p.prior[1] for p in effect.parameters if p.prior and p.transform != "log"}
    small = small.with_values({n: min(z, small.parameter(n).bounds[1]) for n, z in moved.items()})
    sizes = np.array([COPY.of(p.unit) for p in small.parameters])
    values = np.array([p.value for p in small.parameters])
    x = np.array([0.3 + 1.2 * rng.random(len(small.states))])
    u = np.array([0.3 + 0.6 * rng.random(len(small.inputs))])
    of_state = np.array([COPY.of(s.unit) for s in small.states])
    of_input = np.array([COPY.of(i.unit) for i in small.inputs])
    moving = [k for k, s in enumerate(small.states) if s.name not in ("n_left", "n_right")]
    evaluate = VectorisedModel(small)
    rates = evaluate(x, u, values)[:, moving]
    copied = evaluate(x * of_state, u * of_input, sizes * values)[:, moving]
    assert copied == pytest.approx(rates * of_state[moving] / COPY.of("s"), rel=0.03, abs=1e-6)


@pytest.mark.parametrize("propulsion", ["shaft", "force"])
def test_input_response_scales_with_the_thrust_once(propulsion: str) -> None:
    """A drive in newtons already has the size of the boat. Its coefficients are shares and arms, and its states are
    thrusts.
    """
    drive = LENGTH**3 if propulsion == "force" else 1.0
    for effect in input_response_effects(horizontal_model(propulsion)):  # type: ignore[arg-type]
        assert effect.curve is not None
        large = scale_priors(effect, COPY)
        of_force = {"X": LENGTH**3, "N": LENGTH**4}[effect.curve.force]
        for p, q in zip(effect.parameters, large.parameters, strict=True):
            if p.unit != "Hz":
                assert (q.prior or (0, 0))[1] * drive == pytest.approx(of_force * (p.prior or (0, 0))[1])
        assert [s.sd0 for s in large.states] == pytest.approx([drive * float(s.sd0) for s in effect.states])


def test_product_curves_have_the_unit_of_their_coefficient() -> None:
    model = nominal_model(horizontal_model())
    wanted = {
        ("X", "u", "v"): "kg/m",
        ("X", "u", "r"): "kg",
        ("N", "u", "v"): "kg",
        ("N", "u", "r"): "kg m",
        ("N", "v", "r"): "kg m",
    }
    for (force, first, second), unit in wanted.items():
        effect = nonparametric_effect(model, ForceCurve(force, first, second), (-1.0, 1.0))
        assert {p.unit for p in effect.parameters} == {unit}
        assert dimension(unit) == DIMENSIONS[unit]
    reading = nonparametric_effect(model, ForceCurve("r", "r"), (-1.0, 1.0))
    changed = scale_priors(reading, COPY).parameters
    assert changed == reading.parameters  # The errors of a gyro do not depend on the boat.


def test_size_of_a_boat_is_its_mass_and_radius_of_gyration() -> None:
    assert size_of(horizontal_model()) == VesselScale()
    ship = horizontal_model().with_values({"m_u": 37.0 * 8.0, "m_r": 9.69 * 32.0})
    assert astuple(size_of(ship)) == pytest.approx((8.0, 2.0))


def test_units_of_diffusions_and_ratios_are_parsed() -> None:
    assert dimension("m/s/sqrt(s)") == (0.0, 1.0, -1.5)
    assert dimension("kg m2/(N m)") == (0.0, 0.0, 2.0)
    assert dimension("V") == (0.0, 0.0, 0.0)


def test_rescaling_is_idempotent() -> None:
    model = nominal_model(horizontal_model())
    once = rescale(model, VesselScale(8.0, 30.0))
    assert rescale(once, VesselScale(8.0, 30.0)) == once
    assert once.parameter("q_N").value == pytest.approx(8 * 30 * model.parameter("q_N").value, rel=1e-9)


def _scores(scale: float) -> tuple[dict[str, Score], float]:
    """Return the scores of a boat with a yaw bias, with all forces multiplied by ``scale``, and its fitted surge
    mass.
    """
    found = channels_of(sail(boat_with("yaw-bias", 1), 200.0, 101)[0])
    for side in ("left", "right"):
        n = found.pop(f"n_{side}")
        found[f"f_{side}"] = Channel(n.t, scale * (40.05 * n.value * abs(n.value) + 1.11 * n.value**2))
    run, full = LogSegment("run", found), nominal_model(horizontal_model("force"))
    wanted = {n: e for n, e in catalogue().items() if n in ("yaw-bias", "lift", "lever-arm", "coulomb")}
    everything, kept = with_all_candidates(full, wanted, [run])
    rows = [make_record(everything, run, 10.0)]
    fitted = fit_with_rescaling(full, rows, ())
    size = size_of(fitted.fit.model)
    scores, _ = score_all(fitted, rows, {n: scale_priors(e, size) for n, e in kept.items()})
    return {s.name: s for s in scores}, fitted.fit.model.values["m_u"]


def test_priors_of_effects_follow_the_size_that_was_found() -> None:
    given = catalogue()["wind"].parameters[0]
    wind = replace(
        catalogue()["wind"],
        parameters=(given.known(2.0, 0.5, ParameterOrigin.PRIOR), *catalogue()["wind"].parameters[1:]),
    )
    small = VesselScale(8.0 / 37.0, 0.6)
    found = rescale_effects(horizontal_model("shaft") + wind, VesselScale(), small)
    expected = scale_priors(catalogue()["wind"], small)
    for p in expected.parameters[1:]:
        assert found.parameter(p.name).prior == pytest.approx(p.prior), p.name
    assert found.parameter("F_wx").prior == (2.0, 0.5)
    assert found.parameter("F_wy").prior[1] == pytest.approx(15.0 * small.of("N"))  # type: ignore[index]
    again = rescale_effects(found, small, VesselScale())
    assert again.parameter("k_air").prior == pytest.approx(catalogue()["wind"].parameters[-1].prior)
    assert again.parameter("m_u") == horizontal_model("shaft").parameter("m_u")


def test_fit_of_a_small_boat_scales_the_priors_of_requested_effects() -> None:
    """The size of the boat is unknown before its first fit."""
    channels = channels_of(sail(boat_with("wind", 1), 100.0, 101)[0])
    for side in ("left", "right"):
        n = channels.pop(f"n_{side}")
        channels[f"f_{side}"] = Channel(n.t, 0.2 * (40.05 * n.value * abs(n.value) + 1.11 * n.value**2))
    model = nominal_model(horizontal_model("force") + catalogue()["wind"])
    fitted = fit_with_rescaling(model, [make_record(model, LogSegment("run", channels), 5.0)], ())
    size = size_of(fitted.fit.model)
    assert size.mass == pytest.approx(0.2, rel=0.4)
    prior = fitted.fit.model.parameter("F_wy").prior
    assert prior is not None
    assert prior[1] == pytest.approx(15.0 * size.of("N"), rel=0.3)


@pytest.mark.study
def test_scores_are_independent_of_the_size_of_the_boat() -> None:
    """The size of the large boat is unknown: its fit starts from the masses of the small boat."""
    (small, m_small), (large, m_large) = _scores(1.0), _scores(FERRY)
    assert m_large == pytest.approx(FERRY * m_small, rel=0.01)
    assert small["yaw-bias"].lm > 5
    for name in ("yaw-bias", "lift", "lever-arm", "coulomb", "N(u)"):
        assert large[name].lm == pytest.approx(small[name].lm, rel=0.05, abs=0.3), name
    # The threshold covers all tests that were made. A scanned candidate has several tests.
    once = [score_threshold(s, list(small.values())) for s in small.values()]
    made = [s.threshold for s in small.values()]
    assert all(a >= b for a, b in zip(made, once, strict=True))
    assert max(a - b for a, b in zip(made, once, strict=True)) > 0.1
