"""Tests of the conditions under which the search accepts an effect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from seatrial.ident.diagnosis.acceptance import (
    improves_prediction,
    is_accepted,
    is_validated,
    is_worth_its_parameters,
    pooled_t,
    refit_outcome,
    validation_gain,
)
from seatrial.ident.diagnosis.findings import EffectImportance, Outcome, Refit, Round
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY
from seatrial.ident.model.structure import Effect, EffectKind
from seatrial.ident.validation.prediction_errors import PredictionChange


@dataclass
class View:
    record: Any
    ll: np.ndarray


def fitted(**by_run: np.ndarray) -> Any:
    """Return a stand-in for a fitted model with the given log-likelihoods of each run, one value per second."""
    views = [
        View(SimpleNamespace(name=n, t=100.0 + np.arange(ll.size), duration=ll.size - 1.0), ll)
        for n, ll in by_run.items()
    ]
    return SimpleNamespace(model=SimpleNamespace(block=5.0), validation=tuple(views))


def test_validation_gain_is_summed_over_runs_with_an_error_from_ten_second_blocks() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.normal(0.3, 1.0, (2, 200))
    gain, t = validation_gain(fitted(one=np.zeros(200), two=np.zeros(200)), fitted(one=first, two=second))
    blocks = np.concatenate([first.reshape(20, 10).sum(1), second.reshape(20, 10).sum(1)])
    assert gain == pytest.approx(first.sum() + second.sum())
    student = blocks.mean() / (blocks.std(ddof=1) / 40**0.5)
    assert t == pytest.approx(stats.norm.isf(stats.t.sf(student, 39)), rel=1e-3)


def with_estimation(model: Any, ll: np.ndarray) -> Any:
    """Return the stand-in for a fitted model with one estimation record of these log-likelihoods."""
    model.estimation = fitted(estimation=ll).validation
    return model


def test_pooled_t_adds_the_blocks_of_the_estimation_data_less_their_penalty() -> None:
    """A gain in one of twelve blocks of the validation data is not significant. With ten of 120 more it is."""
    burst = np.repeat([1.0, *[0.0] * 11], 10)
    before = with_estimation(fitted(run=np.zeros(120)), np.zeros(1200))
    after = with_estimation(fitted(run=burst), np.tile(burst, 10))
    _, alone = validation_gain(before, after)
    assert alone < 2.0
    assert pooled_t(before, after, 4.0) > 3.0
    assert pooled_t(before, after, 100.0) < 1.0  # a penalty as large as the gain of the estimation data


def test_pooled_t_of_useless_effects_is_seldom_large() -> None:
    """A useless parameter gains half a unit of ln L on the data that it was fitted to, and loses as much on others."""
    rng, found = np.random.default_rng(5), []
    for _ in range(500):
        x = rng.normal(size=1200)
        size = x.mean()  # estimate of an effect of size zero
        before = with_estimation(fitted(run=np.zeros(200)), np.zeros(1200))
        y = rng.normal(size=200)
        after = with_estimation(fitted(run=size * y - size**2 / 2), size * x - size**2 / 2)
        found.append(pooled_t(before, after, np.log(1200) / 2))
    assert np.mean(np.array(found) > 3.0) < 0.01


@pytest.mark.parametrize("n_blocks", [3, 5, 12, 24])
def test_chance_gains_pass_equally_rarely_for_few_and_many_blocks(n_blocks: int) -> None:
    """The share of random gains with t > 2 is that of the normal distribution. With 3 blocks and no correction it was 9
    %.
    """
    rng, found = np.random.default_rng(n_blocks), []
    for _ in range(2000):
        # The run is long enough for blocks of 10 s.
        ll = np.repeat(rng.normal(size=n_blocks), 10 if n_blocks == 24 else 5)
        found.append(validation_gain(fitted(run=np.zeros(ll.size)), fitted(run=ll))[1])
    assert np.mean(np.array(found) > 2.0) == pytest.approx(0.0228, abs=0.011)


def test_few_blocks_with_large_losses_are_not_treated_as_outliers() -> None:
    """The model predicts two turning circles worse, and forty other blocks a little better."""
    ll = np.full(400, 0.5)
    ll[150:170] = -80.0
    gain, t = validation_gain(fitted(run=np.zeros(400)), fitted(run=ll))
    assert gain < 0
    assert not is_validated(refit(gain=gain, t=t))


def test_validation_gain_compares_only_runs_of_both_models() -> None:
    gain, _ = validation_gain(fitted(a=np.zeros(50), b=np.zeros(50)), fitted(a=np.full(50, 1.0)))
    assert gain == pytest.approx(50.0)


def test_validation_gain_raises_an_error_if_a_value_is_not_finite() -> None:
    with pytest.raises(ValueError, match="not finite"):
        validation_gain(fitted(a=np.zeros(50)), fitted(a=np.full(50, np.nan)))


def change(ratio: float, low: float, high: float) -> PredictionChange:
    return PredictionChange(ratio, low, high, 10.0, {})


SAME, NEARLY = change(1.0, 0.99, 1.01), change(0.99, 0.98, 1.004)


def refit(
    *, criterion: float = 50.0, gain: float = 30.0, t: float = 4.0, kind: EffectKind = EffectKind.CATALOGUE, **more: Any
) -> Refit:
    effect = Effect("wind", "wind", {}, kind=kind)
    return Refit(effect, cast(Any, None), criterion + 8.0, 1, criterion, gain, t, **more)


@pytest.mark.parametrize(
    ("values", "accepted"),
    [
        ({}, True),
        ({"criterion": -1.0}, False),
        ({"gain": -1522.0, "t": 5.9}, False),
        ({"t": 1.9}, False),
        ({"t": 1.3, "pooled_t": 3.2}, True),
        ({"t": 1.3, "pooled_t": 2.8}, False),
        ({"t": 0.8, "pooled_t": 6.0}, False),
        ({"prediction": change(1.02, 0.98, 1.06)}, True),
        ({"prediction": change(0.7, 0.5, 0.9)}, True),
        ({"prediction": change(1.2, 1.1, 1.3)}, False),
        # Each step is within its interval, but all effects together predict worse than the nominal model.
        ({"prediction": change(1.1, 0.97, 1.25), "total": change(1.86, 1.09, 3.19)}, False),
        ({"prediction": change(1.1, 0.97, 1.25), "total": change(1.2, 0.9, 1.5)}, True),
        # An effect without a physical formula must predict better. A physical effect may gain too little for the
        # interval.
        ({"kind": EffectKind.RESONANT, "prediction": NEARLY, "by_inputs": SAME}, False),
        ({"kind": EffectKind.RESONANT, "prediction": NEARLY, "by_inputs": change(0.95, 0.9, 0.98)}, True),
        # The simulation error must fall beyond its interval, and by a material amount.
        ({"kind": EffectKind.RESONANT, "prediction": NEARLY, "by_inputs": change(0.95, 0.89, 1.01)}, False),
        ({"kind": EffectKind.RESONANT, "prediction": NEARLY, "by_inputs": change(0.99, 0.98, 0.999)}, False),
        ({"kind": EffectKind.NONPARAMETRIC, "prediction": change(0.7, 0.5, 0.9), "by_inputs": SAME}, True),
        # If the other effects improve the prediction, the point estimate is sufficient.
        *(
            ({"kind": EffectKind.NONPARAMETRIC, "prediction": change(ratio, 0.94, 1.02), "total": total}, accepted)
            for ratio, total, accepted in (
                (0.98, change(0.4, 0.2, 0.7), True),
                (0.995, change(0.4, 0.2, 0.7), False),
                (0.98, change(0.9, 0.8, 1.02), False),
            )
        ),
        # A directionally unstable boat: the errors grow in bursts, and their ratio has no useful interval.
        *(
            ({"kind": EffectKind.NONPARAMETRIC, "prediction": change(ratio, 0.4, 1.7), "pooled_t": t}, accepted)
            for ratio, t, accepted in ((0.85, 4.0, True), (0.95, 4.0, False), (0.85, 2.5, False))
        ),
        ({"prediction": NEARLY}, True),
    ],
)
def test_refit_is_accepted_only_if_every_condition_holds(values: dict[str, Any], accepted: bool) -> None:
    assert is_accepted(refit(**values)) is accepted


def test_thresholds_of_the_policy_decide() -> None:
    strict = replace(DEFAULT_POLICY, min_t=5.0)
    assert is_validated(refit(t=4.0))
    assert not is_validated(refit(t=4.0), strict)
    assert refit_outcome(refit(t=4.0, prediction=SAME), (), strict) is Outcome.NOT_VALIDATED


@pytest.mark.parametrize(
    ("prediction", "error", "predicts", "pays"),
    [
        (change(0.7, 0.5, 0.9), 1.0, True, True),
        (change(0.98, 0.7, 1.3), DEFAULT_POLICY.min_error_ratio + 0.01, True, True),
        (change(0.98, 0.7, 1.3), DEFAULT_POLICY.min_error_ratio - 0.01, False, True),
        (change(1.2, 1.1, 1.3), 1.5, False, False),
        # The error is the same with and without the effect.
        (change(0.99, 0.9, 1.1), DEFAULT_POLICY.material_error_ratio - 0.001, False, False),
    ],
)
def test_effect_importance_reports_support_and_improved_prediction(
    prediction: Any, error: float, predicts: bool, pays: bool
) -> None:
    weight = EffectImportance("wind", 100.0, error, 30.0, 4.0, prediction)
    assert (improves_prediction(weight), is_worth_its_parameters(weight)) == (predicts, pays)
    # A better prediction also counts as support.
    assert is_worth_its_parameters(replace(weight, t=1.9)) is (predicts and pays)
    assert not is_worth_its_parameters(replace(weight, t=0.9))
    assert not is_worth_its_parameters(EffectImportance("wind", 100.0, error, -3.0, 4.0, prediction))


@pytest.mark.parametrize(("high", "gain", "pays"), [(0.6, 20.0, True), (0.85, 20.0, False), (0.6, -1.0, False)])
def test_effect_with_a_certain_large_fall_of_the_error_needs_no_t_statistic(
    high: float, gain: float, pays: bool
) -> None:
    weight = EffectImportance("wind", 100.0, 1.5, gain, 0.76, change(0.43, 0.32, high))
    assert is_worth_its_parameters(weight) is pays


@pytest.mark.parametrize(
    ("outcomes", "of_round"),
    [
        ((Outcome.OUTRANKED, Outcome.NOT_VALIDATED), Outcome.NOT_VALIDATED),
        ((Outcome.WORSE_PREDICTION, Outcome.NOT_VALIDATED), Outcome.WORSE_PREDICTION),
        ((Outcome.SMALL, Outcome.NOT_SUPPORTED), Outcome.SMALL),
        ((), Outcome.UNTESTED),
    ],
)
def test_explanation_of_a_round_without_an_effect_names_the_best_outcome(outcomes: Any, of_round: Outcome) -> None:
    from dataclasses import replace

    refits = tuple(replace(refit(), outcome=o) for o in outcomes)
    search_round = Round((), (), refits, None)
    assert search_round.outcome is of_round
    assert ("wind" in search_round.explanation) is (
        of_round in (Outcome.WORSE_PREDICTION, Outcome.SMALL)
    )  # Only these outcomes name the effect.
    assert ("small compared with the effects found" in search_round.explanation) is (of_round is Outcome.SMALL)
