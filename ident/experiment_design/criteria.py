"""Optimality criteria D, A, E and Ds of the Fisher information. A larger value is better for all of them.

Parameters are scaled by their characteristic steps (``scale``), so that A and E do not compare kilograms with radians.
The scale changes D only by a constant. Sources: Pukelsheim 2006; Goodwin and Payne 1977, chapter 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

Kind = Literal["D", "A", "E", "Ds"]
KINDS: tuple[Kind, ...] = ("D", "A", "E", "Ds")
SINGULAR = -1e9  # criterion of an information matrix that is singular or not finite


@dataclass(frozen=True)
class Criterion:
    """Optimality criterion of chosen parameters. The other parameters are nuisance parameters.

    A call returns the criterion of information matrices; a larger value is better. All parameters are divided by their
    characteristic steps. D is the log determinant of the information about the chosen parameters, with nuisance
    parameters projected out. Ds is computed as D; its name says that the chosen parameters are a subset. A is minus the
    logarithm of the mean variance of the chosen parameters. E is minus the logarithm of the largest eigenvalue of their
    covariance.

    Attributes
    ----------
    kind
        D, A, E or Ds.
    chosen
        Indices of the chosen parameters in the information matrix.
    scale : Array (q,)
        Characteristic step of each parameter, in its unit.
    """

    kind: Kind
    chosen: tuple[int, ...]
    scale: Array

    def __call__(self, information: Array) -> Array:
        """Return the criterion (n,) of information matrices (n, q, q) in the units of the parameters.

        A larger value is better. It is ``SINGULAR`` (-1e9) for a matrix that is not finite, that has a diagonal element
        of zero or below, or that is singular: scaled to a unit diagonal, its smallest eigenvalue is below 1e-12.
        """
        F = information * np.outer(self.scale, self.scale)
        good = np.isfinite(F).all(axis=(1, 2)) & (np.diagonal(F, axis1=1, axis2=2) > 0).all(axis=1)
        found = np.full(len(F), SINGULAR)
        found[good] = self._value(F[good])
        return np.where(np.isfinite(found), found, SINGULAR)

    def _value(self, F: Array) -> Array:
        """Return the criterion (n,) of finite information matrices F (n, q, q) in characteristic steps.

        The diagonal of F must be positive. The criterion of a singular matrix is ``SINGULAR`` (-1e9): scaled to a unit
        diagonal, its smallest eigenvalue is below 1e-12. Without matrices the result is empty.
        """
        if not len(F):
            return np.zeros(0)
        # Determinant and inverse are computed with a unit diagonal, since units differ by many powers of ten.
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
        value[singular] = SINGULAR
        return np.asarray(value)


def characteristic_steps(model: Model, names: tuple[str, ...]) -> Array:
    """Return the characteristic step of each parameter: the smallest change that matters.

    Parameters
    ----------
    model
        The model.
    names
        Names of q parameters.

    Returns
    -------
    Array (q,)
        Step in the unit of each parameter: its ``step`` in the model. Without one it is 1 % of the size of its value,
        or 1 if the value is zero.
    """
    parameters = [model.parameter(n) for n in names]
    return np.array([p.step or 0.01 * abs(p.value) or 1.0 for p in parameters])
