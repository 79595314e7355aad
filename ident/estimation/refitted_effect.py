"""Effects that a diagnosis tried, with their estimates, for model.toml and the design of the next mission."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class RefittedEffect:
    """Effect that a diagnosis tried: its estimates in a fit with it.

    Attributes
    ----------
    name
        Name of the effect.
    beside
        Names of the other effects of the catalogue in this fit.
    values, errors
        Estimate and standard error of each of its parameters, by name, in the units of the parameters. The estimate of
        a per-record parameter is the mean over the records. A parameter without a standard error has no entry in
        ``errors``.
    """

    name: str
    beside: tuple[str, ...]
    values: Mapping[str, float]
    errors: Mapping[str, float]
