"""What a fit says in a sentence or two, and how its prediction errors changed.

What must be said before an estimate is read: that the fit stopped short, that a sensor was stuck.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from seatrial.daq.checks import FAULT
from seatrial.ident.characterisation import Levels, Quadratic, ThrustCurve, steady_thrust
from seatrial.ident.data import ORIGIN, Record
from seatrial.ident.estimation import (
    FailedRun,
    Fit,
    FittedModel,
    HomogeneityTest,
    ThrustScale,
    against_priors,
    least_inertia,
    scale_of,
)
from seatrial.ident.model import Model
from seatrial.ident.results.parts import (
    Calibrations,
    CrossCorrelation,
    Errors,
    PredictionChange,
    PredictionFit,
    Provenance,
    ResidualTests,
    ResultWarning,
)
from seatrial.ident.results.tables import format_number
from seatrial.ident.validation import FEWEST, OUTLYING, ChannelResiduals

NAMES = {
    "x": "north",
    "y": "east",
    "psi": "heading",
    "r": "yaw rate",
    "u": "surge speed",
    "v": "sway speed",
    "vx": "velocity north",
    "vy": "velocity east",
    "ax": "surge specific force",
    "ay": "sway specific force",
    "speed": "speed over ground",
    "n": "shaft speed",
}
LATE = frozenset({"sensor-late", "thrust-late", "motion-late"})  # codes of checks
INERTIA_AND_DAMPING = frozenset({"m", "d", "T", "K"})  # first letters of the parameters that a delay biases
MOST_NAMES = 4  # channels that a sentence lists
FINE_SHIFT = 2.0  # %; a smaller change is told to a tenth of it
TIMES = 3.0  # a ratio of errors above it is said as such
LEVEL = 0.01
MEASURED = {"phi", "theta", "psi", "p", "q", "r"}  # inputs that are a sensor's output, with its noise
NO_DEAD_ZONE = 5e-4  # of full command: less is told as 0.0 %
PASSED = 0.05  # part of the rows with a command whose commands are smaller than any that was tried
FEWEST_SAMPLES = 10  # samples that are all the same before a sensor is called stuck


def change_sentence(change: PredictionChange, horizon: float) -> str:
    """How the prediction errors of all channels over the horizon [s] changed. That they fall or rise is said only where
    the interval says so."""
    begin = f"{horizon:g} s ahead on {change.role} data, all channels: "
    if change.low is None or change.high is None:
        return f"{begin}the data are too short to tell whether the prediction error changes."
    shift, low, high = (100 * (r - 1) for r in (change.ratio, change.low, change.high))
    places = 0 if abs(shift) >= FINE_SHIFT else 1
    rounded = [round(r, places) + 0.0 for r in (shift, low, high)]  # no -0
    by, least, most = (f"{abs(r):.{places}f}" for r in rounded)
    if change.verdict == "unchanged":
        by, least, most = (f"{r:+.{places}f}" for r in rounded)
        said = f"no significant change of the prediction error ({by} %; 95 %: {least} to {most} %)"
    elif change.verdict == "fell":
        said = f"prediction error falls by {by} % (95 %: {most} to {least} %)"
    elif change.ratio < TIMES:
        said = f"prediction error rises by {by} % (95 %: {least} to {most} %)"
    else:
        said = f"prediction error is {format_number(change.ratio)} times as large (95 %: {format_number(change.low)} "
        said += f"to {format_number(change.high)})"
    named = [("better", change.better, MOST_NAMES), ("worse", change.worse, len(change.worse))]
    parts = [said, *(f"{word}: {_listed(names, most)}" for word, names, most in named if names)]
    return f"{begin}{'; '.join(parts)}."


def _listed(channels: Sequence[str], most: int = MOST_NAMES) -> str:
    """The first few by name."""
    names = [NAMES.get(name, name) for name in channels]
    more = len(names) - most
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:most])} and {more} more"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def vehicle_answer(
    prediction: PredictionFit | None,
    errors: Errors,
    horizon: float,
    residuals: Sequence[ResidualTests],
    cross: Sequence[CrossCorrelation],
    *,
    searchable: bool,
) -> str:
    """How much of all channels is predicted over the horizon [s], and whether the residuals are white. ``searchable``:
    `ident diagnose` can search further."""
    said = "" if prediction is None else f"{_fit(prediction, errors, horizon)} "
    return f"{said}{_residuals(errors, residuals, cross, searchable)}"


def _fit(prediction: PredictionFit, errors: Errors, horizon: float) -> str:
    """With the channels that are predicted best and worst."""
    begin = f"{horizon:g} s ahead on {prediction.role} data, all channels: "
    table = errors.estimation if errors.validation is None else errors.validation
    lost = [n for n, row in table.horizon.items() if row.after is None]
    if lost:
        return f"{begin}the prediction diverges ({_listed(lost)})."
    each = {n: 1 - (row.after or 0.0) / row.spread for n, row in table.horizon.items() if row.spread}
    low, high = prediction.low, prediction.high
    interval = "" if low is None or high is None else f" (95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    ends = [f"{_percent(each[n])} ({NAMES.get(n, n)})" for n in sorted(each, key=lambda n: -each[n])]
    span = f", from {ends[0]} to {ends[-1]}" if len(ends) > 1 else ""
    return f"{begin}fit {_percent(prediction.fit)}{interval}{span}."


def _residuals(
    errors: Errors, residuals: Sequence[ResidualTests], cross: Sequence[CrossCorrelation], searchable: bool
) -> str:
    """Each at 1 % over all channels, tests and inputs together (Bonferroni)."""
    tests = [p for r in residuals for p in (r.ljung_box_p, r.periodogram_p)]
    pairs = [c for c in cross if c.p is not None]
    left = [c for c in pairs if c.p is not None and c.p * len(pairs) < LEVEL]
    known = {c.input for c in left}
    coloured = any(p is not None and p * len(tests) < LEVEL for p in tests)
    if not tests:
        least = f"that takes {FEWEST} samples of a channel"
        return f"Too little was measured to tell whether the residuals are white: {least}."
    if not known and not coloured:
        hidden = "; whether the disturbance forces hide an effect, `seatrial ident diagnose` tells"
        unseen = _unseen(errors, residuals)
        return f"The residuals are white and know nothing of the inputs{hidden if searchable else ''}{unseen}."
    if known and known <= MEASURED:
        named = " and ".join(sorted(known))
        return (
            f"The residuals still know {named}, which the model takes as measured: that may be the noise of these "
            f"measurements and need not be a lack of the model{'. They are not white' if coloured else ''}."
        )
    end = f"The residuals still know the inputs{_by_how_much(left)}" if known else "The residuals are not white"
    either = ": the model lacks something, or the noise of a sensor is correlated"
    how = ": run `seatrial ident diagnose` to see whether an effect is missing" if searchable else either
    return f"{end}{how}."


def _by_how_much(left: Sequence[CrossCorrelation]) -> str:
    """A long record shows correlations that do not matter."""
    most = max((c for c in left if c.largest is not None), key=lambda c: c.largest or 0.0, default=None)
    return "" if most is None else f" (correlation up to {most.largest:.2g}, {NAMES.get(most.channel, most.channel)})"


def _unseen(errors: Errors, residuals: Sequence[ResidualTests]) -> str:
    """Channels of the estimation data with too few samples to say so."""
    seen = {r.channel for r in residuals}
    left = [n for n in errors.estimation.one_step if n not in seen]
    return f" (of {', '.join(left)} there are too few to tell)" if left else ""


def calibration_notes(calibration: Calibrations, horizon: float) -> list[str]:
    """A line for each kind of prediction whose bands are wrong, on data that the fit has not seen where there are some;
    ``horizon``: s."""
    role, table = ("validation", calibration.validation)
    if table is None:
        role, table = "estimation", calibration.estimation
    kinds = (
        ("one step ahead", table.one_step),
        (f"{horizon:g} s ahead", table.horizon),
        ("simulated", table.simulation),
    )
    notes = []
    for verdict, what in (("overconfident", "larger"), ("underconfident", "smaller")):
        for words, channels in kinds:
            wrong = [
                f"{n} {'diverged' if c.scale is None else format(c.scale, '.2g')}"
                for n, c in channels.items()
                if c.verdict == verdict
            ]
            if wrong:
                notes.append(
                    f"On {role} data, {words}, errors are {what} than the model says, by these factors: "
                    f"{', '.join(wrong)}."
                )
    return notes


def estimation_warnings(fit: Fit, records: Sequence[Record], length: float | None = None) -> list[ResultWarning]:
    """Return the warnings of a fit, those about its scale first.

    ``length``: length of the hull [m]; None if it is not known.
    """
    said = scale_warnings(scale_of(fit.model))
    for p, value, widths in against_priors(fit):
        mean, sd = p.prior or (math.nan, math.nan)
        if p.name in fit.model.noises:
            text = (
                f"The residuals contradict the declared {p.meaning}: {p.name} = {mean:.3g} {p.unit} was said, the "
                f"estimate is {value:.3g} {p.unit}. It is estimated, and what was said is a prior of it."
            )
            said.append(ResultWarning(code="noise-contradicted", text=text))
            continue
        text = (
            f"The data contradict the prior of {p.full_name}: {mean:.4g} ± {sd:.2g} {p.unit} was said, the estimate is "
            f"{value:.4g} {p.unit}, {abs(widths):.1f} standard deviations away. The prior is wrong, or what else "
            "is given (thrust, arms, units)."
        )
        said.append(ResultWarning(code="prior-contradicted", text=text))
    least = least_inertia(fit, length)
    if least is not None and fit.estimate("m_r")[0] < least:
        text = (
            f"m_r is {fit.estimate('m_r')[0]:.3g} kg m2, less than a rigid body with this mass can have, which is at "
            f"least {least:.2g} kg m2. Look at the thrust, the arms and the unit of the yaw rate."
        )
        said.append(ResultWarning(code="inertia-too-small", text=text))
    return said + cut_records(records) + stuck_sensors(records)


def design_warnings(model: Model, thrust: float, pole: float | None) -> list[ResultWarning]:
    """What a design rests on that nobody gave: the model's own thrust and arms, or those between command and force;
    ``thrust``: what one thruster is then taken to give at full speed [N]; ``pole``: of the shafts between command and
    model [1/s], None where the model has them."""
    said = scale_warnings(scale_of(model))
    forces = [i.name for i in model.inputs if i.unit in ("N", "N m")]
    if forces:
        text = (
            f"The model takes {', '.join(forces)} and not commands: the thrust of a command is a built-in "
            f"{thrust:.0f} N at full speed, on built-in arms, and the standard errors are those of such thrusters."
        )
        said.append(ResultWarning(code="thrust-scale-unknown", text=text))
    if pole is not None:
        text = (
            f"Shafts are taken to follow their commands with a built-in time constant of {1e3 / pole:.0f} ms, whatever "
            "the bench found; with slower ones a fit will know less."
        )
        said.append(ResultWarning(code="shaft-lag-built-in", text=text))
    return said


def scale_warnings(scale: ThrustScale) -> list[ResultWarning]:
    """Warn of a thrust or of thruster arms that were not given: masses and inertias are ratios then."""
    said = []
    if scale.relative:
        text = (
            "Nobody gave the thrust: motion alone tells ratios. Masses, damping and forces are over T, the full-ahead "
            "thrust of one thruster (c1 + c2); multiply by it. Give --thruster MODEL, --fix c1=..., --prior "
            "c1=MEAN:SD, or [scale] in the import map."
        )
        said.append(ResultWarning(code="thrust-scale-unknown", text=text))
    if scale.relative_yaw:
        text = (
            "Nobody gave the thrusters' arms: inertia and damping in yaw are over the arm y_arm. The Munk moment "
            "(m_u - m_v) u v tells it roughly, wrong where the hull has other moments of that form. Give the rig's "
            "[[thruster]] position_m, --fix y_left=... --fix y_right=..., or [geometry] in the import map."
        )
        said.append(ResultWarning(code="arm-unknown", text=text))
    return said


def outlier_lines(residuals: Sequence[ChannelResiduals], model: Model) -> list[str]:
    """A line for each channel that has innovations far beyond its noise, and what can be done."""
    robust = {o.name for o in model.outputs if o.robust}
    lines = []
    for r in residuals:
        if r.tests.outliers and r.channel not in robust:
            lines.append(
                f"{r.record}: {r.tests.outliers} of {r.e.size} innovations of {r.channel} are beyond {OUTLYING:g} "
                f"standard deviations, the largest at {r.tests.largest:.2g}: outliers, or an event that the model "
                "lacks. --robust gives outliers little weight."
            )
    return lines


def faults_first(made: Provenance) -> str:
    """What every answer begins with where logs with faults were used all the same; else empty."""
    faults = [f"{log.path}: {f.where}: {f.text}" for log in made.logs for f in log.findings if f.spoils]
    return f"Despite faults of the logs, which may make all of this meaningless ({'; '.join(faults)}): " * bool(faults)


def check_warnings(made: Provenance) -> list[ResultWarning]:
    """One for each finding of the checks before the fit that is not in order, with all the logs that it is of."""
    logs: dict[str, list[str]] = {}
    for log in made.logs:
        for f in log.findings:
            logs.setdefault(f"{f.where}: {f.text} [{f.code}]{': ' * bool(f.advice)}{f.advice}.", []).append(log.path)
    return [ResultWarning(code="log-check", text=f"{_listed(paths)}: {text}") for text, paths in logs.items()]


def late_sensor_warnings(made: Provenance, model: Model) -> list[ResultWarning]:
    """One that names the parameters which a late sensor, or a thrust that is logged late, biases; none without one."""
    logs = [log.path for log in made.logs if any(f.code in LATE and f.level == FAULT for f in log.findings)]
    biased = [p.name for p in model.parameters if p.free and p.name.partition("_")[0] in INERTIA_AND_DAMPING]
    if not logs or not biased:
        return []
    text = (
        f"{_listed(logs)}: a signal comes late, and the fit takes it as in time: {', '.join(biased)} are biased, by "
        "more than their standard errors. Correct its time stamps; for a late GNSS receiver, --effect gnss-latency "
        "estimates its age."
    )
    return [ResultWarning(code="late-sensor-bias", text=text)]


def frame_warnings(model: Model, unplaced: Sequence[str], *, unsaid: bool = False) -> list[ResultWarning]:
    """What is assumed where the model has a fixed point, which is one for all logs, and it is not known that x and y of
    these logs (``unplaced``), or those of the saved model (``unsaid``), count from one place."""
    points = [e.name for e in model.effects if e.fixed_point]
    if not points or not (unplaced or unsaid):
        return []
    why = (
        "the model does not say from where its x and y counted"
        if unsaid
        else (
            f"{_listed(list(unplaced))} {'gives' if len(unplaced) == 1 else 'give'} x and y "
            "without latitude and longitude"
        )
    )
    text = (
        f"The fixed point of {_listed(points)} is one for all logs, and {why}: all x and y are taken to count from one "
        "place. Where they do not, the point and its force are wrong."
    )
    return [ResultWarning(code="frame-assumed", text=text)]


def frames_assumed(stage: FittedModel) -> list[ResultWarning]:
    """Those of a fit, where several logs have to have one frame."""
    records = {r.name: r for r in (*stage.records, *(v.record for v in stage.validation if not stage.cross_validated))}
    unplaced = [name for name, r in records.items() if "x" in r.outputs and r.meta.get(ORIGIN) is None]
    return frame_warnings(stage.fit.model, unplaced if len(records) > 1 else ())


def not_converged(fit: Fit) -> str | None:
    """Return the sentence that replaces the answer of a fit that did not converge; None if it converged."""
    if fit.converged:
        return None
    return (
        f"The fit did not converge: it {fit.message}. Take no estimate or error from it: look for a stuck or "
        "missing signal first, then give --initial or --prior, or a model with fewer free parameters."
    )


def failed_run_warnings(failed: Sequence[FailedRun]) -> list[ResultWarning]:
    """One for each validation run that could not be evaluated."""
    text = "Left out of the validation: {0.record}, which cannot be evaluated: {0.reason}."
    return [ResultWarning(code="validation-run-failed", text=text.format(f)) for f in failed]


def cut_records(records: Sequence[Record]) -> list[ResultWarning]:
    """One for each record that ends early, since one of its signals does."""
    cuts = ((r, *r.meta["cut"]) for r in records if "cut" in r.meta)
    return [
        ResultWarning(
            code="record-cut",
            text=f"{r.name}: {name} ends {lost:.0f} s before the other signals, and what comes after it is not used.",
        )
        for r, name, lost in cuts
    ]


def stuck_sensors(records: Sequence[Record]) -> list[ResultWarning]:
    """One for each channel of a record whose samples are all the same."""
    return [line for record in records for line in _stuck(record)]


def _stuck(record: Record) -> list[ResultWarning]:
    lines = []
    for j, name in enumerate(record.outputs):
        y = record.y[:, j]
        y = y[np.isfinite(y)]
        if y.size >= FEWEST_SAMPLES and np.ptp(y) == 0.0:
            text = f"{record.name}: {name} reads {y[0]:.6g} in all of its {y.size} samples: a stuck sensor?"
            lines.append(ResultWarning(code="stuck-sensor", text=text))
    return lines


def smallest_command(records: Sequence[Record]) -> float:
    """Of a thruster on its bench, apart from zero and from the few that a ramp passes."""
    size = np.abs(np.concatenate([r.u[:, r.inputs.index("n_cmd_0")] for r in records]))
    return float(np.quantile(size[size > 0.0], PASSED)) if size.any() else 1.0


def plus_minus(value: float, error: float) -> str:
    """``40.783 ± 0.029``: a value and two significant digits of its standard error."""
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 9) if error > 0.0 else 1
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {error:.{decimals}f}"  # + 0.0: no minus before nought


def thruster_answer(
    fitted: Fit,
    has_force: bool,
    ways: Sequence[float] = (1.0, -1.0),
    calibration: float | None = None,
    smallest: float = 0.0,
) -> str:
    """``ways``: that the shaft turned, 1 ahead, -1 astern; ``calibration``: relative standard uncertainty of the
    measured force, None where nobody gave it; ``smallest``: command that was tried, as the dead zone is unknown below
    it."""
    a, tau, d = (fitted.estimate(n) for n in ("a", "tau", "d"))
    shaft = f"the shaft follows its command {1e3 * tau[0]:.0f} ms late with a time constant of {1e3 / a[0]:.0f} ms " + (
        f"and does not turn below {100 * d[0]:.1f} % of full command"
        if d[0] >= NO_DEAD_ZONE
        else f"and has no dead zone above the smallest command tried, {format_number(100 * smallest)} %"
    )
    if not has_force:
        return shaft[0].upper() + shaft[1:] + "; without a load cell nothing is known of its thrust."
    known = "statistical only" if calibration is None else "with the load cell's calibration"
    ends, lost = [], []
    for way, word in ((1.0, "ahead"), (-1.0, "astern")):
        force, error = (float(z[0]) for z in steady_thrust(fitted, np.array([way])))
        if way in ways and math.isfinite(error):
            ends.append(f"{plus_minus(way * force, math.hypot(error, (calibration or 0.0) * force))} N {word}")
        else:
            lost.append(f"{word}: not {'told by the data' if way in ways else 'measured'}")
    if not ends:
        return f"The logs do not tell the thrust ({', '.join(lost)}); {shaft}."
    also = "".join(f"; {line}" for line in lost)
    return f"The thruster gives {' and '.join(ends)} at full speed ({known}{also}); {shaft}."


def thruster_warnings(ways: Sequence[float]) -> list[ResultWarning]:
    """What a bench leaves unmeasured; ``ways``: that the shaft turned, 1 ahead, -1 astern."""
    if len(ways) != 1:
        return []
    one, other = ("ahead", "astern") if ways[0] > 0 else ("astern", "ahead")
    text = (
        f"The shaft turned {one} only: c2 is fixed at 0, so that the model takes the thruster to push {other} as hard "
        f"as {one}, which nobody measured. Add a log with steps {other}."
    )
    return [ResultWarning(code="one-direction", text=text)]


def curve_warnings(levels: Levels) -> list[ResultWarning]:
    """What a static curve leaves unknown: the load cell's zero."""
    if levels.offset is not None:
        return []
    text = (
        "The command is nowhere held at zero: the load cell's zero is unknown, and an offset is in all forces. Rest "
        "before and after the steps."
    )
    return [ResultWarning(code="zero-unknown", text=text)]


