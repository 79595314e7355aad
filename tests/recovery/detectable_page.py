"""Smallest sizes of effects that a diagnosis of a realistic mock boat finds, by trial: docs/detectable-sizes.md.

python -m tests.recovery.detectable_page

Two realistic mock boats without a large effect run variants of a trial: with other sensors, or for longer. In each
trial the model is fitted with wind and with the common errors, which these boats have, and the smallest size that the
score test finds with a probability of 80 % is computed for each effect (`seatrial.ident.diagnosis.power`). An effect
that is in the fitted model has the size that its standard error gives for the same test.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from seatrial.bench.mission_generators import make_mission
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.diagnosis.findings import Diagnosis
from seatrial.ident.diagnosis.power import POWER, detectable_sizes
from seatrial.ident.diagnosis.score_test import Score, score_test_passes, score_threshold
from seatrial.ident.diagnosis.search import diagnose
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.thrust_scale import prior_distances
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.model.structure import Model, Output, Sensor, Signals
from seatrial.ident.models.horizontal import STANDARD, horizontal_model
from seatrial.ident.numerics import noncentrality
from seatrial.ident.report.formatting import degrees_for
from seatrial.mocks.hidden_effects.catalogue import make_effect
from seatrial.mocks.offline_simulation import Recording, simulate
from seatrial.mocks.plant.boat import Boat, draw_boat
from tests.missions import channels_of
from tests.recovery.cases import Row, code_state
from tests.recovery.kinds import NONE, SECONDS, VALIDATION_SECONDS, Case, boat_of
from tests.recovery.resumable import resume
from tests.recovery.tables import as_markdown, interval

ROOT = Path(__file__).parents[2]
DATA = ROOT / "docs/data/detectable-sizes.jsonl"
PAGE = ROOT / "docs/detectable-sizes.md"
BOATS = (41, 42)
HEADING_HZ, HEADING_SD = 5.0, math.radians(0.3)  # heading of two GNSS antennas that are a metre apart
HEADING_OFFSET = math.radians(0.5)  # misalignment of the two antennas
WITHOUT_ACCELEROMETERS = tuple(name for name in STANDARD if name != "accelerometer")


@dataclass(frozen=True)
class Variant:
    """Variant of a trial: its sensors, and its duration as a multiple of the usual one."""

    says: str
    accelerometers: bool = False
    heading: bool = False  # a second heading, of two GNSS antennas
    times: float = 1.0


VARIANTS = {
    "base": Variant("base"),
    "longer": Variant("twice as long", times=2.0),
    "accelerometers": Variant("with accelerometers", accelerometers=True),
    "heading": Variant("with a second heading", heading=True),
    "both": Variant("with both", accelerometers=True, heading=True),
}


@dataclass(frozen=True)
class Trial:
    """A boat, by its seed, in a variant of the trial."""

    seed: int
    variant: str

    @property
    def key(self) -> str:
        """Return the key of the trial in the results."""
        return f"{self.variant}/{self.seed}"


@dataclass(frozen=True)
class Verification:
    """Trials of a textbook boat with an effect of the computed size or a multiple of it.

    They count how often the score test of the effect passes.
    """

    effect: str  # name of the hidden effect and of the effect of the catalogue
    hidden: str  # parameter of the hidden effect
    parameter: str  # parameter of the effect of the catalogue, in the same unit
    times: float  # true size over the computed one
    runs: int

    @property
    def key(self) -> str:
        """Return the key of the verification in the results."""
        return f"verification/{self.effect}/{self.times:g}"


VERIFICATIONS = (
    Verification("mount", "psi_0", "psi_mount", 1.0, 40),
    Verification("yaw-bias", "n_0", "N_0", 1.0, 40),
    Verification("yaw-bias", "n_0", "N_0", 2.0, 12),
)
CLEAN_RUNS, RUN_SECONDS = 4, 120.0


def run_case(case: Trial | Verification) -> Row:
    """Return the line of a trial or of a verification."""
    row: Row = {"key": case.key, "code": code_state()}
    began = time.process_time()
    row |= verified(case) if isinstance(case, Verification) else sizes_of_trial(case)
    return row | {"cpu": round(time.process_time() - began, 1)}


def sizes_of_trial(trial: Trial) -> Row:
    """Fit the model to a trial, and return the smallest size of each parameter of each effect.

    No effect is searched for, so that the models of the trials differ only by the common errors that the data need. The
    row also has these errors, and the distance of the thrust from its prior.
    """
    variant = VARIANTS[trial.variant]
    boat, runs = boat_of(Case(NONE, trial.seed, "realistic-clean")), []
    for seconds, mission_seed, run in ((SECONDS, 100, 1), (VALIDATION_SECONDS, 200, 2)):
        lasts = variant.times * seconds
        t, n = make_mission("mixed", lasts, mission_seed + trial.seed).setpoints()
        runs.append(segment(boat, simulate(boat, t, np.asarray(n), lasts, run), variant, [trial.seed, run]))
    found = diagnose(model_of(variant) + catalogue()["wind"], runs[:1], runs[1:], max_effects=0)
    sizes = {d.effect: d.sizes for d in detectable_sizes(found.scores, rows_of(found), found.policy)}
    sizes |= {n: sizes_in_model(found, n) for n in (e.name for e in found.after.fit.model.effects) if n in catalogue()}
    return {
        "common": [e.name for e in found.common_errors.effects] if found.common_errors else [],
        "prior": [round(d.distance, 2) for d in prior_distances(found.after.fit)],
        "sizes": {name: largest_of_records(by_name) for name, by_name in sizes.items()},
    }


def segment(boat: Boat, recording: Recording, variant: Variant, seed: Sequence[int]) -> LogSegment:
    """Return the channels of a recording that the sensors of a variant have measured."""
    channels = channels_of(recording)
    if not variant.accelerometers:
        channels = {name: c for name, c in channels.items() if name not in ("ax", "ay")}
    if variant.heading:
        channels["psi_gnss"] = second_heading(boat, recording, seed)
    return LogSegment(f"run {seed[-1]}", channels)


def second_heading(boat: Boat, recording: Recording, seed: Sequence[int]) -> Channel:
    """Return the heading of a receiver with two antennas: noisy, misaligned, and as late as the positions of the boat.

    The plant has no such receiver, so that its heading follows from the true heading at 10 Hz.
    """
    late = next(e.parameters["latency"] for e in boat.effects if e.name == "gnss-latency")
    rng, truth = np.random.default_rng([*seed, 93]), recording.truth
    t = np.arange(1.0, float(truth["t"][-1]), 1.0 / HEADING_HZ)
    psi = np.interp(t - late, truth["t"], np.unwrap(truth["psi"])) + HEADING_OFFSET
    return Channel(t, psi + HEADING_SD * rng.standard_normal(t.size))


def model_of(variant: Variant) -> Model:
    """Return the nominal model of the sensors of a variant, with the thrust known to 5 %."""
    model = horizontal_model(sensors=STANDARD if variant.accelerometers else WITHOUT_ACCELEROMETERS)
    c1 = replace(model.parameter("c1").at(40.05), free=True, prior=(40.05, 2.0), origin=ParameterOrigin.PRIOR)
    c2 = replace(model.parameter("c2").at(1.11).fixed(), origin=ParameterOrigin.GIVEN)
    model = model.replace_parameters(c1, c2)
    return with_second_heading(model) if variant.heading else model


def with_second_heading(model: Model) -> Model:
    """Return a model with the output ``psi_gnss``: a second heading with an offset and a latency of its own."""

    def measure(s: Signals) -> None:
        """Set the second heading [rad]: the heading of a short time before, with the misalignment of the antennas."""
        s.y["psi_gnss"] = s.x.psi - s.p.tau_psi_gnss * s.x.r + s.p.psi_gnss_0

    sensor = Sensor("gnss_heading", (Output("psi_gnss", "rad", "e_psi_gnss", angle=True),))
    parameters = (
        Parameter("psi_gnss_0", 0.0, "rad", "misalignment of the two antennas", prior=(0.0, 0.02), step=0.01),
        Parameter("tau_psi_gnss", 0.1, "s", "latency of the second heading", prior=(0.1, 0.1), step=0.02),
        Parameter("e_psi_gnss", 0.01, "rad", "noise of the second heading", "log"),
    )
    return replace(
        model,
        sensors=(*model.sensors, sensor),
        parameters=(*model.parameters, *parameters),
        stages=(*model.stages, ("second_heading", measure)),
        source="",
    )


def rows_of(found: Diagnosis) -> int:
    """Return the number of rows of the estimation data."""
    return sum(v.record.n_rows for v in found.after.estimation)


def sizes_in_model(found: Diagnosis, effect: str) -> dict[str, float]:
    """Return the smallest size of each parameter of an effect that is in the fitted model, as its score test had it.

    The information of a parameter is that of the inverse covariance of the effect's parameters, with the others at
    zero, without their priors and without the inflation by correlated residuals, as in a score test.
    """
    fit, zero = found.after.fit, {p.name for p in catalogue()[effect].parameters if p.value == 0.0}
    plain = (fit.covariance - np.nan_to_num(fit.considered)) / np.outer(fit.inflation, fit.inflation)
    at = [i for i, p in enumerate(fit.parameters) if p.name in zero and np.isfinite(plain[i, i]) and plain[i, i] > 0]
    if not at:
        return {}
    priors = [fit.parameters[i].prior for i in at]
    information = np.diag(np.linalg.inv(plain[np.ix_(at, at)])) - [0.0 if p is None else p[1] ** -2 for p in priors]
    needed = noncentrality(limit_of(Score(effect, 0.0, len(at), 0.0, {}, {}), found), len(at), POWER)
    return {fit.names[i]: math.sqrt(needed / info) for i, info in zip(at, information, strict=True) if info > 0}


def limit_of(score: Score, found: Diagnosis) -> float:
    """Return the value that the statistic of a score has to exceed: critical value, and penalty of the criterion."""
    return max(score_threshold(score, found.scores, found.policy), score.df * math.log(rows_of(found)))


def largest_of_records(sizes: Mapping[str, float]) -> dict[str, float]:
    """Return sizes by parameter; of a parameter with its own value in each record, the largest."""
    names = dict.fromkeys(name.partition("@")[0] for name in sizes)
    return {n: float(f"{max(v for k, v in sizes.items() if k.partition('@')[0] == n):.4g}") for n in names}


def verified(case: Verification) -> Row:
    """Count how often the score test of an effect of the computed size passes, on a textbook boat in short runs."""
    seed = BOATS[0]
    scores = [(f, own_score(f, case.effect)) for f in (short_diagnosis(draw_boat(seed), k) for k in range(CLEAN_RUNS))]
    information = [s.information[case.parameter] for _, s in scores]
    needed = [noncentrality(limit_of(s, f), s.df, POWER) for f, s in scores]
    size = math.sqrt(float(np.mean(needed) / np.mean(information)))
    full = make_effect(case.effect, seed).parameters[case.hidden]
    effect = make_effect(case.effect, seed, case.times * size / abs(full))
    exceeded = passed = 0
    for k in range(case.runs):
        found = short_diagnosis(draw_boat(seed, [effect]), 100 + k)
        score = own_score(found, case.effect)
        exceeded += score.lm > limit_of(score, found)
        passed += score_test_passes(score, found.scores, found.policy)
    return {
        "parameter": case.parameter,
        "size": round(size, 5),
        "simulated": round(effect.parameters[case.hidden], 5),
        "runs": case.runs,
        "exceeded": int(exceeded),
        "passed": int(passed),
    }


def short_diagnosis(boat: Boat, run: int) -> Diagnosis:
    """Return the score tests of the nominal model on a short run of a textbook boat, without a search."""
    segments = []
    for name, seconds, k in (("estimation", RUN_SECONDS, 2 * run), ("validation", RUN_SECONDS / 2, 2 * run + 1)):
        t, n = make_mission("mixed", seconds, 7).setpoints()
        segments.append(LogSegment(name, channels_of(simulate(boat, t, np.asarray(n), seconds, k))))
    return diagnose(model_of(Variant("", accelerometers=True)), segments[:1], segments[1:], max_effects=0)


def own_score(found: Diagnosis, name: str) -> Score:
    """Return the score of an effect."""
    return next(s for s in found.scores if s.name == name)


TEXT = """# What a diagnosis can and cannot see

