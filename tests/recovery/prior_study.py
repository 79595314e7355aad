"""Warnings about correct priors: how often `seatrial ident vehicle` says that the data contradict a right prior.

python -m tests.recovery.prior_study
python -m tests.recovery.prior_study --given thrust

A correct prior is a measurement with an error of the stated size: its mean is drawn from a normal distribution around
the true value. Each boat has one for the thrust alone, or for the thrust, the masses and the damping. There are
textbook boats, realistic mock boats, and realistic mock boats with a large effect that the model lacks. The study ends
when the 95 % interval of the share of warnings lies on one side of 1 %, or when all boats have been run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seatrial.ident.estimation.thrust_scale import prior_distances
from seatrial.ident.reporter import QUIET
from seatrial.ident.workflows.vehicle import fit_vehicle
from seatrial.ident.workflows.vehicle_model import VehicleRequest
from seatrial.mocks.plant.boat import draw_boat
from tests.recovery.cases import Row, code_state, recordings_of
from tests.recovery.kinds import KINDS, NONE, Case, all_large
from tests.recovery.logged import ESTIMATION, VALIDATION, write_logs
from tests.recovery.resumable import read, resume
from tests.recovery.tables import as_markdown, interval

OUT = Path(__file__).parents[2] / "docs/data/correct-priors.jsonl"
# Relative standard deviation of each prior: a bench test of the thruster, a scale and a strip calculation of the added
# masses, a towing test.
WIDTHS = {"c1": 0.05, "m_u": 0.1, "m_v": 0.2, "m_r": 0.2, "d_uu": 0.15, "d_v": 0.25, "d_r": 0.25}
GIVEN = {"all": tuple(WIDTHS), "thrust": ("c1",)}  # names of the given priors
FIRST_SEEDS = {"all": 101, "thrust": 201}  # the boats of both are different ones
SECONDS = (250.0, 120.0)
MOST = 0.01  # largest share of warnings


@dataclass(frozen=True)
class PriorCase:
    """A boat, and the priors that are given for it: a key of `GIVEN`."""

    boat: Case
    given: str

    @property
    def key(self) -> str:
        """Return the key of the case in the results."""
        return f"{self.given}/{self.boat.key}"

    def priors(self) -> dict[str, tuple[float, float]]:
        """Return mean and standard deviation of a correct prior of each parameter."""
        rng = np.random.default_rng([self.boat.seed, list(KINDS).index(self.boat.kind)])
        true = draw_boat(self.boat.seed).truth()
        sds = {name: width * true[name] for name, width in WIDTHS.items()}
        drawn = {name: (float(true[name] + sd * rng.standard_normal()), float(sd)) for name, sd in sds.items()}
        return {name: drawn[name] for name in GIVEN[self.given]}


def cases(given: str, boats: int) -> list[PriorCase]:
    """Return the boats with these priors: one of each kind for each seed."""
    found = []
    for seed in range(FIRST_SEEDS[given], FIRST_SEEDS[given] + boats):
        large = str(np.random.default_rng([seed, 91]).choice(all_large(seed)))
        kinds = ((NONE, "clean"), (NONE, "realistic-clean"), (large, "realistic"))
        found += [PriorCase(Case(effect, seed, kind), given) for effect, kind in kinds]
    return found


def run_case(case: PriorCase) -> Row:
    """Fit a boat with correct priors, and return the distance of each from the data, in standard deviations."""
    row: Row = {"key": case.key, "code": code_state()}
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_logs(folder, recordings_of(case.boat, SECONDS))
        request = VehicleRequest(
            [folder / ESTIMATION],
            [folder / VALIDATION],
            folder,
            fixed={"c2": draw_boat(case.boat.seed).truth()["c2"]},
            priors=case.priors(),
        )
        try:
            done = fit_vehicle(request, "", QUIET, with_dynamics=False)
        except Exception as problem:  # The study continues and counts the failure.
            return row | {"error": f"{type(problem).__name__}: {problem}"}
    found = {d.parameter.name: round(d.distance, 2) for d in prior_distances(done.fitted.fit)}
    warned = sum(w.code == "prior-contradicted" for w in done.result.warnings)
    return row | {"distance": {n: d for n, d in found.items() if n in WIDTHS}, "warnings": warned}


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return a table of the share of priors with a warning, one line for each kind of boat and one for all."""
    lines = [["given priors", "boats", "fits", "tested", "warnings", "share", "95 % interval", "RMS distance"]]
    groups = [*dict.fromkeys(group_of(r) for r in rows), ("", "all")]
    for group in groups:
        chosen = [r for r in rows if group in (group_of(r), ("", "all"))]
        n, warned = counts(chosen)
        share = f"{100 * warned / n:.1f} %" if n else ""
        rms = float(np.sqrt(np.mean([d**2 for r in chosen for d in r["distance"].values()])))
        lines.append([*group, str(len(chosen)), str(n), str(warned), share, f"{interval(warned, n)} %", f"{rms:.2f}"])
    return lines


def group_of(row: Row) -> tuple[str, str]:
    """Return the given priors and the kind of the boat of a line."""
    given, kind, *_ = str(row["key"]).split("/")
    return given, kind


def counts(rows: Sequence[Row]) -> tuple[int, int]:
    """Return the number of priors, and the number of them with a warning."""
    return sum(len(r["distance"]) for r in rows), sum(r["warnings"] for r in rows)


def decided(rows: Sequence[Row]) -> bool:
    """Return whether the 95 % interval of the share of warnings lies on one side of 1 %."""
    n, warned = counts(rows)
    if n == 0:
        return False
    low, high = (float(x) / 100 for x in interval(warned, n).split("-"))
    return high <= MOST or low > MOST


def described(row: Row) -> str:
    """Return the line of a finished case: the distances of its priors, or its error."""
    return f"{row['key']}: {row.get('distance', row.get('error'))}"


def main(words: Sequence[str] | None = None) -> int:
    """Run the boats until the share of warnings is decided, and print the table."""
    parser = argparse.ArgumentParser(
        "python -m tests.recovery.prior_study",
        description=__doc__.splitlines()[0] if __doc__ else None,
        epilog="Example: python -m tests.recovery.prior_study --boats 3 --out build/priors.jsonl",
    )
    parser.add_argument("--boats", type=int, default=20, help="largest number of boats of each kind")
    parser.add_argument(
        "--given", choices=list(GIVEN), default="all", help="priors of all parameters, or of the thrust"
    )
    parser.add_argument("--out", type=Path, default=OUT, help="results, a JSON line a case")
    options = parser.parse_args(words)
    every = cases(options.given, options.boats)
    for at in range(3, len(every) + 1, 3):
        rows = resume(every[:at], run_case, described, 1, options.out)
        if decided([r for r in rows if "error" not in r]):
            break
    known = list(read(options.out).values())
    print(as_markdown(table([r for r in known if "error" not in r])))
    print(f"\n{sum('error' in r for r in known)} of {len(known)} fits failed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
