"""Table of the replicates of `seatrial ident study`: one Parquet file with a row for each replicate and parameter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from seatrial.ident.estimation import Method
from seatrial.ident.parallel import write_rows
from seatrial.ident.studies import Case, Row

COLUMNS: dict[str, type] = {
    "study": str,  # name of the case
    "replicate": int,
    "parameter": str,  # None: the replicate has no fit
    "unit": str,
    "truth": float,  # None: drawn anew for each replicate, or an initial state
    "value": float,  # estimate; None without a truth
    "logarithmic": bool,  # whether the next four columns are of the logarithm of the parameter
    "deviation": float,  # estimate minus truth
    "se": float,
    "bound": float,  # Cramer-Rao bound of the standard error
    "far": float,  # far end of the interval minus truth, of an estimate at its bound
    "flag": str,
    "method": str,
    "converged": bool,
    "iterations": int,
    "cpu": float,  # s, of the fit
    "simulation": float,  # s, CPU time
    "code": str,  # hash of the code
    "error": str,  # None: the replicate has a fit
}


def write_replicates(
    path: Path, studies: Sequence[tuple[Case, Sequence[Row]]], seed: int, method: Method, version: str
) -> None:
    """Write the replicates of all studies as one Parquet file. An existing file is replaced.

    Parameters
    ----------
    path : Path
        The file, in a folder that exists.
    studies : sequence of (Case, sequence of Row)
        Case and replicates of each study.
    seed : int
        Seed of all random draws, for the metadata.
    method : str
        ``prediction-error`` or ``output-error``.
    version : str
        Version of seatrial, for the metadata.

    Raises
    ------
    SeatrialError
        If pyarrow is not installed.
    """
    rows = [row for case, replicates in studies for r in replicates for row in replicate_rows(case, r, method)]
    write_rows(path, COLUMNS, rows, {"seed": seed, "method": method, "seatrial": version})


def replicate_rows(case: Case, replicate: Row, method: Method) -> list[dict[str, Any]]:
    """Return the rows of the table for one replicate: one for each estimate, or one with the error of a failed fit.

    The estimates of output error include initial states, which have no unit and no true value here. Neither have
    parameters whose true values are drawn for each replicate, such as the current.
    """
    common = {
        "study": case.name,
        "replicate": replicate["k"],
        "method": method,
        **{n: replicate.get(n) for n in ("converged", "iterations", "cpu", "simulation", "code", "error")},
    }
    if "error" in replicate:
        return [common]
    known = {p.name: p for p in case.model.parameters}
    rows = []
    for name, deviation in replicate["d"].items():
        p = known.get(name)
        row = common | {"parameter": name, "unit": None if p is None else p.unit, "deviation": deviation}
        row |= {n: replicate[n].get(name) for n in ("se", "bound", "far")}
        row |= {"flag": replicate["flags"].get(name), "logarithmic": p is not None and p.transform == "log"}
        if p is not None and not (p.per_record and p.prior):
            row |= {"truth": p.value, "value": p.from_free(p.to_free(p.value) + deviation)}
        rows.append(row)
    return rows
