"""Tests of the search for missing effects: choice, repeated starts, removal, and candidates that cannot be tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs

from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.diagnosis import search
from seatrial.ident.diagnosis.acceptance import is_immaterial, refit_outcome
from seatrial.ident.diagnosis.adequacy import AttributionEvidence, assess_alternatives, reason_without_experiment
from seatrial.ident.diagnosis.common_errors import CommonErrorScore
from seatrial.ident.diagnosis.findings import (
    CommonErrorsFit,
    Diagnosis,
    EffectAttribution,
    EffectImportance,
    Outcome,
    Refit,
    RemovedEffect,
    Round,
    ShortData,
    UntestedCandidate,
    ValidationMismatch,
)
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.diagnosis.search import _Search, _with_initial_values, diagnose, evaluate_diagnosis
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine import LargerModel
from seatrial.ident.estimation import AT_BOUND
from seatrial.ident.estimation.fitted_model import FittedModel, validated_in_blocks
from seatrial.ident.estimation.homogeneity import BETWEEN, ParameterShift
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.model.structure import Effect, EffectKind, EffectPrior, ForceCurve, Input, ModelKind
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.report.sections.answer import effect_card
from seatrial.ident.reporter import QUIET
from seatrial.ident.results import parts
from seatrial.ident.results.diagnosis import (
    GivenModel,
    _blocks_note,
    _command_clause,
    _effect_rows,
    _mismatch_row,
    _notes,
    _quiet_round,
    _size_on_card,
    _two_velocities_sentence,
    _untested_warnings,
    command_without_validation,
    diagnosis_answer,
    diagnosis_caveat,
    reported_mismatches,
    sizes_in_words,
    what_is_lacking,
)
from seatrial.ident.validation.prediction_errors import PredictionChange
from seatrial.mocks.plant.boat import Boat
from tests.missions import boat_with, channels_of, sail

NAN = float("nan")
SAME = PredictionChange(0.99, 0.9, 1.1, 10.0, {})
FELL, ROSE = PredictionChange(0.7, 0.6, 0.8, 10.0, {}), PredictionChange(1.3, 1.2, 1.4, 10.0, {})


def blank(**more: Any) -> Any:
    """Return a stand-in for a fitted model that has only the given fields, and logs of validation."""
    return cast(Any, type("FakeFit", (), {"fit": None, "cross_validated": False, **more})())


def fitted_boat() -> Any:
    """Return a stand-in for a fitted model that has only a fit with a model."""
    return blank(fit=SimpleNamespace(model=with_disturbances(horizontal_model("shaft"))))


def a_search(*candidates: Effect) -> _Search:
    return _Search([], [], {e.name: e for e in candidates}, QUIET)


def refit(name: str, criterion: float, gain: float = 50.0, t: float = 5.0) -> Refit:
    return Refit(Effect(name, name, {}), blank(), criterion + 8.0, 1, criterion, gain, t)


def exactly(by_name: dict[str, PredictionChange | Exception]) -> Any:
    """Return a replacement of the exact refit that gives the listed prediction change or raises the listed error."""

    def exact(_search: _Search, _current: FittedModel, rough: Refit) -> Refit:
        found = by_name.get(rough.effect.name, FELL)
        if isinstance(found, Exception):
            raise found
        exact_refit = replace(rough, prediction=found)
        return replace(exact_refit, outcome=refit_outcome(exact_refit, []))

    return exact


@pytest.mark.parametrize(
    ("by_name", "outcomes", "untested"),
    [
        # Four candidates that fail validation do not block the fifth.
        ({}, [*[Outcome.NOT_VALIDATED] * 4, Outcome.ADDED, Outcome.OUTRANKED], []),
        ({"e": ROSE}, [*[Outcome.NOT_VALIDATED] * 4, Outcome.WORSE_PREDICTION, Outcome.ADDED], []),
        ({"e": ValueError("x0")}, [*[Outcome.NOT_VALIDATED] * 4, Outcome.ADDED], [("e", "x0")]),
        ({"e": ROSE, "f": ROSE}, [*[Outcome.NOT_VALIDATED] * 4, *[Outcome.WORSE_PREDICTION] * 2], []),
    ],
)
def test_best_accepted_candidate_is_chosen(
    monkeypatch: pytest.MonkeyPatch, by_name: Any, outcomes: list[Outcome], untested: list[tuple[str, str]]
) -> None:
    monkeypatch.setattr(_Search, "_fit_exactly", exactly(by_name))
    refused = [refit(name, 1000.0 - k, gain=-5.0, t=-1.0) for k, name in enumerate("abcd")]
    lost: list[UntestedCandidate] = []
    judged, chosen = a_search()._choose_refit(blank(), [refit("f", 90.0), *refused, refit("e", 100.0)], lost)
    assert [r.outcome for r in judged] == outcomes
    added = [r for r in judged if r.outcome is Outcome.ADDED]
    assert [chosen] == (added or [None])
    assert [(u.effect.name, u.reason) for u in lost] == untested


@pytest.mark.parametrize(
    ("behind", "by_name", "chosen"),
    [
        (1.5, {"lift": SAME, "wind": FELL}, "wind"),  # The wind is about as likely and predicts better.
        (1.5, {"lift": FELL, "wind": SAME}, "lift"),
        (1.5, {"lift": SAME, "wind": ValueError("x0")}, "lift"),
        (1.5, {"lift": SAME, "wind": ROSE}, "lift"),
        (2.5, {"lift": SAME, "wind": FELL}, "lift"),  # The wind is less likely.
    ],
)
def test_better_prediction_decides_between_equally_likely_effects(
    monkeypatch: pytest.MonkeyPatch, behind: float, by_name: Any, chosen: str
) -> None:
    monkeypatch.setattr(_Search, "_fit_exactly", exactly(by_name))
    judged, found = a_search()._choose_refit(blank(), [refit("lift", 100.0), refit("wind", 100.0 - behind)], [])
    assert found is not None
    worse = [r.effect.name for r in judged if r.outcome is Outcome.WORSE_PREDICTION]
    assert worse == [name for name, change in by_name.items() if change is ROSE]
    assert [found.effect.name] == [r.effect.name for r in judged if r.outcome is Outcome.ADDED] == [chosen]


@pytest.mark.parametrize("kind", [EffectKind.BETWEEN_RUNS, EffectKind.NONPARAMETRIC])
@pytest.mark.parametrize(
    ("gain", "t", "chosen"), [(400.0, 6.0, "adaptable"), (40.0, 1.4, "wind"), (-40.0, -1.4, "wind")]
)
def test_adaptable_effect_is_chosen_only_if_it_explains_significantly_more(
    monkeypatch: pytest.MonkeyPatch, kind: EffectKind, gain: float, t: float, chosen: str
) -> None:
    """A parameter that differs between runs, and a curve, adapt to any error of the model."""
    monkeypatch.setattr(_Search, "_fit_exactly", exactly({}))
    monkeypatch.setattr(search, "comparison", lambda *_: blank(gain=(gain, t), prediction=SAME))
    adaptable = refit("adaptable", 500.0)
    adaptable = replace(adaptable, effect=replace(adaptable.effect, kind=kind))
    judged, found = a_search()._choose_refit(blank(), [adaptable, refit("lift", 90.0), refit("wind", 100.0)], [])
    assert found is not None
    assert [found.effect.name] == [r.effect.name for r in judged if r.outcome is Outcome.ADDED] == [chosen]
    assert [r.effect.name for r in judged] == ["adaptable", "wind", "lift"]


@pytest.mark.parametrize(
    ("name", "criterion", "chosen"),
    [
        ("fouling", 101.0, f"{BETWEEN}payload"),
        ("fouling", 99.0, "fouling"),
        ("current-drift", 101.0, "current-drift"),  # The current of each run is no property of the boat.
    ],
)
def test_parameter_difference_between_runs_competes_with_an_effect_that_contains_one(
    monkeypatch: pytest.MonkeyPatch, name: str, criterion: float, chosen: str
) -> None:
    """Fouling with a loss in each run describes two runs of different thrust, if its times are at the starts."""
    monkeypatch.setattr(_Search, "_fit_exactly", exactly({}))
    monkeypatch.setattr(search, "comparison", lambda *_: blank(gain=(-40.0, -1.4), prediction=SAME))
    between = refit(f"{BETWEEN}payload", criterion)
    between = replace(between, effect=replace(between.effect, kind=EffectKind.BETWEEN_RUNS))
    own = replace(refit(name, 100.0), effect=catalogue()[name])
    _, found = a_search()._choose_refit(blank(), [between, own], [])
    assert found is not None
    assert found.effect.name == chosen


@pytest.mark.parametrize(
    ("trial", "second", "pair_t", "tried", "kept"),
    [
        (refit("bias", 200.0, gain=8.0, t=0.4), True, 5.0, True, True),
        (refit("bias", 200.0, gain=8.0, t=0.4), False, 5.0, True, False),  # No second effect is accepted.
        (refit("bias", 200.0, gain=8.0, t=0.4), True, 1.5, True, False),  # The pair is not validated.
        (refit("bias", 30.0, gain=8.0, t=0.4), True, 5.0, False, False),  # The effect explains too little.
        (refit("bias", 200.0, gain=-8.0, t=-0.4), True, 5.0, False, False),  # The validation data are against it.
    ],
)
def test_two_effects_that_hide_each_other_are_added_together(
    monkeypatch: pytest.MonkeyPatch, trial: Refit, second: bool, pair_t: float, tried: bool, kept: bool
) -> None:
    wind = replace(refit("wind", 90.0), outcome=Outcome.ADDED)
    asked: list[str] = []

    def exact(_search: _Search, _current: FittedModel, rough: Refit) -> Refit:
        asked.append(rough.effect.name)
        return replace(rough, outcome=Outcome.NOT_VALIDATED)

    score = Score("wind", 100.0, 1, 50.0, {}, {})
    monkeypatch.setattr(_Search, "_fit_exactly", exact)
    monkeypatch.setattr(_Search, "scored", lambda *_: ([score], [score]))
    monkeypatch.setattr(_Search, "_run_round", lambda *_: Round((score,), ("wind",), (wind,), wind if second else None))
    monkeypatch.setattr(search, "Comparison", lambda *_: blank(gain=(40.0, pair_t)))
    mine = a_search(trial.effect, wind.effect)
    trial = replace(trial, outcome=Outcome.NOT_VALIDATED)
    rejected = replace(refit("lift", 90.0, gain=-1.0), outcome=Outcome.NOT_VALIDATED)
    found = mine._look_ahead(blank(), Round((), ("bias",), (trial, rejected), None), 3)
    assert asked == (["bias"] if tried else [])
    assert (found is not None) is kept
    assert ("bias" in mine.candidates) is not kept
    assert mine.rounds == []
    if found is not None:
        first, last = found
        assert first.chosen is not None
        assert (first.chosen.effect.name, first.chosen.outcome) == ("bias", Outcome.ADDED)
        assert first.chosen in first.refits
        assert last.chosen is wind
    # There has to be room for two effects.
    assert mine._look_ahead(blank(), Round((), ("bias",), (trial, rejected), None), 1) is None


def test_candidate_with_a_negative_score_criterion_is_still_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []
    note = lambda _self, _current, pairs, *_: tried.extend(effect.name for effect, _ in pairs)  # noqa: E731
    monkeypatch.setattr(_Search, "_refit_all", note)
    alone = a_search(Effect("compass", "compass", {}))
    alone.n = 5000
    score = Score("compass", 28.0, 4, 20.0, {}, {})
    assert score.criterion(alone.n) < 0
    alone._run_round(fitted_boat(), [score], [score])
    assert tried == ["compass"]


def test_data_too_short_for_the_tests_are_reported() -> None:
    """The block statistic cannot exceed the number of blocks. With too few blocks, no effect of any size passes."""
    scores = [Score("wind", 900.0, df, 5.0, {}, {}, blocks=12) for df in (1, 4, 8)]
    short = search._short_data(scores, blank(records=[blank(duration=60.0)], model=blank(block=5.0)))
    assert short == ShortData(60.0, 105.0, 2, 3)
    answer = diagnosis_answer(
        Diagnosis(blank(), blank(cross_validated=False), (), (), (), short_data=short), None, 10.0
    )
    assert answer == (
        "No effect was found, but 60 s of estimation data are too short to test 2 of 3 candidates: give logs of "
        "105 s or more."
    )
    missed = ValidationMismatch("run 2", "x", 3.0, None)
    answer = diagnosis_answer(
        Diagnosis(blank(), blank(cross_validated=False), (), (), (), short_data=short, mismatches=(missed,)), None, 10.0
    )
    assert answer.endswith("too short to test 2 of 3 candidates: give logs of 105 s or more.")
    assert search._short_data([replace(s, blocks=21) for s in scores], blank()) is None
    assert [scores[k].least_blocks() for k in range(3)] == [7, 14, 21]


@pytest.mark.parametrize("fell", [True, False])
def test_curve_without_a_better_prediction_is_described_as_a_resemblance(fell: bool) -> None:
    curve = Effect("unknown X(u)", "a curve: the force X depends on u", {}, kind=EffectKind.NONPARAMETRIC)
    chosen = Refit(curve, blank(), 90.0, 1, 82.0, 30.0, 4.0)
    found = Diagnosis(
        blank(), blank(cross_validated=False), (Round((), (), (chosen,), chosen),), (), (),
        (EffectAttribution(curve.name, "nonparametric"),), (EffectImportance(curve.name, 90.0, 1.02, 41.2, 5.34),),
    )  # fmt: skip
    change = parts.PredictionChangeRow(
        role="validation", ratio=0.98, low=0.96, high=0.99 if fell else 1.01, verdict="fell" if fell else "unchanged",
        better=(), worse=(),
    )  # fmt: skip
    answer = diagnosis_answer(found, change, 10.0)
    assert answer.startswith("The model lacks a curve" if fell else "The missing effect resembles a curve")
    assert ("falls" in answer) is fell
    beside = replace(found, policy=replace(found.policy, min_identified_ratio=1.15))
    assert diagnosis_answer(beside, change, 10.0).startswith("The missing effect resembles a curve")
    support = "their log-likelihood rises with a curve: the force X depends on u by 41 (t = 5.3)."
    assert (f"One step ahead the validation data support it: {support} Prediction" in answer) is not fell


@pytest.mark.parametrize("first", ["identified", "ambiguous"])
def test_headline_lists_several_ambiguous_effects_as_several(first: str) -> None:
    """One effect that resembles two others would be another claim."""
    names = ("mismatch", "dead-band", "wind")
    chosen = [Refit(Effect(n, f"a {n}", {}), blank(), 90.0, 1, 82.0, 30.0, 4.0) for n in names]
    judged = [EffectAttribution(n, "ambiguous") for n in names]
    judged[0] = EffectAttribution("mismatch", first)  # type: ignore[arg-type]
    found = Diagnosis(
        blank(), blank(fit=blank(flags=())), tuple(Round((), (), (c,), c) for c in chosen), (), (), tuple(judged),
        tuple(EffectImportance(n, 90.0, 1.3, 41.2, 5.34) for n in names),
    )  # fmt: skip
    begin = "The model lacks a mismatch, and effects" if first == "identified" else "The model lacks effects"
    listed = "a dead-band; a wind" if first == "identified" else "a mismatch; a dead-band; a wind"
    assert what_is_lacking(found, fell=True) == f"{begin} that resemble: {listed}"


@pytest.mark.parametrize(("value", "named"), [(0.6, False), (2.5, True)])
@pytest.mark.parametrize("first", [True, False])
def test_curve_without_a_significant_value_is_not_in_the_headline(value: float, named: bool, first: bool) -> None:
    """All values of a curve were within 0.6 standard errors of zero, and the headline said that the model lacks it."""
    own = tuple(Parameter(f"g_{k}", 0.0, "N", "a value of the curve") for k in range(2))
    curve = Effect("unknown X(u)", "a curve of u", {}, parameters=own, kind=EffectKind.NONPARAMETRIC)
    lag = Effect("cell-lag", "a lag", {})
    chosen = [Refit(e, blank(), 90.0, 1, 82.0, 30.0, 4.0) for e in ((curve, lag) if first else (lag, curve))]
    judged = {n: EffectAttribution(n, k) for n, k in ((curve.name, "nonparametric"), (lag.name, "ambiguous"))}  # type: ignore[arg-type]
    fit = blank(flags=(), estimate=lambda _, name: (0.1 if name == "g_0" else -value, 1.0))
    found = Diagnosis(
        blank(), blank(fit=fit), tuple(Round((), (), (c,), c) for c in chosen), (), (),
        tuple(judged[c.effect.name] for c in chosen),
        tuple(EffectImportance(c.effect.name, 90.0, 1.3, 41.2, 5.34) for c in chosen),
    )  # fmt: skip
    said = what_is_lacking(found, fell=True)
    assert ("a curve of u" in said) is named
    assert "a lag" in said
    answer = diagnosis_answer(found, None, 10.0)
    beside = "The model also has a curve of u, but none of its values differs significantly from zero"
    assert (beside in answer) is not named


@pytest.mark.parametrize(
    ("criterion", "rival"),
    [
        (80.0, " or, nearly as well, a thrust-angle"),
        (70.0, ""),
        (120.0, " or a thrust-angle, which explains the estimation data better"),
    ],
)
def test_headline_names_the_rival_that_explains_the_data_as_well(criterion: float, rival: str) -> None:
    chosen, other, curve = (
        Refit(Effect(n, f"a {n}", {}), blank(), 90.0, 1, bic, 30.0, 4.0)
        for n, bic in (("mismatch", 82.0), ("thrust-angle", criterion), ("wind", 81.0))
    )
    judged = EffectAttribution("mismatch", "ambiguous", not_excluded=("wind-shear", "thrust-angle"))
    found = Diagnosis(
        blank(), blank(fit=blank(flags=())), (Round((), (), (other, chosen, curve), chosen),), (), (), (judged,),
        (EffectImportance("mismatch", 90.0, 1.3, 41.2, 5.34),),
    )  # fmt: skip
    begin = "The missing effect resembles a mismatch"
    assert what_is_lacking(found, fell=True) == begin + rival


@pytest.mark.parametrize(("error", "change", "said"), [(0.07, SAME, True), (0.002, SAME, False), (0.07, FELL, False)])
def test_headline_says_that_the_size_of_an_effect_is_not_determined(
    error: float, change: PredictionChange, said: bool
) -> None:
    walk = Effect("walk", "propeller walk", {}, (Parameter("k", 0.0), Parameter("x_walk", -0.8)))
    fit = type("Fit", (), {"estimate": lambda _, name: {"k": (0.006, error)}[name], "flags": ()})()
    fit.model = SimpleNamespace(parameters=())
    chosen = Refit(walk, blank(fit=fit), 90.0, 1, 82.0, 30.0, 4.0)
    found = Diagnosis(
        blank(), blank(fit=fit, cross_validated=False), (Round((), (), (chosen,), chosen),), (), (),
        (EffectAttribution("walk", "ambiguous"),),
        (EffectImportance("walk", 90.0, 1.02, 41.2, 5.34, prediction=change),),
    )  # fmt: skip
    answer = diagnosis_answer(found, None, 10.0)
    assert answer.startswith("The missing effect resembles propeller walk")
    assert ("(its size is not determined)" in answer) is said
    words = replace(walk, in_words=lambda estimates: "6 N to port")
    told = _size_on_card(words, found)
    assert told is not None
    assert told.endswith("6 N to port")
    assert told.startswith("not determined: each part") is said


def test_round_without_a_significant_score_lists_the_tested_candidates() -> None:
    scores = tuple(Score(f"effect{k}", 3.0, 1, 2.0, {}, {}, threshold=12.0) for k in range(40))
    short = ShortData(60.0, 105.0, 3, 40)
    quiet_round = _quiet_round(Diagnosis(blank(), blank(), (), (), (), scores=scores, short_data=short))
    assert (quiet_round.tested, quiet_round.passed, quiet_round.chosen) == (40, 0, None)
    assert len(quiet_round.candidates) > 10
    assert quiet_round.why == "no candidate passes the score tests; 60 s of data are too short to test 3 of 40"


def test_search_that_reached_its_limit_names_the_untried_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """The untried candidates were never refitted, so their importance is unknown."""
    mine, score = a_search(Effect("wind", "wind", {})), Score("wind", 900.0, 1, 50.0, {}, {}, threshold=12.0)
    monkeypatch.setattr(mine, "scored", lambda _fitted: ([score], [score]))
    mine.run(blank(), 0)
    assert mine.untried == [score]
    chosen = refit("hump", 900.0)
    after = blank(fit=blank(flags=()))
    found = Diagnosis(after, after, (Round((), (), (chosen,), chosen),), (score,), (), untried_scores=(score,))
    caveat = (
        "The search ended when it had added 1 effect: it had reached the largest number of effects, "
        "--max-effects 1; give a larger number to try the other candidates: steady wind."
    )
    assert diagnosis_caveat(found) == caveat  # The caveat is also shown on the screen.
    assert caveat not in _notes(found, GivenModel("model.toml"))
    doubted = replace(found, attributions=(EffectAttribution("hump", "ambiguous", ("a lag resembles it",)),))
    next_step = "The recommended experiment (Next experiment, in the report) may decide this."
    doubt = f"It is not certain that the missing effect is hump: a lag resembles it. {next_step}"
    assert diagnosis_caveat(doubted) == f"{doubt} {caveat}"


def test_unexplained_residuals_name_the_score_test_that_contradicts_the_model() -> None:
    """The tests of whiteness may pass then, so that the answer says which tests contradict the model."""
    scores = tuple(Score(n, x, 5, x, {}, {}, threshold=22.0) for n, x in (("wind", 46.0), ("N(v)", 133.0)))
    rejected = refit("bias", 60.0)
    found = Diagnosis(
        blank(), blank(cross_validated=False), (Round(scores, ("wind", "N(v)"), (rejected,), None),), (), ()
    )
    answer = diagnosis_answer(found, None, 10.0)
    assert answer.startswith(
        "The score tests contradict the model (the strongest one: yaw moment that follows the sway speed, N(v), p = "
        "5e-27), but no candidate explains the residuals: "
    )
    assert "can find what the tests of whiteness and of the correlations with the inputs miss." in answer
    of_titles = replace(found, rounds=(Round(scores[:1], ("wind",), (rejected,), None),))
    assert "(the strongest one: steady wind, p = 9e-09)" in diagnosis_answer(of_titles, None, 10.0)


def test_waves_that_were_not_tried_are_named() -> None:
    """The answer has them if nothing else is missing, otherwise a note."""
    words = "have a narrow spectral peak at 0.55 Hz, as of waves, or of a machine or a swinging sensor if"
    fitted = blank(cross_validated=False, fit=blank(flags=()))
    found = Diagnosis(blank(), fitted, (), (), (), untried_waves=0.546875)
    assert words in diagnosis_answer(found, None, 10.0)
    assert words not in diagnosis_answer(replace(found, untried_waves=None), None, 10.0)
    curve = Effect("unknown X(u)", "a curve: the force X depends on u", {}, kind=EffectKind.NONPARAMETRIC)
    chosen = Refit(curve, blank(), 90.0, 1, 82.0, 30.0, 4.0)
    with_effect = replace(
        found,
        rounds=(Round((), (), (chosen,), chosen),),
        attributions=(EffectAttribution(curve.name, "nonparametric"),),
        importances=(EffectImportance(curve.name, 90.0, 1.02, 41.2, 5.34),),
    )
    assert words not in diagnosis_answer(with_effect, None, 10.0)
    assert any(words in note for note in _notes(with_effect, GivenModel("model.toml")))


@pytest.mark.parametrize("possible", [True, False])
def test_waves_are_looked_for_if_they_were_no_candidate(possible: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without common errors, or if the search has tried them beside these, waves are a candidate of the search."""
    peak = Score("waves", 90.0, 5, 90.0, {}, {"f_wave": 0.5})
    monkeypatch.setattr(search, "wave_peak_score", lambda fitted, policy: peak)
    state: Any = SimpleNamespace(waves=object() if possible else None, policy=DEFAULT_POLICY)
    assert search._untried_waves(state, blank()) == (0.5 if possible else None)


