"""Tests of the attribution of found effects: remaining scores, nonparametric effects and competing models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import ArrayLike
from rich.console import Console

from seatrial.ident.diagnosis.adequacy import (
    AttributionEvidence,
    assess_alternatives,
    depends_on_remaining_tests,
    with_excluded,
)
from seatrial.ident.diagnosis.findings import (
    Diagnosis,
    EffectAttribution,
    EffectImportance,
    Refit,
    Round,
    UntestedCandidate,
)
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.standard_errors import AT_BOUND
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Effect, EffectPrior, ForceCurve
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.scaling import effect_for
from seatrial.ident.numerics import Array
from seatrial.ident.report.page import write_report
from seatrial.ident.report.terminal import print_result
from seatrial.ident.results.diagnosis import in_words
from seatrial.ident.results.tables import effect_parameter_rows
from seatrial.ident.validation.prediction_errors import ChannelChange, PredictionChange
from tests.ident.pages import loaded
from tests.ident.report_example import diagnosis
from tests.ident.unlisted import kind_of

N = 4000  # Number of rows.
UNSCALED = SimpleNamespace(values={}, inputs=())  # A model without thrust coefficients.


def refit(name: str, criterion: float, t: float = 5.0, fit: object = None, **more: Any) -> Refit:
    """Return a refit with an effect of this name. Fields that the attribution does not read are left out."""
    effect = Effect(name, name.replace("-", " "), {}, **kind_of(name), **more)
    fitted = SimpleNamespace(fit=fit or SimpleNamespace(names=(), flags=()))
    return Refit(effect, cast(Any, fitted), criterion + 8.3, 1, criterion, 50.0, t)


def a_fit(
    names: Sequence[str], values: ArrayLike, covariance: Array, model: object = UNSCALED, flags: object = ()
) -> Any:
    """Return a stand-in for a fit with the given estimates, without data."""
    found, errors = np.asarray(values), np.sqrt(np.diag(covariance))

    def estimate(name: str, record: int = 0) -> tuple[float, float]:
        i = names.index(name if name in names else f"{name}@{record}")
        return float(found[i]), float(errors[i])

    return SimpleNamespace(
        names=tuple(names),
        values=found,
        errors=errors,
        covariance=covariance,
        flags=flags,
        model=model,
        estimate=estimate,
    )


def one_round(chosen: Refit, *others: Refit) -> Round:
    return Round((), (), (chosen, *others), chosen)


def score(name: str, criterion: float) -> Score:
    return Score(name, criterion + 8.294, 1, 20.0, {}, {}, **kind_of(name))


def attributions_of(
    *rounds: Round, left: tuple[Score, ...] = (), untested: tuple[str, ...] = ()
) -> tuple[EffectAttribution, ...]:
    return assess_alternatives(rounds, AttributionEvidence(left, N, untested))


def test_effect_that_leaves_no_unexplained_score_is_identified() -> None:
    (found,) = attributions_of(one_round(refit("wind", 800.0), refit("heading-moment", 300.0)))
    assert found == EffectAttribution("wind", "identified")


def test_larger_form_of_an_effect_competes_only_if_it_explains_more() -> None:
    """A nesting effect explains at least as much. It counts only if its further parameters pay for their number."""
    chosen = refit("steady-pull", 1500.0)
    (near,) = attributions_of(one_round(chosen, refit("mooring", 1490.0, nests=("steady-pull",))))
    (stranger,) = attributions_of(one_round(chosen, refit("mooring", 1490.0)))
    (better,) = attributions_of(one_round(chosen, refit("mooring", 1510.0, nests=("steady-pull",))))
    assert near == EffectAttribution("steady-pull", "identified")
    assert stranger.not_excluded == better.not_excluded == ("mooring",)


@pytest.mark.parametrize(
    ("criterion", "nests", "attribution"),
    [(660.0, ("mismatch",), "identified"), (720.0, ("mismatch",), "ambiguous"), (660.0, (), "ambiguous")],
)
def test_larger_form_that_explains_no_more_is_no_reason_though_its_test_passes(
    criterion: float, nests: tuple[str, ...], attribution: str
) -> None:
    """Its test shows that the thrust varies during a run; the difference of the thrusters is there all the same."""
    fouling = refit("fouling", criterion, nests=nests)
    mismatch = refit("mismatch", 700.0, alternatives=("fouling",))
    left = (score("fouling", 12.0),)
    first, _ = attributions_of(one_round(mismatch, fouling), one_round(refit("battery-sag", 140.0)), left=left)
    assert first.attribution == attribution


@pytest.mark.parametrize(
    ("worth", "attribution"),
    [
        (DEFAULT_POLICY.max_remaining_criterion - 1, "identified"),
        (DEFAULT_POLICY.max_remaining_criterion + 1, "ambiguous"),
    ],
)
def test_remaining_score_makes_an_effect_ambiguous_above_a_threshold(worth: float, attribution: str) -> None:
    (found,) = attributions_of(one_round(refit("lever-arm", 500.0)), left=(score("N(u, r)", worth),))
    assert found.attribution == attribution
    if found.reasons:
        assert found.reasons == (
            "even with it in the model, the score tests still find that N depends on u and r (expected ΔBIC 21), which "
            "may be the true cause",
        )


def test_effect_that_keeps_its_size_stays_identified_despite_remaining_scores() -> None:
    left = (*(score(f"other-{k}", 60.0) for k in range(9)), score("yaw-bias", 58.0))
    mismatch = refit("mismatch", 700.0, alternatives=("yaw-bias",))
    rounds = (one_round(mismatch), one_round(refit("wind", 140.0)))
    assert {a.attribution for a in attributions_of(*rounds, left=left)} == {"ambiguous"}
    evidence = AttributionEvidence(
        left, N, unaffected=frozenset({"mismatch"}), beside=frozenset({"other-0", "other-1", "yaw-bias"})
    )
    first, second = assess_alternatives(rounds, evidence)
    assert first == EffectAttribution("mismatch", "identified")
    assert second.attribution == "ambiguous"
    # An alternative that was not fitted beside the effect may still be there in its place.
    (first, _) = assess_alternatives(rounds, replace(evidence, beside=frozenset({"other-0"})))
    assert first.reasons == (
        "even with it in the model, the score tests still find a constant or speed-dependent yaw moment ('yaw-bias'), "
        "which acts in a similar way",
    )


def test_a_fit_beside_remaining_candidates_is_needed_only_if_it_can_change_the_attribution() -> None:
    left = tuple(score(f"other-{k}", 60.0) for k in range(9))
    rounds = (one_round(refit("mismatch", 700.0)),)
    for remaining, reservations, needed in (((), (), False), (left, (), True), (left, ("the fit failed",), False)):
        evidence = AttributionEvidence(remaining, N, reservations=reservations)
        assert depends_on_remaining_tests(rounds, evidence) is needed
        unaffected = replace(evidence, unaffected=frozenset({"mismatch"}))
        changed = [assess_alternatives(rounds, e)[0].attribution for e in (evidence, unaffected)]
        assert (changed[0] != changed[1]) is needed


@pytest.mark.parametrize(
    ("n_left", "ratio", "t", "attribution"),
    [
        (9, 1.25, 5.0, "identified"),
        (9, 1.15, 5.0, "ambiguous"),
        (9, 1.25, 1.5, "ambiguous"),
        (6, 1.15, 1.5, "identified"),
    ],
)
def test_an_effect_of_little_importance_is_ambiguous_where_many_tests_pass(
    n_left: int, ratio: float, t: float, attribution: str
) -> None:
    """Several of the effects that the tests still find can together look like it."""
    left = tuple(score(f"other-{k}", 60.0) for k in range(n_left))
    rounds = (one_round(refit("mismatch", 700.0)),)
    kept = frozenset({"mismatch"})
    weight = EffectImportance("mismatch", 700.0, ratio, 90.0, t)
    evidence = AttributionEvidence(left, N, importances=(weight,), unaffected=kept)
    (found,) = assess_alternatives(rounds, evidence)
    assert found.attribution == attribution
    assert bool(found.reasons) == (attribution == "ambiguous")
    # The fit beside the remaining candidates is not made if it cannot change that.
    needed = depends_on_remaining_tests(rounds, replace(evidence, unaffected=frozenset()))
    assert needed == (attribution == "identified")


@pytest.mark.parametrize(
    ("curve", "channel", "high", "attribution"),
    [
        ("psi(n_diff)", "r", 0.5, "identified"),
        ("psi(n_diff)", "r", 0.9, "ambiguous"),
        ("psi(n_diff)", "psi", 0.5, "ambiguous"),
        ("N(n_diff)", "r", 0.5, "ambiguous"),
    ],
)
def test_an_error_of_the_heading_is_no_rival_of_an_effect_that_predicts_the_yaw_rate(
    curve: str, channel: str, high: float, attribution: str
) -> None:
    """The gyro measures the yaw rate, so that an error of the heading cannot make its prediction better."""
    change = ChannelChange(0.4, 0.3, high, 0.05, 0.02)
    weight = EffectImportance(
        "thrust-angle", 200.0, 1.8, 90.0, 5.0, PredictionChange(0.4, 0.3, 0.5, 10.0, {channel: change})
    )
    evidence = AttributionEvidence((score(curve, 240.0),), N, importances=[weight])
    (found,) = assess_alternatives([one_round(refit("thrust-angle", 800.0))], evidence)
    assert found.attribution == attribution


def test_every_alternative_that_is_not_excluded_has_its_reason() -> None:
    """An alternative with a far worse ΔBIC in place of the effect is not excluded if its score test still passes."""
    sag = refit("derating", 700.0, alternatives=("battery-sag", "fouling"))
    rounds = (one_round(sag, refit("battery-sag", 80.0), refit("fouling", 20.0)), one_round(refit("wind", 140.0)))
    found, _ = attributions_of(*rounds, left=(score("fouling", 9.0), score("battery-sag", 8.0)))
    assert found.not_excluded == ("battery-sag", "fouling")
    (reason,) = [r for r in found.reasons if "which act in a similar way" in r]
    assert "('fouling') and the" in reason
    assert "('battery-sag')" in reason


def test_effect_that_keeps_its_size_stays_identified_despite_a_small_curve() -> None:
    rounds = (one_round(refit("yaw-bias", 195.0)), one_round(refit("X(past of n_sum)", 27.0)))
    evidence = AttributionEvidence((), N, unaffected=frozenset({"yaw-bias"}))
    assert assess_alternatives(rounds, evidence)[0].attribution == "identified"
    assert assess_alternatives(rounds, AttributionEvidence((), N))[0].attribution == "ambiguous"
    large = (rounds[0], one_round(refit("X(past of n_sum)", 90.0)))
    assert assess_alternatives(large, evidence)[0].attribution == "ambiguous"


def test_threshold_of_the_remaining_score_grows_with_the_explained_criterion() -> None:
    """A strong effect with an approximate formula may leave a larger remaining score than a weak effect."""
    (strong,) = attributions_of(one_round(refit("lever-arm", 5000.0)), left=(score("accelerometer-tilt", 100.0),))
    (weak,) = attributions_of(one_round(refit("lever-arm", 600.0)), left=(score("accelerometer-tilt", 100.0),))
    assert (strong.attribution, weak.attribution) == ("identified", "ambiguous")


@pytest.mark.parametrize(
    ("n_left", "attribution"),
    [(DEFAULT_POLICY.max_remaining_tests, "identified"), (DEFAULT_POLICY.max_remaining_tests + 1, "ambiguous")],
)
def test_many_small_remaining_scores_make_an_effect_ambiguous(n_left: int, attribution: str) -> None:
    """If a lag is fitted in place of a delay, many tests find a small remaining effect. No test finds a large one."""
    left = tuple(score(f"candidate-{k}", 3.0) for k in range(n_left))
    (found,) = attributions_of(one_round(refit("lag", 4000.0)), left=left)
    assert found.attribution == attribution


@pytest.mark.parametrize(("n_left", "attribution"), [(12, "identified"), (13, "ambiguous")])
def test_number_of_remaining_scores_is_judged_by_the_number_of_tests(n_left: int, attribution: str) -> None:
    left = tuple(score(f"candidate-{k}", 3.0) for k in range(n_left))
    nominal = [score(f"candidate-{k}", 3.0) for k in range(120)]
    evidence = AttributionEvidence(left, N, nominal=nominal)
    (found,) = assess_alternatives([one_round(refit("lag", 4000.0))], evidence)
    assert found.attribution == attribution


def test_nonparametric_effect_added_beside_an_effect_makes_it_ambiguous() -> None:
    wind, table = attributions_of(one_round(refit("heading-moment", 700.0)), one_round(refit("unknown Y(psi)", 1000.0)))
    assert (wind.attribution, table.attribution) == ("ambiguous", "nonparametric")
    assert "it is not enough alone: unknown Y(psi) had to be added too" in wind.reasons


def test_validated_nonparametric_effect_that_explains_more_makes_an_effect_ambiguous() -> None:
    (doubted,) = attributions_of(one_round(refit("dead-band", 110.0), refit("unknown N(n_diff)", 150.0)))
    (kept,) = attributions_of(one_round(refit("dead-band", 110.0), refit("unknown N(n_diff)", 150.0, t=1.0)))
    assert (doubted.attribution, kept.attribution) == ("ambiguous", "identified")


def test_competing_models_with_a_close_criterion_are_listed() -> None:
    (found,) = attributions_of(
        one_round(refit("delay", 400.0), refit("lag", 385.0), refit("filter-lag", 395.0), refit("lift", 9.0))
    )
    assert found.attribution == "ambiguous"
    assert found.not_excluded == ("filter-lag", "lag")
    assert found.reasons == ("filter lag explains the data nearly as well (its ΔBIC is 5 worse)",)
    assert found.competitor == "filter-lag"


def test_a_competing_model_close_in_its_share_is_compared_by_its_share() -> None:
    (found,) = attributions_of(one_round(refit("thrust-angle", 1250.0), refit("propeller-walk", 1203.0)))
    title = catalogue()["propeller-walk"].title
    share = f"{title} explains 96 % as much (its ΔBIC is 47 worse)"
    assert found.reasons == (f"{share}, and the formula of the right effect may be wrong by as much",)


def test_competing_model_that_fits_better_but_fails_validation_is_reported() -> None:
    for t, better in ((1.0, "no"), (5.0, "not significantly")):
        (found,) = attributions_of(one_round(refit("pendulum", 400.0), refit("compass", 439.0, t=t)))
        gain = "compass explains the estimation data better (its ΔBIC is 39 better)"
        assert found.reasons == (f"{gain}, but predicts the validation data {better} better",)


def test_untested_alternative_is_not_excluded() -> None:
    sag = refit("current-drift", 200.0, alternatives=("wind", "battery-sag"))
    (found,) = attributions_of(one_round(sag), untested=("battery-sag",))
    assert (found.attribution, found.not_excluded) == ("ambiguous", ("battery-sag",))


@pytest.mark.parametrize(
    ("excluded", "names"),
    [
        (("thrust-angle", "propeller-walk"), ("thrust-angle", "propeller-walk")),  # they name mismatch, not it them
        (("yaw-bias", "filter-lag"), ("yaw-bias",)),
        (("filter-lag", "cell-drift"), ()),
    ],
)
def test_an_effect_whose_alternatives_were_left_out_is_no_sure_name(
    excluded: tuple[str, ...], names: tuple[str, ...]
) -> None:
    """A turned thruster was "identified" as a thrust mismatch, because the search had left out the true effect."""
    chosen = replace(refit("mismatch", 200.0), effect=catalogue()["mismatch"])
    before = cast(Any, SimpleNamespace(model=with_disturbances(horizontal_model())))
    sure = EffectAttribution("mismatch", "identified")
    found = Diagnosis(before, before, (one_round(chosen),), (), (), attributions=(sure,))
    judged = with_excluded(found, [catalogue()[n] for n in excluded])
    assert [e.name for e in judged.excluded] == list(excluded)
    (attribution,) = judged.attributions
    assert (attribution.attribution == "ambiguous") == bool(names)
    assert attribution.not_excluded == names
    titles = " and ".join(catalogue()[n].title for n in names)
    assert len(attribution.reasons) == bool(names)
    for reason in attribution.reasons:
        assert reason.startswith(f"{titles}, which act")
        assert reason.endswith(" left out of the search (--exclude)")


def test_alternative_that_the_fitted_parameters_imitate_is_not_excluded() -> None:
    """The estimated asymmetry of the thrust absorbs most of a loss of reverse thrust. The rest of that loss resembles
    other effects.
    """
    linear = refit("thrust-linearity", 90.0, alternatives=("dead-band", "reverse-thrust"))
    hidden = replace(score("reverse-thrust", 5.0), tolerance=4e-4)
    (found,) = assess_alternatives([one_round(linear)], AttributionEvidence((), N, nominal=[hidden]))
    assert (found.attribution, found.not_excluded) == ("ambiguous", ("reverse-thrust",))
    why = (
        "the loss of thrust in reverse ('reverse-thrust') acts in a similar way, and these data cannot test it, "
        "because other parameters of the model take up nearly all of it"
    )
    assert found.reasons == (why,)
    (itself,) = assess_alternatives(
        [one_round(refit("reverse-thrust", 90.0))], AttributionEvidence((), N, nominal=[hidden])
    )
    assert itself.reasons == (
        "other parameters of the model take up nearly all of it, so that these data cannot test it",
    )
    (seen,) = assess_alternatives(
        [one_round(linear)], AttributionEvidence((), N, nominal=[replace(hidden, tolerance=2e-3)])
    )
    assert seen.attribution == "identified"


def test_alternative_whose_refit_failed_is_not_excluded() -> None:
    """Otherwise the second best effect would be called identified."""
    lost = UntestedCandidate(refit("mismatch", 0.0).effect, "tau_b is outside its bounds")
    (found,) = attributions_of(replace(one_round(refit("heading-moment", 300.0)), untested=(lost,)))
    assert found.attribution == "ambiguous"
    assert found.reasons == (
        "mismatch may be the true cause too: it passes the score test, but could not be fitted (tau_b is outside its "
        "bounds)",
    )


@pytest.mark.parametrize(
    ("errors", "attribution"), [((1.3, 1.2), "identified"), ((7.3, 6.3), "ambiguous"), ((np.nan, 1.0), "ambiguous")]
)
def test_tether_with_an_uncertain_anchor_position_is_ambiguous(errors: tuple[float, float], attribution: str) -> None:
    """The track is 12 m long. The true anchor at (40, -30) m is three standard errors away."""
    names, ends = ("k_tether", "x_tether", "y_tether"), ("x_tether", "y_tether")
    fit = a_fit(names, [0.07, 19.6, -15.4], np.diag(np.square([0.006, *errors])))
    parameters = tuple(Parameter(n, 0.0 if n == "k_tether" else 1.0, "m" if n in ends else "kg/m2") for n in names)
    scan = dict.fromkeys(ends, (0.0, 12.0))
    line = refit("tether", 800.0, fit=fit, parameters=parameters, scan=scan, fixed_point=True)
    track = SimpleNamespace(outputs=("psi", "x", "y"), y=np.array([[0.1, -1.4, -5.1], [0.2, 10.3, 8.4], [np.nan] * 3]))
    fitted = cast(Any, SimpleNamespace(fit=fit, records=[track]))
    (found,) = attributions_of(one_round(replace(line, fitted=fitted)))
    assert found.attribution == attribution


@pytest.mark.parametrize("name", [n for n, e in catalogue().items() if e.scan and n != "tether"])
def test_scanned_parameters_other_than_the_anchor_are_not_treated_as_a_position(name: str) -> None:
    """The lever arm of the wind also has the unit metre."""
    effect = catalogue()[name]
    n = len(effect.parameters)
    values = np.array([p.value or 1.0 for p in effect.parameters])
    fit = a_fit(tuple(p.name for p in effect.parameters), values, 0.01 * np.eye(n))
    fitted = cast(Any, SimpleNamespace(fit=fit, records=[]))
    (found,) = attributions_of(one_round(replace(refit(name, 800.0, fit=fit), effect=effect, fitted=fitted)))
    assert found.attribution == "identified"


@pytest.mark.parametrize(("x_walk", "attribution"), [(-0.9, "identified"), (-1.62, "ambiguous")])
def test_propellers_far_behind_the_boat_are_no_sure_name(x_walk: float, attribution: str) -> None:
    """On a boat of 1.8 m with one propeller weak in reverse, propellers 1.6 m behind the origin fitted best."""
    effect = catalogue()["propeller-walk"]
    fit = a_fit(
        tuple(p.name for p in effect.parameters), [-0.09, -0.002, x_walk], np.diag(np.square([0.01, 0.01, 0.33]))
    )
    fitted = cast(Any, SimpleNamespace(fit=fit, records=[]))
    (found,) = attributions_of(one_round(replace(refit(effect.name, 800.0, fit=fit), effect=effect, fitted=fitted)))
    assert found.attribution == attribution
    if found.reasons:
        assert "x_walk (position of the propellers ahead of the origin) is -1.62 ± 0.33 m" in found.reasons[0]


def test_propellers_far_from_their_given_position_are_no_sure_name() -> None:
    model = replace(horizontal_model(), effect_priors=(EffectPrior("x_walk", -0.5, 0.05, "rig"),))
    effect = effect_for(model, catalogue()["propeller-walk"])
    errors = np.diag(np.square([0.01, 0.01, 0.05]))
    fit = a_fit(tuple(p.name for p in effect.parameters), [-0.09, -0.002, -0.9], errors)
    fitted = cast(Any, SimpleNamespace(fit=fit, records=[]))
    (found,) = attributions_of(one_round(replace(refit(effect.name, 800.0, fit=fit), effect=effect, fitted=fitted)))
    assert found.attribution == "ambiguous"
    assert "is -0.90 ± 0.05 m, which is far from the given position (-0.50 ± 0.05 m)" in found.reasons[0]


@pytest.mark.parametrize(("error", "attribution"), [(1.3, "identified"), (1.003, "ambiguous")])
def test_effect_without_influence_on_the_prediction_is_ambiguous(error: float, attribution: str) -> None:
    """An elastic tether is fitted as a drifting current: the likelihood rises by thousands, but the prediction does not
    improve.
    """
    unchanged = PredictionChange(0.99, 0.9, 1.1, 10.0, {})
    weight = EffectImportance("current-drift", 4000.0, error, 300.0, 9.0, unchanged)
    (found,) = assess_alternatives(
        [one_round(refit("current-drift", 4000.0))], AttributionEvidence((), N, importances=[weight])
    )
    assert found.attribution == attribution


@pytest.mark.parametrize(("error", "ratio"), [(1.2, 0.95), (1.05, 0.8), (1.1, 0.9)])
def test_small_effect_is_not_identified_beside_common_errors(error: float, ratio: float) -> None:
    """Either ratio of the errors may reach 1.15: that by inputs alone, or that over the horizon."""
    beside = replace(DEFAULT_POLICY, min_identified_ratio=DEFAULT_POLICY.min_identified_ratio_beside)
    weight = EffectImportance(
        "bank", 200.0, error, 90.0, 5.0, PredictionChange(ratio, ratio - 0.04, ratio + 0.04, 10.0, {})
    )
    evidence = AttributionEvidence((), N, importances=[weight])
    (found,) = assess_alternatives([one_round(refit("bank", 800.0))], evidence, beside)
    assert (found.attribution == "identified") == (max(error, 1 / ratio) >= 1.15)
    (alone,) = assess_alternatives([one_round(refit("bank", 800.0))], evidence)
    assert alone.attribution == "identified"
    if found.reasons:
        assert "only 11 % larger" in found.reasons[0]


@pytest.mark.parametrize(("error", "attribution"), [(1.2, "identified"), (1.1, "ambiguous")])
def test_form_of_the_hull_is_identified_only_if_the_prediction_is_much_better(error: float, attribution: str) -> None:
    """No hull has exactly the drag terms of the model, so a small difference is no missing effect."""
    weight = EffectImportance("lift", 200.0, error, 90.0, 5.0, PredictionChange(0.94, 0.72, 1.24, 10.0, {}))
    (found,) = assess_alternatives([one_round(refit("lift", 800.0))], AttributionEvidence((), N, importances=[weight]))
    assert found.attribution == attribution


@pytest.mark.parametrize(("high", "attribution"), [(1.24, "ambiguous"), (0.98, "identified")])
def test_form_of_the_hull_beside_common_errors_has_to_improve_the_prediction(high: float, attribution: str) -> None:
    """By inputs alone the error is 20 % larger without the effect, but over the horizon it may be the same."""
    beside = replace(DEFAULT_POLICY, min_identified_ratio=DEFAULT_POLICY.min_identified_ratio_beside)
    weight = EffectImportance("lift", 200.0, 1.2, 90.0, 5.0, PredictionChange(0.85, 0.7, high, 10.0, {}))
    evidence = AttributionEvidence((), N, importances=[weight])
    (found,) = assess_alternatives([one_round(refit("lift", 800.0))], evidence, beside)
    assert found.attribution == attribution
    if found.reasons:
        assert found.reasons == ("the prediction 10 s ahead is no better with this effect",)


@pytest.mark.parametrize(("high", "n_left"), [(1.75, 9), (0.9, 9), (1.75, 0)])
def test_a_change_of_the_prediction_that_is_not_significant_is_told_of_an_ambiguous_effect(
    high: float, n_left: int
) -> None:
    """It does not make the name ambiguous alone."""
    left = tuple(score(f"other-{k}", 60.0) for k in range(n_left))
    weight = EffectImportance("wind", 200.0, 1.3, 90.0, 5.0, PredictionChange(0.85, 0.41, high, 10.0, {}))
    evidence = AttributionEvidence(left, N, importances=[weight])
    (found,) = assess_alternatives([one_round(refit("wind", 800.0))], evidence)
    assert found.attribution == ("ambiguous" if n_left else "identified")
    told = "with it the error 10 s ahead is not significantly smaller (-15 %, 95 %: -59 to +75 %)" in found.reasons
    assert told is (high > 1.0 and n_left > 0)


def test_effect_with_unknown_importance_is_ambiguous() -> None:
    weight = EffectImportance("wind", float("nan"), float("nan"), untested="x0")
    (found,) = assess_alternatives([one_round(refit("wind", 800.0))], AttributionEvidence((), N, importances=[weight]))
    assert found.attribution == "ambiguous"
    assert found.reasons == ("the prediction without this effect could not be tested: x0",)


def test_reservation_about_the_data_makes_every_effect_ambiguous() -> None:
    short = "the estimation data are short (60 s)"
    (found,) = assess_alternatives([one_round(refit("wind", 800.0))], AttributionEvidence((), N, reservations=[short]))
    assert (found.attribution, found.reasons) == ("ambiguous", (short,))


def test_effect_that_only_names_a_dependence_stays_identified_beside_a_curve_of_it() -> None:
    moment = refit("heading-moment", 700.0, nonparametric_of=ForceCurve("N", "psi"))
    name, _ = attributions_of(
        one_round(moment), one_round(refit("unknown N(psi)", 200.0)), left=(score("N(psi)", 1.0),)
    )
    assert name == EffectAttribution("heading-moment", "identified")
    doubted, _ = attributions_of(one_round(moment), one_round(refit("unknown Y(psi)", 200.0)))
    assert doubted.attribution == "ambiguous"


def test_effect_that_could_replace_several_effects_is_not_excluded() -> None:
    """A centre of gravity ahead of the origin couples sway and yaw and resists turning, so two other effects fit as
    well.
    """
    pair = (
        one_round(refit("sway-yaw", 670.0, alternatives=("cg-offset", "cross-flow"))),
        one_round(refit("turning-resistance", 80.0, alternatives=("cg-offset",))),
    )
    coupled, turning = attributions_of(*pair, left=(score("cross-flow", -1.0),))
    assert (coupled.attribution, turning.attribution) == ("ambiguous", "identified")
    (alone,) = attributions_of(pair[0], left=(score("cross-flow", -1.0),))
    assert alone.attribution == "identified"


@pytest.mark.parametrize(("criterion", "attribution"), [(172.0, "ambiguous"), (800.0, "identified")])
def test_small_alternative_of_a_strong_effect_is_ambiguous_as_a_correction_of_its_formula(
    criterion: float, attribution: str
) -> None:
    """The true shaft speed follows a different power of the command. Near full command, the difference resembles a
    speed limit.
    """
    curve, limit = attributions_of(
        one_round(refit("speed-curve", 4357.0)),
        one_round(refit("speed-limit", criterion, alternatives=("speed-curve",))),
    )
    assert (curve.attribution, limit.attribution) == ("identified", attribution)
    if limit.reasons:
        assert limit.reasons == ("it is small beside speed curve, and may only correct the formula of that effect",)
    (_, unrelated) = attributions_of(one_round(refit("speed-curve", 4357.0)), one_round(refit("rod-flex", criterion)))
    assert unrelated.attribution == "identified"


@pytest.mark.parametrize(
    ("name", "description"),
    [
        ("N(u, r)", "that N depends on u and r"),
        ("X(past of n_sum)", "that X follows n_sum"),
        ("X(swing after n_sum)", "that X oscillates after n_sum"),
        ("psi(n_diff)", "that the error of psi depends on n_diff"),
        ("F(t)", "that F depends on t"),
        ("n_dot(slip)", "that n_dot depends on slip"),
        ("lag", "a first-order thrust lag behind the shaft ('lag')"),
    ],
)
def test_remaining_score_is_described_in_words(name: str, description: str) -> None:
    (found,) = attributions_of(
        one_round(refit("lever-arm", 500.0)), left=(score(name, DEFAULT_POLICY.max_remaining_criterion + 1),)
    )
    assert found.reasons[0].startswith(
        f"even with it in the model, the score tests still find {description} (expected ΔBIC "
    )
    assert found.competitor == name


def test_two_effects_without_remaining_scores_are_both_identified() -> None:
    assert [
        j.attribution
        for j in attributions_of(one_round(refit("lever-arm", 9000.0)), one_round(refit("yaw-bias", 120.0)))
    ] == [
        "identified",
        "identified",
    ]


def test_caveat_is_shown_below_the_answer(tmp_path: Path) -> None:
    result = diagnosis()
    result["caveat"] = "The name is uncertain: a lag explains nearly as much."
    result["effects"][0] |= {
        "attribution": "ambiguous",
        "reasons": ["a lag explains nearly as much"],
        "not_excluded": ["lag"],
    }
    write_report(loaded(result), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("The name is uncertain: a lag explains nearly as much.") == 1
    rule = "not excluded, by ΔBIC or by the tests with this effect in the model"
    points = ["ambiguous", "a lag explains nearly as much", f"{rule}: lag"]
    places = [page.index(f"<li>{point}</li>") for point in points]
    assert places == sorted(places)
    console = Console(width=80, record=True, file=StringIO())
    print_result(loaded(result), console)
    assert "The name is uncertain: a lag explains nearly as much." in console.export_text()


HUMP = (Parameter("A", 0.0, "N", "height of the hump"), Parameter("w", 0.2, "m/s", "its width"))


@pytest.mark.parametrize(
    ("height", "width", "flags", "reason"),
    [
        (6.0, 0.13, (), None),
        (-6.0, 0.13, (), None),
        (6.0, 1.0, (("w", AT_BOUND),), "its parameter w (its width) is at its bound, 1 m/s, and so no estimate"),
        (6.0, 0.13, (("d_u", AT_BOUND), ("w", "half of its information comes from its prior")), None),
        (-3.1, 0.37, (), "its size is 3.1 standard errors from zero (a sure name needs 4): A = -3.1 ± 1 N"),
    ],
)
def test_effect_whose_parameters_are_at_bounds_or_undetermined_is_ambiguous(
    height: float, width: float, flags: tuple[tuple[str, str], ...], reason: str | None
) -> None:
    """A hump that imitates another resistance has a width at its bound or an undetermined height."""
    fit = a_fit(("d_u", "A", "w"), [9.0, height, width], np.diag([0.01, 1.0, 0.0025]), flags=flags)
    (found,) = attributions_of(one_round(refit("hump", 800.0, fit=fit, parameters=HUMP)))
    assert found.attribution == ("ambiguous" if reason else "identified")
    assert found.reasons == ((reason,) if reason else ())


@pytest.mark.parametrize(("value", "attribution"), [(5.1, "identified"), (-5.1, "ambiguous")])
def test_resistance_that_would_push_the_boat_is_no_sure_name(value: float, attribution: str) -> None:
    """An offset of the centre of gravity forward acts as a negative X_rr: both are forces over r^2 in surge."""
    effect = catalogue()["turning-resistance"]
    model = SimpleNamespace(parameters=effect.parameters, values={}, inputs=())
    fit = a_fit(("X_rr",), [value], np.array([[1.16**2]]), model)
    chosen = replace(refit("turning-resistance", 800.0, fit=fit), effect=effect)
    (found,) = attributions_of(one_round(chosen))
    assert found.attribution == attribution
    title = "an offset of the centre of gravity (x_g, y_g)"
    if attribution == "ambiguous":
        assert found.reasons == (
            f"its sign contradicts this name (X_rr = -5.1 ± 1.2 kg m), and {title} has a similar form",
        )
        assert found.not_excluded == ("cg-offset",)
    told = in_words(effect, SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    contradicts = f", a sign that contradicts this name: {title} has a similar form"
    assert told == ("X_rr = 5 ± 1 kg m" if value > 0 else f"X_rr = -5 ± 1 kg m{contradicts}")


def test_effects_of_a_similar_form_are_in_the_catalogue() -> None:
    for effect in catalogue().values():
        names = {p.name for p in effect.parameters if p.bounds[0] < 0.0}
        assert names >= {*effect.cannot_be_negative}, effect.name
        assert {*effect.alternatives} >= {*effect.cannot_be_negative.values()}, effect.name


def test_parameter_at_its_bound_is_no_finding_in_words() -> None:
    """A share of 0.9 that is the bound of the search is told as a limit, not as an estimate."""
    effect = catalogue()["derating"]
    model = SimpleNamespace(parameters=effect.parameters, values={}, inputs=())
    fit = a_fit(("k_heat", "tau_heat"), [0.9, 16.5], np.diag([np.nan, 1.4**2]), model)
    fit.parameters, fit.records = effect.parameters, ("run1",)
    told = in_words(effect, SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    assert told.endswith("it comes back in the same time")
    fit.flags = (("k_heat", AT_BOUND),)
    told = in_words(effect, SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    assert told.endswith("; k_heat = 0.9 is at the limit of this parameter, and so no estimate")
    silent = in_words(replace(effect, in_words=None), SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    assert silent == "k_heat = 0.9 is at the limit of this parameter, and so no estimate"
    rows = effect_parameter_rows(effect, SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    assert [row.at_bound for row in rows] == [True, False]


def test_size_of_the_battery_loss_is_that_at_the_end_of_the_run_with_the_most_work() -> None:
    effect = catalogue()["battery-sag"]
    model = SimpleNamespace(parameters=effect.parameters, values={}, inputs=effect.inputs)
    fit = a_fit(("beta_E",), [0.2], np.diag([0.02**2]), model)
    fit.parameters, fit.records = effect.parameters, ("run1", "run2")
    runs = [
        SimpleNamespace(record=SimpleNamespace(inputs=("n", "work"), u=np.array([[1, 0.0], [1, w]]))) for w in (0.3, 2)
    ]
    told = in_words(effect, SimpleNamespace(fit=fit, estimation=runs))  # type: ignore[arg-type]
    assert "work of 150 s at full power, the thrust is 40 ± 4 % smaller" in told


def test_caveat_has_no_newtons_if_the_thrust_is_unknown() -> None:
    model = horizontal_model()
    thrust = model.values["c1"] + model.values["c2"]
    free = Parameter("A", 0.0, "N", "height of the hump")
    fit = a_fit(["A"], [0.1 * thrust], np.array([[(0.05 * thrust) ** 2]]), model)
    fit.parameters = (SimpleNamespace(name="A", unit="N", segment=None),)
    (found,) = attributions_of(one_round(refit("hump", 800.0, fit=fit, parameters=(free,))))
    assert found.reasons == ("its size is 2.0 standard errors from zero (a sure name needs 4): A/T = 0.1 ± 0.05",)
    fit.flags = (("A", AT_BOUND),)
    (found,) = attributions_of(one_round(refit("hump", 800.0, fit=fit, parameters=(free,))))
    assert found.reasons == ("its parameter A/T (height of the hump) is at its bound, 0.1, and so no estimate",)


@pytest.mark.parametrize(
    ("sizes", "errors", "correlation", "attribution"),
    [
        ((9.0, 0.1), (1.0, 1.0), 0.0, "identified"),  # The component of a wind across its direction may be zero.
        ((0.5, 0.1), (1.0, 1.0), 0.0, "ambiguous"),
        ((0.5, 9.0), (1.0, np.nan), 0.0, "ambiguous"),  # An estimate without a standard error does not count.
        # The data do not determine the sum, but they determine the difference.
        ((0.5, -0.5), (1.0, 1.0), 0.999, "identified"),
    ],
)
def test_sizes_of_an_effect_are_tested_jointly(
    sizes: tuple[float, float], errors: tuple[float, float], correlation: float, attribution: str
) -> None:
    both = np.array(errors)
    covariance = np.outer(both, both) * np.array([[1.0, correlation], [correlation, 1.0]])
    fit = a_fit(("F_x", "F_y"), sizes, covariance)
    across = (Parameter("F_x", 0.0, "N"), Parameter("F_y", 0.0, "N"))
    (found,) = attributions_of(one_round(refit("wind", 800.0, fit=fit, parameters=across)))
    assert found.attribution == attribution


def test_reason_has_all_sizes_that_it_judges() -> None:
    fit = a_fit(("F_x", "F_y"), (2.0, 2.5), np.eye(2))
    both = (Parameter("F_x", 0.0, "N"), Parameter("F_y", 0.0, "N"))
    (found,) = attributions_of(one_round(refit("wind", 800.0, fit=fit, parameters=both)))
    (reason,) = found.reasons
    assert reason == (
        "its sizes together are 3.2 standard errors from zero (a sure name needs 4): F_x = 2 ± 1 N, F_y = 2.5 ± 1 N"
    )


def test_no_size_is_tested_beside_the_curve_that_contains_the_effect() -> None:
    """Only the sum of the effect and the curve is determined."""
    fit = a_fit(("N_s",), (0.1,), np.eye(1))
    own = {"parameters": (Parameter("N_s", 0.0, "N m"),), "nonparametric_of": ForceCurve("N", "psi")}
    moment = one_round(refit("heading-moment", 800.0, fit=fit, **own))
    assert attributions_of(moment)[0].attribution == "ambiguous"
    curve = one_round(refit("unknown N(psi)", 300.0, fit=fit))
    assert attributions_of(moment, curve)[0].attribution == "identified"
    another = one_round(refit("unknown Y(psi)", 10.0, fit=fit))
    assert attributions_of(moment, another)[0].attribution == "ambiguous"


def test_size_of_a_per_record_parameter_is_tested_like_a_common_parameter() -> None:
    drift = (Parameter("V_dx", 0.0, "m/s^2", "drift", per_record=True),)
    records = SimpleNamespace(records=("a", "b"))
    for values, attribution in (((0.5, -9.0), "identified"), ((0.5, 0.1), "ambiguous")):
        fit = a_fit(("V_dx@0", "V_dx@1"), values, np.eye(2))
        drifting = refit("current-drift", 800.0, fit=fit, parameters=drift)
        fitted = cast(Any, SimpleNamespace(fit=fit, **vars(records)))
        (found,) = attributions_of(one_round(replace(drifting, fitted=fitted)))
        assert found.attribution == attribution
    assert found.reasons == ("the data do not determine its size: V_dx@0 = 0.5 ± 1 m/s^2, V_dx@1 = 0.1 ± 1 m/s^2",)


def test_attribution_uses_the_estimates_of_the_final_model() -> None:
    """A size that was determined in its own round may be undetermined after a later effect was added."""

    def fitted(value: float) -> Any:
        return SimpleNamespace(fit=a_fit(("F",), [value], np.eye(1)))

    wind = refit("wind", 800.0, fit=fitted(6.0).fit, parameters=(Parameter("F", 0.0, "N"),))
    (alone,) = assess_alternatives([one_round(wind)], AttributionEvidence((), N))
    (beside,) = assess_alternatives([one_round(wind)], AttributionEvidence((), N, after=fitted(1.5)))
    assert (alone.attribution, beside.attribution) == ("identified", "ambiguous")


def test_effect_is_ambiguous_if_a_remaining_score_exceeds_its_criterion() -> None:
    large, small = one_round(refit("wind", 30000.0)), one_round(refit("lift", 650.0))
    both = attributions_of(large, small, left=(score("mooring", 700.0),))
    assert [found.attribution for found in both] == ["identified", "ambiguous"]
