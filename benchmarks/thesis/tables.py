"""The tables in Markdown: truth, what the paper prints, and the estimates here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.thesis import printed
from benchmarks.thesis.fits import Both, Plane
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.validation.whiteness import whiteness_test

Lines = list[str]
Estimates = Mapping[str, tuple[float, float]]
CHANNELS = ("ax", "ay", "x", "y", "vx", "vy", "r", "psi")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Lines:
    """A table's lines; all columns but the first are numbers."""
    return [
        "| " + " | ".join(head) + " |",
        "|---|" + "---:|" * (len(head) - 1),
        *("| " + " | ".join(r) + " |" for r in rows),
    ]


def number(value: float, error: float | None = None) -> str:
    """Four digits, and a standard error where there is one."""
    text = "0" if abs(value) < 5e-5 else f"{value:.4g}"
    return text if error is None or not np.isfinite(error) else f"{text} ± {error:.2g}"


def table_2(estimates: Mapping[str, Estimates], truth: Mapping[str, float] | None) -> Lines:
    """``estimates``: by the title of their column; ``truth``: None for a log."""
    rows = []
    for n, value in printed.TABLE_2.items():
        known = [number(truth[n])] if truth else []
        rows.append([_named(n), number(value), *known, *(number(*e[n]) for e in estimates.values())])
    return markdown(["", "paper", *(["truth"] if truth else []), *estimates], rows)


def tables_3_and_4(one: Both, paper: Mapping[str, Mapping[str, float]]) -> Lines:
    """OE and PE on one record, with the errors of OE that hold for coloured residuals beside its own."""
    head = ["", "paper OE", "paper PE", "truth", "OE", "OE, robust error", "PE"]
    rows = []
    for n in paper["OE"]:
        robust = float(one.oe.robust_errors[one.oe.names.index(n)])
        (oe, error), pe = one.oe.estimate(n), one.pe.estimate(n)
        rows.append(
            [
                _named(n),
                number(paper["OE"][n]),
                number(paper["PE"][n]),
                number(one.truth[n]),
                number(oe, error),
                f"± {robust:.2g}" if np.isfinite(robust) else "",
                number(*pe),
            ]
        )
    return markdown(head, rows)


def table_5(truth: Mapping[str, float], three: Fit, six: Fit, forces: Fit) -> Lines:
    """Three degrees of freedom, measured attitude, and three with disturbance forces."""
    paper = printed.TABLE_5
    rows = [
        [
            _named(n),
            number(paper["3DOF"][n]),
            number(paper["6DOF K"][n]),
            number(truth[n]),
            *(number(*f.estimate(n)) for f in (three, six, forces)),
        ]
        for n in paper["3DOF"]
    ]
    return markdown(["", "paper 3DOF", "paper 6DOF K", "truth", "3DOF", "6DOF K", "3DOF with forces"], rows)


def innovations(three: Plane, six: Plane) -> Lines:
    """Size and colour of the innovations of both models, channel by channel."""
    rows = []
    for n in CHANNELS:
        cells = [cell for one in (three, six) for cell in _colour(one, n)]
        rows.append([f"`{n}`", *cells])
    return markdown(["", "3DOF rms", "first three correlations", "6DOF K rms", "first three correlations"], rows)


def _colour(one: Plane, channel: str) -> list[str]:
    if channel not in [o.name for o in one.fit.model.outputs]:
        return ["", ""]
    t, e, sd = one.innovations(channel)
    w = whiteness_test(channel, t, e / sd)
    return [f"{e.std():.3g}", ", ".join(f"{a:+.2f}" for a in w.acf[:3]) + (" (white)" if w.white else "")]


def distance(estimate: Fit, truth: Mapping[str, float], names: Sequence[str]) -> float:
    """The largest distance from the truth, in reported standard errors."""
    z = [abs(v - truth[n]) / e for n in names for v, e in [estimate.estimate(n)] if np.isfinite(e)]
    return float(max(z))


def _named(name: str) -> str:
    return f"`{name}` [{printed.UNITS[name]}]"