An effect that a boat has may be too small for the data of a trial. This page has the smallest size of each effect that
its score test finds with a probability of {power:.0f} %, on realistic mock boats, and what to add to a trial to see
more. `seatrial ident diagnose` computes the same sizes for your own data: see *What these data would have shown* in its
report.

    python -m tests.recovery.detectable_page

The two boats have the small imperfections of [realistic mock boats](realistic-boats.md) and no large effect. The
usual trial is a mixed mission of {seconds:.0f} s with a heading, a gyro, GNSS position and velocity, and measured
shaft speeds; the thrust is known to 5 %. The fitted model has wind, which these boats have, and the common errors of
sensors and hull form that the data need, as a diagnosis has after its first steps. The second heading is that of a
receiver with two antennas: {hz:.0f} Hz, a noise of {sd:.1f}°, unknown misalignment and latency.

## What to add to a trial

{summary}

The second column counts the effects of the table below that pass at their typical size on both boats. The third
has the median, over all effects, of the smallest size divided by that of the usual trial. An effect gains if its
smallest size falls by 30 % or more.

## Smallest sizes

{table}

Two numbers are those of the two boats. The parameter is that of the effect which shows best. The typical size is half
a standard deviation of the effect's prior, which `seatrial mission design` also assumes. A dash means that the trial
has no sensor on which the effect acts, or that the estimated parameters explain the effect at any size. The common
errors are not the same ones in all trials, so that an effect can need a larger size in a longer trial: there the data
need another common error, which explains a part of the effect. An effect larger than its smallest size passes its
score test, but the diagnosis may still find it ambiguous, and rejects it if it does not improve the prediction of the
validation data. `waves` is tested by a spectral peak and has no such size.

