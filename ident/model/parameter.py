"""Parameters: a value, and apart from it what is known of it (unit, transform, prior, free or fixed).

Composed names: the one place that makes them. Nothing takes a name apart; what it is made of stands in types.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal


def segment_name(name: str, segment: int | None) -> str:
    """``V_x@0``: a parameter that each segment of data has for itself; ``m_u``: one that all share (None)."""
    return name if segment is None else f"{name}@{segment}"


def tap_name(name: str, tap: int) -> str:
    """``n_left~3``: the input ``n_left`` that many steps ago; ``n_left`` itself for none."""
    return f"{name}~{tap}" if tap else name


INF = math.inf
LARGEST = 700.0  # logarithm of a number that can still be written; a search may ask for more
ROUNDING = 1e-9  # of a bound: a value that is outside by no more, such as a mean of values on it, stands on it


class ParameterRole(StrEnum):
    """What a parameter is for; the model tells those of noise and of initial states by their use (``Model.role``)."""

    DYNAMICS = "dynamics"  # rates and outputs depend on it
    NOISE = "noise"  # a standard deviation or a diffusion
    DISTURBANCE = "disturbance"  # of a disturbance that is zero on average, such as its memory
    INITIAL_STATE = "initial-state"


class ParameterOrigin(StrEnum):
    """Provenance of a parameter's value, or of its prior; what is free and has no prior is estimated from the logs."""

    BUILT_IN = "built-in"  # of the structure: nobody gave it for this boat
    GIVEN = "given"  # by the user: rig file, import map, --fix, a model of the user's own
    MEASURED = "measured"  # on the bench
    PRIOR = "prior"  # a mean and a standard deviation that the user gave
    ESTIMATED = "estimated"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model.

    ``transform="log"`` estimates the logarithm of a positive parameter. ``prior`` is (mean, standard
    deviation) in the parameter's own unit: normal, or normal in the logarithm with the relative standard
    deviation. ``per_record`` parameters (current, biases) take a value of their own in each record.
    A ``considered`` one is not estimated but as uncertain as its prior says, which goes into the errors of all others
    (consider covariance: Schmidt 1966; Tapley, Schutz and Born 2004, section 6.3): what data of the same sensors cannot
    tell.
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
    step: float = 0.0  # a change that is small but felt; 0: a hundredth of the value
    role: ParameterRole = ParameterRole.DYNAMICS
    segment: int | None = None  # of a ``per_record`` one in a fit: the record whose own it is
    origin: ParameterOrigin = ParameterOrigin.GIVEN  # of the value or of its prior, see ``provenance``
    # Whether the value of an effect grows with the size of the boat, by its unit (`seatrial.ident.models.scaling`).
    # False if it belongs to a device, the water or the sea.
    scales: bool = True

    def __post_init__(self) -> None:
        low, high = self.bounds
        if self.considered and (self.prior is None or self.per_record):
            raise ValueError(f"parameter {self.name}: considered, it needs a prior, and one value for all records")
        if self.transform == "log" and self.value <= 0:
            raise ValueError(f"parameter {self.name}: {self.value} is not positive, but its transform is log")
        nearest = min(max(self.value, low), high)
        if 0 < abs(self.value - nearest) <= ROUNDING * abs(nearest):
            object.__setattr__(self, "value", nearest)
        if not low <= self.value <= high:
            raise ValueError(f"parameter {self.name}: {self.value} is outside its bounds [{low}, {high}]")

    @property
    def exact(self) -> bool:
        """Whether it is taken for known without an error."""
        return not (self.free or self.considered)

    @property
    def considered_sd(self) -> float | None:
        """Standard deviation with which it goes into the errors of others; None of one that is estimated or exact."""
        return self.prior[1] if self.considered and not self.free and self.prior is not None else None

    @property
    def full_name(self) -> str:
        """``V_x@0`` of a record's own, else the name."""
        return segment_name(self.name, self.segment)

    @property
    def provenance(self) -> ParameterOrigin:
        """Where the value of a fit comes from."""
        known = self.prior is not None and self.origin in (ParameterOrigin.MEASURED, ParameterOrigin.PRIOR)
        return self.origin if known or not self.free else ParameterOrigin.ESTIMATED

    def to_free(self, value: float) -> float:
        """The coordinate in which the estimator moves."""
        return math.log(value) if self.transform == "log" else value

    def from_free(self, coordinate: float) -> float:
        return math.exp(min(coordinate, LARGEST)) if self.transform == "log" else coordinate

    def slope(self, value: float) -> float:
        """d value / d coordinate."""
        return value if self.transform == "log" else 1.0

    def free_prior(self) -> tuple[float, float] | None:
        """Prior mean and standard deviation in the estimator's coordinate."""
        if self.prior is None:
            return None
        mean, sd = self.prior
        return (math.log(mean), sd / mean) if self.transform == "log" else (mean, sd)

    def free_bounds(self) -> tuple[float, float]:
        low, high = self.bounds
        if self.transform == "log":
            return (math.log(low) if low > 0 else -INF, math.log(high) if high < INF else INF)
        return low, high

    def at(self, value: float) -> Parameter:
        return replace(self, value=float(value))

    def fixed(self) -> Parameter:
        return replace(self, free=False)

    def known(self, value: float, sd: float, origin: ParameterOrigin) -> Parameter:
        """With a value that somebody knows: fixed where ``sd`` is 0 (nobody says how well), else a prior."""
        if sd == 0.0:
            return replace(self, value=float(value), free=False, considered=False, origin=origin)
        prior = (float(value), float(sd))
        return replace(self, value=float(value), prior=prior, free=self.considered_sd is None, origin=origin)

    def freed(self) -> Parameter:
        return replace(self, free=True, considered=False)
