"""Density of the innovations of a sensor with outliers: a normal density mixed with a small part of a very wide
density.

    p(z) = (1 - e) N(z; 0, 1) + e C(z; 0, c),   z = innovation / its standard deviation

C is a Cauchy density of scale c. The score ``psi = -d ln p / dz`` is z for good samples and falls to zero for outliers.
The filter update for this likelihood is exactly (Masreliez 1975)

    x += P H' / sqrt(S) psi(z),   P -= P H' H P / S psi'(z).

docs/decisions/0010-robust-innovations.md gives the reasons for this density instead of Huber's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.model.structure import Model

SHARE = 0.01  # e: assumed share of outliers; the estimates depend little on it
WIDTH = 20.0  # c: typical size of an outlier in standard deviations; correct within about a factor of ten suffices
# Fisher information of a sample about its mean, E[psi^2], and about its scale, E[(z psi - 1)^2] / 2, relative to that
# of a normal sample
INFORMATION = (0.9834999, 0.9596000)
LIKELY = 0.5  # a sample counts as an outlier if the probability that it is good is below this
MANY_OUTLIERS = 0.1  # share of the samples; with more outliers, the model is wrong, not the samples


def log_density(z: Any) -> Any:
    """Return the logarithm ``ln p`` of the density at the standardised innovation ``z``.

    ``z`` is the innovation divided by its standard deviation: a number, an array or a symbol. The density is a normal
    one (99 %) mixed with a Cauchy density of scale 20 for outliers (1 %).
    """
    return np.log(_inlier_density(z) + _outlier_density(z))


def robust_weight(z: Any) -> Any:
    """Return the probability (0 to 1) that a sample is no outlier, given its standardised innovation ``z``.

    ``z`` is the innovation divided by its standard deviation: a number, an array or a symbol. One sample in 100 is
    assumed to be an outlier. The probability is near 1 for a small ``z``, and falls to 0 as its size grows.
    """
    return _inlier_density(z) / (_inlier_density(z) + _outlier_density(z))


def score(z: Any) -> Any:
    """Return the score ``psi = -d ln p / dz`` of the density p at the standardised innovation ``z``.

    ``z`` is the innovation divided by its standard deviation. The score is about z for good samples and falls to zero
    for outliers.
    """
    w = robust_weight(z)
    return w * z + (1.0 - w) * _outlier_score(z)


def score_slope(z: Any) -> Any:
    """Return the derivative ``psi' = d psi / dz`` of the score at the standardised innovation ``z``.

    The slope never exceeds 1, so that the covariance of the filter stays positive. It is about 1 for good samples,
    about 0 for outliers, and negative in between, where a sample may be good or an outlier. A negative slope increases
    the variance of the state in the update, because two values of the state are plausible.
    """
    w, apart, square = robust_weight(z), z - _outlier_score(z), WIDTH**2 + z * z
    return w + (1.0 - w) * 2.0 * (WIDTH**2 - z * z) / (square * square) - w * (1.0 - w) * apart * apart


def _inlier_density(z: Any) -> Any:
    """Return the normal part ``(1 - e) N(z; 0, 1)`` of the density, that of good samples at ``z`` (e: `SHARE`)."""
    return (1.0 - SHARE) / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * z * z)


def _outlier_density(z: Any) -> Any:
    """Return the wide part ``e C(z; 0, c)`` of the density at ``z``: a Cauchy density (e: `SHARE`, c: `WIDTH`)."""
    return SHARE / (np.pi * WIDTH) / (1.0 + z * z / WIDTH**2)


def _outlier_score(z: Any) -> Any:
    """Return the score of the wide part alone, ``-d ln C / dz`` at ``z``, with the Cauchy density C."""
    return 2.0 * z / (WIDTH**2 + z * z)


def with_outlier_model(model: Model, sensors: Iterable[str] | None = None) -> Model:
    """Return the model with an innovation density that includes outliers, for some of its sensors.

    Parameters
    ----------
    model : Model
        Model to change.
    sensors : Iterable[str], optional
        Names of the sensors. None: all sensors of the model. Empty: none. Sensors that are not named are kept as they
        are, also with outliers in their density.

    Raises
    ------
    KeyError
        If the model lacks a named sensor. The message lists the sensors of the model.
    """
    available = [s.name for s in model.sensors]
    chosen = available if sensors is None else list(sensors)
    unknown = sorted(set(chosen) - set(available))
    if unknown:
        raise KeyError(f"model {model.name} has no sensor {unknown[0]!r}; it has {', '.join(available)}")
    return replace(
        model,
        sensors=tuple(
            replace(s, outputs=tuple(replace(o, robust=True) for o in s.outputs)) if s.name in chosen else s
            for s in model.sensors
        ),
    )


def robust_sensors(model: Model) -> tuple[str, ...]:
    """Return the names of the sensors whose innovation density includes outliers, in the order of the model.

    One such output of a sensor is enough. Return () if there is no such sensor.
    """
    return tuple(s.name for s in model.sensors if any(o.robust for o in s.outputs))


def outlier_notes(
    model: Model, outliers: Sequence[NDArray[np.bool_]], measured: Sequence[NDArray[np.bool_]]
) -> list[str]:
    """Return one sentence for each output whose density includes outliers, with the number and share of its outliers.

    Parameters
    ----------
    model : Model
        Fitted model.
    outliers : Sequence[Array (n_rows, n_outputs) of bool]
        For each record: True for samples that the fit treated as outliers.
    measured : Sequence[Array (n_rows, n_outputs) of bool]
        For each record: whether a row has a sample of the output.

    Returns
    -------
    list of str
        An output without a sample has no sentence. Without outliers the sentence has the number 0 and no share. If more
        than 10 % of the samples are outliers, the sentence warns that the model lacks an effect.
    """
    notes = []
    for j, output in enumerate(model.outputs):
        n, total = (sum(int(flags[:, j].sum()) for flags in records) for records in (outliers, measured))
        if output.robust and total:
            share = f" ({100 * n / total:.2g} %)" if n else ""
            caveat = (
                ", too many for outliers: the model lacks an effect on this channel, which --robust hides; fit or "
                "diagnose without --robust"
            )
            many = caveat if n > MANY_OUTLIERS * total else ""
            were = "was" if n == 1 else "were"
            notes.append(f"{output.name}: {n} of {total} samples {were} treated as outliers{share}{many}")
    return notes
