"""The two pages: tables as Markdown, figures as one HTML file."""

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

Say = Callable[[str], None]
INTRODUCTION = """\
# The paper's tables and figures once more

    {command}

The data of the paper (*Nonlinear system identification of autonomous marine vehicles*, MSc thesis, IST) are not
public. Here its estimates are made the truth, missions are simulated with process noise by the models themselves (in
plain numpy, `ident/estimation/stochastic_simulation.py`), and estimated again. So the columns "paper" and "truth" say
what boat it is, and the
rest whether these estimators find it. One realisation of one seed: for bias and coverage see [study.md](study.md).
± is one standard error.

The figures are in [thesis.html](thesis.html), which opens without a network: 4.1 and 4.2 (accelerometer and
magnetometer at rest), 4.3 (the thruster's response), 5.1 to 5.3 (designed experiments), 6.1 (yaw rate), 6.2 (position
and its differences), 6.3 to 6.6 (innovations of acceleration and position, 3DOF and 6DOF K).
"""


def write(out: Path, seed: int, bench: Path | None, say: Say, *, evaluations: int = 15_000, repeats: int = 50) -> None:
    """thesis.md and thesis.html into a folder. Raises SeatrialError where the log of a bench cannot be used."""
    measured = None if bench is None else bench_log(bench)  # before anything that takes minutes
    say("thruster")
    thruster = bench_experiment(seed)
    second = _thruster_part(thruster, measured)
    say("yaw and surge")
    turn, run = yaw_experiment(seed), surge_experiment(seed)
    say("three degrees of freedom, and measured attitude")
    sailed, three, six = plane_experiment(seed)
    forces = with_forces(sailed)
    command = f"python -m benchmarks.thesis --seed {seed}" + (f" --bench {bench.name}" if bench else "")
    lines = [INTRODUCTION.format(command=command), *second, *_yaw_and_surge(turn, run)]
    lines += [
        "## Table 5: the horizontal plane",
        "",
        "A boat that leans in turns, pitches with thrust and rolls and pitches in small waves; 400 s of steps on both",
        "thrusters, AHRS at 20 Hz, GNSS at 5 Hz, unknown current. 3DOF is `horizontal:shaft` with white process noise,",
        "as in the paper; 6DOF K is `kinematic:shaft:yaw`, which measures attitude instead of predicting it; the last",
        "column is what `seatrial ident vehicle` fits: 3DOF with disturbance forces.",
        "",
        *tables.table_5(sailed.truth, three.fit, six.fit, forces),
        "",
        *_said(sailed.truth, {"3DOF": three.fit, "6DOF K": six.fit, "3DOF with forces": forces}),
        "",
        "Innovations, in units of the channel (figures 6.3-6.6): a right model leaves them white.",
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
        "The paper's figures once more",
        "Figures 4.1-4.3, 5.1-5.3 and 6.1-6.6 on simulated data",
        f"Made by {command}; numbers and words in thesis.md.",
        parts,
    )
    say(f"written: {out / 'thesis.md'}, {out / 'thesis.html'}")


def _thruster_part(simulated: Both, bench: tuple[dict[str, tuple[float, float]], str] | None) -> list[str]:
    """``bench``: estimates and errors of a log, and its name."""
    names = printed.TABLE_2
    columns = {label: {n: f.estimate(n) for n in names} for label, f in (("OE", simulated.oe), ("PE", simulated.pe))}
    lines = [
        "## Table 2: the thruster",
        "",
        "Steps that grow, then a chirp of each sign; 90 s, command, shaft speed and force at 80 Hz, a load cell that",
        "swings. Beside a, c1 and c2 the delay of the command is estimated, which the paper does not have.",
        "",
        *tables.table_2(columns, simulated.truth),
        "",
    ]
    if bench is not None:
        found, where = bench
        lines += [f"The thruster of the log {where}:", "", *tables.table_2({"PE": found}, None), ""]
    return lines


def _yaw_and_surge(turn: Both, run: Both) -> list[str]:
    return [
        "## Table 3: yaw",
        "",
        "180 s of moments in steps, gyro at 20 Hz, process noise 0.02 rad/s/√s.",
        "",
        *tables.tables_3_and_4(turn, printed.TABLE_3),
        "",
        *_said(turn.truth, {"OE": turn.oe, "PE": turn.pe}),
        "",
        "## Table 4: surge",
        "",
        "180 s of thrust in steps, position at 5 Hz, process noise 0.02 m/s/√s. The paper's `d_u` is next to nothing,",
        "and so it is here in truth: an estimate at its bound of zero has no standard error.",
        "",
        *tables.tables_3_and_4(run, printed.TABLE_4),
        "",
        *_said(run.truth, {"OE": run.oe, "PE": run.pe}),
        "",
    ]


def _said(truth: Mapping[str, float], fits: Mapping[str, Fit]) -> list[str]:
    """How far each is from the truth, in its own standard errors, and where no error can be told."""
    parts = []
    for label, fit in fits.items():
        known = [n for n in fit.names if n in printed.UNITS]
        parts.append(f"{label} {tables.distance(fit, truth, known):.1f}")
    lines = [f"Largest distance from the truth, in reported standard errors: {', '.join(parts)}."]
    if any(
        what == AUTOCORRELATED_TOO_LONG
        for fit in fits.values()
        for _, what in fit.flags
        if not fit.options.process_noise
    ):
        lines += [
            "What process noise moved the boat by stays in OE's residuals until the end of the record: no error",
            "allows for that, and a robust error is not given. Those of PE hold.",
        ]
    return lines
