"""Sizes of effects in words for reports: a value with its standard error and unit, and with its direction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

Estimates = Mapping[str, tuple[float, float]]  # estimate and standard error by parameter
ESTIMATED_CURVE, GIVEN_CURVE = "the estimated curve", "the given curve"  # of the thrust, by the origin of c1 and c2
FACTORS = {"deg": math.degrees(1.0), "%": 100.0}  # from the unit of a parameter to a unit of a report


def size_in_words(value: float, error: float, unit: str) -> str:
    """Return a size with its standard error and unit as text, for example "1.4 ± 0.1 s"."""
    return f"{_with_error(value, error, 2)} {unit}"


def share_in_words(share: float, error: float) -> str:
    """Return a share of a thrust in per cent with its standard error as text, for example "90 ± 2"."""
    return _with_error(100 * share, 100 * error, 0)


def _with_error(value: float, error: float, decimals: int) -> str:
    """Return a number with its standard error as text.

    The number of decimals (none to three) follows from the error. If the error is zero or not finite, it is left out,
    and the number has ``decimals`` decimals.
    """
    if not (math.isfinite(error) and error > 0):
        return f"{value:.{decimals}f}"
    digits = min(max(-math.floor(math.log10(error)), 0), 3)  # the error has one significant digit
    return f"{round(value, digits) + 0.0:.{digits}f} ± {error:.{digits}f}"  # + 0.0: no negative zero


def directed_size(estimate: tuple[float, float], unit: str, positive: str, negative: str) -> str:
    """Return a size with its direction in words, such as "10.2 ± 0.5 N m to port".

    ``positive`` and ``negative`` are the words for both signs of the estimate. An estimate of zero is positive.
    """
    value, error = estimate
    return f"{size_in_words(abs(value), error, unit)} {positive if value >= 0 else negative}"


def in_sentence(parameter: str, unit: str, sentence: str) -> Callable[[Estimates], str]:
    """Return a function for ``Effect.in_words``: the estimate of one parameter, in place of ``{}`` in the sentence."""

    def describe(estimates: Estimates) -> str:
        """Return the sentence with the estimate."""
        return sentence.format(size_in_words(*estimates[parameter], unit))

    return describe


def share_in_sentence(parameter: str, sentence: str, left: bool = False) -> Callable[[Estimates], str]:
    """Return a function for ``Effect.in_words``: a share in per cent, in place of ``{}`` in the sentence.

    The share is the parameter, or what is ``left`` of the whole: one less the parameter.
    """

    def describe(estimates: Estimates) -> str:
        """Return the sentence with the share."""
        value, error = estimates[parameter]
        return sentence.format(share_in_words(1.0 - value if left else value, error))

    return describe


def directed_in_sentence(
    parameter: str, unit: str, sentence: str, positive: str, negative: str
) -> Callable[[Estimates], str]:
    """Return a function for ``Effect.in_words``: a size with its direction, in place of ``{}`` in the sentence.

    The unit is that of the parameter, or ``deg`` for one in rad, or ``%`` for a ratio.
    """

    def describe(estimates: Estimates) -> str:
        """Return the sentence with the size and its direction."""
        factor = FACTORS.get(unit, 1.0)
        value, error = estimates[parameter]
        return sentence.format(directed_size((factor * value, factor * error), unit, positive, negative))

    return describe


def largest_of_headings(estimates: Estimates, names: Sequence[str]) -> tuple[float, float, int]:
    """Return the value with the largest size of a Fourier series of the heading, its standard error and its heading.

    The heading is in whole degrees. The standard error leaves out the correlations of the coefficients.

    Parameters
    ----------
    estimates
        Estimates of the coefficients, with standard errors.
    names
        Names of the coefficients of sin psi, cos psi, sin 2 psi and cos 2 psi.
    """
    psi = np.radians(np.arange(360.0))
    shapes = np.array([np.sin(psi), np.cos(psi), np.sin(2 * psi), np.cos(2 * psi)])
    values, errors = np.array([estimates[n] for n in names]).T
    series = values @ shapes
    k = int(np.argmax(np.abs(series)))
    return float(series[k]), float(np.linalg.norm(errors * shapes[:, k])), k
