"""Remarks on parameters with a given prior: given value, value by the data alone, and estimate."""

from __future__ import annotations

import math

from seatrial.ident.estimation.standard_errors import MOSTLY_PRIOR
from seatrial.ident.estimation.thrust_scale import value_of_data
from seatrial.ident.model import Flag, Parameter, ParameterOrigin

LEAST_EXCESS = 1.01  # standard error over that of the prior, from which it counts as larger
BEYOND_PRIOR = (
    "it also contains what the model does not explain: correlated residuals, sensor errors, effects that may be "
    "missing, and a difference of the thrusts of both sides"
)

LARGER_ERROR = "its standard error is larger than the given one, as it contains what the model does not explain"


def exceeded_prior(p: Parameter, value: float, error: float) -> float | None:
    """Return the standard deviation of the prior of a parameter if the standard error of its estimate exceeds it.

    Only priors that the user gave for this boat are considered. The error must exceed the standard deviation by more
    than one per cent. With the transform "log" it must do so for the logarithm too: an estimate that is larger than the
    mean of the prior has a larger error by this alone. `BEYOND_PRIOR` describes what such an error contains.

    Parameters
    ----------
    p
        The parameter.
    value, error
        Its estimate and the standard error, in the unit of the parameter; the error may be NaN.

    Returns
    -------
    float or None
        Standard deviation as it was given, in the unit of the parameter. None if the error does not exceed it, or if
        the user gave no prior.
    """
    at_estimate = p.prior_deviation(value)
    if not p.free or p.provenance is ParameterOrigin.ESTIMATED or p.prior is None or at_estimate is None:
        return None
    given = p.prior[1]
    return given if error > LEAST_EXCESS * max(given, at_estimate) else None


def agrees_with_bench(p: Parameter, value: float) -> bool:
    """Return whether an estimate is within one standard deviation of the value that a bench test has measured.

    Such a parameter keeps its measured value, which is no reason for a flag.
    """
    measured = p.free and p.prior is not None and p.provenance is ParameterOrigin.MEASURED
    return measured and p.prior is not None and abs(value - p.prior[0]) <= p.prior[1]


def given_prior_flags(
    p: Parameter, estimate: tuple[float, float], weight: float, factor: float = 1.0, unit: str | None = None
) -> tuple[Flag, ...]:
    """Return the flags on a prior that the user gave: the given value, that of the data, the estimate, a larger error.

    Parameters
    ----------
    p
        The parameter.
    estimate
        Its value and standard error, in the unit of the parameter; the error may be NaN.
    weight
        Share of the prior in the information on the parameter, 0 to 1.
    factor, unit
        Factor to the reported unit, and this unit. By default they are those of the parameter.

    Returns
    -------
    tuple of Flag
        Empty if the user gave no prior, or if the flag would say nothing: the estimate agrees with that of a bench
        test, or the data have a tenth of the information or more, and the standard error is not larger than that of the
        prior.
    """
    if not p.free or p.provenance is ParameterOrigin.ESTIMATED or p.prior is None or agrees_with_bench(p, estimate[0]):
        return ()
    (value, error), (mean, sd) = estimate, p.prior
    is_larger = exceeded_prior(p, value, error) is not None
    if not is_larger and not weight > MOSTLY_PRIOR:
        return ()

    def shown(x: float, spread: float = math.nan) -> str:
        """Return a value with its standard deviation, if it has one, in the reported unit."""
        numbers = f"{factor * x:.4g}" + (f" ± {factor * spread:.3g}" if math.isfinite(spread) else "")
        return f"{numbers} {p.unit if unit is None else unit}".rstrip()

    alone = value_of_data(p, value, weight)
    data = (
        f"the data alone say about {shown(alone)}"
        if alone is not None
        else (f"the data have {100.0 * (1.0 - weight):.0f} % of the information, too little for a value of their own")
    )
    found = Flag("prior", f"given {shown(mean, sd)}; {data}; fitted {shown(value, error)}")
    if not is_larger:
        return (found,)
    return found, Flag("larger error", LARGER_ERROR)
