"""Tests of the Monte Carlo study: its simulation against known truths, its statistics on artificial rows, and its
command.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet
import pytest

from seatrial import command_line
from seatrial.ident.data.record import Record
from seatrial.ident.estimation.fisher_scoring import Bounds
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.stochastic_simulation import SampledInputs, simulate_stochastic
from seatrial.ident.model.parameter import INF, Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.parallel import TaskOutcome, Workers
from seatrial.ident.report.study_page import study_as_text
from seatrial.ident.reporter import QUIET
from seatrial.ident.studies.cases import CASES, make_case
from seatrial.ident.studies.monte_carlo import (
    Row,
    count_replicates,
    hashed_files,
    read_replicates,
    run_replicates,
    summarise,
    variance_change_by_bounds,
)
from seatrial.ident.workflows import study
from seatrial.ident.workflows.study_table import write_replicates
from tests.ident import page_examples
from tests.ident.reports import Kept


def values_of(model: Model, n: int = 1) -> np.ndarray:
    return np.tile(list(model.values.values()), (n, 1))


def drifting() -> Model:
    """Return a model of an Ornstein-Uhlenbeck state with an input, and its integral."""
    return plain_model(
        "drifting",
        f=lambda x, u, p: {"v": (u.w - x.v) / p.tau, "s": x.v},
        h=lambda x, u, p: {"y": x.s},
        states=(State("v", noise="q", sd0=0.4), State("s", sd0=0.0)),
        inputs=(Input("w", hold="linear"),),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("tau", 2.0), Parameter("q", 0.3), Parameter("e", 0.05)),
    )


def test_simulated_noise_has_the_variance_of_the_equation() -> None:
    """Check mean and stationary variance of an Ornstein-Uhlenbeck process and the variance of its integral (Gardiner
    2009, 3.8.4).
    """
    model, t, n = drifting(), np.arange(0.0, 12.05, 0.1), 1500
    inputs = SampledInputs.linear(t, np.ones((t.size, 1)))
    rngs = [np.random.default_rng([1, k]) for k in range(n)]
    x, y = simulate_stochastic(model, inputs, values_of(model, n), rngs, x0=np.zeros((n, 2)))
    assert x.shape == (n, t.size, 2)
    k, tau, q = 60, 2.0, 0.3
    decay = np.exp(-t[k] / tau)
    variance = q**2 * tau / 2 * (1 - decay**2)
    assert x[:, k, 0].mean() == pytest.approx(1 - decay, abs=4 * np.sqrt(variance / n))
    assert x[:, k, 0].var() == pytest.approx(variance, rel=4 * np.sqrt(2 / n))
    travelled = q**2 * tau**2 * (t[k] - 2 * tau * (1 - decay) + tau / 2 * (1 - decay**2))
    assert x[:, k, 1].var() == pytest.approx(travelled, rel=4 * np.sqrt(2 / n))
    assert (y[:, k, 0] - x[:, k, 1]).std() == pytest.approx(0.05, rel=0.1)
    started, _ = simulate_stochastic(model, inputs, values_of(model, n), rngs)
    assert started[:, 0, 0].std() == pytest.approx(0.4, rel=0.1)


@pytest.mark.parametrize("name", ["surge", "yaw", "horizontal", "kinematic"])
def test_simulation_without_noise_equals_that_of_the_engine(name: str) -> None:
    """The two integrators are independent."""
    case = make_case(name, seconds=40.0)
    model = case.model.with_values({p: 1e-12 for p in case.model.values if p[:2] in ("s_", "e_")})
    still = [replace(s, noise=s.noise if isinstance(s.noise, str) else 0.0) for s in model.states]
    model = replace(model, states=tuple(still))
    x0 = np.zeros((1, len(model.states)))
    x, y = simulate_stochastic(model, case.inputs, values_of(model), [np.random.default_rng(0)], x0=x0)
    record = Record(
        name,
        case.inputs.t,
        case.inputs.u,
        case.inputs.u_next,
        np.full(y[0].shape, np.nan),
        tuple(i.name for i in model.inputs),
        tuple(o.name for o in model.outputs),
    )
    engine = simulate(model, record, x0=x0[0])
    np.testing.assert_allclose(x[0], engine.x, atol=2e-4)
    np.testing.assert_allclose(y[0], engine.y, atol=1e-3)


def test_replicate_is_independent_of_the_other_replicates() -> None:
    case = make_case("yaw", seconds=60.0)
    together, alone = run_replicates(case, [0, 1, 2], 7), run_replicates(case, [2], 7)
    assert together[2]["k"] == 2
    assert together[2]["d"] == pytest.approx(alone[0]["d"], abs=1e-9)
    assert together[1]["d"] != together[2]["d"]
    assert run_replicates(case, [2], 8)[0]["d"] != alone[0]["d"]


@pytest.mark.study
def test_prediction_error_estimates_are_right_and_output_error_estimates_are_not() -> None:
    case = make_case("yaw", seconds=120.0)
    right = {j.name: j for j in summarise(run_replicates(case, range(80), 3))}
    for name in ("m_r", "d_r", "d_rr"):
        j = right[name]
        assert abs(j.bias) < 4 * j.bias_error, name
        assert j.ratio_interval[0] < 1.1, name
        assert j.ratio_interval[1] > 0.9, name
        assert j.coverage_interval[1] > 0.95, name
    wrong = {j.name: j for j in summarise(run_replicates(case, range(60), 3, "output-error"))}
    assert wrong["m_r"].ratio > 3
    assert {"variance", "coverage"} <= set(wrong["m_r"].misses)


def test_considered_parameter_is_drawn_for_each_replicate() -> None:
    """Otherwise a study of a fit with this parameter would find its errors many times too large."""
    case = make_case("yaw", free=("m_r", "d_r"), seconds=60.0)
    d_rr = case.model.parameter("d_rr")
    d_rr = replace(d_rr, bounds=(-INF, INF), considered=True, prior=(d_rr.value, 3.0))
    rows = run_replicates(replace(case, model=case.model.replace_parameters(d_rr)), range(60), 3)
    found = {j.name: j for j in summarise(rows)}["d_r"]
    assert found.coverage > 0.85
    for ratio in (found.ratio, found.bound_ratio):
        assert 0.6 < ratio < 1.6


def made_up(d: np.ndarray, se: float, bound: float = 1.0) -> list[Row]:
    return [
        {
            "converged": True,
            "cpu": 1.0,
            "simulation": 2.0,
            "d": {"a": float(x), "b": 0.0},
            "se": {"a": se, "b": None},
            "far": {"a": None, "b": None},
            "bound": {"a": bound, "b": None},
        }
        for x in d
    ]


@pytest.mark.study
def test_output_error_covers_without_process_noise(tmp_path: Path) -> None:
    """If the first sample was taken as the exact start, three of four intervals missed the truth."""
    request = study.StudyRequest(
        ["surge"], 60, 1, tmp_path, "output-error", truth={"s_u": 1e-9, "d_u": 8.4}, workers=Workers(1)
    )
    result = study.run_studies(request, "test", QUIET)
    (part,) = result.studies
    assert [p.name for p in part.parameters] == ["m_u", "d_u", "d_uu", "e_x"]
    for p in part.parameters:
        assert p.n == 60
        assert p.coverage_high > 0.95, p.name
        assert p.ratio_low < 1.1, p.name


def test_statistics_of_a_study() -> None:
    d = np.array([-1.0, 0.0, 1.0, 2.0, 3.0])
    (j,) = summarise([*made_up(d, 1.0, 2.0), {"converged": False, "cpu": 1.0, "simulation": 2.0}])
    assert (j.name, j.n, j.at_bound) == ("a", 5, 0)
    assert j.sd == pytest.approx(np.sqrt(2.5))
    assert j.bias == pytest.approx(1 / np.sqrt(2.5))
    assert j.ratio == pytest.approx(2.5)
    assert j.bound_ratio == pytest.approx(2.5 / 4)
    assert j.coverage == pytest.approx(3 / 5)
    # The interval is from the table of Clopper and Pearson.
    assert j.coverage_interval == pytest.approx((0.1466, 0.9473), abs=1e-3)
    assert j.ratio_interval == pytest.approx((2.5 * 4 / 11.143, 2.5 * 4 / 0.4844), rel=1e-3)
    assert j.bound_interval == pytest.approx((0.625 * 4 / 11.143, 0.625 * 4 / 0.4844), rel=1e-3)
    assert j.misses == ("bias (chance?)", "variance (chance?)", "coverage (chance?)")
    rows = [*made_up(d, 1.0), {"converged": False, "cpu": 1.0, "simulation": 2.0}, {"error": "no", "simulation": 2.0}]
    found = count_replicates(rows)
    assert (found.replicates, found.failed, found.unconverged) == (7, 1, 1)


def test_failed_and_unconverged_fits_are_in_the_verdict() -> None:
    """The statistics of the remaining fits may look right."""
    result = page_examples.study()
    fine, _, none = result.studies
    for failed, unconverged, message in (
        (0, 0, "surge, 500 replicates: 2 of 2"),
        (0, 1, "surge, 500 replicates, of which 1 did not converge: 2 of 2 parameters meet the aims"),
        (50, 300, "of which 50 failed and 300 did not converge: too many for a verdict."),
    ):
        part = msgspec.structs.replace(fine, failed=failed, unconverged=unconverged)
        assert message in study.study_answer(part)
        text = study_as_text(msgspec.structs.replace(result, studies=(part,)))
        assert ("left out of the table: " in text) == bool(failed + unconverged)
    assert study.study_answer(none) == "none: no replicate can be judged: 1 did not converge."


def test_hash_of_a_study_covers_all_code_that_it_runs() -> None:
    """If a package was left out, samples of different code were mixed without a warning."""
    names = {path.name for path in hashed_files()}
    assert {"thrust_history.py", "sensor_noise.py", "optimal_design.py", "likelihood.py"} <= names


def test_misses_beyond_chance_are_reported() -> None:
    rng = np.random.default_rng(4)
    (fine,) = summarise(made_up(rng.normal(size=20_000), 1.0))
    assert fine.misses == ()
    (poor,) = summarise(made_up(0.5 + 1.5 * rng.normal(size=2000), 1.0))
    assert poor.misses == ("bias", "variance", "coverage")


def test_estimate_at_its_bound_has_a_one_sided_interval() -> None:
    """The estimates are normal, and the truth is 1.3 standard deviations above a bound.

    The one-sided interval of an estimate at the bound ends where the likelihood drops by 1.92, and the study counts its
    coverage.
    """
    rng, rows = np.random.default_rng(2), []
    for free in rng.normal(size=4000):
        stuck = free < -1.3
        far = -1.3 + 3.8415 / (-(free + 1.3) + np.sqrt((free + 1.3) ** 2 + 3.8415)) if stuck else None
        rows.append(
            {
                "converged": True,
                "cpu": 1.0,
                "simulation": 2.0,
                "d": {"a": max(float(free), -1.3)},
                "se": {"a": None if stuck else 1.0},
                "far": {"a": far},
                "bound": {"a": 0.918},
            }
        )
    (j,) = summarise(rows)
    assert (j.n, j.at_bound) == (4000, sum(r["se"]["a"] is None for r in rows))
    assert j.misses == ()
    assert j.ratio < 0.95  # The reported variance is not that of an estimate that is clipped.


def test_least_variance_near_a_bound_is_that_of_a_clipped_normal() -> None:
    """The bound is 1.3 standard deviations away. Far from a bound, the least variance is the Cramér-Rao bound."""
    P = np.array([[1.0, -0.9], [-0.9, 1.0]])
    bounds = Bounds(np.array([-np.inf, 0.0]), np.full(2, np.inf), np.zeros(2, dtype=bool))
    taken = [
        variance_change_by_bounds(np.linalg.inv(P), P, np.array([0.0, 1.3]), bounds, np.random.default_rng(k))
        for k in range(40)
    ]
    least = 1.0 + np.mean(taken, axis=0)
    assert least[1] == pytest.approx(0.842, abs=0.02)  # E max(z, -1.3)^2 - (E max(z, -1.3))^2
    assert least[0] == pytest.approx(1 - 0.81 * (1 - 0.842), abs=0.02)
    assert (
        variance_change_by_bounds(np.linalg.inv(P), P, np.array([0.0, 9.0]), bounds, np.random.default_rng(1)) == 0.0
    ).all()


@pytest.mark.study
def test_interrupted_study_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case, out = make_case("surge", seconds=60.0), tmp_path / "surge.jsonl"
    first = study.run_study(case, 4, 2, out, workers=Workers(1))
    lines = out.read_text().splitlines()
    out.write_text("\n".join([lines[0], lines[1], json.dumps({**json.loads(lines[2]), "error": "x"}), lines[3][:50]]))
    done: list[int] = []
    monkeypatch.setattr(
        study,
        "run_replicates",
        lambda case, numbers, *rest: done.extend(numbers) or run_replicates(case, numbers, *rest),
    )
    out.write_text(out.read_text() + "\n")
    again = study.run_study(case, 4, 2, out, workers=Workers(1))
    assert done == [2, 3]
    for a, b in zip(first, again, strict=True):
        assert a["d"] == pytest.approx(b["d"], abs=1e-9)
    done.clear()
    study.run_study(case, 4, 3, out, workers=Workers(1))  # Another seed is another study.
    assert done == [0, 1, 2, 3]


def test_killed_study_keeps_finished_replicates(tmp_path: Path) -> None:
    """Lines are written within seconds, not only after a hundred replicates."""
    out = tmp_path / "yaw.jsonl"
    words = ["ident", "study", "yaw", "--replicates", "2000", "--jobs", "1", "--out", str(tmp_path)]
    running = subprocess.Popen([sys.executable, "-m", "seatrial", *words], stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + 120.0
        while not read_replicates(out):
            assert time.monotonic() < until
            assert running.poll() is None
            time.sleep(0.02)
    finally:
        running.kill()
        running.wait()
    found = read_replicates(out)
    assert 1 <= len(found) < 20
    assert [r["k"] for r in found] == list(range(len(found)))
    reporter = Kept()
    study.run_study(make_case("yaw"), len(found), 1, out, workers=Workers(1), reporter=reporter)
    assert reporter.lines == [f"yaw: {len(found)} replicates exist already"]


def test_tasks_are_sized_by_their_duration() -> None:
    def sizes(simulation: float, fit: float) -> list[int]:
        pace, found = study._TaskSize(range(200)), []
        for task in pace.tasks():
            found.append(len(task))
            rows: list[Row] = [{"k": k, "simulation": simulation / len(task)} for k in task]
            pace.adapt(rows, simulation + fit * len(task))
        assert sum(found) == 200
        return found

    assert sizes(1.0, 1.5)[:4] == [1, 2, 4, 6]  # Each task takes 10 s.
    assert set(sizes(1.0, 1000.0)) == {1}
    assert sizes(0.1, 0.001)[:6] == [1, 2, 4, 8, 16, study.BATCH]
    assert sizes(20.0, 2.0)[3:6] == [8, 10, 10]  # Tasks of one replicate would need ten times as many simulations.


@pytest.mark.parametrize("backend", ["threading", "multiprocessing"])
def test_study_runs_on_any_joblib_backend(backend: str, tmp_path: Path) -> None:
    """One backend returns results as they come, the other after each batch."""
    import joblib

    case = make_case("surge", seconds=30.0)
    with joblib.parallel_config(backend=backend, n_jobs=2):
        rows = study.run_study(case, 3, 2, tmp_path / "a.jsonl")
    alone = study.run_study(case, 3, 2, tmp_path / "b.jsonl", workers=Workers(1))
    assert [r["d"] for r in rows] == [r["d"] for r in alone]


def test_replicates_of_a_dead_process_are_failures_that_the_next_run_repeats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, run_many = make_case("surge", seconds=30.0), study.run_many

    def dying(tasks: Iterable[Sequence[int]], *rest: Any) -> Iterator[TaskOutcome[Any, Any]]:
        for outcome in run_many(tasks, *rest):
            yield TaskOutcome(outcome.task, None, "its process died 3 times") if 0 in outcome.task else outcome

    monkeypatch.setattr(study, "run_many", dying)
    rows = study.run_study(case, 3, 2, tmp_path / "a.jsonl", workers=Workers(1))
    assert [r["k"] for r in rows if r.get("error") == "its process died 3 times"] == [0]
    assert count_replicates(rows).failed == 1
    monkeypatch.setattr(study, "run_many", run_many)
    again = study.run_study(case, 3, 2, tmp_path / "a.jsonl", workers=Workers(1))
    assert count_replicates(again).failed == 0


def test_cases_and_their_options() -> None:
    for name in CASES:
        case = make_case(name, seconds=20.0)
        assert case.inputs.t[-1] == pytest.approx(20.0)
        assert case.inputs.u.shape == (case.inputs.t.size, len(case.model.inputs))
    assert make_case("surge", {"d_u": 3.0}).model.values["d_u"] == 3.0
    assert make_case("surge", free=["s_u"]).model.free == ("s_u",)
    assert make_case("surge", bounded=False).model.parameter("d_u").bounds[0] == -np.inf


def test_study_uses_the_estimator_of_the_commands_by_default(tmp_path: Path) -> None:
    for name in ("surge", "yaw", "horizontal", "kinematic"):
        case = make_case(name, seconds=20.0)
        assert case.reml
        assert case.model.second_order
    noise = make_case("noise", seconds=20.0)  # The defaults are those of `ident noise`.
    assert not noise.reml
    assert not noise.model.second_order
    how = {"first": {"mean_order": 1}, "both": {}, "plain": {"reml": False, "mean_order": 1}}
    cases = {name: make_case("surge", seconds=60.0, **flags) for name, flags in how.items()}
    done = {
        name: study.run_study(case, 3, 1, tmp_path / "one.jsonl", workers=Workers(1)) for name, case in cases.items()
    }
    assert len((tmp_path / "one.jsonl").read_text().splitlines()) == 9  # No study was resumed as another.
    s_u = {name: [r["d"]["s_u"] for r in rows] for name, rows in done.items()}
    assert all(a > b + 0.01 for a, b in zip(s_u["first"], s_u["plain"], strict=True))
    d_u = {name: [r["d"]["d_u"] for r in rows] for name, rows in done.items()}
    assert all(abs(a - b) > 1e-5 for a, b in zip(d_u["first"], d_u["both"], strict=True))
    words = [study.estimator(cases[name], "prediction-error") for name in ("both", "plain")]
    assert words[0].endswith("by restricted likelihood, filter's mean of second order")
    assert words[1].endswith("by maximum likelihood, filter's mean of first order")


@pytest.mark.study
def test_studies_of_noise_and_kinematic_models() -> None:
    """The data come from each model itself. The estimates are unbiased, and their intervals cover the truth."""
    for name, n, seconds in (("noise", 40, 100.0), ("kinematic", 12, 120.0)):
        case = make_case(name, seconds=seconds)
        rows = run_replicates(case, range(n), 3)
        assert count_replicates(rows).failed == count_replicates(rows).unconverged == 0
        found = summarise(rows)
        assert {j.name for j in found} == set(case.model.free)
        for j in found:
            assert abs(j.bias) < 4 * j.bias_error, j.name
            assert j.coverage_interval[1] > 0.94, j.name
            assert j.bound_interval[0] < 1.2, j.name


def test_attitude_of_a_case_is_the_integral_of_its_rates() -> None:
    """Euler angles are integrated from the body rates (Fossen 2011, eq. 2.28)."""
    case = make_case("kinematic", seconds=60.0)
    t, u = case.inputs.t, case.inputs.u
    phi, theta, psi, p, q, r = u[:, 2:].T
    rates = (
        p + np.tan(theta) * (np.sin(phi) * q + np.cos(phi) * r),
        np.cos(phi) * q - np.sin(phi) * r,
        (np.sin(phi) * q + np.cos(phi) * r) / np.cos(theta),
    )
    for angle, rate in zip((phi, theta, psi), rates, strict=True):
        travelled = np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(t)))
        np.testing.assert_allclose(travelled, angle - angle[0], atol=0.02 * np.ptp(angle) + 0.005)
    assert np.ptp(psi) > 1.0


def test_study_command_writes_result_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["ident", "study", "surge", "--replicates", "6", "--seconds", "60", "--jobs", "1", "--out", str(tmp_path)]
    outputs, page = [], tmp_path / "docs/study.md"
    for more in ([], ["--docs", str(page)]):
        with pytest.raises(SystemExit) as leaving:
            command_line.main([*words, *more])
        assert not leaving.value.code
        outputs.append(capsys.readouterr())
    assert "surge, PE: 60 s" in outputs[0].out
    assert "6 of 6 replicates" in outputs[0].err
    assert "6 replicates exist already" in outputs[1].err
    assert "noise by restricted likelihood, filter's mean of second order" in outputs[0].out
    assert page.read_text().startswith("# Monte Carlo study")
    assert "](pictures/study-surge.svg)" in page.read_text()
    assert page.read_text().replace(f" --docs {page}", "") == (tmp_path / "study.md").read_text().replace(
        f" --docs {page}", ""
    )
    drawn = (tmp_path / "docs/pictures/study-surge.svg").read_text()
    assert drawn == (tmp_path / "pictures/study-surge.svg").read_text()
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["kind"], result["seed"]) == ("study", 1)
    (part,) = result["studies"]
    assert [p["name"] for p in part["parameters"]] == ["m_u", "d_u", "d_uu", "s_u", "e_x"]
    lines = [json.loads(line) for line in (tmp_path / "surge.jsonl").read_text().splitlines()]
    assert len(lines) == 6
    table = pyarrow.parquet.read_table(tmp_path / "replicates.parquet")
    assert json.loads(table.schema.metadata[b"seatrial.settings"])["seed"] == 1
    rows = [r for r in table.to_pylist() if r["replicate"] == 3]
    assert [r["parameter"] for r in rows] == ["m_u", "d_u", "d_uu", "s_u", "e_x"]
    (mass,), (replicate,) = [r for r in rows if r["parameter"] == "m_u"], [x for x in lines if x["k"] == 3]
    assert mass["deviation"] == replicate["d"]["m_u"]
    assert mass["truth"] == next(p["truth"] for p in part["parameters"] if p["name"] == "m_u")
    assert mass["logarithmic"]
    assert np.log(mass["value"] / mass["truth"]) == pytest.approx(mass["deviation"])
    assert table.num_rows == 6 * 5


def test_table_of_all_studies_has_failed_replicates_and_drawn_truths(tmp_path: Path) -> None:
    surge, plane = make_case("surge"), make_case("horizontal")
    names = [*plane.model.free, "x0_u"]
    fitted = {"k": 0, "simulation": 0.1, "converged": True, "iterations": 3, "cpu": 1.0, "code": "c",
              "d": dict.fromkeys(names, 0.0), **{n: dict.fromkeys(names) for n in ("se", "bound", "far")},
              "flags": {"d_u": "at its bound"}}  # fmt: skip
    failed = {"k": 1, "simulation": 0.1, "code": "c", "error": "LinAlgError: singular"}
    path = tmp_path / "replicates.parquet"
    write_replicates(path, [(surge, [failed]), (plane, [fitted])], 4, "output-error", "1.0")
    rows = pyarrow.parquet.read_table(path).to_pylist()
    assert [(rows[0][n]) for n in ("study", "replicate", "parameter", "error")] == ["surge", 1, None, failed["error"]]
    by_name = {r["parameter"]: r for r in rows[1:]}
    assert by_name["V_x"]["truth"] is None  # drawn for each replicate
    assert by_name["x0_u"]["value"] is None
    assert by_name["d_u"]["flag"] == "at its bound"
    assert by_name["m_u"]["value"] == pytest.approx(plane.model.values["m_u"])


def test_study_without_pyarrow_says_what_it_leaves_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "find_spec", lambda name: None)
    reporter = Kept()
    request = study.StudyRequest(["surge"], 3, 1, tmp_path, seconds=60.0, workers=Workers(1))
    study.run_studies(request, "test", reporter)
    assert not (tmp_path / "replicates.parquet").exists()
    assert "replicates.parquet is not written" in reporter.lines[-1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("boat", "no study of 'boat': there are surge, yaw, horizontal, kinematic, thruster, noise"),
        ("surge --truth m_x=1", "has no parameter 'm_x'"),
        ("surge --truth d_u=-1", "outside its bounds"),
        ("surge --free nothing", "has no parameter 'nothing'"),
    ],
)
def test_impossible_study_gives_a_one_line_error(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        command_line.main(["ident", "study", *words.split(), "--out", str(tmp_path)])
    err = capsys.readouterr().err
    assert leaving.value.code == 1
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize("jobs", ["0", "-2"])
def test_number_of_processes_is_positive_or_minus_one(
    jobs: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit) as leaving:
        command_line.main(["ident", "study", "surge", "--jobs", jobs, "--out", str(tmp_path)])
    assert leaving.value.code == 2
    assert "is not a number of processes; give 1 or more, or -1" in capsys.readouterr().err
    asked: list[int] = []
    monkeypatch.setattr(study, "run_study", lambda *args, workers, **more: asked.append(workers.jobs) or [])
    for words in ([], ["--jobs", "-1"], ["--jobs", "3"]):
        with pytest.raises(SystemExit):
            command_line.main(["ident", "study", "surge", *words, "--out", str(tmp_path)])
    assert asked == [-1, -1, 3]


def test_snippet_of_the_how_to_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The snippet runs in this process instead of on a cluster, and with fewer replicates."""
    text = (Path(__file__).parents[3] / "docs/how-to/study.md").read_text(encoding="utf-8")
    own, table, block = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    file = (Path(__file__).parents[3] / "docs/examples/own_study.py").read_text(encoding="utf-8")
    assert own.split() == re.sub("  # .*", "", file.partition('"""\n')[2]).split()
    assert make_case("docs/examples/own_study.py:calm").name == "calm"
    code = block.replace('Workers(backend="dask", scheduler="tcp://192.168.1.5:8786")', "Workers(1)")
    code = code.replace("study(case, 500", "study(case, 2")
    assert code.count("Workers(1)") == code.count("study(case, 2") == 1
    monkeypatch.chdir(tmp_path)
    found: dict[str, object] = {}
    exec(compile(code, "study.md", "exec"), found)
    assert len(found["rows"]) == 2
    assert (tmp_path / "mine.jsonl").exists()
    request = study.StudyRequest(["surge"], 3, 1, tmp_path / "study", seconds=60.0, workers=Workers(1))
    study.run_studies(request, "test", QUIET)
    exec(compile(table, "study.md", "exec"), found)
    assert len(found["fitted"]) > 5


def test_make_study_and_its_page_cover_every_model() -> None:
    root = Path(__file__).parents[3]
    recipe = (root / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    words = next(line for line in recipe if " ident study " in line).split()
    assert set(CASES) - {"designed"} <= set(words)
    replicates = words[words.index("--replicates") + 1]
    assert int(replicates) >= 500
    page = root / words[words.index("--docs") + 1]
    text = page.read_text(encoding="utf-8")
    assert f"--replicates {replicates} " in text.splitlines()[2]
    for name in set(CASES) - {"designed"}:
        section = text.partition(f"## {name}, PE\n")[2].partition("\n## ")[0]
        assert f"; {replicates} replicates, 0 failed, " in section
        assert f"](pictures/study-{name}.svg)" in section
        drawn = (page.parent / f"pictures/study-{name}.svg").read_text(encoding="utf-8")
        listed = re.findall(r"^\| (\w+) \| \d", section, re.MULTILINE)
        assert set(listed) == set(make_case(name, seconds=20.0).model.free)
        assert all(f">{parameter}</text>" in drawn for parameter in listed)
