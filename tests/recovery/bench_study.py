"""Recovery study of the bench: is the hidden effect of a thruster identified?

    python -m tests.recovery.bench_study [--seed S] [--seeds N] [--jobs 2] [--effects a,b] [--scales 1,0.5]
                                         [--out FILE] [--report] [--docs]

The cases are every effect of ``seatrial.mocks.hidden_effects.bench``, and no effect, on benches of N seeds, at full and
half size. One run of the plan `all` is for the fit of the thruster and its diagnosis, and another for validation. Each
finished case is written as a line to the out file. An interrupted study is resumed. --report runs no case.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from seatrial.ident.characterisation.thruster import THRUSTER_RATE, fit_with_delay_on_grid
from seatrial.ident.data.record import Channel, LogSegment, Record, build_record
from seatrial.ident.diagnosis.findings import Diagnosis
from seatrial.ident.diagnosis.search import diagnose
from seatrial.ident.estimation.fitted_model import FittedModel
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions
from seatrial.ident.model.structure import Model
from seatrial.ident.models.thruster import delay_step, delayed_channels, thruster_model
from seatrial.ident.validation.prediction_errors import pooled_errors, simulation_run
from seatrial.mocks.hidden_effects.bench import EFFECTS, make_effect
from seatrial.mocks.plant.bench import Bench, draw_bench
from seatrial.mocks.plant.bench_effect import NONE
from tests.missions import bench_channels_of, push
from tests.recovery.cases import code_state
from tests.recovery.resumable import read, resume
from tests.recovery.tables import as_markdown, as_text

OUT = Path("build/bench_recovery.jsonl")
DOCS = Path(__file__).parents[2] / "docs" / "recovery-bench.md"
NAMES = ("none", *EFFECTS)
Row = dict[str, Any]


@dataclass(frozen=True)
class BenchCase:
    """Case of the study: an effect (or ``none``) of a given size on the bench of a seed."""

    effect: str
    seed: int
    scale: float = 1.0

    @property
    def key(self) -> str:
        """Return the key of the case in the results."""
        return f"{self.effect}/{self.seed}/{self.scale:g}"


def bench_of(case: BenchCase) -> Bench:
    """Return the bench with its effect."""
    none = case.effect == "none"
    return draw_bench(case.seed, NONE if none else make_effect(case.effect, case.seed, case.scale))


def bench_run(found: Mapping[str, Channel], run: int, model: Model) -> LogSegment:
    """Return the channels as `seatrial ident diagnose` makes them from a log."""
    own = {"n": found["n_thruster"], "force": found["force"]}
    return LogSegment(f"run {run}", delayed_channels(found["n_cmd_thruster"], delay_step(model)) | own)


def diagnose_bench(case: BenchCase) -> Diagnosis:
    """Fit the thruster to one run, and return the diagnosis of this model."""
    found = [bench_channels_of(push(bench_of(case), run)[0]) for run in (1, 2)]  # The plan `all`, twice.

    def records(model: Model) -> list[Record]:
        return [build_record(model, bench_run(found[0], 1, model).channels, name="run 1", rate=THRUSTER_RATE)]

    model = fit_with_delay_on_grid(thruster_model(), records(thruster_model()), records, EstimationOptions())[0].model
    return diagnose(model, [bench_run(found[0], 1, model)], [bench_run(found[1], 2, model)], rate=THRUSTER_RATE)


def run_case(case: BenchCase) -> Row:
    """Run a case and return its line of the study. A failed case also gives a line."""
    began = time.process_time()
    row: Row = asdict(case) | {"key": case.key, "code": code_state()}
    try:
        found = diagnose_bench(case)
    except Exception as problem:  # The study continues and counts the failure.
        return row | {"error": f"{type(problem).__name__}: {problem}"}
    return row | {
        "cpu": round(time.process_time() - began, 2),
        "found": [r.effect.name for r in found.effects],
        "attribution": [j.attribution for j in found.attributions],
        "remaining_candidates": [s.name for s in found.remaining],
        "before": free_errors(found.before),
        "after": free_errors(found.after),
    }


def free_errors(fitted: FittedModel) -> dict[str, float]:
    """Return root mean square errors in simulation on the validation data, by channel."""
    parts = pooled_errors([dict(simulation_run(fitted.model, v.record, v.values).errors) for v in fitted.validation])
    return {name: float(f"{e.rms:.4g}") for name, e in parts.items()}


def line(row: Row) -> str:
    """Return a short description of a case."""
    if "error" in row:
        return f"{row['key']}: failed: {row['error']}"
    return f"{row['key']}: {', '.join(row['found']) or 'none'} ({verdict(row)}, {row['cpu']:.0f} s)"


def verdict(row: Row) -> str:
    """Return the verdict of a case.

    exact: only the true effect was found. first: the true effect is first, followed by others. missed: no effect was
    found. nonparametric: a nonparametric curve is first. ambiguous: another effect is first but not identified. wrong:
    another effect is first and identified, or an effect was found on a clean bench.
    """
    truth, found = row["effect"], row["found"]
    if truth == "none" or not found:
        return "exact" if (truth == "none") == (not found) else "missed" if not found else "wrong"
    if found[0] == truth:
        return "exact" if found == [truth] else "first"
    if found[0].startswith("unknown "):
        return "nonparametric"
    return "ambiguous" if row["attribution"][0] != "identified" else "wrong"


def false_name(row: Row) -> bool:
    """Return whether an effect was called identified that does not exist."""
    found = zip(row["found"], row["attribution"], strict=True)
    return any(attribution == "identified" and name != row["effect"] for name, attribution in found)


VERDICTS = ("exact", "first", "ambiguous", "nonparametric", "missed", "wrong")


def rates(rows: Sequence[Row]) -> list[list[str]]:
    """Return a table with one line per effect."""
    lines = [["truth", "cases", *VERDICTS, "force error before -> after, N", "shaft error before -> after", "CPU s"]]
    for name in [n for n in NAMES if any(r["effect"] == n and "error" not in r for r in rows)]:
        cases = [r for r in rows if r["effect"] == name and "error" not in r]
        counts = [sum(verdict(r) == v for r in cases) for v in VERDICTS]
        errors = [
            f"{middle([r['before'][c] for r in cases]):.3g} -> {middle([r['after'][c] for r in cases]):.3g}"
            for c in ("force", "n")
        ]
        cpu = f"{middle([r['cpu'] for r in cases]):.0f}"
        lines.append([name, str(len(cases)), *(str(c or ".") for c in counts), *errors, cpu])
    return lines


def middle(values: Sequence[float]) -> float:
    """Return the median."""
    kept = sorted(values)
    return (kept[(len(kept) - 1) // 2] + kept[len(kept) // 2]) / 2


def summary(rows: Sequence[Row]) -> list[list[str]]:
    """Return the table of the most important numbers."""
    good = [r for r in rows if "error" not in r]
    lines = [["", ""]]
    for scale in sorted({r["scale"] for r in good}, reverse=True):
        some = [r for r in good if r["scale"] == scale and r["effect"] != "none"]
        if not some:
            continue
        for description, kinds in (
            ("true effect first", ("exact", "first")),
            ("only the true effect", ("exact",)),
            ("another effect first, identified", ("wrong",)),
        ):
            lines.append([f"{description}, size {scale:g}", f"{sum(verdict(r) in kinds for r in some)}/{len(some)}"])
        lines.append(
            [f"another effect identified anywhere, size {scale:g}", f"{sum(map(false_name, some))}/{len(some)}"]
        )
    clean = [r for r in good if r["effect"] == "none"]
    if clean:
        lines.append(["false alarms on clean benches", f"{sum(bool(r['found']) for r in clean)}/{len(clean)}"])
    return [*lines, ["cases that failed", str(len(rows) - len(good))]]


def report(rows: Sequence[Row], form: Any) -> str:
    """Return all tables."""
    head = "## " if form is as_markdown else ""
    parts = [("Summary", summary(rows))]
    for scale in sorted({r["scale"] for r in rows}, reverse=True):
        parts.append(
            (
                f"By effect, size {scale:g} (errors: medians of the simulation errors on validation data)",
                rates([r for r in rows if r["scale"] == scale]),
            )
        )
    text = "\n\n".join(f"{head}{title}\n\n{form(lines)}" for title, lines in parts)
    words = (
        "*exact*: only the true effect was found, or no effect on a clean bench. *first*: the true effect is first, "
        "followed by others. *ambiguous*: another effect is first, but it is not identified. *nonparametric*: a "
        "nonparametric curve is first. *missed*: no effect was found. *wrong*: another effect is first and identified, "
        "or an effect was found on a clean bench. A dot stands for zero."
    )
    return f"{text}\n\n{words}"


def document(rows: Sequence[Row], command: str) -> str:
    """Return the text of docs/recovery-bench.md."""
    return (
        "# Recovery study of the bench\n\n"
        "Each mock bench has one hidden effect (`mocks/hidden_effects/bench.py`, in another form than in the catalogue "
        "of `ident`), or no hidden effect (a clean bench). Each bench runs the plan `all` (126 s) twice. The first run "
        "is for the fit and the diagnosis, the second for validation. Every bench has its own thrust coefficients, "
        "pool and noise.\n\n"
        f"    {command}\n\n" + report(rows, as_markdown) + "\n"
    )


def main(words: Sequence[str] | None = None) -> int:
    """Run the missing cases, then print the tables."""
    arguments = _parser().parse_args(words)
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    # One clean bench for each seed and scale. All clean benches differ.
    cases = [
        BenchCase(e, s + (1000 * k if e == "none" else 0), scale)
        for s in seeds
        for k, scale in enumerate(arguments.scales)
        for e in arguments.effects
    ]
    try:
        rows = (
            list(read(arguments.out).values())
            if arguments.report
            else resume(cases, run_case, line, arguments.jobs, arguments.out)
        )
    except KeyboardInterrupt:
        print(f"interrupted; run the same again to go on ({arguments.out})", file=sys.stderr)
        return 130
    print(report(rows, as_text))
    if arguments.docs:
        scales = ",".join(f"{s:g}" for s in arguments.scales)
        command = (
            f"python -m tests.recovery.bench_study --seed {arguments.seed} --seeds {arguments.seeds} --scales {scales}"
        )
        DOCS.write_text(document(rows, f"{command} --docs"), encoding="utf-8")
        print(f"written: {DOCS.name}")
    return 1 if any("error" in r for r in rows) else 0


def _effects(text: str) -> list[str]:
    for name in text.split(","):
        if name not in NAMES:
            raise argparse.ArgumentTypeError(f"no effect {name!r}; there are {', '.join(NAMES)}")
    return text.split(",")


def _scales(text: str) -> list[float]:
    return [float(s) for s in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m tests.recovery.bench_study", description="Is it named?")
    parser.add_argument("--seed", type=int, default=1, help="the first bench's")
    parser.add_argument("--seeds", type=int, default=3, help="how many benches for each effect")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--effects", type=_effects, default=list(NAMES), help="comma-separated, `none` among them")
    parser.add_argument("--scales", type=_scales, default=[1.0, 0.5], help="sizes of the effects, comma-separated")
    parser.add_argument("--out", type=Path, default=OUT, help="results, a JSON line a case")
    parser.add_argument("--report", action="store_true", help="only print what is in the out file")
    parser.add_argument("--docs", action="store_true", help="write docs/recovery-bench.md")
    return parser


if __name__ == "__main__":
    sys.exit(main())
