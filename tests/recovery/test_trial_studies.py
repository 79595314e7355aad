"""Tests of the studies of trials: smallest sizes, the next experiment, correct priors, and scatter between runs."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from seatrial.ident.diagnosis.certainty import NAME_RECORDS
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY
from seatrial.ident.numerics import normal_ppf
from seatrial.ident.results.parts import DiagnosisResult
from seatrial.mocks.offline_simulation import simulate
from seatrial.mocks.plant.boat import draw_boat
from tests.recovery import detectable_page, interval_study, prior_study
from tests.recovery.detectable_page import VARIANTS, Trial, model_of, segment, summary, table
from tests.recovery.kinds import Case, boat_of
from tests.recovery.next_experiment import competitor_limit, expected_probability, lead_of
from tests.recovery.resumable import read


def result(*rounds: tuple[str | None, dict[str, float]]) -> DiagnosisResult:
    """Return a stand-in for a result that has only rounds, each with the chosen effect and the criteria of refits."""
    rows = [
        SimpleNamespace(chosen=name, refits=[SimpleNamespace(name=n, criterion=c) for n, c in criteria.items()])
        for name, criteria in rounds
    ]
    return cast(DiagnosisResult, SimpleNamespace(rounds=rows))


def test_the_page_of_smallest_sizes_is_made_of_its_data() -> None:
    page = detectable_page.PAGE.read_text(encoding="utf-8")
    assert page == detectable_page.document(list(read(detectable_page.DATA).values()))


def test_tables_of_smallest_sizes() -> None:
    trials: Any = {
        ("base", 41): {"delay": {"tau_delay": 0.2}, "cg-offset": {"x_g": 0.4, "y_g": 0.01}},
        ("base", 42): {"delay": {"tau_delay": 0.4}, "cg-offset": {"x_g": 0.4, "y_g": 0.02}},
        ("longer", 41): {"delay": {"tau_delay": 0.1}, "accelerometer-scale": {"k_acc": 0.01}},
        ("longer", 42): {"delay": {"tau_delay": 0.2}, "accelerometer-scale": {}, "waves": {}},
    }
    lines = {line[0]: line for line in table(trials)}
    assert lines["delay"][1:5] == ["tau_delay", "0.25 s", "0.2 to 0.4", "0.1 to 0.2"]
    assert lines["cg-offset"][1] == "y_g"  # it shows best
    assert lines["cg-offset"][4] == "–"
    assert "waves" not in lines
    base, longer = summary(trials)[1:3]
    assert base[1:3] == ["1 of 3", "1.00"]  # the delay is too small on the second boat
    assert longer[1:] == ["1 of 3", "0.50", "delay (0.50), accelerometer-scale (new)"]


def test_the_second_heading_is_late_misaligned_and_noisy() -> None:
    boat = boat_of(Case("none", 41, "realistic-clean"))
    t = np.array([0.0])
    run = segment(boat, simulate(boat, t, np.array([[0.8, -0.2]]), 60.0, 1), VARIANTS["heading"], [41, 1])
    assert {"psi_gnss", "psi"} <= set(run.channels)
    assert "ax" not in run.channels
    seen = run.channels["psi_gnss"]
    true = simulate(boat, t, np.array([[0.8, -0.2]]), 60.0, 1).truth
    psi, r = (np.interp(seen.t, true["t"], np.unwrap(true[name])) for name in ("psi", "r"))
    late = next(e.parameters["latency"] for e in boat.effects if e.name == "gnss-latency")
    error = seen.value - psi + late * r - detectable_page.HEADING_OFFSET
    assert np.std(error) == pytest.approx(detectable_page.HEADING_SD, rel=0.15)
    assert abs(np.mean(error)) < 0.002
    model = model_of(VARIANTS["both"])
    assert [s.name for s in model.sensors][-1] == "gnss_heading"
    assert "ax" in [o.name for o in model.outputs]


def test_keys_of_trials_differ() -> None:
    assert len({Trial(seed, v).key for seed in (41, 42) for v in VARIANTS}) == 2 * len(VARIANTS)


def test_expected_probability_of_the_right_name() -> None:
    found = result(("wind", {"wind": 900.0, "lag": 200.0}), ("delay", {"delay": 60.0, "lag": 55.0}))
    assert lead_of(found, ("delay", "lag")) == 5.0
    assert lead_of(found, ("delay", "mount")) == 0.0
    assert competitor_limit(found, "delay") == DEFAULT_POLICY.max_distance
    unsure, sure = (NAME_RECORDS[how].probability for how in ("ambiguous", "identified"))
    assert expected_probability(found, ("delay", "lag"), 1e4) == pytest.approx(sure, abs=1e-4)
    assert expected_probability(found, ("delay", "lag"), 1e-9) == pytest.approx(unsure, abs=1e-4)
    # The lead reaches the limit of 10 on average if T is 5.
    assert expected_probability(found, ("delay", "lag"), 5.0) == pytest.approx((sure + unsure) / 2, abs=1e-4)
    strong = result(("delay", {"delay": 4000.0, "lag": 3900.0}))
    assert competitor_limit(strong, "delay") == pytest.approx(0.05 * 4000.0 * 650.0 / 400.0)


def test_correct_priors_are_measurements_of_the_truth() -> None:
    z = []
    for case in prior_study.cases("all", 40):
        true = draw_boat(case.boat.seed).truth()
        z += [(mean - true[name]) / sd for name, (mean, sd) in case.priors().items()]
    assert np.mean(z) == pytest.approx(0.0, abs=3 / math.sqrt(len(z)))
    assert np.std(z) == pytest.approx(1.0, abs=0.1)
    assert all(set(case.priors()) == {"c1"} for case in prior_study.cases("thrust", 2))


def test_warnings_about_correct_priors_are_counted() -> None:
    quiet = {"key": "all/clean/none/1", "distance": {"c1": 1.0, "m_u": -1.0}, "warnings": 0}
    loud = {"key": "thrust/clean/none/1", "distance": {"c1": 4.0}, "warnings": 1}
    lines = prior_study.table([quiet, loud])
    assert [line[3:5] for line in lines[1:]] == [["2", "0"], ["1", "1"], ["3", "1"]]
    assert lines[-1][-1] == f"{math.sqrt(18 / 3):.2f}"
    assert not prior_study.decided([quiet])
    assert prior_study.decided([quiet] * 200)  # none of 400
    assert prior_study.decided([loud] * 10)


def test_at_most_one_warning_in_a_hundred_correct_priors() -> None:
    rows = [r for r in read(prior_study.OUT).values() if "error" not in r]
    n, warned = prior_study.counts(rows)
    assert n > 300
    assert warned / n <= prior_study.MOST


def test_scatter_between_runs_is_estimated_beside_that_of_few_errors() -> None:
    rng, rows = np.random.default_rng(7), []
    for k in range(400):
        n = rng.uniform(20.0, 80.0, size=2)
        scales = np.exp(0.15 * rng.standard_normal(2)) * np.sqrt(rng.chisquare(n) / n)
        runs = [{"horizon": {"r": [scale, number]}} for scale, number in zip(scales.tolist(), n.tolist(), strict=True)]
        rows.append({"key": f"boat{k}/auto", "runs": runs})
    count, total, sampling = interval_study.scatter(rows)
    assert count == 400
    assert interval_study.run_scatter(total, sampling) == pytest.approx(0.15, abs=0.02)
    assert interval_study.run_scatter(sampling, sampling) == 0.0


def test_scatter_between_boats_is_estimated_beside_few_errors_of_a_run() -> None:
    rng, rows = np.random.default_rng(8), []
    quantiles = np.abs(half_normal(interval_study.GRID))
    for k in range(3000):
        own = 0.4 * rng.standard_normal()
        scales = np.exp(own + 0.3 * rng.standard_normal(2))
        runs = [{"simulation": {"r": [scale, 5.0, (scale * quantiles).tolist()]}} for scale in scales.tolist()]
        rows.append({"key": f"boat{k}/auto", "runs": runs})
    assert interval_study.boat_scatter(rows) == pytest.approx(0.4, abs=0.03)
    plain, widened = np.mean(interval_study.coverage(rows, "simulation"), axis=0)
    assert plain < 0.9
    assert 0.93 < widened < 0.97
    assert interval_study.coverage_by_other_boats(rows[:40]) == pytest.approx(widened, abs=0.04)


def half_normal(share: np.ndarray) -> np.ndarray:
    """Return the value below which the absolute value of a standard normal variable is with a probability."""
    return np.minimum(normal_ppf(0.5 + 0.5 * share), interval_study.DIVERGED)
