"""Tests of the score tests against theory: their false-alarm rate, the likelihood ratio, and their invariances."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy import stats

from seatrial.ident.data.record import Record
from seatrial.ident.diagnosis import score_test
from seatrial.ident.diagnosis.candidates import TrajectoryLinearisation, normal_equations
from seatrial.ident.diagnosis.score_test import (
    ROBUST_BLOCK_S,
    ColumnIndex,
    NormalEquations,
    PriorTerms,
    Score,
    SensitivityColumns,
    SensitivityFilter,
    assign_columns,
    block_index,
    fitted_parameters,
    prior_terms,
    score_tests,
    whole_blocks,
)
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import fit_and_evaluate
from seatrial.ident.estimation.likelihood import FilterResult, Likelihood
from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Effect, EffectKind, Signals, State
from tests.ident.sliders import (
    CUBE,
    DRAG,
    PUSH,
    TAPE,
    Q,
    no_priors,
    score_of,
    scores_at,
    scores_of_columns,
    slide,
    slider,
    whole,
)

N_SETS = 100
Linearised = tuple[TrajectoryLinearisation, FilterResult, list[np.ndarray]]


def rate_bounds(p: float, n: int = N_SETS) -> tuple[float, float]:
    """Return the interval that holds the observed rate of n trials with probability 99.9 %. Each trial has probability
    p.
    """
    low, high = stats.binom.interval(0.999, n, p)
    return low / n, high / n


def path_of(record: Record) -> Linearised:
    """Fit the slider to a record. Return the linearisation, the filter result and the columns of the fitted
    parameters.
    """
    fitted = fit(slider(), [record], settings=SearchSettings(threads=1))
    run = Likelihood(fitted.model).filter(record, fitted.record_values[0])
    path = TrajectoryLinearisation(fitted.model, fitted.record_values[0], record, run.x_pred)
    return path, run, [path.parameter(n) for n in fitted.names]


@pytest.fixture(scope="module")
def null_scores() -> dict[str, np.ndarray]:
    """Return the p values (n, 2) of the LM test and its block version by name, on data without a missing effect."""
    found: dict[str, list[tuple[float, float]]] = {}
    for seed in range(N_SETS):
        path, run, own = path_of(slide(seed))
        columns = [next(path.effect(e)) for e in (PUSH, DRAG, TAPE)]
        columns.append(
            SensitivityColumns("push and drag", np.concatenate([whole(path, c) for c in columns[:2]], axis=2))
        )
        for s in scores_of_columns(path, run, own, columns):
            assert s.df == (2 if s.name == "push and drag" else 1)
            found.setdefault(s.name, []).append((s.p, s.p_block))
    return {name: np.array(rows) for name, rows in found.items()}


@pytest.mark.parametrize("name", ["push", "drag", "tape", "push and drag"])
def test_lm_is_chi_squared_if_no_effect_is_missing(null_scores: dict[str, np.ndarray], name: str) -> None:
    p, p_block = null_scores[name].T
    assert p.size == N_SETS
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    low, high = rate_bounds(0.05)
    assert low <= np.mean(p < 0.05) <= high
    # The block version is chi-squared only for many blocks (here there are six). Its false-alarm rate must never be
    # higher.
    assert np.mean(p_block < 0.05) <= high


def test_lm_equals_the_likelihood_ratio_for_a_small_effect() -> None:
    for seed, push, drag in ((1, 0.06, 0.0), (2, -0.05, 0.0), (3, 0.0, 0.5), (4, 0.0, 0.6)):
        record = slide(seed, 600, push, drag)
        effect, size = (PUSH, push) if push else (DRAG, drag)
        fitted, (s,) = score_of(record, [effect])
        larger = fit(fitted.model + effect, [record], settings=SearchSettings(threads=1))
        ratio = 2 * (larger.log_likelihood - fitted.log_likelihood)
        value, error = larger.estimate(effect.parameters[0].name)
        assert s.lm > 5
        # A push is linear, so only the trapezoidal rule differs. Drag also changes the gains of the filter.
        assert s.lm == pytest.approx(ratio, rel=0.03 if push else 0.2)
        assert abs(s.step[effect.parameters[0].name] - value) < 0.5 * error
        assert abs(value - size) < 3.5 * error


def test_score_of_a_fitted_parameter_is_zero() -> None:
    """An effect that the fitted parameters can imitate has no score. Adding it to a candidate does not change the
    score.
    """
    record = slide(5, 400, push=0.05)
    path, run, own = path_of(record)
    push = whole(path, next(path.effect(PUSH)))
    mixed = push + 3.0 * own[0][:, :, None] - 0.7 * own[1][:, :, None]
    same = SensitivityColumns("damping", own[1][:, :, None])
    pushed, combined = scores_of_columns(
        path, run, own, [SensitivityColumns("push", push), SensitivityColumns("mixed", mixed)]
    )
    (none,) = scores_of_columns(path, run, own, [same])
    assert (none.lm, none.df, none.lm_block, none.step, none.p, none.p_block) == (0.0, 1, 0.0, {}, 1.0, 1.0)
    assert none.tolerance < 1e-8
    assert scores_of_columns(path, run, own, [replace(same, delta=0.0 * same.delta)]) == []  # No column acts.
    assert combined.lm == pytest.approx(pushed.lm, rel=1e-6)
    assert combined.lm_block == pytest.approx(pushed.lm_block, rel=1e-6)


def test_tolerance_is_the_residual_of_a_regression_on_the_fitted_parameters() -> None:
    """The tolerance depends on the data alone. The priors of the fitted parameters do not increase it."""
    path, run, own = path_of(slide(5, 400, push=0.05))
    push = whole(path, next(path.effect(PUSH)))
    columns = [SensitivityColumns(f"{k:g}", push + k * own[0][:, :, None]) for k in (0.0, 300.0)]
    carrier = SensitivityFilter(run, path.own, path.jacobian)
    g = carrier([SensitivityColumns("fitted", np.stack(own, 2)), *columns])
    normal, m = NormalEquations([str(k) for k in range(g.shape[1])]), len(own)
    normal.add(range(g.shape[1]), g, carrier.e, block_index(carrier.t))
    strong = PriorTerms(np.zeros(m), 1e3 * np.diag(normal.information)[:m])
    found = score_tests(normal, strong, assign_columns(columns, m, 1)[0])
    for score, column in zip(found, g.T[m:], strict=True):
        rest = column - g[:, :m] @ np.linalg.lstsq(g[:, :m], column, rcond=None)[0]
        assert score.tolerance == pytest.approx(np.sum(rest**2) / np.sum(column**2), rel=1e-4)
    assert found[1].tolerance < 0.1 * found[0].tolerance


def test_scores_are_independent_of_units_and_copies_add_no_degrees_of_freedom() -> None:
    record = slide(6, 400, drag=0.1)
    path, run, own = path_of(record)
    drag = whole(path, next(path.effect(DRAG)))
    cube = whole(path, next(path.effect(CUBE)))
    thousand, twice, plain = scores_of_columns(
        path,
        run,
        own,
        [
            SensitivityColumns("thousand", np.concatenate([1e3 * drag, 1e-3 * cube], axis=2), ("a", "b")),
            SensitivityColumns("twice", np.concatenate([drag, cube, drag], axis=2)),
            SensitivityColumns("plain", np.concatenate([drag, cube], axis=2), ("a", "b")),
        ],
    )
    assert thousand.lm == pytest.approx(plain.lm, rel=1e-6)
    assert thousand.step["a"] == pytest.approx(plain.step["a"] * 1e-3, rel=1e-6)
    assert (plain.df, twice.df) == (2, 2)
    assert twice.lm == pytest.approx(plain.lm, rel=1e-4)


def test_one_sided_effect_with_the_wrong_sign_has_no_score() -> None:
    record = slide(7, 400, push=0.08)
    fitted = fit(slider(), [record], settings=SearchSettings(threads=1))
    ahead = scores_at(fitted, record, [replace(PUSH, one_sided=True)])[0]

    def pull(s: object) -> None:
        s.rate["v"] = s.rate["v"] - s.p.k_push  # type: ignore[attr-defined]

    astern = scores_at(fitted, record, [replace(PUSH, hooks={"rate": pull}, one_sided=True)])[0]
    assert ahead.lm > 10
    assert (astern.lm, astern.lm_block) == (0.0, 0.0)
    assert astern.step["k_push"] == pytest.approx(-ahead.step["k_push"])


def whitened(run: FilterResult, e: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Multiply innovations (n_rows, n_outputs) by the inverse Cholesky factors of their covariances, in the order of
    rows.
    """
    out = []
    for k in range(len(e)):
        seen = np.flatnonzero(np.isfinite(run.e[k]))
        if seen.size:
            S = H[k][seen] @ run.P_pred[k] @ H[k][seen].T + np.diag(run.R[seen])
            out.append(np.linalg.solve(np.linalg.cholesky(S), e[k, seen]))
    return np.concatenate(out)