## Check by simulation

The sizes follow from the information of the data and from the distribution of the statistic. For two effects they are
checked on a textbook boat with runs of {run_seconds:.0f} s, which have the effect:

{checks}

The computation expects {power:.0f} % above the limit at the computed size. It takes the noise of the fit without the
effect. In a fit to data with the effect, the disturbance forces explain a part of it: a constant moment makes the
fitted disturbance slower, and the statistic smaller. So the sizes of this page are lower limits, above all for effects
that change slowly: the constant moment has to be larger than computed, and twice the computed size is enough. The
column *passed* adds the block-robust test, which the computation leaves out.
"""


def document(rows: Sequence[Row]) -> str:
    """Return the text of the page."""
    trials = {(r["key"].split("/")[0], int(r["key"].split("/")[1])): r["sizes"] for r in rows if "sizes" in r}
    checks = [["effect", "parameter", "true size", "runs", "statistic above the limit", "95 % interval", "passed"]]
    for r in sorted((r for r in rows if "exceeded" in r), key=lambda r: str(r["key"])):
        _, effect, times = r["key"].split("/")
        share, passed = (f"{100 * r[key] / r['runs']:.0f} %" for key in ("exceeded", "passed"))
        factor, unit = degrees_for(unit_of(effect, r["parameter"]))
        size = f"{factor * abs(r['simulated']):.2g} {unit}".rstrip()
        size += " (as computed)" if times == "1" else f" ({times} times as computed)"
        limits = f"{interval(r['exceeded'], r['runs'])} %"
        checks.append([effect, r["parameter"], size, str(r["runs"]), share, limits, passed])
    return TEXT.format(
        power=100 * POWER,
        seconds=SECONDS,
        hz=HEADING_HZ,
        sd=math.degrees(HEADING_SD),
        summary=as_markdown(summary(trials)),
        table=as_markdown(table(trials)),
        run_seconds=RUN_SECONDS,
        checks=as_markdown(checks),
    )


Sizes = Mapping[tuple[str, int], Mapping[str, Mapping[str, float]]]  # by variant and boat: effect, parameter, size


def table(trials: Sizes) -> list[list[str]]:
    """Return the table of the smallest sizes: one line for each effect, with the parameter that shows best."""
    lines = [["effect", "parameter", "typical size", *(v.says for v in VARIANTS.values())]]
    for effect in effects_of(trials):
        name = best_parameter(trials, effect)
        if name is None:
            lines.append([effect, "", "", *["–"] * len(VARIANTS)])
            continue
        factor, unit = degrees_for(unit_of(effect, name))
        cells = []
        for variant in VARIANTS:
            found = sorted(factor * s for s in sizes_of(trials, variant, effect, name))
            cells.append(" to ".join(dict.fromkeys(f"{s:.2g}" for s in found)) or "–")
        typical = f"{factor * typical_size(effect, name):.2g} {unit}".rstrip()
        lines.append([effect, name, typical, *cells])
    return lines


def summary(trials: Sizes) -> list[list[str]]:
    """Return the table of the variants: effects found at their typical size, median gain, effects that gain most."""
    lines = [["trial", "pass at the typical size", "size, over the usual trial", "effects that gain"]]
    names = {e: best_parameter(trials, e) for e in effects_of(trials)}
    for variant, how in VARIANTS.items():
        seen, ratios = 0, {}
        for effect, name in names.items():
            if name is None:
                continue
            sizes, usual = sizes_of(trials, variant, effect, name), sizes_of(trials, "base", effect, name)
            seen += len(sizes) == len(BOATS) and max(sizes) <= typical_size(effect, name)
            if len(sizes) == len(usual) > 0:
                ratios[effect] = math.exp(float(np.mean(np.log(sizes)) - np.mean(np.log(usual))))
        gains = sorted((r, e) for e, r in ratios.items() if r <= 0.7)
        new = [
            e for e, n in names.items() if n and not sizes_of(trials, "base", e, n) and sizes_of(trials, variant, e, n)
        ]
        gained = [f"{e} ({r:.2f})" for r, e in gains[:6]] + [f"{e} (new)" for e in new]
        more = f" and {len(gains) - 6} more" if len(gains) > 6 else ""
        median = f"{np.median(list(ratios.values())):.2f}" if ratios else ""
        lines.append([how.says, f"{seen} of {len(names)}", median, ", ".join(gained) + more])
    return lines


def effects_of(trials: Sizes) -> list[str]:
    """Return the names of all effects that a trial has a size of, sorted. ``waves`` has no size."""
    return sorted({name for sizes in trials.values() for name in sizes} - {"waves"})


def sizes_of(trials: Sizes, variant: str, effect: str, parameter: str) -> list[float]:
    """Return the smallest sizes of a parameter in a variant, one for each boat that has one."""
    found = [trials.get((variant, seed), {}).get(effect, {}).get(parameter) for seed in BOATS]
    return [s for s in found if s is not None]


def best_parameter(trials: Sizes, effect: str) -> str | None:
    """Return the parameter of an effect whose smallest size is smallest relative to its typical size; None without one.

    The first variant that has sizes of the effect decides.
    """
    for variant in VARIANTS:
        names = {n for seed in BOATS for n in trials.get((variant, seed), {}).get(effect, {})}
        ratios = {n: np.mean(sizes_of(trials, variant, effect, n)) / typical_size(effect, n) for n in names}
        if ratios:
            return min(ratios, key=lambda n: float(ratios[n]))
    return None


def typical_size(effect: str, name: str) -> float:
    """Return half of the standard deviation of a parameter's prior, or five steps if it has none."""
    p = parameter_of(effect, name)
    return 0.5 * p.prior[1] if p.prior is not None else 5.0 * p.step


