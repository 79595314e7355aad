"""Tables in Markdown with the values of the paper, the true values and the estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.thesis import printed
from benchmarks.thesis.fits import Both, Plane
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.validation.whiteness import whiteness_test

Lines = list[str]
Estimates = Mapping[str, tuple[float, float]]  # name -> value and standard error
CHANNELS = ("ax", "ay", "x", "y", "vx", "vy", "r", "psi")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Lines:
    """Return the lines of a table in Markdown. All columns except the first are aligned as numbers.

    ``head`` has the titles of the columns, and ``rows`` the cells of each row.
    """
    return [
        "| " + " | ".join(head) + " |",
        "|---|" + "---:|" * (len(head) - 1),
        *("| " + " | ".join(r) + " |" for r in rows),
    ]


def number(value: float, error: float | None = None) -> str:
    """Return a value as text with four digits, followed by its standard error if that is given and finite.

    A value below 5e-5 in size is written as 0.
    """
    text = "0" if abs(value) < 5e-5 else f"{value:.4g}"
    return text if error is None or not np.isfinite(error) else f"{text} ± {error:.2g}"


def table_2(estimates: Mapping[str, Estimates], truth: Mapping[str, float] | None) -> Lines:
    """Return table 2, on the thruster.

    Parameters
    ----------
    estimates : mapping of str to estimates
        Values and standard errors, by the title of their column.
    truth : mapping of str to float, optional
        True values; None for a measured log.
    """
    rows = []
    for n, value in printed.TABLE_2.items():
        true_value = [number(truth[n])] if truth else []
        rows.append([_name_with_unit(n), number(value), *true_value, *(number(*e[n]) for e in estimates.values())])
    return markdown(["", "paper", *(["truth"] if truth else []), *estimates], rows)


def tables_3_and_4(both: Both, paper: Mapping[str, Mapping[str, float]]) -> Lines:
    """Return table 3 or 4: OE and PE on one record, with the robust standard errors of OE for coloured residuals.

    ``both`` has the estimates of the record. ``paper`` has the printed estimates by method ("OE", "PE") and parameter.
    """
    head = ["", "paper OE", "paper PE", "truth", "OE", "OE, robust error", "PE"]
    rows = []
    for n in paper["OE"]:
        robust = float(both.oe.robust_errors[both.oe.names.index(n)])
        (oe, error), pe = both.oe.estimate(n), both.pe.estimate(n)
        rows.append(
            [
                _name_with_unit(n),
                number(paper["OE"][n]),
                number(paper["PE"][n]),
                number(both.truth[n]),
                number(oe, error),
                f"± {robust:.2g}" if np.isfinite(robust) else "",
                number(*pe),
            ]
        )
    return markdown(head, rows)


def table_5(truth: Mapping[str, float], three: Fit, six: Fit, forces: Fit) -> Lines:
    """Return table 5: the estimates of three models of the horizontal plane beside the paper's.

    ``truth`` has the true values by parameter. The fits are those of 3DOF, 6DOF K (measured attitude), and 3DOF with
    disturbance forces.
    """
    paper = printed.TABLE_5
    rows = [
        [
            _name_with_unit(n),
            number(paper["3DOF"][n]),
            number(paper["6DOF K"][n]),
            number(truth[n]),
            *(number(*f.estimate(n)) for f in (three, six, forces)),
        ]
        for n in paper["3DOF"]
    ]
    return markdown(["", "paper 3DOF", "paper 6DOF K", "truth", "3DOF", "6DOF K", "3DOF with forces"], rows)


def innovations(three: Plane, six: Plane) -> Lines:
    """Return the table of RMS and autocorrelation of the innovations of 3DOF and 6DOF K, with a row per channel."""
    rows = []
    for n in CHANNELS:
        cells = [cell for plane in (three, six) for cell in _innovation_cells(plane, n)]
        rows.append([f"`{n}`", *cells])
    return markdown(["", "3DOF rms", "first three correlations", "6DOF K rms", "first three correlations"], rows)


def _innovation_cells(plane: Plane, channel: str) -> list[str]:
    """Return two cells: RMS and first three autocorrelations of the innovations of a channel.

    The cells are empty if the model lacks the channel. "(white)" is added if the whiteness test passes.
    """
    if channel not in [o.name for o in plane.fit.model.outputs]:
        return ["", ""]
    t, e, sd = plane.innovations(channel)
    w = whiteness_test(channel, t, e / sd)
    return [f"{e.std():.3g}", ", ".join(f"{a:+.2f}" for a in w.acf[:3]) + (" (white)" if w.white else "")]


def distance(estimate: Fit, truth: Mapping[str, float], names: Sequence[str]) -> float:
    """Return the largest error of the estimates of parameters ``names`` in units of their standard errors.

    ``truth`` has the true values. Estimates without a finite standard error are skipped.
    """
    z = [abs(v - truth[n]) / e for n in names for v, e in [estimate.estimate(n)] if np.isfinite(e)]
    return float(max(z))


def _name_with_unit(name: str) -> str:
    """Return the name of a parameter in Markdown with its unit, such as "`m_u` [kg]"."""
    return f"`{name}` [{printed.UNITS[name]}]"