def test_whitened_sensitivities_are_the_derivatives_of_the_innovations() -> None:
    """The effects are linear and do not change the gains, so differences of complete filter runs are exact."""
    record = slide(8, 562)
    record = replace(record, t=np.cumsum(np.random.default_rng(8).uniform(0.05, 0.15, record.n_rows)))
    model = slider() + PUSH + TAPE
    values = np.array(list(model.values.values()))
    likelihood, names = Likelihood(model), list(model.values)
    run = likelihood.filter(record, values)
    H = VectorisedModel(model).output_jacobian(run.x_pred, record.u, values)
    path = TrajectoryLinearisation(slider(), values[:5], record, run.x_pred)
    carrier = SensitivityFilter(run, record, path.jacobian)
    g, e, t = carrier([next(path.effect(e)) for e in (PUSH, TAPE)]), carrier.e, carrier.t
    np.testing.assert_allclose(e, whitened(run, run.e, H), atol=1e-9)
    assert t.size == e.size == np.isfinite(record.y).sum()
    for column, name in enumerate(("k_push", "k_tape")):
        step = np.where(np.array(names) == name, 1e-3, 0.0)
        moved = [likelihood.filter(record, values + sign * step).e for sign in (0.5, -0.5)]
        wanted = whitened(run, (moved[0] - moved[1]) / 1e-3, H)
        # The linearisation error is h d / 6 m of the value.
        np.testing.assert_allclose(g[:, column], wanted, atol=1e-2 * np.abs(wanted).max())


