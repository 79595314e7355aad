"""Options of an estimate: what the user chooses, and how exactly a search is carried out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from ident.model import Model

Method = Literal["prediction-error", "output-error"]
TOLERANCE = 1e-6  # of the log-likelihood: parameters within about a thousandth of a standard error


@dataclass(frozen=True)
class EstimationOptions:
    """How parameters are estimated: chosen on the command line, kept with the fit.

    Attributes:
        outlier_model: contaminated normal innovations in all sensors (``ident.model.outlier_density``); without it
            in those in which the model has them.
        reml: restricted maximum likelihood for noise (``ident.estimation.restricted_likelihood``); not in output
            error, which has no noise parameters but those of the sensors.
        mean_order: propagation of the filter's mean, of first or second order; None: as the model says.
        method: extended Kalman filter between samples, or simulation without process noise.
        horizon: how far ahead predictions are judged [s]; None: the model's own.
    """

    outlier_model: bool = False
    reml: bool = False
    mean_order: Literal[1, 2] | None = None
    method: Method = "prediction-error"
    horizon: float | None = None

    def __post_init__(self) -> None:
        if self.method not in ("prediction-error", "output-error"):
            raise ValueError(f"no method {self.method!r}: prediction-error or output-error")

    @property
    def process_noise(self) -> bool:
        """Whether the model's process noise counts."""
        return self.method == "prediction-error"

    def with_mean_order(self, model: Model) -> Model:
        """The model with its mean propagated as chosen here."""
        return model if self.mean_order is None else replace(model, second_order=self.mean_order == 2)


@dataclass(frozen=True)
class SearchSettings:
    """How exactly one search for the maximum is carried out.

    Attributes:
        tolerance: gain in log-likelihood below which the search ends.
        max_iterations: of Fisher scoring.
        robust_errors: also standard errors that hold for autocorrelated residuals (sandwich covariance), and those of
            parameters on a flat likelihood. Both cost evaluations, which the many rough fits of a diagnosis spare.
        initial_state: of output error alone: the start of each record is estimated too
            (``ident.estimation.output_error.free_start``), or taken for exact as the model gives it.
        joseph: Joseph's form of the covariance update, for a start that is uncertain by many orders.
        threads: records that are evaluated at once.
    """

    tolerance: float = TOLERANCE
    max_iterations: int = 60
    robust_errors: bool = True
    initial_state: Literal["free", "given"] = "free"
    joseph: bool = False
    threads: int = 2

    def __post_init__(self) -> None:
        if self.initial_state not in ("free", "given"):
            raise ValueError(f"no initial state {self.initial_state!r}: free or given")


# of a candidate's fit; the model that is kept is fitted exactly
ROUGH = SearchSettings(tolerance=0.02, robust_errors=False)
