"""Criteria of optimal design (Pukelsheim 2006; Goodwin and Payne 1977, chapter 6): larger is better in all of them.

Parameters are taken in the steps in which they are felt (``scale``), so that A and E do not compare kilograms with
radians; D does not depend on it but for a constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ident.model import Model
from ident.numerics import Array

Kind = Literal["D", "A", "E", "Ds"]
KINDS: tuple[Kind, ...] = ("D", "A", "E", "Ds")
NOTHING = -1e9  # of an information that is singular or not finite


@dataclass(frozen=True)
class Criterion:
    """``kind`` over the parameters at ``chosen`` of the information's coordinates; the others are nuisances.

    D: log det of the information of the chosen (nuisances projected out); Ds is D for a chosen few. A: minus the
    logarithm of the mean variance. E: the logarithm of the least eigenvalue. scale (q,): a felt step of each.
    """

    kind: Kind
    chosen: tuple[int, ...]
    scale: Array

    def __call__(self, information: Array) -> Array:
        """(n,) of informations (n, q, q) in the parameters' own units."""
        F = information * np.outer(self.scale, self.scale)
        good = np.isfinite(F).all(axis=(1, 2)) & (np.diagonal(F, axis1=1, axis2=2) > 0).all(axis=1)
        found = np.full(len(F), NOTHING)
        found[good] = self._value(F[good])
        return np.where(np.isfinite(found), found, NOTHING)

    def _value(self, F: Array) -> Array:
        """The determinant is taken after scaling the diagonal to one: units differ by many powers of ten."""
        if not len(F):
            return np.zeros(0)
        size = np.sqrt(np.diagonal(F, axis1=1, axis2=2))
        scaled = F / (size[:, :, None] * size[:, None, :])
        chosen = list(self.chosen)
        others = [i for i in range(F.shape[1]) if i not in self.chosen]
        singular = np.linalg.eigvalsh(scaled)[:, 0] < 1e-12
        scaled[singular] = np.eye(F.shape[1])
        if self.kind in ("D", "Ds"):
            value = np.linalg.slogdet(scaled)[1] + 2 * np.log(size[:, chosen]).sum(axis=1)
            if others:
                value = value - np.linalg.slogdet(scaled[:, others][:, :, others])[1]
        else:
            covariance = np.linalg.inv(scaled) / (size[:, :, None] * size[:, None, :])
            part = covariance[:, chosen][:, :, chosen]
            if self.kind == "A":
                value = -np.log(np.trace(part, axis1=1, axis2=2) / len(chosen))
            else:
                value = -np.log(np.linalg.eigvalsh(part)[:, -1])
        value[singular] = NOTHING
        return np.asarray(value)


def characteristic_steps(model: Model, names: tuple[str, ...]) -> Array:
    """(q,): a change of each parameter that is small but felt."""
    parameters = [model.parameter(n) for n in names]
    return np.array([p.step or 0.01 * abs(p.value) or 1.0 for p in parameters])
