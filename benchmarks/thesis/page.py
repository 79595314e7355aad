"""Writer of both pages: the tables in Markdown, and the figures in one HTML file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.thesis import printed, tables
from benchmarks.thesis.drawings import bench_part, innovation_part, noise_part, predictor_part
from benchmarks.thesis.experiments import chapter_5
from benchmarks.thesis.figures import write_figures
from benchmarks.thesis.fits import (
    Both,
    at_rest,
    bench_experiment,
    bench_log,
    plane_experiment,
    surge_experiment,
    with_forces,
    yaw_experiment,
)
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.standard_errors import AUTOCORRELATED_TOO_LONG

Say = Callable[[str], None]  # prints a line of progress
INTRODUCTION = """\
# The tables and figures of the paper with simulated data

    {command}

The data of the paper (*Nonlinear system identification of autonomous marine vehicles*, MSc thesis, IST) are not
public. Here the estimates of the paper are the true parameters. Missions are simulated by the models with process noise
(in plain numpy, `ident/estimation/stochastic_simulation.py`), and the parameters are estimated from the simulated data.
The columns "paper" and "truth" describe the boat. The other columns show whether the estimators find these values. The
estimators are output error (OE) and prediction error (PE), which the [glossary](glossary.md) defines. The tables are
one realisation of one seed; [study.md](study.md) has bias and coverage. ± is one standard error.