@pytest.mark.parametrize(
    ("name", "flagged", "waves_gain", "tried", "kept"),
    [
        ("sway-slosh", "zeta_s", 90.0, True, False),
        ("sway-slosh", "zeta_s", 40.0, True, True),  # waves explain less than the mass
        ("sway-slosh", "m_u", 90.0, False, True),
        ("sway-slosh", "", 90.0, False, True),
        ("yaw-bias", "N_0", 90.0, False, True),
    ],
)
def test_a_mass_that_oscillates_without_damping_is_compared_with_waves(
    name: str, flagged: str, waves_gain: float, tried: bool, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside the common errors waves are no candidate, and such a mass takes their place."""
    known = catalogue()
    mine = a_search(known[name])
    mine.waves = known["waves"]
    fit: Any = SimpleNamespace(flags=((flagged, AT_BOUND),) if flagged else (), estimate=lambda _: (0.51, 0.01))
    best = replace(refit(name, 50.0), effect=known[name], fitted=blank(fit=fit))
    begun: list[Score] = []

    def refit_all(_self: Any, _current: Any, pairs: Any, refits: list[Refit], _untested: Any) -> None:
        begun.extend(score for _, score in pairs)
        refits.extend(replace(refit("waves", waves_gain), effect=effect) for effect, _ in pairs)

    monkeypatch.setattr(_Search, "_refit_all", refit_all)
    refits = [best, refit("mismatch", 20.0)]
    mine._refit_waves_beside(fitted_boat(), refits, [])
    assert [s.scan for s in begun] == [{"f_wave": 0.51}] * tried
    assert (name in mine.candidates) is kept
    assert ("waves" in mine.candidates) is (mine.waves is None) is tried
    if tried:  # and only once
        mine._refit_waves_beside(fitted_boat(), refits, [])
        assert len(begun) == 1


def test_answer_without_an_effect_names_the_effects_that_come_nearest() -> None:
    """The estimation data support them, and the validation data cannot decide."""
    scores = (Score("wind", 133.0, 1, 46.0, {}, {}, threshold=22.0),)
    undecided = Outcome.NOT_VALIDATED
    refits = (
        replace(refit("a curve", 400.0), outcome=Outcome.NO_BETTER_PREDICTION),
        replace(refit("wind", 30.0, gain=4.7, t=0.88), outcome=undecided),
        replace(refit("battery", 22.0, gain=4.3, t=1.72), outcome=undecided),
        replace(refit("contradicted", 20.0, gain=-1.0, t=-0.5), outcome=undecided),
        replace(refit("weak", 9.0, gain=0.4, t=0.5), outcome=undecided),
    )
    found = Diagnosis(blank(), blank(cross_validated=False), (Round(scores, ("wind",), refits, None),), (), ())
    assert (
        "The effects that come nearest are battery (t = 1.7) and wind (t = 0.9): the estimation data support them, and "
        "the validation data are too few to decide. A score test can find" in diagnosis_answer(found, None, 10.0)
    )
    waves = replace(found, untried_waves=0.55)
    steps = diagnosis_answer(waves, None, 10.0).partition("\nNext steps, in this order:\n")[2]
    starts = ("1. Diagnose all logs", "2. `seatrial ident vehicle --effect battery --effect wind` estimates them")
    places = [
        steps.index(x) for x in (*starts, "\n3. Fit the model with `--effect waves`", "\n4. If this adds nothing:")
    ]
    assert places == sorted(places)
    assert places[0] == 0
    one = replace(found, rounds=(replace(found.rounds[0], refits=refits[2:]),))
    assert "The effect that comes nearest is battery (t = 1.7): the estimation data support it" in diagnosis_answer(
        one, None, 10.0
    )
    none = replace(found, rounds=(replace(found.rounds[0], refits=refits[3:]),))
    assert "nearest" not in diagnosis_answer(none, None, 10.0)


def test_an_effect_with_many_parameters_is_near_if_all_data_support_it() -> None:
    """Wind with six parameters had the largest t and gain on the validation data, and was not named."""
    scores = (Score("N(v, r)", 91.0, 3, 46.0, {}, {}, threshold=22.0),)
    fits = [refit("pull", 21.6, gain=4.5, t=0.93), refit("line", 15.9, gain=5.3, t=1.30)]
    wind = refit("wind", 7.0, gain=9.2, t=1.43)
    undecided = [replace(r, outcome=Outcome.NOT_VALIDATED) for r in (*fits, wind)]
    found = Diagnosis(blank(), blank(cross_validated=False), (Round(scores, (), tuple(undecided), None),), (), ())
    assert "nearest are wind (t = 1.4) and line (t = 1.3)" in diagnosis_answer(found, None, 10.0)
    for changed in ({"criterion": -1.0}, {"validation_gain": 1.4}):
        rest = replace(found.rounds[0], refits=(*undecided[:2], replace(undecided[2], **changed)))
        assert "nearest are line (t = 1.3) and pull" in diagnosis_answer(replace(found, rounds=(rest,)), None, 10.0)


def test_a_diagnosis_with_validation_that_adds_nothing_names_that_of_all_logs() -> None:
    """The same logs without --validate gave an effect, and the answer advised --validate."""
    scores = (Score("wind", 133.0, 1, 46.0, {}, {}, threshold=22.0),)
    rejected = replace(refit("wind", 30.0, gain=4.7, t=0.9), outcome=Outcome.NOT_VALIDATED)
    found = Diagnosis(blank(), blank(cross_validated=False), (Round(scores, (), (rejected,), None),), (), ())
    command = "seatrial ident diagnose vehicle/model.toml 1.mcap 2.mcap --validate 3.mcap --out diagnosis"
    again = command_without_validation(command)
    assert again == "seatrial ident diagnose vehicle/model.toml 1.mcap 2.mcap 3.mcap --out diagnosis-all"
    said = f"1. Diagnose all logs of the boat together, without --validate: `{again}`. An effect is then fitted to"
    assert said in diagnosis_answer(found, None, 10.0, again=again)
    assert "together, without --validate. An effect" in diagnosis_answer(found, None, 10.0)  # from Python
    every = replace(found, after=blank(cross_validated=True))
    answer = diagnosis_answer(every, None, 10.0)
    assert "If this adds nothing: add further logs of the boat to the estimation, or record longer runs, and" in answer
    assert "without --validate:" not in answer


@pytest.mark.parametrize(
    ("command", "again"),
    [
        ("a.toml 1 --validate=2 --out=d --rate 5", "a.toml 1 2 --out=d-all --rate 5"),
        ("a.toml --validate 2 --validate 3 1", "a.toml 2 3 1 --out diagnosis-all"),
        ("a.toml 1 --out d/ --validate 2", "a.toml 1 --out d-all 2"),
    ],
)
def test_the_logs_of_validation_join_the_others_in_the_next_command(command: str, again: str) -> None:
    begin = "seatrial ident diagnose "
    assert command_without_validation(f"{begin}{command}") == f"{begin}{again}"
    assert command_without_validation(f"{begin}a.toml 1 --out d") == ""


@pytest.mark.parametrize(
    ("call", "again"),
    [
        ("'vehicle', ['1.mcap'], validate=['2.mcap'], rate=5.0", "'vehicle', ['1.mcap', '2.mcap'], rate=5.0"),
        ("seatrial.fit(['1.mcap'], validate=['2.mcap']), ['1.mcap'], validate=['2.mcap']", "fit, ['1.mcap', '2.mcap']"),
        ("'vehicle', ['1.mcap']", ""),
        ("'vehicle', [25 logs], validate=['2.mcap']", ""),
    ],
)
def test_the_logs_of_validation_join_the_others_in_the_next_call(call: str, again: str) -> None:
    said = f"seatrial.diagnose({again})" if again else ""
    assert command_without_validation(f"seatrial.diagnose({call})") == said


def test_an_open_verdict_of_the_validation_logs_has_the_command_that_decides() -> None:
    """The answer had a found effect, no significant change of the error, and no command for the next step."""
    effect = Effect("reverse-mismatch", "a loss in reverse", {})
    chosen = Refit(effect, blank(), 90.0, 1, 82.0, 30.0, 4.0)
    found = Diagnosis(
        blank(), blank(cross_validated=False, fit=blank(flags=())), (Round((), (), (chosen,), chosen),), (), (),
        (EffectAttribution(effect.name, "identified"),), (EffectImportance(effect.name, 90.0, 1.02, 137.0, 3.7),),
    )  # fmt: skip
    change = parts.PredictionChangeRow(
        role="validation", ratio=0.71, low=0.48, high=1.04, verdict="unchanged", better=(), worse=()
    )
    again = "seatrial ident diagnose vehicle/model.toml 1.mcap 2.mcap 3.mcap --out diagnosis-all"
    said = (
        "So the effect is found in the data, but these validation logs are too few to decide if it improves the "
        f"prediction. Next, diagnose all logs of the boat together, without --validate: `{again}`."
    )
    assert said in diagnosis_answer(found, change, 10.0, again=again)
    fell = structs.replace(change, high=0.9, verdict="fell")
    assert again not in diagnosis_answer(found, fell, 10.0, again=again)
    narrow = structs.replace(change, ratio=0.99, low=0.97, high=1.01)  # the prediction is as good: that is decided
    assert again not in diagnosis_answer(found, narrow, 10.0, again=again)
    blocks = replace(found, after=blank(cross_validated=True, fit=blank(flags=())))
    assert "Next, diagnose all logs" not in diagnosis_answer(blocks, change, 10.0, again=again)


def test_a_curve_of_two_velocities_is_told_once_and_has_a_page() -> None:
    """One answer said: may be the true cause, no better prediction, worse on the validation data."""
    name, title = "N(v, r)", "a nonparametric effect: the yaw moment N depends on v, r"
    curve = Effect(f"unknown {name}", title, {}, kind=EffectKind.NONPARAMETRIC)
    score = Score(name, 200.0, 3, 91.0, {}, {}, threshold=22.0, curve=ForceCurve("N", "v", "r"))
    of_curve = Refit(curve, blank(), 58.0, 3, 34.0, 14.0, 2.6, outcome=Outcome.NO_BETTER_PREDICTION)
    found = Diagnosis(blank(), blank(cross_validated=False), (Round((score,), (), (of_curve,), None),), (), ())
    answer = diagnosis_answer(found, None, 10.0)
    said = (
        "no candidate improves the prediction: a curve by which the yaw moment N depends on v, r explains a part of "
        "the residuals one step ahead (the log-likelihood of the validation data rises by 14, t = 2.6), but "
        "the prediction is no better with it."
    )
    page = f"What an unexplained {name} means, and what to do: documentation, Theory, Diagnosis, section 11."
    assert said in answer
    assert answer.endswith(page)
    # Without validation logs, blocks of time decide.
    blocks = diagnosis_answer(replace(found, after=blank(cross_validated=True)), None, 10.0)
    assert "(the log-likelihood of the blocks of time rises by 14, t = 2.6), but the prediction" in blocks
    assert "the validation data" not in blocks
    assert answer.count("no better") == answer.count("log-likelihood") == 1
    assert "is not among them" not in answer
    headings = (Path(__file__).parents[3] / "docs/theory/diagnosis.md").read_text(encoding="utf-8").splitlines()
    assert any(line.startswith("## 11. ") and "two velocities" in line for line in headings)
    wind = replace(refit("wind", 25.0, gain=30.0, t=2.3), fitted=blank(fit=blank(names=(), flags=())))
    first = Round((), (), (replace(of_curve, outcome=Outcome.OUTRANKED), wind), wind)
    (judged,) = assess_alternatives([first, found.rounds[0]], AttributionEvidence((score,), 1000))
    assert judged.reasons[0].endswith("), which explains the estimation data and does not improve the prediction")
    model = blank(parameters=(), outputs=(), values={}, inputs=(), kind=ModelKind.VEHICLE)
    after = blank(fit=blank(flags=(), model=model, records=()), model=model)
    weight = EffectImportance("wind", 900.0, 1.3, 50.0, 5.0)
    beside = Diagnosis(
        after, after, (first, found.rounds[0]), (score,), (), attributions=(judged,), importances=(weight,)
    )
    caveat = str(diagnosis_caveat(beside))
    assert caveat.endswith(page)
    assert "true cause" not in caveat
    assert not any("no better" in note for note in _notes(beside, GivenModel("model.toml")))
    certain = replace(beside, attributions=(EffectAttribution("wind", "identified"),))
    assert str(diagnosis_caveat(certain)).count("no better") == 1
    (row,) = _effect_rows(beside, "validation")
    (rival,) = row.alternatives
    assert rival.why_not == "it is a curve, and an effect with a formula is preferred"
    card = str(dict(effect_card(row, 10.0).facts)["Fitted in its place, ΔBIC"])
    assert card.replace("\u00a0", " ") == f"unknown {name} (9.00 better on the estimation data, but {rival.why_not})"


def test_only_forces_of_two_velocities_have_the_page_on_them() -> None:
    for name in ("N(v)", "N(n_diff)", "psi(u, r)", "N(past of u)", "wind"):
        assert _two_velocities_sentence(name) == ""
    assert "unexplained Y(u, r) means" in _two_velocities_sentence("Y(u, r)")


SKEG = Effect("skeg", "a skeg or drag aft", {})
YAW_CURVE = Score("N(v, r)", 190.0, 3, 80.0, {}, {}, threshold=22.0, curve=ForceCurve("N", "v", "r"))


def removed_again(effect: Effect, explained: tuple[str, ...], remaining: tuple[Score, ...], own: bool) -> Diagnosis:
    """Return a diagnosis whose only effect, supported by the data, was removed as the prediction is no better."""
    chosen, score = replace(refit(effect.name, 200.0), effect=effect), Score(effect.name, 225.0, 1, 80.0, {}, {})
    passed = (effect.name, *(s.name for s in remaining))
    return Diagnosis(
        blank(),
        blank(cross_validated=False),
        (Round((score, *remaining), passed, (chosen,), chosen, explained=explained),),
        (*remaining, score),
        (),
        removed=(RemovedEffect(effect, 96.0, 5.7, SAME),),
        own_effects=(effect.name,) if own else (),
    )


def test_an_effect_of_ones_own_that_explains_the_other_candidates_says_so() -> None:
    answer = diagnosis_answer(removed_again(SKEG, ("N(v, r)",), (YAW_CURVE,), own=True), None, 10.0)
    assert (
        "No effect of the catalogue or of your own improves the prediction: a skeg or drag aft (your effect" in answer
    )
    assert (
        "It also explains what another candidate would otherwise explain, which is then too weak to be tried: yaw "
        "moment that follows the product of sway speed and yaw rate, N(v, r). It is left out because the prediction"
    ) in answer
    assert "`seatrial ident vehicle --effects FILE.py --effect skeg` estimates it with the model." in answer
    assert "section 11" not in answer  # the effect explains the curve
    none = diagnosis_answer(Diagnosis(blank(), blank(), (), (), (), own_effects=("skeg",)), None, 10.0)
    assert none.startswith(
        "No effect is missing: the data show neither an effect of the catalogue or of your own nor a"
    )


def test_a_call_of_python_says_where_it_runs() -> None:
    """Its logs are the names of files, without their folder."""
    assert _command_clause("seatrial ident diagnose m.toml a.mcap") == ": `seatrial ident diagnose m.toml a.mcap`"
    assert _command_clause("seatrial.diagnose(fit, ['a.mcap'])").startswith(" in the folder of the logs: `seatrial.")
    assert _command_clause("") == ""


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (
            ("battery-sag",),
            "1 candidate passes its score test, but explains too little to be tried: the loss of thrust",
        ),
        (("battery-sag", "X(u, r)"), "2 candidates pass their score tests, but each of them explains too little"),
    ],
)
def test_candidates_too_small_to_be_tried_are_not_denied(names: tuple[str, ...], said: str) -> None:
    """The answer was that the data show no effect, above a figure with candidates beyond their thresholds."""
    small = tuple(Score(n, 28.0, 1, 20.0, {}, {}) for n in names)
    found = Diagnosis(blank(), blank(fit=blank(flags=())), (), small, ())
    answer = diagnosis_answer(found, None, 10.0)
    assert answer.startswith("No effect that is large enough to matter is missing: " + said)
    assert f"p = {small[0].p_block:.1g}" in answer
    assert "`seatrial ident vehicle --effect battery-sag` estimates it." in answer
    assert (
        reason_without_experiment(found) == "each candidate that passed the score tests explains too little to matter"
    )
    row = _quiet_round(replace(found, scores=(*small, Score("wind", 2.0, 2, 1.0, {}, {}))))
    assert [c.passed for c in row.candidates] == [*([True] * len(small)), False]
    assert row.why == "each candidate that passes explains too little to be tried"


def test_a_stronger_curve_makes_the_name_of_a_removed_effect_uncertain_and_has_the_page() -> None:
    """With waves in the model, one answer offered a swinging mount and was silent about N(v, r)."""
    mount = Effect("swinging-mount", "a thruster that swings in its mount", {})
    answer = diagnosis_answer(removed_again(mount, (), (YAW_CURVE,), own=False), None, 10.0)
    assert "No effect of the catalogue improves the prediction" in answer
    assert (
        "The strongest candidate of the score tests is another one, and is not in the model either: yaw moment that "
        "follows the product of sway speed and yaw rate, N(v, r). So the name of this effect is uncertain. What an "
        "unexplained N(v, r) means, and what to do: documentation, Theory, Diagnosis, section 11."
    ) in answer
    assert "uncertain" not in diagnosis_answer(removed_again(mount, (), (), own=False), None, 10.0)


def test_the_search_records_the_candidates_that_an_added_effect_explains(monkeypatch: pytest.MonkeyPatch) -> None:
    strong = {n: Score(n, 900.0, 1, 80.0, {}, {}, threshold=22.0) for n in ("skeg", "wind", "current")}
    tested = iter([list(strong.values()), [strong["current"]], []])
    s = _Search([], [], {n: Effect(n, n, {}) for n in strong}, QUIET)
    rounds = iter([replace(refit(n, 200.0), effect=Effect(n, n, {})) for n in ("skeg", "current")])

    def scored(_search: _Search, _current: FittedModel) -> Any:
        passed = next(tested)
        return passed, passed

    def run_round(_search: _Search, _current: FittedModel, scores: list[Score], tried: list[Score]) -> Round:
        chosen = next(rounds)
        return Round(tuple(scores), tuple(x.name for x in tried), (chosen,), chosen)

    monkeypatch.setattr(_Search, "scored", scored)
    monkeypatch.setattr(_Search, "_run_round", run_round)
    monkeypatch.setattr(_Search, "add_common_errors", lambda *_: None)
    monkeypatch.setattr(_Search, "_report_round", lambda *_: None)
    s.forward(blank(), 3)
    assert [r.explained for r in s.rounds] == [("wind",), ()]


def test_a_diagnosis_of_a_bench_names_no_boat_and_no_command_of_a_boat() -> None:
    """No fit of a thruster takes effects: only the diagnosis adds them."""
    scores = (Score("cell-lag", 133.0, 1, 46.0, {}, {}, threshold=22.0),)
    undecided = replace(refit("cell-lag", 30.0, gain=4.7, t=1.9), outcome=Outcome.NOT_VALIDATED)
    found = Diagnosis(blank(), blank(cross_validated=False), (Round(scores, (), (undecided,), None),), (), ())
    answer = diagnosis_answer(found, None, 1.0, bench=True)
    assert "too few to decide. A diagnosis with longer or further logs of the bench decides, and adds it if" in answer
    assert "1. Diagnose all logs of this thruster on the bench together, without --validate. An effect" in answer
    assert "If this adds nothing: record longer tests, and look" in answer
    left = replace(found, removed=(RemovedEffect(refit("cell-lag", 30.0).effect, 662.0, 6.6, SAME),))
    removed = diagnosis_answer(left, None, 1.0, bench=True)
    assert "is no better with it." in removed
    boat = " ".join((diagnosis_answer(found, None, 1.0), diagnosis_answer(left, None, 1.0)))
    assert boat.count("`seatrial ident vehicle --effect cell-lag` estimates it with the model.") == 2
    chosen = refit("stiction", 900.0)
    after = blank(fit=blank(flags=(), model=blank(parameters=(), outputs=())))
    weight = EffectImportance("stiction", 900.0, 1.3, 50.0, 5.0)
    rounds = (Round((), (), (chosen,), chosen), Round(scores, (), (), None))
    beside = Diagnosis(after, after, rounds, scores, (), importances=(weight,))
    caveat = str(diagnosis_caveat(beside, bench=True))
    assert "give all logs of this thruster on the bench, or record longer and more varied tests, and" in caveat
    for text in (answer, removed, caveat):
        assert not any(word in text for word in ("boat", "ident vehicle", "--effect"))


@pytest.mark.parametrize(
    ("wind", "said"),
    [
        (refit("wind", 11.0, gain=14.9, t=1.6), "nearest are wind (t = 1.6) and pull (t = 1.4): the estimation"),
        (refit("wind", 11.0, gain=14.9, t=1.1), "too few to decide. Wind is not among them: its t is smaller, 1.1. A"),
        (
            refit("wind", 7.0, gain=1.4, t=1.6),
            "Wind is not among them: its fit gains 15 in 2 ln L on the estimation data, little for 1 parameter, and "
            "the log-likelihood of the validation data rises by 1 (t = 1.6). A",
        ),
        (
            refit("wind", 30.0, gain=-4.0, t=-1.0),
            "Wind is not among them: the validation data do not support it sufficiently: the log-likelihood of "
            "the validation data falls by 4 (t = -1.0). A",
        ),
        (None, "Steady wind is not among them: it was not fitted in this round. A"),
    ],
)
def test_the_strongest_candidate_is_among_the_nearest_or_the_answer_says_why_not(wind: Any, said: str) -> None:
    """Refits are in the order of a criterion that counts parameters, so that the wind with its six came last."""
    scores = (Score("wind", 133.0, 1, 46.0, {}, {}, threshold=22.0),)
    fits = [refit("pull", 32.0, gain=7.0, t=1.4), refit("line", 25.0, gain=11.0, t=1.2), *filter(None, [wind])]
    refits = tuple(replace(r, outcome=Outcome.NOT_VALIDATED) for r in fits)
    found = Diagnosis(blank(), blank(cross_validated=False), (Round(scores, ("wind",), refits, None),), (), ())
    assert said in diagnosis_answer(found, None, 10.0)


def sized(gain: float, size: float, error: float) -> Refit:
    """Return a refit of a damping with this size and standard error, and this gain on the validation data."""
    effect = Effect("damping", "damping", {}, (Parameter("X_rr", 0.0, "kg m"), Parameter("w", 0.2, "m")))
    estimates = {"X_rr": (size, error), "w": (0.3, 0.1)}
    fit = blank(
        model=blank(parameters=(), inputs=(), values={}), flags=(), records=("run1",),
        estimate=staticmethod(lambda name, record=0: estimates[name]),
    )  # fmt: skip
    return replace(refit("damping", 30.0, gain=gain, t=0.9), effect=effect, fitted=blank(fit=fit),
                   outcome=Outcome.NOT_VALIDATED)  # fmt: skip


@pytest.mark.parametrize(
    ("gain", "size", "error", "named"),
    [(4.0, 2.0, 1.2, True), (0.3, 2.0, 1.2, False), (-0.2, 2.0, 1.2, False), (4.0, 0.4, 1.2, False)],
)
def test_a_left_out_candidate_that_is_noise_is_not_named(gain: float, size: float, error: float, named: bool) -> None:
    """An answer once named a force of 0.4 ± 1.2 kg whose log-likelihood "rises by 0"."""
    chosen, after = refit("hump", 900.0), blank(fit=blank(flags=(), model=blank(parameters=(), outputs=())))
    left = [Score(name, 90.0, 1, 50.0, {}, {}, threshold=12.0) for name in ("damping", "wind")]
    wind = replace(refit("wind", 30.0, gain=3.0, t=1.0), outcome=Outcome.NOT_VALIDATED)
    rounds = (Round((), (), (chosen,), chosen), Round(tuple(left), (), (sized(gain, size, error), wind), None))
    weight = EffectImportance("hump", 900.0, 1.3, 50.0, 5.0)
    found = Diagnosis(after, after, rounds, tuple(left), (), importances=(weight,))
    caveat = str(diagnosis_caveat(found))
    assert ("Of those that were fitted, the strongest is damping (X_rr = 2.0 ± 1.2 kg m):" in caveat) is named
    clear = "Of those that were fitted with a clear size and gain, the strongest is steady wind: the validation data do"
    assert (clear in caveat) is not named
    assert "rises by 0 " not in caveat


def test_nearest_effects_have_their_sizes() -> None:
    """A coefficient is of no use without its size and sign."""
    effect = Effect("drag", "drag", {}, (Parameter("X_rr", 0.0, "kg m"), Parameter("w", 0.2, "m")))
    found = {"X_rr": (5.071, 1.159), "w": (0.3, 0.1)}
    fit = blank(
        model=blank(parameters=(), inputs=(), values={}), flags=(), records=("run1",),
        estimate=staticmethod(lambda name, record=0: found[name]),
    )  # fmt: skip
    assert sizes_in_words(effect, blank(fit=fit)) == "X_rr = 5.1 ± 1.2 kg m"


def test_caveat_of_a_certain_name_has_the_candidates_that_still_pass() -> None:
    chosen, after = refit("hump", 900.0), blank(fit=blank(flags=(), model=blank(parameters=(), outputs=())))
    left = (Score("wind", 90.0, 1, 50.0, {}, {}, threshold=12.0),)
    rounds = (Round((), (), (chosen,), chosen), Round(left, ("wind",), (), None))
    certain = (EffectAttribution("hump", "identified"),)
    weight = EffectImportance("hump", 900.0, 1.3, 50.0, 5.0)
    found = Diagnosis(after, after, rounds, left, (), attributions=certain, importances=(weight,))
    assert diagnosis_caveat(found) == (
        "The effects found do not explain the residuals in full: beside them the score tests still find 1 candidate: "
        "steady wind. The search did not add it, because no candidate that passed could be fitted. To find out, give "
        "all logs of the boat, or record longer and more varied runs, and diagnose again with their logs."
    )
    assert "The model can be used: its standard errors" in str(diagnosis_caveat(replace(found, uncertainty=blank())))
    many = tuple(replace(left[0], name=f"{force}(n_diff)") for force in ("psi", "N", "X", "Y", "T"))
    words = str(diagnosis_caveat(replace(found, remaining=many)))
    assert (
        "find 5 candidates; the strongest are heading error that follows the difference of the shaft speeds, "
        "psi(n_diff); yaw moment that follows the difference of the shaft speeds, N(n_diff); surge force that " in words
    )
    assert "T(n_diff)" not in words
    assert "The search added none of them, because" in words
    assert diagnosis_caveat(replace(found, remaining=())) is None
    # The search ended with an added effect, and not by --max-effects.
    small = diagnosis_caveat(replace(found, rounds=rounds[:1]))
    assert small is not None
    assert small == (
        "1 more candidate passes its score test: steady wind. Nothing has to be done about this: it explains too "
        "little to be tried, and a larger --max-effects tries no more."
    )
    several = str(diagnosis_caveat(replace(found, rounds=rounds[:1], remaining=many, uncertainty=blank())))
    assert several.startswith("5 more candidates pass their score tests; the strongest are ")
    assert several.endswith("an estimate.")
    for word in ("still find", "To find out", "in full"):
        assert word not in several
    note = next(n for n in _notes(replace(found, rounds=rounds[:1]), GivenModel("m.toml")) if "still pass" in n)
    assert (
        "none of them is in the model: steady wind. Nothing has to be done about this: each of them explains too little"
        in note
    )
    doubted = replace(found, attributions=(EffectAttribution("hump", "ambiguous", ("a lag resembles it",)),))
    next_step = "The recommended experiment (Next experiment, in the report) may decide this."
    doubt = "It is not certain that the missing effect is hump: a lag resembles it."
    assert diagnosis_caveat(doubted) == f"{doubt} {next_step}"
    by_curve = EffectAttribution("hump", "ambiguous", ("a lag resembles it",), ("wind",), "X(u)")
    other = "The recommended experiment (Next experiment, in the report) distinguishes it from steady wind, which the"
    named = replace(found, before=blank(model=horizontal_model()))
    assert diagnosis_caveat(replace(named, attributions=(by_curve,))) == f"{doubt} {other} data do not exclude either."
    of_wind = replace(by_curve, competitor="wind")
    assert diagnosis_caveat(replace(named, attributions=(of_wind,))) == f"{doubt} {next_step}"
    both = (*doubted.attributions, EffectAttribution("wind", "ambiguous", ("steady-pull is as good",)))
    assert diagnosis_caveat(replace(doubted, attributions=both)) == (
        "It is not certain that one of the missing effects is hump: a lag resembles it. It is not certain that one of "
        f"the missing effects is wind: steady-pull is as good. {next_step}"
    )


@pytest.mark.parametrize(
    ("given", "refit_converged", "begin"),
    [
        (True, True, "For use, take the model that was given"),
        (True, False, "For use, take the model that was given"),
        (False, True, "Do not use the model that was given to the diagnosis: its fit did not converge."),
        (False, False, "Do not use the model that was given to the diagnosis, nor that of this diagnosis"),
    ],
)
def test_a_model_whose_fit_did_not_converge_is_not_for_use(given: bool, refit_converged: bool, begin: str) -> None:
    after = blank(fit=blank(flags=(), converged=refit_converged))
    (note,) = _notes(Diagnosis(after, after, (), (), ()), GivenModel("model.toml", given))
    assert note.startswith(f"No effect was added. {begin}")
    assert ("For use, take the model.toml of this diagnosis" in note) == (not given and refit_converged)


def test_a_removed_effect_takes_no_place_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one effect at most, the first is removed again, and the search goes on without trying it again."""
    mine = a_search(*(Effect(n, n, {}) for n in ("motor", "wind", "hump")))
    mine.n = 100
    scores = [Score(n, lm, 1, 50.0, {}, {}, threshold=12.0) for n, lm in (("motor", 900.0), ("wind", 90.0))]
    tested = list[Any]()

    def scored(fitted: Any) -> tuple[list[Score], list[Score]]:
        tested.append(getattr(fitted, "name", "start"))
        return scores, scores

    monkeypatch.setattr(mine, "scored", scored)
    removed = blank(effect=Effect("motor", "motor", {}))

    def added(_current: Any, _scores: Any, tried: list[Score]) -> Round:
        chosen = refit(tried[0].name, 900.0)
        return Round((), (), (chosen,), chosen)

    weighed = [(blank(), blank(name="plain"), (), [removed]), (blank(), blank(name="windy"), (), [removed])]
    monkeypatch.setattr(mine, "_run_round", added)
    monkeypatch.setattr(mine, "weighed_effects", lambda *_: weighed.pop(0))
    found = mine.run(blank(), 1)
    assert [r.chosen.effect.name for r in mine.rounds if r.chosen is not None] == ["motor", "wind"]
    assert (found.model.name, found.removed) == ("windy", [removed])
    assert not weighed
    assert tested == ["start", "plain", "windy"]  # not the models with an effect that may be removed at once


def test_a_removed_effect_is_replaced_only_by_a_strong_candidate_that_did_not_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mine = a_search(*(Effect(n, n, {}) for n in ("motor", "wind", "hump")))
    mine.n = 100
    failed = replace(refit("hump", 700.0), outcome=Outcome.NOT_VALIDATED)
    mine.rounds = [Round((), (), (failed,), None)]
    scores = [Score(n, lm, 1, 50.0, {}, {}, threshold=12.0) for n, lm in (("hump", 700.0), ("wind", 40.0))]
    monkeypatch.setattr(mine, "scored", lambda _fitted: (scores, scores))
    monkeypatch.setattr(mine, "_run_round", lambda *_: pytest.fail("no candidate is worth a round"))
    current = blank()
    assert mine.forward(blank(), 3, current) is current
    assert mine.untried == []


@pytest.mark.parametrize(
    ("accepted", "batches"),
    [(["wind"], [["motor", "wind"]]), ([], [["motor", "wind"], ["hump"]])],
)
def test_a_candidate_that_failed_before_is_refitted_last(
    monkeypatch: pytest.MonkeyPatch, accepted: list[str], batches: list[list[str]]
) -> None:
    """The candidate with the highest score is tried again at once, although it failed too."""
    names = ("motor", "hump", "wind")
    mine = a_search(*(Effect(n, n, {}) for n in names))
    mine.n = 100
    failed = [replace(refit(n, 300.0), outcome=Outcome.NOT_VALIDATED) for n in ("motor", "hump")]
    mine.rounds = [Round((), (), tuple(failed), None)]
    done: list[list[str]] = []

    def refitted(_current: Any, tried: Any, refits: list[Refit], _untested: Any) -> None:
        if tried:
            done.append([effect.name for effect, _ in tried])
            refits += [refit(effect.name, 80.0) for effect, _ in tried]

    monkeypatch.setattr(mine, "_refit_all", refitted)
    monkeypatch.setattr(search, "is_accepted", lambda r, _policy: r.effect.name in accepted)
    monkeypatch.setattr(mine, "_choose_refit", lambda _current, refits, _untested: (refits, None))
    passed = [Score(n, 300.0 - k, 1, 50.0, {}, {}, threshold=12.0) for k, n in enumerate(names)]
    mine._run_round(fitted_boat(), passed, passed)
    assert done == batches


@pytest.mark.parametrize(("accepted", "more"), [(True, ["hump"]), (False, ["hump", "lift"])])
def test_a_candidate_that_cannot_win_any_more_is_not_refitted(
    monkeypatch: pytest.MonkeyPatch, accepted: bool, more: list[str]
) -> None:
    """A refit gains at most five times as much as its score. The limit holds only if another effect is accepted."""
    lms = {"motor": 300.0, "wind": 290.0, "hump": 120.0, "lift": 40.0}
    mine = a_search(*(Effect(n, n, {}) for n in lms))
    mine.n = 100
    done: list[str] = []

    def refitted(_current: Any, tried: Any, refits: list[Refit], _untested: Any) -> None:
        done.extend(effect.name for effect, _ in tried)
        refits += [refit(effect.name, 400.0) for effect, _ in tried]

    monkeypatch.setattr(mine, "_refit_all", refitted)
    monkeypatch.setattr(search, "is_accepted", lambda _r, _policy: accepted)
    monkeypatch.setattr(mine, "_choose_refit", lambda _current, refits, _untested: (refits, None))
    passed = [Score(n, lm, 1, 50.0, {}, {}, threshold=12.0) for n, lm in lms.items()]
    mine._run_round(fitted_boat(), passed, passed)
    assert done == ["motor", "wind", *more]


def test_removal_never_leaves_effects_that_predict_worse_than_the_nominal_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each of three effects pays beside the others. Without one of them, the other two predict worse than no effect."""
    mine = a_search()
    mine.rounds = [Round((), (), (r,), r) for r in (refit("hump", 900.0), refit("cubic", 300.0), refit("lift", 90.0))]
    left: list[str] = []

    def weighed(_before: Any, current: Any, chosen: Any, *_: Any) -> tuple[EffectImportance, ...]:
        names = [c.effect.name for c in chosen]
        return tuple(EffectImportance(n, 10.0, 1.1, 20.0, 0.3 if n == "hump" else 6.0, FELL) for n in names)

    def compared(_before: Any, after: Any, *_: Any) -> Any:
        left.append(after.name)
        return blank(prediction=ROSE if after.name == "without hump" else FELL)

    monkeypatch.setattr(search, "effect_importance", weighed)
    monkeypatch.setattr(search, "Comparison", compared)
    monkeypatch.setattr(search, "fit_without", lambda *arguments: blank(name=f"without {arguments[3].name}"))
    current, weights, removed = mine.backward_elimination(blank(), blank(), blank(name="all"))
    assert left == ["without hump", "without lift"]
    assert [r.effect.name for r in removed] == ["hump", "lift"]
    assert [w.effect for w in weights] == ["cubic"]
    assert current.name == "without lift"


@pytest.mark.parametrize(("error", "removed"), [(1.01, ["table"]), (1.001, ["table", "lift"]), (1.05, [])])
def test_nonparametric_effect_must_improve_the_prediction_beside_the_others(
    monkeypatch: pytest.MonkeyPatch, error: float, removed: list[str]
) -> None:
    mine = a_search()
    table = refit("table", 900.0)
    table = replace(table, effect=replace(table.effect, kind=EffectKind.LAGGED))
    mine.rounds = [Round((), (), (r,), r) for r in (table, refit("lift", 90.0))]
    monkeypatch.setattr(search, "Comparison", lambda *_: blank(prediction=FELL))
    monkeypatch.setattr(search, "fit_without", lambda *_: blank())
    monkeypatch.setattr(
        search,
        "effect_importance",
        lambda _b, _c, chosen, *_: tuple(EffectImportance(c.effect.name, 10.0, error, 20.0, 6.0, SAME) for c in chosen),
    )
    assert [r.effect.name for r in mine.backward_elimination(blank(), blank(), blank())[2]] == removed


@pytest.mark.parametrize(
    ("name", "criterion", "prediction", "outcome"),
    [
        # The criterion is 1 % of that of its declared alternative, which corresponds to 3 degrees.
        ("mount", 100.0, SAME, Outcome.ADDED),
        ("lift", 100.0, SAME, Outcome.SMALL),
        ("lift", 100.0, FELL, Outcome.ADDED),
        ("lift", 300.0, SAME, Outcome.ADDED),
        ("mount", 300.0, ROSE, Outcome.WORSE_PREDICTION),
    ],
)
def test_effect_with_a_small_likelihood_gain_may_matter(
    name: str, criterion: float, prediction: PredictionChange, outcome: Outcome
) -> None:
    compass = replace(refit("compass", 10_000.0), effect=catalogue()["compass"])
    assert refit_outcome(replace(refit(name, criterion), prediction=prediction), [compass]) is outcome


SCANNED = Effect(
    "scanned",
    "scanned",
    {},
    (Parameter("A", 0.0, bounds=(-1.0, 1.0), prior=(0.0, 2.0)), Parameter("w", 1.0)),
    scan={"w": (0.5, 1.0, 2.0)},
)
SCORE = Score("scanned", 100.0, 1, 50.0, {"A": 5.0}, {"w": 1.0})


def test_initial_values_of_a_refit_start_at_the_score_test_and_end_at_zero() -> None:
    assert [tuple(p.value for p in e.parameters) for e in _with_initial_values(SCANNED, SCORE)] == [
        (1.0, 1.0),
        (0.6, 1.0),
        (1.0, 0.5),
        (1.0, 2.0),
        (-0.6, 1.0),
        (0.0, 1.0),
    ]


@pytest.mark.parametrize(("n_failures", "untested"), [(0, False), (5, False), (6, True)])
def test_failed_refit_is_repeated_from_other_starts_and_then_listed_as_untested(
    monkeypatch: pytest.MonkeyPatch, n_failures: int, untested: bool
) -> None:
    tried = []

    class Model:
        def __add__(self, effect: Effect) -> Effect:
            return effect

    def fitted(model: Effect, *_: Any, **__: Any) -> Any:
        tried.append(model)
        if len(tried) <= n_failures:
            raise np.linalg.LinAlgError("SVD did not converge") if len(tried) == 1 else ValueError("other")
        return blank(fit=blank(log_posterior=60.0))

    monkeypatch.setattr(search, "fit_and_evaluate", fitted)
    monkeypatch.setattr(search, "comparison", lambda *_: blank(gain=(30.0, 4.0), pooled_t=lambda _self, _penalty: 5.0))
    mine = a_search(SCANNED)
    mine.n = 1000
    found = mine._refit(blank(fit=blank(model=Model(), log_posterior=10.0)), SCANNED, SCORE)
    assert len(tried) == min(n_failures + 1, 6)
    if untested:
        assert found == UntestedCandidate(SCANNED, "SVD did not converge")
    else:
        assert isinstance(found, Refit)
        assert found.gain == pytest.approx(100.0)


def test_candidates_have_the_given_position_of_the_thrusters() -> None:
    """Candidates and common errors have it, and a wide prior only without it."""
    effects = {name: catalogue()[name] for name in ("propeller-walk", "thrust-angle", "wind")}
    runs = segments(boat_with("mismatch", 1), seconds=60.0)[:1]
    plain = horizontal_model()
    given = replace(plain, effect_priors=tuple(EffectPrior(n, -0.8, 0.05, "rig") for n in ("x_walk", "x_delta")))
    for model, known in ((given, True), (plain, False)):
        start = search._prepared_search(model, runs, [], effects, 10.0, QUIET, search.DEFAULT_POLICY)
        for name, parameter in (("propeller-walk", "x_walk"), ("thrust-angle", "x_delta")):
            effect = start.candidates[name]
            (p,) = (p for p in effect.parameters if p.name == parameter)
            assert (p.prior == (-0.8, 0.05)) == known
            assert (effect.scan[parameter] == (-0.8,)) == known
            assert start.common.get(name, effect) is effect
        assert start.candidates["wind"].parameters[0].origin is not ParameterOrigin.PRIOR


def test_extended_model_that_fits_worse_is_refitted_from_another_start(monkeypatch: pytest.MonkeyPatch) -> None:
    values = iter([-500.0, 40.0, 90.0])

    class Model:
        def __add__(self, effect: Effect) -> Effect:
            return effect

    monkeypatch.setattr(search, "fit_and_evaluate", lambda *_, **__: blank(fit=blank(log_posterior=next(values))))
    for name in ("comparison", "whole_run_comparison"):
        monkeypatch.setattr(search, name, lambda *_: blank(gain=(30.0, 4.0), pooled_t=lambda _self, _penalty: 5.0))
    mine = a_search(SCANNED)
    mine.n = 1000
    found = mine._refit(blank(fit=blank(model=Model(), log_posterior=10.0)), SCANNED, SCORE)
    assert isinstance(found, Refit)
    assert found.gain == pytest.approx(60.0)


@pytest.mark.parametrize(("gain", "place"), [(40.0, "blocks"), (1.0, "whole runs")])
def test_effect_that_the_estimation_data_reject_is_not_evaluated_in_blocks(
    gain: float, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Model:
        def __add__(self, effect: Effect) -> Effect:
            return effect

    used: list[Any] = []

    def fit_once(*_: Any, settings: Any, **__: Any) -> Any:
        used.append(settings.tolerance)
        return blank(fit=blank(log_posterior=10.0 + gain / 2))

    def compared(name: str) -> Any:
        used.append(name)
        return blank(gain=(30.0, 4.0), pooled_t=lambda _self, _penalty: 5.0)

    monkeypatch.setattr(search, "fit_and_evaluate", fit_once)
    monkeypatch.setattr(search, "comparison", lambda *_: compared("blocks"))
    monkeypatch.setattr(search, "whole_run_comparison", lambda *_: compared("whole runs"))
    mine = a_search(SCANNED)
    mine.n = 1000
    mine._refit(blank(fit=blank(model=Model(), log_posterior=10.0)), SCANNED, replace(SCORE, lm=700.0))
    assert used == [3.5, place]  # 1 % of the expected gain, which is half of the statistic


def test_effects_that_do_not_pay_are_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects are removed one at a time, because the second may be needed after the first is removed."""
    mine = a_search()
    mine.rounds = [Round((), (), (r,), r) for r in (refit("hump", 900.0), refit("cubic", 300.0), refit("lift", 90.0))]
    fits = {name: blank(name=name) for name in ("all", "without hump")}

    def weighed(_before: Any, current: Any, chosen: Any, *_: Any) -> tuple[EffectImportance, ...]:
        names = [c.effect.name for c in chosen]
        idle = {"hump": 0.3, "cubic": 1.5} if current is fits["all"] else {}
        return tuple(EffectImportance(n, 10.0, 1.1, 20.0, idle.get(n, 6.0), FELL) for n in names)

    monkeypatch.setattr(search, "effect_importance", weighed)
    monkeypatch.setattr(search, "Comparison", lambda *_: blank(prediction=FELL))
    monkeypatch.setattr(search, "fit_without", lambda *arguments: fits[f"without {arguments[3].name}"])
    current, weights, removed = mine.backward_elimination(blank(), blank(), fits["all"])
    assert current is fits["without hump"]
    assert [w.effect for w in weights] == ["cubic", "lift"]
    assert [r.effect.name for r in removed] == ["hump"]
    assert set(mine.candidates) == {"hump"}  # The last score tests cover the removed effect, too.


def test_effect_is_kept_if_its_removal_could_not_be_tested(monkeypatch: pytest.MonkeyPatch) -> None:
    """This holds if the importance is unknown, and if the exact fit without the effect fails."""
    mine, whole = a_search(), blank()
    mine.rounds = [Round((), (), (r,), r) for r in (refit("cubic", 900.0), refit("hump", 300.0))]
    weights = (EffectImportance("cubic", 10.0, 1.1, 20.0, 0.3, FELL), EffectImportance("hump", NAN, NAN, untested="x0"))

    def fails(*_: Any) -> Any:
        raise ValueError("not finite")

    monkeypatch.setattr(search, "effect_importance", lambda *_: weights)
    monkeypatch.setattr(search, "fit_without", fails)
    current, found, removed = mine.backward_elimination(blank(), blank(), whole)
    assert current is whole
    assert removed == []
    assert [w.untested for w in found] == ["not finite", "x0"]


def test_removal_of_the_last_effect_returns_to_the_fit_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exact fit of the round before has the remaining effects, so that nothing is fitted."""
    mine = a_search()
    first, last = refit("hump", 900.0), refit("cubic", 300.0)
    mine.rounds = [Round((), (), (r,), r) for r in (first, last)]
    weights = {n: EffectImportance(n, 10.0, 1.1, 20.0, t, FELL) for n, t in (("hump", 9.0), ("cubic", 0.3))}

    def importance(_base: Any, _current: Any, chosen: Any, *_: Any) -> tuple[EffectImportance, ...]:
        return tuple(weights[c.effect.name] for c in chosen)

    monkeypatch.setattr(search, "effect_importance", importance)
    monkeypatch.setattr(search, "Comparison", lambda *_: blank(prediction=FELL))
    monkeypatch.setattr(search, "fit_without", lambda *_: pytest.fail("fitted again"))
    current, _, removed = mine.backward_elimination(blank(), blank(), blank())
    assert current is first.fitted
    assert [r.effect.name for r in removed] == ["cubic"]


@pytest.mark.parametrize(
    ("name", "added"), [("waves", True), ("compass-motor", True), ("shaft-clip", False), ("wind", False)]
)
def test_waves_and_sensor_errors_do_not_keep_the_common_errors_out(
    name: str, added: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interference of the motors with the compass once kept the common errors out: m_u was 56.5 +- 4.2 kg, not 41."""
    members = ("telemetry-age", "gnss-latency", "lift", "sway-yaw")
    mine = a_search(*(Effect(n, n, {}) for n in (*members, "compass")), catalogue()[name])
    mine.n, mine.equations = 1000, cast(Any, object())
    mine.common = {n: mine.candidates[n] for n in members}
    extended = blank()
    found = CommonErrorsFit(tuple(mine.common.values()), extended)
    monkeypatch.setattr(search, "score_common_errors", lambda *_: CommonErrorScore(members, 100.0, {}, {}))
    monkeypatch.setattr(search, "with_forms", lambda joint, *_: joint)
    monkeypatch.setattr(search, "fit_common_errors", lambda *_, **__: found)
    result = mine.add_common_errors(blank(), [Score(name, 900.0, 1, 30.0, {}, {})])
    assert (result is extended) is added
    assert ("waves" in mine.candidates) is False
    assert ("compass" in mine.candidates) is True


def test_effects_are_compared_beside_their_remaining_alternatives(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three strong candidates that are no alternatives must not keep the alternatives of the effect out of the fit."""
    names = ("lift", "cross-flow", "sway-yaw", "compass", "heading-moment", "coulomb")
    searched = a_search(*(catalogue()[n] for n in names))
    bias = catalogue()["yaw-bias"]
    assert "heading-moment" in bias.alternatives
    assert "compass" not in bias.alternatives
    chosen = replace(refit("yaw-bias", 100.0), effect=bias)
    searched.rounds = [Round((), (), (chosen,), chosen, ())]
    monkeypatch.setattr(search, "fit_and_evaluate", lambda model, *_, **__: blank(model=model))
    monkeypatch.setattr(search, "_keeps_its_size", lambda effect, *_: effect is bias)
    monkeypatch.setattr(_Search, "_joint_steps", lambda _, scores: scores)
    monkeypatch.setattr(_Search, "_shifted_estimates", lambda *_: {})
    current = blank()
    current.fit = type("FakeFit", (), {"model": with_disturbances(horizontal_model())})
    scores = [Score(n, 60.0 - k, 1, 60.0, {}, {}) for k, n in enumerate(names)]
    kept, beside = searched.unaffected_by(current, scores)
    assert kept == {"yaw-bias"}
    assert beside == {"lift", "cross-flow", "sway-yaw", "heading-moment"}
    # Beside an effect that contains it as a special case, its size is not determined.
    searched.candidates["lift"] = replace(catalogue()["lift"], nests=("yaw-bias",))
    assert "lift" not in searched.unaffected_by(current, scores)[1]


def test_rough_refits_beside_common_errors_hold_the_noise_of_the_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    wind, compass = catalogue()["wind"], catalogue()["compass"]
    nominal = with_disturbances(horizontal_model())
    model = nominal + wind
    mine = a_search()
    assert mine._with_held_noise(model) is model  # only beside the common errors
    mine.common_errors = CommonErrorsFit((), blank())
    held = mine._with_held_noise(model)
    assert set(model.free) - set(held.free) == {"e_psi", "e_r", "e_a", "e_xy", "e_vxy"}
    walking = replace(
        nominal,
        parameters=(*nominal.parameters, Parameter("q_psi", 1e-4, transform="log")),
        states=tuple(replace(s, noise="q_psi") if s.name == "bias_psi" else s for s in nominal.states),
    )
    assert "q_psi" not in mine._with_held_noise(walking + wind).free

    exact: list[Any] = []

    def fitted(model: Any, *_: Any, **__: Any) -> Any:
        exact.append(model)
        raise ValueError("enough")

    monkeypatch.setattr(search, "fit_and_evaluate", fitted)
    rough = refit("wind", 50.0)
    rough = replace(rough, effect=wind, fitted=blank(fit=blank(model=held, start_values=lambda _fit, _model: {})))
    with pytest.raises(ValueError, match="enough"):
        mine._fit_exactly(blank(fit=blank(model=nominal)), rough)
    assert exact[0].free == model.free

    mine.n = 1000
    # The rough fit with an effect of a sensor estimates the noise of the sensors.
    for effect, of_sensor in ((wind, False), (compass, True)):
        exact.clear()
        tried = mine._refit(blank(fit=blank(model=nominal)), effect, Score(effect.name, 60.0, 1, 60.0, {}, {}))
        assert isinstance(tried, UntestedCandidate)
        assert ("e_psi" in exact[0].free) is of_sensor


def test_removal_fits_again_if_common_errors_came_after_an_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = a_search()
    mine.rounds = [Round((), (), (r,), r) for r in (refit("hump", 900.0), refit("cubic", 300.0))]
    mine.common_errors = CommonErrorsFit((), blank(), after=("hump",))
    assert mine._exact_fit_with([mine.rounds[0].refits[0]]) is None
    mine.common_errors = CommonErrorsFit((), blank(), after=())
    assert mine._exact_fit_with([mine.rounds[0].refits[0]]) is mine.rounds[0].refits[0].fitted


def test_effects_are_kept_if_the_model_without_them_cannot_be_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The common errors came after an effect, so that the model without effects has to be fitted once more."""
    mine, plain, whole = a_search(), blank(fit=blank(model=horizontal_model())), blank()
    whole.fit = plain.fit
    mine.rounds = [Round((), (), (r,), r) for r in (refit("hump", 900.0), refit("cubic", 300.0))]
    mine.common_errors = CommonErrorsFit((), whole, after=("hump",))

    def fails(*_: Any, **__: Any) -> Any:
        raise ValueError("not finite")

    monkeypatch.setattr(search, "fit_and_evaluate", fails)
    base, current, found, removed = mine.weighed_effects(plain, whole)
    assert base is plain
    assert current is whole
    assert removed == []
    assert [(w.effect, w.untested) for w in found] == [("hump", "not finite"), ("cubic", "not finite")]


def test_curve_of_an_ambiguous_effect_is_omitted_if_it_cannot_be_fitted() -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise ValueError("x0")

    table = Score("X(u)", 100.0, 1, 0.0, {}, {}, EffectKind.NONPARAMETRIC, ForceCurve("X", "u"))
    chosen = refit("hump", 900.0)
    rounds = [Round((table,), ("X(u)",), (chosen,), chosen)]
    drawn, undrawn = search._reported_curves(blank(), rounds, [EffectAttribution("hump", "ambiguous")], [], fails)
    assert (drawn, undrawn) == ([], "hump: x0")
    judged = (EffectAttribution("hump", "ambiguous"),)
    found = Diagnosis(
        blank(),
        blank(),
        tuple(rounds),
        (),
        (),
        judged,
        (EffectImportance("hump", NAN, NAN, untested="y0"),),
        curve_failure=undrawn,
    )
    assert [(w.code, w.text.rpartition(": ")[2]) for w in _untested_warnings(found)] == [
        ("effect-untested", "y0. Its place in the order of the effects has no meaning."),
        ("curve-not-drawn", "x0. The figure of this curve is missing; the other results do not depend on it."),
    ]


def test_user_candidate_that_cannot_be_tested_is_listed() -> None:
    """Effects of the catalogue that the model cannot carry are not listed."""
    model = horizontal_model()
    seen = Channel(np.arange(3.0), np.zeros(3))
    runs = [LogSegment("mon/run", {"tide": seen}), LogSegment("tue/run", {})]
    tide = Effect("tide", "a tide", {}, inputs=(Input("tide", "m", "linear"),))
    sail = Effect("sail", "a sail", {}, requires=("sail_area",))
    twice = Effect("twice", "a mass", {}, (Parameter("m_u", 1.0),))
    fine = Effect("fine", "a fine one", {}, (Parameter("own", 0.0),))
    candidates = {**catalogue(), **{e.name: e for e in (tide, sail, twice, fine)}}
    refused = search._untestable_candidates(model, candidates, runs)
    assert [(u.effect.name, u.reason) for u in refused] == [
        ("tide", "tue/run lacks its input tide; leave that log out, or give one with this input"),
        ("sail", f"it needs the signal 'sail_area', which model {model.name} does not have"),
        ("twice", f"model {model.name} has m_u already"),
    ]
    found = Diagnosis(blank(), blank(), (), (), (), untestable=refused)
    (first, *_) = _untested_warnings(found)
    assert (first.code, first.text) == (
        "effect-untested",
        "This effect was not tested: a tide (tue/run lacks its input tide; leave that log out, or give one with this "
        "input).",
    )


@pytest.mark.parametrize("contradicted", [True, False])
def test_candidate_that_signals_contradict_is_not_tested(monkeypatch: pytest.MonkeyPatch, contradicted: bool) -> None:
    """Candidates are only collected here; the search is stopped before the first fit."""
    limit = replace(catalogue()["shaft-limit"], refuted_by=lambda runs: f"{len(runs)} run" * contradicted)
    collected: list[str] = []

    def stop(_model: Any, candidates: Mapping[str, Effect], _runs: Any) -> Any:
        collected.extend(candidates)
        raise InterruptedError

    monkeypatch.setattr(search, "with_all_candidates", stop)
    runs = [LogSegment("run", {})]
    with pytest.raises(InterruptedError):
        search._prepared_search(
            with_disturbances(horizontal_model("command")), runs, [], {"lag": catalogue()["lag"], limit.name: limit},
            10.0, QUIET, search.DEFAULT_POLICY,
        )  # fmt: skip
    assert ("shaft-limit" in collected) == (not contradicted)
    refuted = search._refuted_candidates([limit], runs)
    assert [(r.effect.name, r.reason) for r in refuted] == [("shaft-limit", "1 run")] * contradicted
    after = blank(fit=blank(flags=(), converged=True))
    notes = _notes(Diagnosis(after, after, (), (), (), refuted=refuted), GivenModel("model.toml"))
    text = "The data exclude a limit of the shaft speed below full command, which was not tested: 1 run."
    assert (text in notes) == contradicted


def test_halved_initial_value_is_clipped_to_its_bounds() -> None:
    """Half of the ratio 1 is outside its bounds."""
    ratio = Effect("own", "own", {}, (Parameter("ratio", 1.0, bounds=(0.6, 3.0)), Parameter("A", 1.0)))
    assert search._half_values(ratio) == {"ratio": 0.6, "A": 0.5}


def test_failed_refit_is_named_in_the_answer() -> None:
    score = Score("mismatch", 1611.0, 1, 50.0, {}, {})
    lost = UntestedCandidate(catalogue()["mismatch"], "outside its bounds")
    found = Diagnosis(
        blank(), blank(cross_validated=False), (Round((score,), ("mismatch",), (), None, (lost,)),), (score,), ()
    )
    assert found.untested == (lost,)
    assert "could not be fitted: a thrust mismatch" in diagnosis_answer(found, None, 10.0)


def test_payload_has_no_kilograms_if_the_thrust_is_unknown() -> None:
    model = horizontal_model()
    thrust = model.values["c1"] + model.values["c2"]
    shift = ParameterShift("m_payload", "kg", 0.0, 0.0, 0.2 * thrust, 0.01 * thrust, 90.0)
    after = blank(fit=blank(model=model), cross_validated=False)
    found = Diagnosis(blank(), after, (), (), (), mismatches=(ValidationMismatch("tue/run", "r", 2.0, shift),))
    answer = diagnosis_answer(found, None, 10.0)
    assert "The best explanation is m_payload/T = 0.2 ± 0.01 kg/N in that run, instead of 0." in answer
    (row,) = map(_mismatch_row, reported_mismatches(found))
    assert (row.parameter, row.unit) == ("m_payload/T", "kg/N")
    assert (row.fitted, row.value, row.se) == pytest.approx((0.0, 0.2, 0.01))


def test_a_search_that_ended_with_a_removal_says_so_and_how_to_try_what_is_left() -> None:
    """The score tests found much then, so that "too little is left to explain" was wrong."""
    drag, wind = refit("turning-resistance", 46.0), refit("wind", 40.0)
    after = blank(fit=blank(flags=(), model=blank(parameters=(), outputs=())))
    left = tuple(Score(n, 88.0, 2, 40.0, {}, {}, threshold=12.0) for n in ("cg-offset", "turning-resistance"))
    gone = RemovedEffect(drag.effect, 30.1, 2.7, SAME)
    found = Diagnosis(
        after, after, (Round((), (), (drag,), drag), Round((), (), (wind,), wind)), left, (),
        (EffectAttribution("wind", "identified"),), (EffectImportance("wind", 90.0, 1.3, 41.2, 5.34),), (gone,),
    )  # fmt: skip
    caveat = str(diagnosis_caveat(found))
    assert (
        "The search kept none of them, because it ended when it removed turning-resistance again. Of those that were "
        "fitted, the strongest is added resistance in turns (X_rr): it was removed again: the prediction is as good "
        "without it; the log-likelihood of the validation data rises by 30 with it (t = 2.7). To try them, run "
        "`seatrial ident diagnose` with the model of this diagnosis."
    ) in caveat
    notes = " ".join(_notes(found, GivenModel("model.toml")))
    assert "too little is left" not in caveat + notes
    assert "They were not tried beside these effects: it ended when it removed turning-resistance again." in notes
    worse = replace(found, removed=(replace(gone, prediction=ROSE),))
    assert "it was removed again: the prediction is worse with it; the log-likelihood" in str(diagnosis_caveat(worse))


@pytest.mark.parametrize(
    ("gain", "t", "said"),
    [
        (13.0, 1.96, "support it too little for an effect that does not clearly improve the prediction (this needs t "
         "above 2); the log-likelihood of the validation data rises by 13 with it (t = 2.0)."),
        (-3.0, -1.0, "the validation data do not support it; the log-likelihood of the validation data falls by 3 with "
         "it (t = -1.0)."),
    ],
)  # fmt: skip
def test_answer_without_effects_says_why_an_added_effect_was_removed(gain: float, t: float, said: str) -> None:
    """The round said that the log-likelihood rises by 13, and the answer that the data support no added effect."""
    chosen = refit("lift", 60.0, gain=13.0, t=2.0)
    score = Score("lift", 88.0, 1, 40.0, {}, {}, threshold=12.0)
    found = Diagnosis(
        blank(), blank(cross_validated=False), (Round((score,), ("lift",), (chosen,), chosen),), (), (),
        removed=(RemovedEffect(chosen.effect, gain, t, SAME),),
    )  # fmt: skip
    answer = diagnosis_answer(found, None, 10.0)
    assert "no candidate explains the residuals: lift was added and removed again: with the other effects" in answer
    assert said in answer


def test_effect_with_support_but_no_influence_on_the_prediction_is_named() -> None:
    """A lag of filtered velocities has t = 6.6. The former answer "no candidate predicts the validation data better"
    was wrong.
    """
    chosen = refit("filter-lag", 600.0)
    gone = RemovedEffect(catalogue()["filter-lag"], 662.0, 6.6, SAME)
    score = Score("filter-lag", 1862.0, 2, 0.0, {}, {})
    found = Diagnosis(
        blank(),
        blank(cross_validated=False),
        (Round((score,), ("filter-lag",), (chosen,), chosen),),
        (),
        (),
        removed=(gone,),
    )
    assert (
        "is as good without it. The validation data support it: their log-likelihood rises by 662 (t = 6.6). "
        "It is left out because the prediction 10 s ahead is no better with it; `seatrial ident vehicle "
        "--effect filter-lag` estimates it with the model."
    ) in diagnosis_answer(found, None, 10.0)
    poor = diagnosis_answer(found, None, 10.0, ("yaw rate", -0.55))
    assert "one channel 10 s ahead worse than its mean value would: yaw rate, fit -55 %" in poor
    assert not is_immaterial(replace(gone, t=1.0))
    assert not is_immaterial(replace(gone, prediction=ROSE))


# -- on missions of simulated boats
# -------------------------------------------------------------------------------------

FEW = {n: e for n, e in catalogue().items() if n in ("mismatch", "yaw-bias", "cubic-drag", "reverse-thrust")}


def loaded(boat: Boat, kg: float) -> Boat:
    return replace(boat, hull=replace(boat.hull, mass=boat.hull.mass + kg))


def segments(*boats: Boat, seconds: float = 150.0) -> list[LogSegment]:
    """Return one run of each boat, each on its own mission."""
    return [LogSegment(f"run{k}", channels_of(sail(boat, seconds, 100 + k, k)[0])) for k, boat in enumerate(boats, 1)]


@pytest.mark.study
def test_payload_in_one_run_is_identified() -> None:
    clean = boat_with(None, 1)
    runs = segments(clean, loaded(clean, 5.0), clean)
    found = diagnose(horizontal_model(), runs[:2], runs[2:], effects=FEW)
    assert [r.effect.name for r in found.effects] == [f"{BETWEEN}payload"]
    values = [found.after.fit.estimate("m_payload", i)[0] for i in (0, 1)]
    assert values[1] - values[0] == pytest.approx(5.0, abs=0.6)
    # The payload of the validation run is estimated from its other blocks, for the answer and for the acceptance.
    evaluation = evaluate_diagnosis(found)
    assert [e.name for e in evaluation.in_blocks] == [f"{BETWEEN}payload"]
    for evaluated in (evaluation.before, evaluation.after):
        assert evaluated.validation is not None
        assert len(evaluated.validation.records) == len(validated_in_blocks(found.after).validation) > 4
        assert {r.role for r in evaluated.residuals} == {"estimation"}
    assert "has separate parameters for each run" in _blocks_note(evaluation)[0]


def test_validation_run_with_an_extra_payload_is_reported() -> None:
    clean = boat_with(None, 1)
    light, heavy = segments(clean, loaded(clean, 20.0))
    found = diagnose(horizontal_model(), [light], [heavy], effects=FEW)
    assert found.effects == ()
    (mismatch,) = found.mismatches
    assert (mismatch.record, mismatch.scale > 1.5) == ("run2", True)
    assert mismatch.shift is not None
    assert (mismatch.shift.name, mismatch.shift.value) == ("m_payload", pytest.approx(20.0, abs=1.0))
    answer = diagnosis_answer(found, None, 10.0)
    assert answer.startswith("The model does not hold in run2: ")
    assert "m_payload/T = " in answer  # The thrust is unknown.


@pytest.mark.slow
@pytest.mark.study
def test_single_log_is_cross_validated_and_the_answer_reports_it() -> None:
    found = diagnose(horizontal_model(), segments(boat_with("mismatch", 1), seconds=240.0), [], effects=FEW)
    assert [(j.effect, j.attribution) for j in found.attributions] == [("mismatch", "identified")]
    assert found.cross_validated
    assert len(found.after.validation) == 5
    values = {v.record.name: v.values[list(v.model.values).index("eps_LR")] for v in found.after.validation}
    assert len(set(values.values())) == 5  # Each value is estimated from the other blocks.
    assert "predicted by a fit to the other blocks" in diagnosis_answer(found, None, 10.0)


@pytest.mark.slow
def test_one_minute_of_data_never_identifies_an_effect() -> None:
    found = diagnose(horizontal_model(), segments(boat_with("mismatch", 1), seconds=60.0), [], effects=FEW)
    assert [(j.effect, j.attribution) for j in found.attributions] == [("mismatch", "ambiguous")]
    assert any("short" in reason for reason in found.attributions[0].reasons)


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("n", [8, 32])
def test_many_short_runs_give_the_result_of_two_long_runs(n: int) -> None:
    """The correlation time of the disturbance is at its bound in each run. Its mean must be at the bound, too."""
    boat, runs = boat_with("mismatch", 1), []
    channels = channels_of(sail(boat, 320.0, 100)[0])
    for k in range(n):
        low, high = 320.0 * k / n, 320.0 * (k + 1) / n
        runs.append(LogSegment(f"part{k}", channels, low, high))
    found = diagnose(horizontal_model(), runs, segments(boat), effects=FEW)
    assert [(j.effect, j.attribution) for j in found.attributions] == [("mismatch", "identified")]
    assert found.untested == ()


@pytest.mark.slow
@pytest.mark.study
def test_unusable_validation_log_is_listed_and_the_search_continues() -> None:
    good, usable = segments(boat_with("mismatch", 1), boat_with("mismatch", 1))
    lacking = LogSegment("odd", {n: c for n, c in usable.channels.items() if n != "n_left"})
    away = {n: Channel(c.t + 1e4, c.value) if n == "n_left" else c for n, c in usable.channels.items()}
    found = diagnose(horizontal_model(), [good], [lacking, LogSegment("apart", away), usable], effects=FEW)
    assert [f.record for f in found.failed_runs] == ["odd", "apart"]
    assert "n_left" in found.failed_runs[0].reason
    assert "overlap" in found.failed_runs[1].reason
    assert [r.effect.name for r in found.effects] == ["mismatch"]
    assert len(found.after.validation) == 1


def test_refits_with_effects_without_states_share_a_kernel() -> None:
    model, known = with_disturbances(horizontal_model("shaft")), catalogue()
    mine = a_search()
    mine._share_kernels(model, [known["mismatch"], known["sway-slosh"], known["leak"], known["yaw-bias"]])
    (larger,) = mine.larger_models
    # The states of the slosh would take time in all refits.
    assert [e.name for e in larger.model.effects[len(model.effects) :]] == ["mismatch", "leak", "yaw-bias"]
    assert larger.null == {"mismatch", "leak", "yaw-bias"}
    mine._share_kernels(model, [known["mismatch"], known["yaw-bias"]])  # this kernel serves them already
    mine._share_kernels(model, [known["wind"]])  # one effect needs no larger model
    mine._share_kernels(model, [known["wind"], known["leak"]])  # nor does one beside effects that have a kernel
    assert mine.larger_models == [larger]
    mine._share_kernels(model + known["mismatch"], [known["leak"], known["yaw-bias"]])  # a later round
    assert mine.larger_models == [larger]
    mine._share_kernels(model, [known["wind"], known["leak"], known["cg-offset"]])
    assert [e.name for e in mine.larger_models[1].model.effects[len(model.effects) :]] == ["wind", "cg-offset"]


def test_fits_without_an_effect_with_states_share_a_kernel() -> None:
    model, known = with_disturbances(horizontal_model("shaft")), catalogue()
    chosen = [replace(refit(name, 50.0), effect=known[name]) for name in ("sway-slosh", "wind", "mismatch")]
    found = model
    for r in chosen:
        found = found + r.effect
    mine = a_search()
    mine.larger_models = [LargerModel(found + known["leak"], frozenset({"wind", "mismatch", "leak"}))]
    current = blank(fit=blank(model=found))
    mine._share_reduced_kernels(current, chosen[:2])  # a single fit without the slosh needs no larger model
    assert len(mine.larger_models) == 1
    mine._share_reduced_kernels(current, chosen)
    mine._share_reduced_kernels(current, chosen)
    _, reduced = mine.larger_models
    names = [e.name for e in reduced.model.effects[len(model.effects) :]]
    assert names == ["wind", "mismatch", "leak"]
    assert reduced.model.states == model.states
    assert reduced.contains(found.without("sway-slosh"))
    assert reduced.contains(model + known["wind"])
    assert reduced.contains(model + known["wind"] + known["leak"])


def test_shared_kernel_of_a_later_round_leaves_an_effect_that_was_found_without_a_size() -> None:
    """The fit without an effect found uses this kernel, too."""
    model, known = with_disturbances(horizontal_model("shaft")), catalogue()
    mine = a_search()
    mine.rounds = [Round((), (), (), replace(refit("mismatch", 50.0), effect=known["mismatch"]))]
    found = (model + known["mismatch"]).with_values({"eps_LR": 0.2, "m_u": 60.0})
    mine._share_kernels(found, [known["leak"], known["wind"]])
    (larger,) = mine.larger_models
    assert larger.null == {"mismatch", "leak", "wind"}
    assert larger.model.values["eps_LR"] == 0.0
    assert larger.contains(model)
    assert larger.contains(found)
