"""Tests on a local Dask cluster: plain tasks, and the commands, whose numbers are those of one process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest

import seatrial as st
from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.parallel import Workers, run_many
from seatrial.ident.results import ComparisonResult
from seatrial.ident.results.result_file import read_result
from seatrial.ident.studies.cases import make_case
from seatrial.ident.workflows import study
from seatrial.ident.workflows.compare import CompareRequest, compare_models
from tests.ident.parallel import chores
from tests.ident.reports import Kept
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")

THRUST = {"priors": {"c1": (40.0, 2.0)}, "fixed": {"c2": 1.1}}
QUICK = ("--prior", "c1=40:2", "--fix", "c2=1.1", "--no-score-tests")
VARIES = ["cpu", "memory", "worker"]  # columns that differ from run to run


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Start a local Dask cluster of two workers, each a process of its own."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0") as running:
        yield running


@pytest.fixture(scope="module")
def workers(cluster: Any) -> Workers:
    return Workers(backend="dask", scheduler=cluster.scheduler_address)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, boat = tmp_path_factory.mktemp("dask"), boat_with(None, 5)
    return [boat_log(folder / f"run{k}.mcap", boat, 30.0, 100 + k, k) for k in range(1, 4)]


def run(*words: object) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([str(w) for w in words])
    assert not left.value.code


def test_tasks_run_on_the_workers_of_a_dask_cluster(cluster: Any, workers: Workers) -> None:
    reporter = Kept()
    found = [o.value for o in run_many(range(12), chores.square, workers, reporter) if o.value]
    assert sorted(v for v, _ in found) == [k * k for k in range(12)]
    assert {p for _, p in found} == {w.pid for w in cluster.workers.values()}
    assert reporter.lines == ["Dask cluster of 2 workers"]
    assert not reporter.warnings


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_fleet_has_the_numbers_of_one_process(
    logs: list[Path], workers: Workers, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    st.fit_many(logs, score_tests=False, jobs=1, out=tmp_path / "alone", **THRUST)
    capsys.readouterr()
    where = ("--backend", "dask", "--scheduler", workers.scheduler)
    run("ident", "fleet", *logs, *QUICK, *where, "--out", tmp_path / "fleet")
    alone, there = (pyarrow.parquet.read_table(tmp_path / out / "fits.parquet") for out in ("alone", "fleet"))
    assert there.drop_columns(VARIES).equals(alone.drop_columns(VARIES))
    shown = capsys.readouterr()
    assert "Dask cluster of 2 workers" in shown.err
    assert "The model was fitted to 3 of 3 logs" in shown.out


def test_comparison_has_the_numbers_of_one_process(
    logs: list[Path], workers: Workers, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models = [st.fit(log, score_tests=False, **THRUST).save(tmp_path / log.stem) / "model.toml" for log in logs[:2]]
    alone = compare_models(CompareRequest(models, logs[1:], (2.0, 5.0), names=("a", "b")), "", Kept())
    capsys.readouterr()
    where = ("--backend", "dask", "--scheduler", workers.scheduler)
    on = ("--on", logs[1], "--on", logs[2], "--horizon", 2, "--horizon", 5)
    run("ident", "compare", *models, *on, *where, "--out", tmp_path / "out")
    shown = capsys.readouterr()
    assert "Dask cluster of 2 workers" in shown.err
    assert "4 of 4: " in shown.err
    there = read_result(tmp_path / "out/result.json")
    assert isinstance(there, ComparisonResult)
    for one, other in zip(alone.channels, there.channels, strict=True):
        assert [e.rms for e in other.errors] == pytest.approx([e.rms for e in one.errors], rel=1e-6)


def test_study_has_the_numbers_of_one_process(workers: Workers, tmp_path: Path) -> None:
    case = make_case("surge", seconds=30.0)
    alone = study.run_study(case, 6, 2, tmp_path / "alone.jsonl", workers=Workers(1))
    there = study.run_study(case, 6, 2, tmp_path / "dask.jsonl", workers=workers)
    assert [r["d"] for r in there] == [r["d"] for r in alone]


def test_dask_task_of_a_killed_worker_is_run_again(workers: Workers, tmp_path: Path) -> None:
    marks = [tmp_path / f"{'victim' if k == 1 else 'other'}{k}" for k in range(6)]
    found = list(run_many(marks, chores.die_once, workers))
    assert sorted(o.value or "" for o in found) == sorted(m.name for m in marks)


def test_workers_with_another_version_are_refused(workers: Workers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("seatrial.ident.parallel.workers.version", lambda name: "9.9")
    message = (
        r"worker tcp://\S+ has seatrial \S+, and this computer has 9\.9: pip install 'seatrial\[ident,dask\]==9\.9'"
    )
    with pytest.raises(SeatrialError, match=message):
        list(run_many(range(2), chores.square, workers))