The figures are in [thesis.html](thesis.html), which opens without a network: 4.1 and 4.2 (accelerometer and
magnetometer at rest), 4.3 (the thruster's response), 5.1 to 5.3 (designed experiments), 6.1 (yaw rate), 6.2 (position
and its differences), 6.3 to 6.6 (innovations of acceleration and position of the models 3DOF and 6DOF K).
"""


def write(out: Path, seed: int, bench: Path | None, say: Say, *, evaluations: int = 15_000, repeats: int = 50) -> None:
    """Write thesis.md and thesis.html.

    Parameters
    ----------
    out : Path
        Folder for both files. It is made if it does not exist.
    seed : int
        Seed of all simulations.
    bench : Path or None
        Log of a bench run, whose estimates are added to table 2; None for simulated data only.
    say : callable
        Function that prints a line of progress.
    evaluations : int
        Number of evaluated inputs in the search for designs of chapter 5.
    repeats : int
        Number of simulated repeats of the designed experiment.

    Raises
    ------
    SeatrialError
        If the log of the bench cannot be used.
    """
    measured = None if bench is None else bench_log(bench)  # first, so that a wrong log fails at once
    say("thruster")
    thruster = bench_experiment(seed)
    second = _thruster_section(thruster, measured)
    say("yaw and surge")
    turn, run = yaw_experiment(seed), surge_experiment(seed)
    say("three degrees of freedom, and measured attitude")
    sailed, three, six = plane_experiment(seed)
    forces = with_forces(sailed)
    command = f"python -m benchmarks.thesis --seed {seed}" + (f" --bench {bench.name}" if bench else "")
    lines = [INTRODUCTION.format(command=command), *second, *_yaw_and_surge_sections(turn, run)]
    lines += [
        "## Table 5: the horizontal plane",
        "",
        "The boat heels in turns, pitches with thrust, and rolls and pitches in small waves. The mission has 400 s of",
        "steps on both thrusters, an AHRS at 20 Hz, a GNSS receiver at 5 Hz and an unknown current. 3DOF is",
        "`horizontal:shaft` with white process noise, as in the paper. 6DOF K is `kinematic:shaft:yaw`, whose attitude",
        "is measured and not predicted. The last column is the model that `seatrial ident vehicle` fits: 3DOF with",
        "disturbance forces.",
        "",
        *tables.table_5(sailed.truth, three.fit, six.fit, forces),
        "",
        *_largest_error_sentences(sailed.truth, {"3DOF": three.fit, "6DOF K": six.fit, "3DOF with forces": forces}),
        "",
        "The table has the root mean square of the innovations in the units of the channels, and their first three",
        "autocorrelations (figures 6.3-6.6). The innovations of a correct model are white.",
        "",
        *tables.innovations(three, six),
    ]
    designed, figures_5 = chapter_5(seed, evaluations, repeats, say)
    lines += ["", *designed[:-1]]
    out.mkdir(parents=True, exist_ok=True)
    (out / "thesis.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    say("sensors at rest, figures")
    parts = [
        noise_part(at_rest(seed)),
        bench_part(thruster),
        figures_5,
        predictor_part(turn, run),
        innovation_part(three, six),
    ]
    write_figures(
        out / "thesis.html",
        "The figures of the paper with simulated data",
        "Figures 4.1-4.3, 5.1-5.3 and 6.1-6.6 on simulated data",
        f"Written by {command}. The tables and explanations are in thesis.md.",
        parts,
    )
    say(f"written: {out / 'thesis.md'}, {out / 'thesis.html'}")


def _thruster_section(simulated: Both, bench: tuple[dict[str, tuple[float, float]], str] | None) -> list[str]:
    """Return the section of table 2 as lines of Markdown.

    ``simulated`` has the estimates from simulated data. ``bench`` has the estimates with standard errors of a measured
    log by parameter, and the name of the log; None without a log.
    """
    names = printed.TABLE_2
    columns = {label: {n: f.estimate(n) for n in names} for label, f in (("OE", simulated.oe), ("PE", simulated.pe))}
    lines = [
        "## Table 2: the thruster",
        "",
        "The command has steps of growing size, then one chirp of each sign, in 90 s. Command, shaft speed and force",
        "are sampled at 80 Hz, and the load cell oscillates in its mount. The delay of the command is estimated as",
        "well; the paper does not have it.",
        "",
        *tables.table_2(columns, simulated.truth),
        "",
    ]
    if bench is not None:
        found, log_name = bench
        lines += [
            f"The thruster of the log {log_name} has these estimates:",
            "",
            *tables.table_2({"PE": found}, None),
            "",
        ]
    return lines


def _yaw_and_surge_sections(turn: Both, run: Both) -> list[str]:
    """Return the sections of table 3 (yaw, from ``turn``) and table 4 (surge, from ``run``) as lines of Markdown."""
    return [
        "## Table 3: yaw",
        "",
        "The record has 180 s of moments in steps and a gyro at 20 Hz. The process noise is 0.02 rad/s/√s.",
        "",
        *tables.tables_3_and_4(turn, printed.TABLE_3),
        "",
        *_largest_error_sentences(turn.truth, {"OE": turn.oe, "PE": turn.pe}),
        "",
        "## Table 4: surge",
        "",
        "The record has 180 s of thrust in steps and the position at 5 Hz. The process noise is 0.02 m/s/√s. `d_u` is",
        "almost zero in the paper, and therefore in the truth here. An estimate at its bound of zero has no standard",
        "error.",
        "",
        *tables.tables_3_and_4(run, printed.TABLE_4),
        "",
        *_largest_error_sentences(run.truth, {"OE": run.oe, "PE": run.pe}),
        "",
    ]


def _largest_error_sentences(truth: Mapping[str, float], fits: Mapping[str, Fit]) -> list[str]:
    """Return lines of text on the largest error of each fit, in units of its standard errors.

    ``truth`` has the true values by parameter, and ``fits`` the fits by their name in the text. If a robust standard
    error of output error is missing, the lines give the reason.
    """
    distances = []
    for label, fit in fits.items():
        names = [n for n in fit.names if n in printed.UNITS]
        distances.append(f"{label} {tables.distance(fit, truth, names):.1f}")
    lines = [f"The largest distances from the truth, in reported standard errors, are: {', '.join(distances)}."]
    if any(
        flag == AUTOCORRELATED_TOO_LONG
        for fit in fits.values()
        for _, flag in fit.flags
        if not fit.options.process_noise
    ):
        lines += [
            "A displacement by process noise stays in the residuals of OE until the end of the record. No standard",
            "error accounts for this, so a robust error is not reported. The standard errors of PE are valid.",
        ]
    return lines
