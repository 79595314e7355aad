"""Parameters of a model: the value, and separately its properties (unit, transform, prior, free or fixed).

This module also composes the names of per-record parameters (``NAME@i``: the value of a parameter in record i). No
other code parses these names; their components are stored in typed fields.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal


def segment_name(name: str, segment: int | None) -> str:
    """Return the name of a parameter in a fit: ``V_x@0`` for the value of ``V_x`` in record 0.

    ``segment`` is the index of the record. None: the result is ``name``, for a parameter with one value for all
    records.
    """
    return name if segment is None else f"{name}@{segment}"


INF = math.inf
LARGEST = 700.0  # largest logarithm whose exponential is a finite double; a search may try a larger coordinate
ROUNDING = 1e-9  # relative to a bound: a value outside by less, for example a rounded mean, is moved onto the bound


class ParameterRole(StrEnum):
    """Role of a parameter in a model.

    A model declares ``DYNAMICS`` or ``DISTURBANCE`` for each parameter. The roles ``NOISE`` and ``INITIAL_STATE``
    follow from the use of the parameter (`Model.role`).

    Attributes
    ----------
    DYNAMICS
        Rates and outputs depend on the parameter.
    NOISE
        The parameter is a standard deviation or a diffusion.
    DISTURBANCE
        The parameter is a property of a zero-mean disturbance, such as its correlation time.
    INITIAL_STATE
        The parameter is the initial mean of a state.
    """

    DYNAMICS = "dynamics"
    NOISE = "noise"
    DISTURBANCE = "disturbance"
    INITIAL_STATE = "initial-state"


class ParameterOrigin(StrEnum):
    """Origin of a parameter's value, or of its prior, for reports.

    A free parameter without a prior is estimated from the logs.

    Attributes
    ----------
    BUILT_IN
        Default of the model structure, not specific to this boat.
    GIVEN
        From the user: rig file, import map, --fix, or a user-defined model.
    MEASURED
        From a bench test.
    PRIOR
        Mean and standard deviation from the user.
    ESTIMATED
        From a fit to the logs (`Parameter.provenance`).
    """

    BUILT_IN = "built-in"
    GIVEN = "given"
    MEASURED = "measured"
    PRIOR = "prior"
    ESTIMATED = "estimated"


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter of a model.

    Attributes
    ----------
    name, unit, meaning : str
        Name, unit and description.
    value : float
        Value in `unit`.
    transform : "none" or "log"
        "log": the search for the estimate uses the logarithm of the parameter, which must be positive.
    prior : tuple[float, float] or None
        Mean and standard deviation in `unit`. The prior is normal. With the transform "log", the logarithm of the
        parameter is normal, with the mean log(mean) and the standard deviation sd / mean. None: no prior.
    bounds : tuple[float, float]
        Lower and upper bound in `unit`. A value that is outside by at most 1e-9 times the absolute bound, because of
        rounding, is moved onto the bound; with a bound of zero, no value is.
    free : bool
        Whether the parameter is estimated.
    considered : bool
        Whether the parameter is held at its value while the errors of all other parameters include the uncertainty of
        its prior (consider covariance: Schmidt 1966; Tapley, Schutz and Born 2004, section 6.3). It is for parameters
        about which the data contain no information. It has no effect on a free parameter.
    per_record : bool
        Whether the parameter has a separate value in each record, such as a current or a bias.
    step : float
        Characteristic step: the smallest change that matters, in `unit`. 0: a hundredth of the value, or 1 if the value
        is 0 too.
    role : ParameterRole
        Declared role: dynamics, or a property of a zero-mean disturbance.
    segment : int or None
        Index of the record, for a `per_record` parameter in a fit. None for a parameter that all records share.
    origin : ParameterOrigin
        Origin of the value before a fit, or of its prior.
    scales : bool
        Whether the value scales with the size of the boat, by its unit (`seatrial.ident.models.scaling`). False if it
        is a property of a device, the water or the sea.
    """

    name: str
    value: float
    unit: str = ""
    meaning: str = ""
    transform: Literal["none", "log"] = "none"
    prior: tuple[float, float] | None = None
    bounds: tuple[float, float] = (-INF, INF)
    free: bool = True
    considered: bool = False
    per_record: bool = False
    step: float = 0.0
    role: ParameterRole = ParameterRole.DYNAMICS
    segment: int | None = None
    origin: ParameterOrigin = ParameterOrigin.GIVEN
    scales: bool = True

    def __post_init__(self) -> None:
        """Check the parameter, and move a value that is outside its bounds only by rounding onto the bound.

        Raises
        ------
        ValueError
            If the value is NaN or outside its bounds, if it is not positive with the transform "log", or if a
            considered parameter has no prior or is `per_record`. The prior is not compared with the bounds.
        """
        low, high = self.bounds
        if self.considered and (self.prior is None or self.per_record):
            raise ValueError(
                f"parameter {self.name}: it is uncertain and not estimated (considered), so it needs a prior and one "
                "value for all records"
            )
        if self.transform == "log" and self.value <= 0:
            raise ValueError(
                f"parameter {self.name}: {self.value} is not positive; this parameter needs a value above 0"
            )
        if math.isnan(self.value):
            raise ValueError(f"parameter {self.name}: the value is not a number (nan); give a finite number")
        nearest = min(max(self.value, low), high)
        if 0 < abs(self.value - nearest) <= ROUNDING * abs(nearest):
            object.__setattr__(self, "value", nearest)
        if not low <= self.value <= high:
            raise ValueError(
                f"parameter {self.name}: {self.value} is outside its bounds [{low}, {high}]; give a value inside them"
            )

    @property
    def exact(self) -> bool:
        """Whether the parameter has an exact value: it is neither free (estimated) nor considered (uncertain)."""
        return not (self.free or self.considered)

    @property
    def considered_sd(self) -> float | None:
        """Standard deviation of the prior of a considered parameter, in its unit.

        None if the parameter is free or not considered.
        """
        return self.prior[1] if self.considered and not self.free and self.prior is not None else None

    @property
    def full_name(self) -> str:
        """Name with the index of the record, for example ``V_x@0``.

        It is the plain name if the parameter has one value for all records.
        """
        return segment_name(self.name, self.segment)

    @property
    def provenance(self) -> ParameterOrigin:
        """Origin of the value after a fit.

        The declared origin is kept for a parameter that is not free, and for a free parameter whose prior is from a
        measurement or from the user. Any other free parameter is estimated.
        """
        informative = self.prior is not None and self.origin in (
            ParameterOrigin.MEASURED,
            ParameterOrigin.PRIOR,
        )
        return self.origin if informative or not self.free else ParameterOrigin.ESTIMATED

    def to_free(self, value: float) -> float:
        """Convert a value in the unit of the parameter to the coordinate of the search for the estimate.

        The coordinate is the logarithm with the transform "log" (ValueError if the value is not positive), otherwise
        the value.
        """
        return math.log(value) if self.transform == "log" else value

    def from_free(self, coordinate: float) -> float:
        """Convert a coordinate of the search to a value in the unit of the parameter; the inverse of `to_free`.

        With the transform "log", the coordinate is limited to at most 700, so that the value is finite.
        """
        return math.exp(min(coordinate, LARGEST)) if self.transform == "log" else coordinate

    def slope(self, value: float) -> float:
        """Return the derivative of the value with respect to the coordinate of the search (`to_free`), at this value.

        The derivative is the value itself with the transform "log", and otherwise one.
        """
        return value if self.transform == "log" else 1.0

    def free_prior(self) -> tuple[float, float] | None:
        """Return the mean and standard deviation of the prior in the coordinate of the search (`to_free`).

        With the transform "log", they are the logarithm of the mean (ValueError if it is not positive), and the
        standard deviation divided by the mean. None without a prior.
        """
        if self.prior is None:
            return None
        mean, sd = self.prior
        return (math.log(mean), sd / mean) if self.transform == "log" else (mean, sd)

    def prior_deviation(self, value: float) -> float | None:
        """Return the standard deviation of the prior at a value, in the parameter's unit; None without a prior.

        With the transform "log", it is that of the logarithm times the value.
        """
        prior = self.free_prior()
        return None if prior is None else prior[1] * self.slope(value)

    def free_bounds(self) -> tuple[float, float]:
        """Return the lower and upper bound in the coordinate of the search (`to_free`).

        With the transform "log", a lower bound of zero or less becomes minus infinity. The upper bound must then be
        positive (ValueError otherwise). Infinite bounds stay infinite.
        """
        low, high = self.bounds
        if self.transform == "log":
            return (math.log(low) if low > 0 else -INF, math.log(high) if high < INF else INF)
        return low, high

    def at(self, value: float) -> Parameter:
        """Return the parameter with another value, in its unit.

        Raises
        ------
        ValueError
            If the value is outside the bounds, or not positive with the transform "log".
        """
        return replace(self, value=float(value))

    def fixed(self) -> Parameter:
        """Return the parameter as one that is not estimated, at its present value.

        Its prior is kept. A considered parameter stays considered.
        """
        return replace(self, free=False)

    def known(self, value: float, sd: float, origin: ParameterOrigin) -> Parameter:
        """Return the parameter with a value from outside the logs, for example from the rig file or a bench test.

        Parameters
        ----------
        value : float
            Known value, in the unit of the parameter. With ``sd`` > 0 it is also the mean of the prior.
        sd : float
            Standard deviation of the prior, in the unit of the parameter. The parameter is then estimated; but one that
            was considered and not free stays considered. 0: the parameter is fixed at the value, and is not considered;
            an earlier prior is kept.
        origin : ParameterOrigin
            Origin of the value.

        Raises
        ------
        ValueError
            If the value is outside the bounds, not positive with the transform "log", or if ``sd`` is negative or not
            finite.
        """
        if not 0.0 <= sd < math.inf:
            raise ValueError(
                f"{self.name}: a standard deviation of {sd:g} is impossible; give a positive one, or 0 to fix"
            )
        if sd == 0.0:
            return replace(self, value=float(value), free=False, considered=False, origin=origin)
        prior = (float(value), float(sd))
        return replace(self, value=float(value), prior=prior, free=self.considered_sd is None, origin=origin)

    def freed(self) -> Parameter:
        """Return the parameter as one that is estimated. If it was a considered parameter, it is none any more.

        Value and prior are kept.
        """
        return replace(self, free=True, considered=False)


def built_in(parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters of a model structure or effect of the catalogue, with their values marked as built-in.

    ``GIVEN`` is the origin of a parameter that a user declares, and the default. It is replaced by ``BUILT_IN``.
    Parameters with another origin are returned unchanged.
    """
    return tuple(
        replace(p, origin=ParameterOrigin.BUILT_IN) if p.origin is ParameterOrigin.GIVEN else p for p in parameters
    )
