"""Estimates of the logs of two campaigns, as read from the table of the fits."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.estimation import LEAST_OWN
from seatrial.ident.numerics import Array
from seatrial.ident.results import Campaign
from seatrial.ident.workflows.fleet import common_errors

MOST_PRIOR = 0.5  # largest share of a parameter's information that may come from its prior
Row = Mapping[str, Any]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FittedLogs:
    """Estimates of the logs of both campaigns whose fit converged.

    Attributes
    ----------
    logs
        Paths of the logs as given.
    after : Array of bool (n_logs,)
        Whether a log belongs to the campaign after.
    rows
        For each log, its rows of the table by name of the parameter.
    """

    logs: tuple[str, ...]
    after: Mask
    rows: tuple[Mapping[str, Row], ...]

    def part(self, which: Mask) -> FittedLogs:
        """Return the logs for which the mask ``which`` (n_logs,) is true."""
        at = np.flatnonzero(which).tolist()
        return FittedLogs(tuple(self.logs[k] for k in at), self.after[which], tuple(self.rows[k] for k in at))

    @property
    def names(self) -> list[str]:
        """Names of all parameters, in the order of the first log that has them."""
        return list(dict.fromkeys(name for rows in self.rows for name in rows))

    def known(self, name: str) -> Mask:
        """Return for each log whether it has an estimate of the parameter with a standard error (n_logs,)."""
        return np.array([name in r and bool(r[name]["free"]) and r[name]["se"] is not None for r in self.rows])

    def values(self, names: Sequence[str]) -> Array:
        """Return the estimates (n_logs, n_names)."""
        return np.array([[r[n]["value"] for n in names] for r in self.rows], dtype=float).reshape(-1, len(names))

    def covariances(self, names: Sequence[str]) -> Array:
        """Return the covariance of each log's estimates (n_logs, n_names, n_names), with the errors from priors."""
        found = []
        for rows in self.rows:
            se = np.array([rows[n]["se"] for n in names], dtype=float)
            others = [{n: 1.0} | json.loads(rows[n]["correlations"]) for n in names]
            matrix = np.array([[of_one.get(n, 0.0) for n in names] for of_one in others])
            found.append(0.5 * (matrix + matrix.T) * np.outer(se, se))
        return np.array(found).reshape(-1, len(names), len(names))

    def common(self, names: Sequence[str]) -> Array:
        """Return the part of the error of each estimate by each prior (n_logs, n_names, n_priors)."""
        found = common_errors([rows[n] for rows in self.rows for n in names])
        return found.reshape(len(self.rows), len(names), found.shape[1])

    def own_covariances(self, names: Sequence[str]) -> Array:
        """Return the covariances without the errors from priors, positive definite (n_logs, n_names, n_names)."""
        full, common = self.covariances(names), self.common(names)
        return np.array([positive_definite(S - C @ C.T, np.diag(S)) for S, C in zip(full, common, strict=True)])


def positive_definite(matrix: Array, variances: Array) -> Array:
    """Return the nearest covariance whose eigenvalues, scaled by ``variances`` (n,), are at least 1e-6."""
    root = np.sqrt(variances)
    w, V = np.linalg.eigh(matrix / np.outer(root, root))
    return np.asarray((V * np.maximum(w, LEAST_OWN)) @ V.T * np.outer(root, root))


def fitted_logs(rows: Sequence[Row], later: set[str]) -> FittedLogs:
    """Return the estimates of the logs whose fit converged, from the rows of the table.

    ``later`` has the hashes of the logs of the campaign after.
    """
    by_log: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["converged"]:
            by_log.setdefault(row["log"], {})[row["parameter"]] = row
    after = [next(iter(of.values()))["sha256"] in later for of in by_log.values()]
    return FittedLogs(tuple(by_log), np.array(after, dtype=bool), tuple(by_log.values()))


def campaign_of(after: bool) -> Campaign:
    """Return the name of a campaign: ``after`` or ``before``."""
    return "after" if after else "before"
