"""A ferry is diagnosed like a dinghy: priors, steps and disturbance forces go with the size of the boat."""

from __future__ import annotations

import pytest

from ident.data.record import Channel, LogSegment, make_record
from ident.diagnosis.score_test import Score, score_threshold
from ident.diagnosis.search import score_all
from ident.effects.registry import catalogue
from ident.estimation.fitted_model import fit_with_rescaling, nominal, superset
from ident.models.horizontal import horizontal_model
from ident.models.scaling import VesselScale, rescale, scale_priors, size_of
from tests.missions import boat_with, channels_of, sail

FERRY = 50.0  # times the mass, inertia, damping and thrust


@pytest.mark.parametrize(("unit", "factor"), [
    ("N", 4.0), ("kg/s", 4.0), ("kg s/m2", 4.0), ("N m", 100.0), ("kg m2/s", 100.0), ("kg m", 20.0), ("rad/N", 0.25),
    ("", 1.0), ("m/s", 1.0), ("s", 1.0), ("rad s2/m", 1.0)])
def test_forces_go_with_mass_and_moments_with_inertia(unit: str, factor: float) -> None:
    assert VesselScale(4.0, 100.0).of(unit) == pytest.approx(factor)


def test_an_effect_keeps_what_has_no_force_in_it() -> None:
    large = scale_priors(catalogue()["pendulum"], VesselScale(4.0, 100.0))
    mass, frequency, _ = large.parameters
    assert (mass.prior, mass.step) == ((0.0, 40.0), pytest.approx(0.8))
    assert frequency == catalogue()["pendulum"].parameters[1]


def test_resizing_twice_is_resizing_once() -> None:
    model = nominal(horizontal_model())
    once = rescale(model, VesselScale(8.0, 30.0))
    assert rescale(once, VesselScale(8.0, 30.0)) == once
    assert once.parameter("q_N").value == pytest.approx(30 * model.parameter("q_N").value, rel=1e-9)


def _scores(scale: float) -> tuple[dict[str, Score], float]:
    """Scores of a boat with a yaw bias whose every force is ``scale`` times as large, and its fitted surge mass."""
    found = channels_of(sail(boat_with("yaw-bias", 1), 200.0, 101)[0])
    for side in ("left", "right"):
        n = found.pop(f"n_{side}")
        found[f"f_{side}"] = Channel(n.t, scale * (40.05 * n.value * abs(n.value) + 1.11 * n.value**2))
    run, full = LogSegment("run", found), nominal(horizontal_model("force"))
    wanted = {n: e for n, e in catalogue().items() if n in ("yaw-bias", "lift", "lever-arm", "coulomb")}
    everything, kept = superset(full, wanted, [run])
    rows = [make_record(everything, run, 10.0)]
    stage = fit_with_rescaling(full, rows, ())
    size = size_of(stage.fit.model)
    scores, _ = score_all(stage, rows, {n: scale_priors(e, size) for n, e in kept.items()})
    return {s.name: s for s in scores}, stage.fit.model.values["m_u"]


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
