"""Workflow of `seatrial ident study`: Monte Carlo study of the estimator on simulated missions.

A replicate is one simulated mission and the fit to it. Replicates run in parallel, and each is stored as one line of
JSON. At the end all replicates are also one Parquet file. The summary is written to result.json and to a page,
study.md.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import append_to
from seatrial.ident.estimation import Method
from seatrial.ident.parallel import Workers, run_many
from seatrial.ident.report import write_study_docs
from seatrial.ident.reporter import QUIET, Reporter
from seatrial.ident.results import ModelStudy, ParameterStudy, StudyResult, finite, provenance, write_result
from seatrial.ident.studies import (
    Case,
    ParameterCoverage,
    Row,
    count_replicates,
    estimator_code_hash,
    make_case,
    read_replicates,
    run_replicates,
    summarise,
)
from seatrial.ident.workflows.study_table import write_replicates

REPLICATES = "replicates.parquet"
BATCH = 25  # largest number of replicates in a task, which are simulated together
TASK_S = 10.0  # s: aim for the CPU time of a task; its replicates are lost if the study is stopped before its end
ROWS = 3  # version of the content of a line of JSON
ANY_WORKERS = Workers()  # those of ``joblib.parallel_config``


def run_study(
    case: Case,
    n: int,
    seed: int,
    out: Path | str,
    *,
    method: Method = "prediction-error",
    workers: Workers = ANY_WORKERS,
    reporter: Reporter = QUIET,
) -> list[Row]:
    """Run the replicates of a Monte Carlo case that are missing in the file ``out``, and return all replicates.

    A replicate is one simulated mission and the fit to it. Stored replicates are used only if mission, model, true
    values, seed and estimator are the same.

    Parameters
    ----------
    case : Case
        Mission, model and true values of its parameters.
    n : int
        Number of replicates.
    seed : int
        Seed of all random draws.
    out : Path or str
        File of JSON lines; new replicates are appended as soon as they are done. Its folder is created. Replicates of
        other studies in the file stay there and are not used.
    method : str
        ``prediction-error`` or ``output-error``.
    workers : Workers, optional
        Processes that run the replicates; by default those of ``joblib.parallel_config``. The numbers do not depend on
        them.
    reporter : Reporter
        Receives progress, and a warning if used replicates of ``out`` come from another version of the code.

    Returns
    -------
    list of Row
        Replicates 0 to n - 1, in order: dictionaries with the estimates, as from ``run_replicates``. A failed replicate
        has the key ``error`` instead, and is run again by the next call.
    """
    key, out = _study_key(case, seed, method), Path(out)
    done = {r["k"]: r for r in read_replicates(out) if r["key"] == key and r["k"] < n}
    todo = [k for k in range(n) if k not in done]
    if done:
        reporter.progress(f"{case.name}: {len(done)} replicates exist already")
        if any(r["code"] != estimator_code_hash() for r in done.values()):
            reporter.warning(
                f"{out}: some replicates are from another version of the code; give another --out to start again"
            )
    with append_to(out) as file:
        for rows in _rows_by_task(case, todo, seed, method, workers, reporter):
            for row in rows:
                done[row["k"]] = row | {"key": key, "code": estimator_code_hash()}
                file.write(json.dumps(done[row["k"]]) + "\n")
            file.flush()
            reporter.progress(f"{case.name}: {len(done)} of {n} replicates")
    return [done[k] for k in sorted(done)]


def _rows_by_task(
    case: Case, todo: Sequence[int], seed: int, method: Method, workers: Workers, reporter: Reporter
) -> Iterator[list[Row]]:
    """Run the replicates of a study in parallel tasks, and yield the rows of each task as soon as it is done.

    A row is the dictionary of one replicate. Tasks end in any order. ``todo``: numbers of the replicates. The
    replicates of a task that failed as a whole, for example because its process died, have the key ``error``.
    """
    pace = _TaskSize(todo)
    run = partial(_run_timed, case, seed=seed, method=method)
    for outcome in run_many(pace.tasks(), run, workers, reporter):
        if outcome.value is None:
            yield [{"k": k, "simulation": 0.0, "error": outcome.error} for k in outcome.task]
            continue
        seconds, rows = outcome.value
        pace.adapt(rows, seconds)
        yield rows


class _TaskSize:
    """Controller of the number of replicates in a parallel task of a study.

    The first task has one replicate. The size of the next tasks follows from the CPU time of the last finished task.
    The aim is a task of about 10 s, in which estimation takes at least as much time as simulation. The replicates of a
    task are simulated together, so the simulation of many takes little longer than that of one. A task has at most
    twice as many replicates as the last finished one, and at most 25.

    Parameters
    ----------
    todo
        Numbers of all replicates to run.
    """

    def __init__(self, todo: Sequence[int]) -> None:
        """Set the size of the first tasks to one replicate; ``todo`` has the numbers of all replicates to run."""
        self.todo, self.size = todo, 1

    def tasks(self) -> Iterator[Sequence[int]]:
        """Yield the replicate numbers of one task after another, until all replicates are in a task.

        A process that becomes free requests the next task, which has the size that is set at that moment.
        """
        at = 0
        while at < len(self.todo):
            task = self.todo[at : at + self.size]
            at += len(task)
            yield task

    def adapt(self, rows: Sequence[Row], seconds: float) -> None:
        """Set the number of replicates in the next tasks from the CPU time of a finished task.

        Parameters
        ----------
        rows
            Rows of the replicates of the task, at least one, each with the CPU time of its ``simulation`` [s].
        seconds
            CPU time of the task [s], with the simulation.
        """
        simulation = sum(r["simulation"] for r in rows)
        each = max((seconds - simulation) / len(rows), 1e-6)
        self.size = int(min(max(max(TASK_S - simulation, simulation) / each, 1), 2 * len(rows), BATCH))


def _run_timed(case: Case, numbers: Sequence[int], *, seed: int, method: Method) -> tuple[float, list[Row]]:
    """Run the replicates ``numbers`` of a case in one task; return its CPU time [s] and one row for each replicate."""
    began = time.process_time()
    rows = run_replicates(case, numbers, seed, method)
    return time.process_time() - began, rows


@dataclass(frozen=True)
class StudyRequest:
    """Options of `seatrial ident study`, a Monte Carlo study of the estimator.

    Attributes
    ----------
    models
        Names of built-in cases, files model.toml, or ``FILE.py:NAME``. Each has its own study.
    replicates
        Number of missions to simulate for each model.
    seed
        Seed of all random draws.
    out
        Folder for the results.
    method
        Prediction error or output error.
    reml, mean_order
        Whether noise is estimated by restricted maximum likelihood, and order of the filter mean (1 or 2). None: as a
        model.toml was fitted, otherwise as the fit commands do.
    truth
        True values that replace those of the case, by name of the parameter.
    free
        Names of the parameters to estimate; empty: all free parameters of the model.
    seconds
        Length of the mission [s]; None: that of the case.
    bounded
        Whether parameters keep their bounds, for example zero as the lower bound of damping.
    workers
        Processes that run the replicates.
    """

    models: Sequence[str]
    replicates: int
    seed: int
    out: Path
    method: Method = "prediction-error"
    reml: bool | None = None
    mean_order: Literal[1, 2] | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    free: Sequence[str] = ()
    seconds: float | None = None
    bounded: bool = True
    workers: Workers = ANY_WORKERS

    def cases(self) -> list[Case]:
        """Return the case (mission, model and true values) of each model, in the order of ``models``, repeats left out.

        Raises
        ------
        SeatrialError
            If a model or an option cannot be used.
        """
        return [
            make_case(
                name,
                self.truth,
                self.free,
                self.seconds,
                bounded=self.bounded,
                reml=self.reml,
                mean_order=self.mean_order,
            )
            for name in dict.fromkeys(self.models)
        ]


def run_studies(request: StudyRequest, command: str, reporter: Reporter) -> StudyResult:
    """Run the study of each model, and write the results.

    The files in the folder ``request.out`` are one NAME.jsonl of replicates for each case, replicates.parquet with all
    of them (if pyarrow is installed), result.json, and study.md with its folder of pictures. The page report.html is
    written by the command. Replicates that exist there from an earlier run are used.

    Parameters
    ----------
    request : StudyRequest
        Models and options.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    StudyResult
        Content of result.json.

    Raises
    ------
    SeatrialError
        If a model or an option cannot be used, or if ``request.out`` is a file.
    """
    cases, out, method, replicates = request.cases(), request.out, request.method, list[tuple[Case, list[Row]]]()
    if out.exists() and not out.is_dir():
        raise SeatrialError(f"{out}: is a file; give a folder with --out")
    parts = []
    for case in cases:
        rows = run_study(
            case,
            request.replicates,
            request.seed,
            out / f"{case.name}.jsonl",
            method=method,
            workers=request.workers,
            reporter=reporter,
        )
        parts.append(model_study(case, rows, method))
        replicates.append((case, rows))
    made = provenance([], command)
    result = StudyResult(
        created=made.created, seatrial=made.seatrial, command=made.command,
        answer=" ".join(study_answer(p) for p in parts),
        seed=request.seed, studies=tuple(parts),
    )  # fmt: skip
    write_result(result, out / "result.json")
    write_study_docs(result, out / "study.md")
    if find_spec("pyarrow") is None:
        reporter.progress(f"{REPLICATES} is not written: it needs pyarrow, pip install 'seatrial[parquet]'")
    else:
        write_replicates(out / REPLICATES, replicates, request.seed, method, made.seatrial)
    return result


def model_study(case: Case, rows: Sequence[Row], method: Method) -> ModelStudy:
    """Return the summary of one study as the entry of the result.

    Parameters
    ----------
    case : Case
        Mission, model and true values.
    rows : sequence of Row
        Replicates of `run_study`. Failed and unconverged replicates are counted but not used in the statistics.
    method : str
        ``prediction-error`` or ``output-error``.
    """
    truth, n = case.model.values, count_replicates(rows)
    return ModelStudy(
        model=case.name,
        about=case.about,
        method="PE" if method == "prediction-error" else "OE",
        estimator=estimator(case, method),
        replicates=n.replicates,
        failed=n.failed,
        unconverged=n.unconverged,
        cpu_fit=finite(n.cpu_fit),
        cpu_simulation=finite(n.cpu_simulation),
        # output error also estimates initial states, which have no true parameter value
        parameters=tuple(
            _parameter_study(j, truth[j.name], case.model.parameter(j.name).unit)
            for j in summarise(rows)
            if j.name in truth
        ),
    )


def estimator(case: Case, method: Method) -> str:
    """Return the description of the estimator of a study for a table: method, noise estimation, order of the filter.

    Parameters
    ----------
    case : Case
        Case of the study. Its model gives the order of the filter.
    method : str
        ``prediction-error`` or ``output-error``.
    """
    if method == "output-error":
        return "output error"
    noise = "restricted" if case.reml else "maximum"
    order = "second" if case.model.second_order else "first"
    return f"prediction error, noise by {noise} likelihood, filter's mean of {order} order"


def _parameter_study(j: ParameterCoverage, truth: float, unit: str) -> ParameterStudy:
    """Return the row of the result for one parameter of a study: its bias, variance and coverage over the replicates.

    ``j``: these statistics. ``truth``: true value of the parameter in its ``unit``.
    """
    return ParameterStudy(
        name=j.name, unit=unit, truth=truth, n=j.n, at_bound=j.at_bound, sd=j.sd, bias=j.bias,
        bias_error=j.bias_error, ratio=j.ratio, ratio_low=j.ratio_interval[0], ratio_high=j.ratio_interval[1],
        bound_ratio=j.bound_ratio, bound_ratio_low=j.bound_interval[0], bound_ratio_high=j.bound_interval[1],
        coverage=j.coverage, coverage_low=j.coverage_interval[0], coverage_high=j.coverage_interval[1],
        misses=j.misses,
    )  # fmt: skip


def study_answer(study: ModelStudy) -> str:
    """Return a sentence on a study: replicates that were left out, and parameters that meet or miss the aims.

    The aims are limits for bias, variance and coverage. If more than 5 % of the replicates failed or did not converge,
    or if no parameter has statistics, the sentence states this and has no verdict. Parameters that miss an aim
    significantly are named; those that may miss it by chance are counted.

    Parameters
    ----------
    study : ModelStudy
        Summary of the study.
    """
    rows = study.parameters
    if not rows:
        return f"{study.model}: no replicate can be judged" + (f": {study.left_out}." if study.left_out else ".")
    significant = {r.name: [m for m in r.misses if "chance" not in m] for r in rows}
    worst = [f"{name} ({', '.join(misses)})" for name, misses in significant.items() if misses]
    by_chance = sum(bool(r.misses) and not significant[r.name] for r in rows)
    held = f"{sum(not r.misses for r in rows)} of {len(rows)} parameters"
    all_of = f"{study.model}, {study.replicates} replicates"
    if study.too_many_left_out:
        return f"{all_of}, of which {study.left_out}: too many for a verdict."
    if study.left_out:
        all_of += f", of which {study.left_out}"
    parts = [f"{all_of}: {held} meet the aims"]
    parts += [f"{by_chance} may miss them by chance"] if by_chance else []
    return ", ".join([*parts, *([f"these miss them: {', '.join(worst)}"] if worst else [])]) + "."


def _study_key(case: Case, seed: int, method: Method) -> str:
    """Return the key of a study: 12 hexadecimal digits, a hash of mission, model, true values, seed and estimator.

    Stored replicates of an earlier run are used only if their key is the same.
    """
    parameters = [(p.name, p.value, p.bounds, p.free) for p in case.model.parameters]
    values: Any = (
        case.name,
        parameters,
        sorted(case.every.items()),
        seed,
        estimator(case, method),
        case.model.source,
        ROWS,
    )
    inputs = case.inputs
    digest = hashlib.sha256(repr(values).encode())
    for array in (inputs.t, inputs.u, inputs.u_next):
        digest.update(array.tobytes())
    return digest.hexdigest()[:12]