def unit_of(effect: str, name: str) -> str:
    """Return the unit of a parameter of an effect."""
    return parameter_of(effect, name).unit


def parameter_of(effect: str, name: str) -> Parameter:
    """Return a parameter of an effect of the catalogue."""
    return next(p for p in catalogue()[effect].parameters if p.name == name)


def described(row: Row) -> str:
    """Return the line of a finished case."""
    return f"{row['key']}: {row.get('common', row.get('exceeded'))}, {row['cpu']:.0f} s"


def main(words: Sequence[str] | None = None) -> int:
    """Run the trials that the file does not contain yet, and write the page."""
    parser = argparse.ArgumentParser(
        "python -m tests.recovery.detectable_page",
        description=__doc__.splitlines()[0] if __doc__ else None,
        epilog="Example: python -m tests.recovery.detectable_page --out build/detectable.jsonl",
    )
    parser.add_argument("--out", type=Path, default=DATA, help="results, a JSON line a case; finished ones are kept")
    options = parser.parse_args(words)
    cases: list[Trial | Verification] = [Trial(seed, variant) for seed in BOATS for variant in VARIANTS]
    rows = resume([*cases, *VERIFICATIONS], run_case, described, 1, options.out)
    PAGE.write_text(document(rows), encoding="utf-8")
    print(f"written: {PAGE.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
