"""Sizes of effects in words for reports: a value with its standard error and unit, and with its direction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

Estimates = Mapping[str, tuple[float, float]]  # estimate and standard error by parameter


def size_in_words(value: float, error: float, unit: str) -> str:
    """Return a size, its standard error and its unit as text, such as "1.4 ± 0.1 s" (`_with_error`)."""
    return f"{_with_error(value, error, 2)} {unit}"


def share_in_words(share: float, error: float) -> str:
    """Return a share of a thrust in per cent with its standard error, such as "90 ± 2" (`_with_error`)."""
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
