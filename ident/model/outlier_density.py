"""Sensors with outliers: the innovation's density is a normal one with a small part of a very wide one.

    p(z) = (1 - e) N(z; 0, 1) + e C(z; 0, c),   z = innovation / its standard deviation

with C a Cauchy density of scale c. Its score ``psi = -d ln p / dz`` is z for good samples and falls to zero for
outliers, and the filter's update that belongs to this likelihood is exactly (Masreliez 1975)

    x += P H' / sqrt(S) psi(z),   P -= P H' H P / S psi'(z).

Why this and not Huber's: docs/decisions/0010-robust-innovations.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.model.structure import Model

SHARE = 0.01  # e: outliers among the samples, a guess that need not be right
WIDTH = 20.0  # c: how far they are, in standard deviations, within a factor of ten or so
# What a sample tells of its mean and of its scale, E[psi^2] and E[(z psi - 1)^2] / 2, over what a normal one tells.
INFORMATION = (0.9834999, 0.9596000)
LIKELY = 0.5  # a sample that is more likely an outlier than good counts as one
MANY = 0.1  # of the samples; where more are, it is not the samples that are wrong


def log_density(z: Any) -> Any:
    """ln p of a standardised innovation; numbers or symbols."""
    return np.log(_good(z) + _wild(z))


def robust_weight(z: Any) -> Any:
    """The probability that the sample is a good one."""
    return _good(z) / (_good(z) + _wild(z))


def score(z: Any) -> Any:
    """``psi = -d ln p / dz``."""
    w = robust_weight(z)
    return w * z + (1.0 - w) * _wild_score(z)


def score_slope(z: Any) -> Any:
    """``psi'``: 1 for good samples, about 0 for outliers, negative where it is not clear which (the state is then
    less certain than before: it may be in two places). Never above 1, so P stays positive."""
    w, apart, square = robust_weight(z), z - _wild_score(z), WIDTH**2 + z * z
    return w + (1.0 - w) * 2.0 * (WIDTH**2 - z * z) / (square * square) - w * (1.0 - w) * apart * apart


def _good(z: Any) -> Any:
    return (1.0 - SHARE) / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * z * z)


def _wild(z: Any) -> Any:
    return SHARE / (np.pi * WIDTH) / (1.0 + z * z / WIDTH**2)


def _wild_score(z: Any) -> Any:
    return 2.0 * z / (WIDTH**2 + z * z)


def with_outlier_model(model: Model, sensors: Iterable[str] | None = None) -> Model:
    """The model with outliers allowed in the named sensors, or in all. An unknown name is a KeyError."""
    known = [s.name for s in model.sensors]
    wanted = known if sensors is None else list(sensors)
    unknown = sorted(set(wanted) - set(known))
    if unknown:
        raise KeyError(f"model {model.name} has no sensor {unknown[0]!r}; it has {', '.join(known)}")
    return replace(
        model,
        sensors=tuple(
            replace(s, outputs=tuple(replace(o, robust=True) for o in s.outputs)) if s.name in wanted else s
            for s in model.sensors
        ),
    )


def robust_sensors(model: Model) -> tuple[str, ...]:
    """Names of the sensors with outliers allowed."""
    return tuple(s.name for s in model.sensors if any(o.robust for o in s.outputs))


def outlier_notes(
    model: Model, outliers: Sequence[NDArray[np.bool_]], measured: Sequence[NDArray[np.bool_]]
) -> list[str]:
    """A line for each robust channel: how many of its samples are outliers.

    outliers, measured: one (n_rows, n_outputs) a record; ``FilterRun.outliers``, and where there was a sample.
    """
    notes = []
    for j, output in enumerate(model.outputs):
        n, total = (sum(int(one[:, j].sum()) for one in kind) for kind in (outliers, measured))
        if output.robust and total:
            share = f" ({100 * n / total:.2g} %)" if n else ""
            doubt = ", too many for outliers: the model lacks something there, which --robust hides"
            many = doubt if n > MANY * total else ""
            were = "was" if n == 1 else "were"
            notes.append(f"{output.name}: {n} of {total} samples {were} taken for outliers{share}{many}")
    return notes