def curve_notes(levels: Levels, measured: ThrustCurve, quadratic: Quadratic) -> list[str]:
    curve, known = measured.curve, measured.calibration
    errors = np.sqrt(np.diag(quadratic.covariance))
    c2 = (
        "c2 not told by commands of one sign"
        if quadratic.c2 is None
        else f"c2 = {plus_minus(quadratic.c2, errors[1])} N"
    )
    test = f"F with {quadratic.df} and {levels.dof}" if levels.dof else f"chi-squared with {quadratic.df}"
    between = (
        f"with a scatter between visits to one level of {levels.scatter:.2g} N ({levels.dof} degrees of freedom)"
        if levels.dof
        else "but not the scatter between visits, since no level was visited twice"
    )
    zero = (
        f"The load cell's {plus_minus(levels.offset, levels.offset_se)} N at rest are taken off all levels."
        if levels.offset is not None
        else ""
    )
    notes = [
        *filter(None, [zero]),
        f"Quadratic: c1 = {plus_minus(quadratic.c1, errors[0])} N, {c2}; misfit against the levels' own errors: "
        f"p = {quadratic.p:.2g} ({test} degrees of freedom).",
        f"Standard errors of levels are of the readings, with their autocorrelation, {between}; they know nothing of "
        "friction in the rig, of the battery, or of another day.",
        "Of the load cell's calibration nobody gave an error (newton_per_count_sd, lever_ratio_sd of the rig, or "
        "`calibration` in model.toml): masses and forces by this curve have statistical errors only."
        if known is None
        else f"The load cell's calibration, ± {100 * known:.2g} %, is in the errors of what is fitted with this curve.",
    ]
    moved = np.abs(curve.force - levels.force) > 1e-9
    if moved.any():
        pooled = zip(levels.n[moved], levels.force[moved], levels.error[moved], strict=True)
        said = ", ".join(f"{plus_minus(f, s)} N at {n:g}" for n, f, s in pooled)
        notes.append(f"Levels that do not rise with the command were made level: {said}.")
    return notes


def homogeneity_sentence(a: HomogeneityTest) -> str:
    """What the test says, for people."""
    each = ", ".join(f"{v:.3g} ± {e:.2g}" for v, e in zip(a.values, a.errors, strict=True))
    low, high = a.interval
    verdict = "agree" if a.agree else "do not agree"
    silent = f" {', '.join(a.left_out)} do{'es' if len(a.left_out) == 1 else ''} not inform it." if a.left_out else ""
    if a.df == 0:
        return f"{a.name}: whether the logs agree cannot be told.{silent}"
    return (
        f"{a.name}: {a.value:.3g} ± {a.error:.2g} {a.unit} from all logs together (robust error {a.robust_error:.2g}); "
        f"one by one {each}: they {verdict} (likelihood ratio {a.lr:.1f}, chi-square with {a.df} "
        f"degree{'s' if a.df > 1 else ''} of freedom: p = {a.p:.2g}). "
        f"Scatter between logs {a.scatter:.2g}; with it {a.mean:.3g} ± {a.mean_error:.2g}, "
        f"95 % interval {low:.3g} to {high:.3g} {a.unit}.{silent}"
    )
