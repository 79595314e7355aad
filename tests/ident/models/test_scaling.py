"""A ferry is diagnosed like a dinghy: priors, steps and disturbance forces go with the size of the boat."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, LogSegment, make_record
from seatrial.ident.diagnosis.score_test import Score, score_threshold
from seatrial.ident.diagnosis.search import score_all
from seatrial.ident.effects.nonparametric import input_response_effects, nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import fit_with_rescaling, nominal_model, with_all_candidates
from seatrial.ident.model.structure import ForceCurve
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.scaling import VesselScale, dimension, rescale, scale_priors, size_of
from tests.ident.carriers import carrier
from tests.missions import boat_with, channels_of, sail

FERRY = 50.0  # times the mass, inertia, damping and thrust


# Exponents of kg, m and s by hand, of every unit in the catalogue; a radian is none.
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
# What is not the boat's: of a sensor, a link, a shaft, a bench, the water
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
    "T_r",
    "T_uv",
    "tau_gnss",
    "V_dx",
    "V_dy",
    "f_wave",
}
LENGTH = 4.0  # times that of the catalogue's boat
COPY = VesselScale(LENGTH**3, LENGTH)


def froude(unit: str) -> float:
    """The factor of a geometrically similar copy that moves by Froude's law: mass with the cube of its length, time
    with the root."""
    kg, m, s = DIMENSIONS[unit]
    return float(LENGTH ** (3 * kg + m + s / 2))


@pytest.mark.parametrize("name", catalogue())
def test_a_copy_of_another_length_has_the_factor_of_its_dimension(name: str) -> None:
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
    for one, other in zip(effect.states, large.states, strict=True):
        for before, after in ((one.sd0, other.sd0), (one.noise, other.noise), (one.x0, other.x0)):
            factor = 1.0 if isinstance(before, str) else froude(one.unit)
            assert after == (before if isinstance(before, str) else pytest.approx(factor * before)), one.name


@pytest.mark.parametrize("name", catalogue())
def test_the_catalogues_boat_keeps_every_number(name: str) -> None:
    assert scale_priors(catalogue()[name], size_of(horizontal_model())) == catalogue()[name]


@pytest.mark.parametrize(
    "name",
    [n for n, e in catalogue().items() if "bench" not in e.requires and not OTHERS & {p.name for p in e.parameters}],
)
def test_a_copy_moves_like_the_boat(name: str) -> None:
    """So the units are those of what the effects do with their parameters: N_delta [kg] is of a moment."""
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
    n, evaluate = len(small.states), VectorisedModel(small)
    rates = evaluate(x, u, values)[:, :n]
    copied = evaluate(x * of_state, u * of_input, sizes * values)[:, :n]
    assert copied == pytest.approx(rates * of_state / COPY.of("s"), rel=0.03, abs=1e-6)


@pytest.mark.parametrize("propulsion", ["shaft", "force"])
def test_the_response_to_an_input_has_its_thrust_once(propulsion: str) -> None:
    """A drive in newtons is as large as the boat: its coefficients are shares and arms, its states thrusts."""
    drive = LENGTH**3 if propulsion == "force" else 1.0
    for effect in input_response_effects(horizontal_model(propulsion)):  # type: ignore[arg-type]
        assert effect.curve is not None
        large = scale_priors(effect, COPY)
        of_force = {"X": LENGTH**3, "N": LENGTH**4}[effect.curve.force]
        for p, q in zip(effect.parameters, large.parameters, strict=True):
            if p.unit != "Hz":
                assert (q.prior or (0, 0))[1] * drive == pytest.approx(of_force * (p.prior or (0, 0))[1])
        assert [s.sd0 for s in large.states] == pytest.approx([drive * float(s.sd0) for s in effect.states])


def test_products_have_the_unit_of_their_coefficient() -> None:
    model = nominal_model(horizontal_model())
    wanted = {
        ("X", "u", "v"): "kg/m",
        ("X", "u", "r"): "kg",
        ("N", "u", "v"): "kg",
        ("N", "u", "r"): "kg m",
        ("N", "v", "r"): "kg m",
    }
    for (force, one, other), unit in wanted.items():
        effect = nonparametric_effect(model, ForceCurve(force, one, other), (-1.0, 1.0))
        assert {p.unit for p in effect.parameters} == {unit}
        assert dimension(unit) == DIMENSIONS[unit]
    reading = nonparametric_effect(model, ForceCurve("r", "r"), (-1.0, 1.0))
    changed = scale_priors(reading, COPY).parameters
    assert changed == reading.parameters  # the errors of a gyro do not know on which boat it is


def test_the_size_of_a_boat_is_its_mass_and_its_radius_of_gyration() -> None:
    assert size_of(horizontal_model()) == VesselScale()
    ship = horizontal_model().with_values({"m_u": 37.0 * 8.0, "m_r": 9.69 * 32.0})
    assert astuple(size_of(ship)) == pytest.approx((8.0, 2.0))


def test_units_of_diffusions_and_of_ratios_are_read() -> None:
    assert dimension("m/s/sqrt(s)") == (0.0, 1.0, -1.5)
    assert dimension("kg m2/(N m)") == (0.0, 0.0, 2.0)
    assert dimension("V") == (0.0, 0.0, 0.0)


def test_resizing_twice_is_resizing_once() -> None:
    model = nominal_model(horizontal_model())
    once = rescale(model, VesselScale(8.0, 30.0))
    assert rescale(once, VesselScale(8.0, 30.0)) == once
    assert once.parameter("q_N").value == pytest.approx(8 * 30 * model.parameter("q_N").value, rel=1e-9)


def _scores(scale: float) -> tuple[dict[str, Score], float]:
    """Scores of a boat with a yaw bias whose every force is ``scale`` times as large, and its fitted surge mass."""
    found = channels_of(sail(boat_with("yaw-bias", 1), 200.0, 101)[0])
    for side in ("left", "right"):
        n = found.pop(f"n_{side}")
        found[f"f_{side}"] = Channel(n.t, scale * (40.05 * n.value * abs(n.value) + 1.11 * n.value**2))
    run, full = LogSegment("run", found), nominal_model(horizontal_model("force"))
    wanted = {n: e for n, e in catalogue().items() if n in ("yaw-bias", "lift", "lever-arm", "coulomb")}
    everything, kept = with_all_candidates(full, wanted, [run])
    rows = [make_record(everything, run, 10.0)]
    stage = fit_with_rescaling(full, rows, ())
    size = size_of(stage.fit.model)
    scores, _ = score_all(stage, rows, {n: scale_priors(e, size) for n, e in kept.items()})
    return {s.name: s for s in scores}, stage.fit.model.values["m_u"]


@pytest.mark.study
def test_the_scores_do_not_depend_on_the_size_of_the_boat() -> None:
    """The ferry is not announced: the fit starts from the dinghy's masses."""
    (small, m_small), (large, m_large) = _scores(1.0), _scores(FERRY)
    assert m_large == pytest.approx(FERRY * m_small, rel=0.01)
    assert small["yaw-bias"].lm > 5
    for name in ("yaw-bias", "lift", "lever-arm", "coulomb", "N(u)"):
        assert large[name].lm == pytest.approx(small[name].lm, rel=0.05, abs=0.3), name
    # the threshold is that of all tests that were made, of which a scanned candidate has several
    once = [score_threshold(s, list(small.values())) for s in small.values()]
    made = [s.threshold for s in small.values()]
    assert all(a >= b for a, b in zip(made, once, strict=True))
    assert max(a - b for a, b in zip(made, once, strict=True)) > 0.1
