"""Chapter 5 of the paper with simulated data: the designed experiment, its baselines, and its simulated repeats."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from benchmarks.thesis.design_bound import Bound, upper_bound
from benchmarks.thesis.figures import Chart, Curve, Drawing, Part
from seatrial.ident.experiment_design.evaluator import DesignEvaluator
from seatrial.ident.experiment_design.excitation import StepInput
from seatrial.ident.experiment_design.optimal_design import (
    BaselineSignal,
    Design,
    Robustness,
    baseline_signals,
    design,
    monte_carlo,
    predicted_errors,
    predicted_track,
)
from seatrial.ident.experiment_design.problem import DesignProblem
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.numerics.linear_algebra import Array
from seatrial.ident.studies.cases import RepeatStatistics, repeat_design

Say = Callable[[str], None]  # prints a line of progress
SECONDS, GRID = 600.0, 0.2  # s, duration of the experiments and step of their rows
BINS = 60  # of the histograms
SHOWN = 120.0  # s, interval in figure 5.1
OPENING = """\
## Chapter 5: design of experiments

The experiments have 600 s for the nine parameters of the horizontal model at the nominal values of Table 1. AHRS and
GNSS run at 10 Hz, there is no current, and the shaft speeds lag behind the commands as in Table 2. D-optimal steps are
compared with the best of 20 PRBS and of 20 RGS, each with the bandwidth and amplitude that suit the nominal values. The
numbers are log det of the Fisher information (in characteristic steps of the parameters). "at nominal" is the design
minus the best baseline at the nominal values. For "better in" and "by 3 in", 1000 samples of the parameters were drawn
within 0.75 to 1.25 of the nominal values. The columns have the shares of the samples in which the design is better than
both baselines, and better by at least 3. Times are CPU seconds.