def lagging() -> Effect:
    """Return an effect with its own state: a force that follows the speed with a lag."""

    def hook(s: Signals) -> None:
        s.rate["z"] = 0.2 * (s.x.v - s.x.z)
        s.rate["v"] = s.rate["v"] + s.p.k_lagging * s.x.z

    return Effect("lagging", "", {"rate": hook}, (Parameter("k_lagging", 0.0, step=0.01),), (State("z"),))


def test_long_record_is_processed_in_parts_of_whole_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The statistics equal those of the whole record. The states of effects continue from part to part."""
    fitted = fit_and_evaluate(slider(), [slide(11, 900, drag=0.1)], [])
    parameters, effects = fitted_parameters(fitted.model, 1), [PUSH, DRAG, TAPE, lagging()]

    def statistics() -> list[tuple[float, float]]:
        normal, places = normal_equations(fitted, fitted.records, effects, parameters)
        scores = score_tests(normal, no_priors(len(parameters)), places)
        return [(s.lm, s.lm_block) for s in scores]

    wanted = statistics()
    monkeypatch.setattr(score_test, "WHOLE", 0)
    monkeypatch.setattr(score_test, "PART", 120)
    rows = whole_blocks(fitted.records[0].t, ROBUST_BLOCK_S)
    assert len(rows) > 3
    assert all(a.stop == b.start for a, b in pairwise(rows))
    assert len({block_index(fitted.records[0].t[r], ROBUST_BLOCK_S)[0] for r in rows}) == len(rows)
    np.testing.assert_allclose(statistics(), wanted, rtol=1e-9)


@pytest.mark.study
def test_block_robust_test_keeps_its_size_for_coloured_innovations() -> None:
    """The model assumes too little process noise, so its innovations are autocorrelated. The plain test has far too
    many false alarms; the block-robust test does not.
    """
    calm = slider().replace_parameters(slider().parameter("q").at(0.4 * Q))
    plain, block = [], []
    for seed in range(N_SETS):
        s = score_of(slide(1000 + seed, 600), [PUSH], calm)[1][0]
        plain.append(s.p)
        block.append(s.p_block)
    assert np.mean(np.array(plain) < 0.05) > 0.2
    assert np.mean(np.array(block) < 0.05) < rate_bounds(0.05)[1]
    assert np.mean(np.array(block) < 0.5) == pytest.approx(0.5, abs=0.12)


def test_batches_of_columns_add_as_one_array() -> None:
    rng = np.random.default_rng(3)
    g, e, block = rng.standard_normal((60, 5)), rng.standard_normal(60), np.arange(60) // 20
    whole, batches = (NormalEquations([str(k) for k in range(6)]) for _ in range(2))
    at = [0, 4, 1, 5, 2]
    whole.add(at, g, e, block)
    batches.add(at, [g[:, :2], g[:, 2:3], g[:, 3:]], e, block)
    np.testing.assert_allclose(batches.information, whole.information, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(batches.score, whole.score, rtol=1e-12)
    np.testing.assert_allclose(batches.blocks[0], whole.blocks[0], rtol=1e-12)


def test_records_and_blocks_are_additive() -> None:
    rng = np.random.default_rng(1)
    g, e, t = rng.normal(size=(90, 3)), rng.normal(size=90), np.arange(90) * 0.5
    whole, parts = NormalEquations(["a", "b", "c"]), NormalEquations(["a", "b", "c"])
    whole.add([0, 1, 2], g, e, block_index(t))
    for rows in (slice(0, 30), slice(30, 90)):  # The split is at 15 s, where a block ends.
        parts.add([0, 1, 2], g[rows], e[rows], block_index(t[rows]))
    np.testing.assert_allclose(whole.information, g.T @ g)
    np.testing.assert_allclose(parts.score, -g.T @ e)
    blocks = np.concatenate(whole.blocks)
    assert len(blocks) == 45.0 / ROBUST_BLOCK_S
    np.testing.assert_allclose(np.concatenate(parts.blocks), blocks)
    np.testing.assert_allclose(blocks.sum(0), whole.score)


def test_prior_counts_as_information_of_a_fitted_parameter() -> None:
    """With a sharp prior, a fitted parameter cannot imitate the effect. The test then equals that of the column
    alone.
    """
    rng = np.random.default_rng(2)
    g, e = rng.normal(size=(400, 2)), rng.normal(size=400)
    g[:, 1] += 2 * g[:, 0]
    normal = NormalEquations(["fitted", "new"])
    normal.add([0, 1], g, e, block_index(np.arange(400) * 0.1))
    column = SensitivityColumns("new", np.zeros((1, 1, 1)), ("k",))
    (free,) = score_tests(normal, no_priors(1), [ColumnIndex(column, (1,))])
    (held,) = score_tests(normal, PriorTerms(np.zeros(1), np.array([1e12])), [ColumnIndex(column, (1,))])
    rest = g[:, 1] - g[:, 0] * (g[:, 0] @ g[:, 1]) / (g[:, 0] @ g[:, 0])
    # The score of the fitted parameter is not zero here, so its part is subtracted from both scores.
    assert free.lm == pytest.approx((rest @ e) ** 2 / (rest @ rest), rel=1e-9)
    assert held.lm == pytest.approx((g[:, 1] @ e) ** 2 / (g[:, 1] @ g[:, 1]), rel=1e-6)


@pytest.mark.parametrize("transform", ["none", "log"])
def test_fit_held_by_a_sharp_prior_is_at_the_maximum_of_the_posterior(transform: Any) -> None:
    """The prior is far from the truth, so the likelihood alone would move on. The posterior is at its maximum, and the
    score step to the effect equals the result of a fit with both.
    """
    drag = slider().parameter("d")
    held = replace(drag, value=1.3, prior=(1.3, 0.02), transform=transform)
    model, record = slider().replace_parameters(held), slide(21, 900)
    fitted = fit_and_evaluate(model, [record], [])
    parameters = fitted_parameters(fitted.model, 1)
    at = np.array([fitted.fit.estimate(p.name)[0] for p in parameters])
    normal, places = normal_equations(fitted, fitted.records, [PUSH], parameters)
    n = len(parameters)
    prior = prior_terms(parameters, at)
    error = 1 / np.sqrt(np.diag(normal.information)[:n] + prior.information)
    # The distance that the likelihood alone would move, in standard errors.
    assert np.abs(error * normal.score[:n]).max() > 2.0
    assert np.abs(error * (normal.score[:n] + prior.gradient)).max() < 0.2
    score = next(s for s in score_tests(normal, prior, places) if s.name == "push")
    both = fit_and_evaluate(fitted.fit.model + PUSH, [record], [])
    step, error = both.fit.estimate("k_push")
    assert score.step["k_push"] == pytest.approx(step, abs=0.1 * error)
    assert score.lm == pytest.approx(2 * (both.fit.log_posterior - fitted.fit.log_posterior), rel=0.05, abs=0.2)


def test_per_record_effect_may_have_opposite_signs() -> None:
    """Two records are pushed in opposite directions. A common push is not found; a push per record is found."""
    rng = np.random.default_rng(3)
    g = [rng.normal(size=(300, 2)) for _ in range(2)]
    e = [rng.normal(size=300) - sign * 0.5 * common[:, 1] for sign, common in zip((1, -1), g, strict=True)]
    shared = SensitivityColumns("shared", np.zeros((1, 1, 1)), ("k",))
    own = SensitivityColumns("own", np.zeros((1, 1, 1)), ("k",), per_record=True)
    places, total = assign_columns([shared, own], 1, 2)
    assert [p.at for p in places] == [(1,), (2, 3)]
    normal = NormalEquations([str(k) for k in range(total)])
    for i in range(2):
        at = [0] + [k for p in places for k in p.of_record(i)]
        normal.add(at, np.column_stack([g[i], g[i][:, 1]]), e[i], block_index(np.arange(300) * 0.1))
    common, separate = score_tests(normal, no_priors(1), places)
    assert (common.df, separate.df) == (1, 2)
    assert common.p > 0.01
    assert separate.p < 1e-20
    assert separate.step["k@0"] == pytest.approx(0.5, abs=0.2)
    assert separate.step["k@1"] == pytest.approx(-0.5, abs=0.2)


def test_difference_between_runs_is_tested_as_deviation_from_the_mean() -> None:
    """A push that all runs share is no difference between them. The refit of a difference cannot explain it either."""
    rng = np.random.default_rng(4)
    g = [rng.normal(size=(400, 1)) for _ in range(3)]

    def tested(pushes: list[float]) -> tuple[Score, Score]:
        """Return the scores of a push per record and of a difference between the records."""
        kinds = (EffectKind.CATALOGUE, EffectKind.BETWEEN_RUNS)
        columns = [SensitivityColumns(k.value, np.zeros((1, 1, 1)), ("k",), kind=k, per_record=True) for k in kinds]
        places, total = assign_columns(columns, 0, 3)
        normal = NormalEquations([str(k) for k in range(total)])
        noise = np.random.default_rng(5)
        for i, push in enumerate(pushes):
            at = [k for p in places for k in p.of_record(i)]
            e = noise.normal(size=400) - push * g[i][:, 0]
            normal.add(at, np.column_stack([g[i], g[i]]), e, block_index(np.arange(400) * 0.1))
        each, difference = score_tests(normal, no_priors(0), places)
        return each, difference

    each, difference = tested([0.5, 0.5, 0.5])
    assert each.p < 1e-20
    assert difference.df == 2
    assert difference.p > 0.01
    each, difference = tested([0.8, 0.5, 0.2])
    assert difference.p < 1e-8
    assert [difference.step[f"k@{i}"] for i in range(3)] == pytest.approx([0.3, 0.0, -0.3], abs=0.15)
    assert sum(difference.step.values()) == pytest.approx(0.0, abs=1e-12)
    # A likelihood-ratio test of the same hypothesis: least squares with one push per record against a common push.
    weight = np.array([float(x[:, 0] @ x[:, 0]) for x in g])
    push = np.array([each.step[f"k@{i}"] for i in range(3)])
    ratio = float(weight @ (push - weight @ push / weight.sum()) ** 2)
    assert difference.lm == pytest.approx(ratio, rel=0.1)


def test_difference_needs_two_runs_that_show_it() -> None:
    """A difference cannot be tested if the columns of all runs but one are zero."""
    columns = SensitivityColumns("d", np.zeros((1, 1, 1)), ("k",), kind=EffectKind.BETWEEN_RUNS, per_record=True)
    places, total = assign_columns([columns], 0, 2)
    normal = NormalEquations([str(k) for k in range(total)])
    g, e = np.random.default_rng(6).normal(size=(2, 200))
    for i, share in enumerate((1.0, 0.0)):
        normal.add(places[0].of_record(i), share * g[:, None], e, block_index(np.arange(200) * 0.1))
    assert score_tests(normal, no_priors(0), places) == []


@pytest.mark.parametrize("share", [1e-3, 1e-7, 1e-9])
def test_difference_of_a_run_that_hardly_shows_it_is_finite(share: float) -> None:
    """Without the common part, the information of the other run is zero or a rounding error."""
    columns = SensitivityColumns("d", np.zeros((1, 1, 1)), ("k",), kind=EffectKind.BETWEEN_RUNS, per_record=True)
    places, total = assign_columns([columns], 0, 2)
    normal = NormalEquations([str(k) for k in range(total)])
    g, e = np.random.default_rng(6).normal(size=(2, 200))
    for i, size in enumerate((1.0, share)):
        normal.add(places[0].of_record(i), size * g[:, None], e, block_index(np.arange(200) * 0.1))
    for score in score_tests(normal, no_priors(0), places):
        assert np.isfinite([score.lm, score.lm_block, *score.step.values()]).all()