| information | design | best baselines | at nominal | better in | by 3 in | search | 1000 samples |
|---|---|---|---|---|---|---|---|"""
CLOSING = """
The paper uses output error. Its design of 60 steps is optimal for the mean over 16 parameter samples. A design for the
nominal values alone is far better at these values and worse at others. Prediction error accounts for process noise, and
then a full-range PRBS with the right clock is hard to improve. Samples long before a measurement are not informative
about it, so only fast reversals and a few long runs add information. Any disturbance makes the higher information of
output error unattainable, as the standard errors show.
"""


@dataclass(frozen=True)
class Experiment:
    """Experiment that is designed for the information of output error or of prediction error, with its baselines.

    Attributes
    ----------
    title : str
        Name of the experiment in the tables.
    made : Design
        The design.
    judge : DesignProblem
        Problem in which design and baselines are compared: nominal parameters, fine grid.
    found : mapping of str to BaselineSignal
        Best baseline of each kind: "PRBS" and "RGS".
    samples : Robustness
        Log det of design and baselines in 1000 parameter samples.
    search_cpu : float
        CPU time of the search [s].
    samples_cpu : float
        CPU time of the parameter samples for one input [s].
    """

    title: str
    made: Design
    judge: DesignProblem
    found: Mapping[str, BaselineSignal]
    samples: Robustness
    search_cpu: float
    samples_cpu: float

    @property
    def value(self) -> float:
        """Log det of the information of the design at the nominal parameters."""
        return float(DesignEvaluator(self.judge).evaluate(self.command[:, :, None])[0][0])

    @property
    def command(self) -> Array:
        """Commands of the design (n_rows, 2) on the rows of `judge`."""
        return self.made.command_on(self.judge)

    @property
    def margin(self) -> Array:
        """Log det of the design minus that of the better baseline, in each parameter sample (n_samples,)."""
        values = self.samples.values
        return np.asarray(values["design"] - np.max([v for n, v in values.items() if n != "design"], axis=0))


def experiment(title: str, *, process_noise: bool, seed: int, evaluations: int) -> Experiment:
    """Design an experiment of 600 s for the nine parameters at the nominal values of table 1, and its baselines.

    Parameters
    ----------
    title : str
        Name of the experiment in the tables.
    process_noise : bool
        Whether the information is that of prediction error. Without process noise it is that of output error.
    seed : int
        Seed of the search and of the samples.
    evaluations : int
        Number of evaluated inputs in the search.
    """
    began = time.process_time()
    model = horizontal_model(current=False)
    if process_noise:
        problem = DesignProblem(model, StepInput(120, 2, SECONDS, 1.0, GRID), seed=seed)
    else:  # rows of 0.4 s to save time, since 16 parameter samples are simulated for each input
        coarse = 2 * GRID
        problem = DesignProblem(
            model, StepInput(60, 2, SECONDS, 2.0, coarse), process_noise=False, robust=16, seed=seed, grid=coarse
        )
    made = design(problem, evaluations=evaluations)
    search_cpu = time.process_time() - began
    judge = replace(problem, grid=GRID, robust=0, steps=replace(problem.steps, grid=GRID))
    found = baseline_signals(judge, seed=seed)
    began = time.process_time()
    commands = {"design": made.command_on(judge)} | {k: r.command for k, r in found.items()}
    samples = monte_carlo(judge, commands, seed=seed)
    return Experiment(title, made, judge, found, samples, search_cpu, (time.process_time() - began) / len(commands))


def chapter_5(seed: int, evaluations: int, n_repeats: int, say: Say) -> tuple[list[str], Part]:
    """Compute chapter 5. Return it as lines of Markdown, and the section with figures 5.1 to 5.3.

    Parameters
    ----------
    seed : int
        Seed of all searches and simulations.
    evaluations : int
        Number of evaluated inputs in the search by prediction error; output error gets 1.6 times as many.
    n_repeats : int
        Number of simulated repeats of the designed experiment.
    say : callable
        Prints a line of progress.
    """
    say("design of experiments, output error")
    oe = experiment("output error", process_noise=False, seed=seed, evaluations=evaluations * 8 // 5)
    say("design of experiments, prediction error")
    pe = experiment("prediction error", process_noise=True, seed=seed, evaluations=evaluations)
    say("an upper bound for prediction error")
    bound = upper_bound(pe.made, evaluations=evaluations, seed=seed)
    say("repeats of the designed experiment")
    delivered = repeat_design(pe.made, n_repeats, seed)
    words = [
        *_design_table(oe, pe),
        *bound_words(pe, bound),
        *_error_table(oe, pe),
        *_repeat_table(delivered, n_repeats),
    ]
    return words, _chapter_figures(oe, pe)


def bound_words(pe: Experiment, bound: Bound) -> list[str]:
    """Return the paragraph on the upper bound of the information by prediction error as lines of Markdown.

    ``pe`` is the experiment designed for prediction error.
    """
    best = max(pe.found.values(), key=lambda r: r.value)
    return [
        "Because log det is concave, it has an upper bound for all inputs "
        "(`benchmarks/thesis/design_bound.py`). By prediction",
        f"error, no input of these 600 s has more than {bound.value:.1f}, which is {bound.value - pe.value:.1f} above",
        f"this design and {bound.value - best.value:.1f} above its best baseline.",
        "",
    ]


def _design_table(oe: Experiment, pe: Experiment) -> list[str]:
    """Return the table of designs and baselines with its explanation, as lines of Markdown.

    ``oe`` and ``pe`` are the experiments designed for output error and for prediction error, here and below.
    """
    rows = []
    for designed in (oe, pe):
        best = max(designed.found.values(), key=lambda r: r.value)
        baseline = ", ".join(f"{r.kind} {r.value:.1f} ({_bandwidth_text(r)})" for r in designed.found.values())
        rows.append(
            f"| {designed.title} | {designed.value:.1f} | {baseline} | {designed.value - best.value:+.1f} | "
            f"{100 * np.mean(designed.margin > 0):.1f} % | {100 * np.mean(designed.margin >= 3):.1f} % | "
            f"{designed.search_cpu:.0f} s | {designed.samples_cpu:.2f} s |"
        )
    return [*OPENING.splitlines(), *rows, *CLOSING.splitlines(), ""]


def _bandwidth_text(signal: BaselineSignal) -> str:
    """Return the bandwidth of a baseline in words: the clock [s] of a PRBS, or the corner frequency [Hz] of an RGS."""
    return f"clock {signal.bandwidth:g} s" if signal.kind == "PRBS" else f"corner {signal.bandwidth:g} Hz"


def _error_table(oe: Experiment, pe: Experiment) -> list[str]:
    """Return the table of predicted standard errors with its explanation, as lines of Markdown.

    The columns are the design for output error (by both predictions), the design for prediction error, and its best
    baseline.
    """
    names = pe.made.problem.observed_parameters
    best = max(pe.found.values(), key=lambda r: r.value)
    fine = pe.judge.finer
    at = np.searchsorted(pe.judge.t, fine.t + 1e-9, side="right") - 1
    columns = [
        oe.made.errors,
        predicted_errors(pe.judge, oe.made.command_on(fine)),
        pe.made.predicted,
        predicted_errors(pe.judge, best.command[at]),
    ]
    rows = [f"| `{n}` | {' | '.join(f'{c[n]:.2g}' for c in columns)} |" for n in names]
    return [
        "The table has predicted standard errors. The first column is predicted by output error for its own design.",
        "The other columns are predicted by prediction error for the same design, for its own design, and for its",
        "best baseline.",
        "",
        f"| | OE design, by OE | OE design | PE design | {best.kind} |",
        "|---|---|---|---|---|",
        *rows,
        "",
    ]


def _repeat_table(found: list[RepeatStatistics], n: int) -> list[str]:
    """Return the table of ``n`` simulated repeats of the designed experiment with its explanation, as Markdown lines.

    ``found`` has the statistics of each parameter.
    """
    rows = [
        f"| `{d.name}` | {d.predicted:.2g} | {d.ratio:.2f} | {d.interval[0]:.2f} to {d.interval[1]:.2f} | "
        f"{100 * d.coverage:.0f} % | {d.outliers} |"
        for d in found
    ]
    mean = float(np.mean([d.ratio for d in found]))
    return [
        f"{n} simulated repeats of the PE design were fitted with free noise parameters and unbounded damping. The",
        "table has the standard deviation of the estimates divided by the predicted standard error, the 95 % interval",
        "of this ratio, and the share of estimates within 1.96 predicted standard errors.",
        f"The mean ratio is {mean:.2f}.",
        '"Stuck" fits ended in another optimum, more than 8 standard errors away.',
        "",
        "| | predicted | spread/predicted | 95 % | coverage | stuck |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
    ]


def _chapter_figures(oe: Experiment, pe: Experiment) -> Part:
    """Return the section with figures 5.1 to 5.3, and a figure of the predicted track."""
    return Part(
        "design",
        "Design of experiments",
        [
            _input_drawing("Figure 5.1: parametrisation, levels and durations of steps", pe, SHOWN),
            _input_drawing("Figure 5.2: designed input, output error", oe, SECONDS),
            _input_drawing("Figure 5.2: designed input, prediction error", pe, SECONDS),
            _track_drawing(pe),
            _histogram_drawing("Figure 5.3: log det of the information for 1000 parameter samples, output error", oe),
            _histogram_drawing(
                "Figure 5.3: log det of the information for 1000 parameter samples, prediction error", pe
            ),
        ],
    )


def _input_drawing(title: str, designed: Experiment, until: float) -> Drawing:
    """Return a figure of commands and shaft speeds of a design, from the start until ``until`` [s]."""
    problem, rows = designed.judge, designed.judge.t <= until
    command = designed.command[rows]
    shaft = problem.actuation.shaft(designed.command[:, :, None])[rows, :, 0]
    t = problem.t[rows]
    charts = [
        Chart(
            f"{name}, -1..1",
            [
                Curve("command", np.repeat(t, 2)[1:], np.repeat(command[:, k], 2)[:-1]),
                Curve("shaft speed", t, shaft[:, k], "other"),
            ],
        )
        for k, name in enumerate(problem.actuation.channels)
    ]
    return Drawing(title, "s", charts)


def _track_drawing(designed: Experiment) -> Drawing:
    """Return a figure of the predicted track (north and east), with its 95 % band over the parameter samples."""
    track = predicted_track(designed.made)
    assert track is not None  # the horizontal model has a position
    charts = [
        Chart(
            f"{name} [m]",
            [
                Curve(
                    "95 % of the parameter samples",
                    track.t,
                    np.quantile(others, 0.025, axis=0),
                    "band",
                    np.quantile(others, 0.975, axis=0),
                ),
                Curve("nominal boat", track.t, middle),
            ],
        )
        for name, middle, others in (
            ("north", track.x, track.others[:, :, 0]),
            ("east", track.y, track.others[:, :, 1]),
        )
    ]
    caption = "This figure is not in the paper. Without a steering controller, parameter errors add up along the track."
    return Drawing("Predicted track", "s", charts, caption)


def _histogram_drawing(title: str, designed: Experiment) -> Drawing:
    """Return a figure of histograms of log det over the parameter samples, for the design and its baselines.

    Values outside the 0.2 % and 99.8 % quantiles count in the outermost of 60 bins.
    """
    values = np.concatenate(list(designed.samples.values.values()))
    low, high = (float(q) for q in np.quantile(values, [0.002, 0.998]))
    edges = np.linspace(low, high, BINS + 1)
    roles: dict[str, Literal["model", "other", "truth"]] = {"design": "model", "PRBS": "other", "RGS": "truth"}
    curves = [
        Curve(
            name,
            np.repeat(edges, 2)[1:-1],
            np.repeat(np.histogram(np.clip(v, low, high), edges)[0].astype(float), 2),
            roles[name],
        )
        for name, v in designed.samples.values.items()
    ]
    return Drawing(title, "log det of the information", [Chart("samples", curves)])
