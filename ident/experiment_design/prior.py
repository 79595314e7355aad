"""Prior knowledge of the parameters: a distribution for samples, and the information of earlier logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from seatrial.ident.estimation import SavedModel, dynamic_parameters
from seatrial.ident.experiment_design.information import prior_information
from seatrial.ident.model import Model, ParameterOrigin
from seatrial.ident.numerics import Array, scaled_pseudo_inverse

PRIOR_HALFWIDTH = 0.25  # relative; default prior: uniform within 0.75 to 1.25 of the nominal values (thesis)
ESTIMATED = ParameterOrigin.ESTIMATED


@dataclass(frozen=True)
class ParameterPrior:
    """Prior of k parameters of a model, centred on the values of the model.

    Attributes
    ----------
    names
        Names of the k parameters. All other parameters of the model keep their values.
    box
        Half-width of a uniform distribution, relative to the value of each parameter. It is not used with a covariance.
    covariance : Array (k, k)
        Covariance of a normal distribution, in the units of the parameters. None: the distribution is uniform.
    information : Array (k, k)
        Information of earlier logs about the parameters, in 1 / (unit of row times unit of column). None: no earlier
        logs.
    inflation
        By parameter, the ratio of the standard error that is robust to correlated residuals to the standard error from
        the information, both from earlier logs. New logs are expected to have the same ratio. A parameter that is not
        named has the ratio 1.
    """

    names: tuple[str, ...]
    box: float = PRIOR_HALFWIDTH
    covariance: Array | None = None
    information: Array | None = None
    inflation: Mapping[str, float] = field(default_factory=dict)

    def sample(self, model: Model, n: int, rng: np.random.Generator) -> Array:
        """Draw parameter samples of a model.

        Parameters
        ----------
        model
            Model whose values are the centre of the distribution.
        n
            Number of samples.
        rng
            Random generator.

        Returns
        -------
        Array (n, n_parameters)
            Values of all parameters of the model, in its order. Each sample is clipped to the bounds of its parameter.
            A normal sample of a parameter with a positive value is raised to at least 0.1 of this value.
        """
        index = [p.name for p in model.parameters]
        values = np.tile([p.value for p in model.parameters], (n, 1))
        columns = [index.index(name) for name in self.names]
        nominal = values[:, columns]
        if self.covariance is None:
            values[:, columns] = nominal * rng.uniform(1 - self.box, 1 + self.box, nominal.shape)
        elif columns:
            drawn = rng.multivariate_normal(nominal[0], self.covariance, n, method="eigh", check_valid="ignore")
            least = np.where(nominal > 0, 0.1 * nominal, -np.inf)
            values[:, columns] = np.maximum(drawn, least)
        bounds = np.array([model.parameter(name).bounds for name in self.names]).reshape(-1, 2).T
        values[:, columns] = np.clip(values[:, columns], *bounds)
        return values


def default_prior(model: Model, observed: Sequence[str]) -> ParameterPrior:
    """Return the prior without earlier logs: uniform within 0.75 to 1.25 times the values of the model.

    The prior has those of the ``observed`` parameters that a fit estimates. Parameters whose value was given, for
    example a thrust curve from the bench, are left out.
    """
    return ParameterPrior(tuple(n for n in observed if model.parameter(n).provenance is ESTIMATED))


def prior_matrix(model: Model, observed: Sequence[str], nuisances: Sequence[str], prior: ParameterPrior) -> Array:
    """Return the information about the parameters before the designed experiment.

    Parameters
    ----------
    model
        The model.
    observed
        Names of the shared parameters that the sensors observe.
    nuisances
        Names of the per-record nuisance parameters that the sensors observe, for example the current.
    prior
        Prior knowledge. A name that is not in ``observed`` is left out.

    Returns
    -------
    Array (q, q)
        Prior information about ``observed`` and then ``nuisances``, in the units of the parameters. Nuisance parameters
        have the priors of the model. The observed parameters have the information of earlier logs, which includes their
        priors. Without earlier logs, only observed parameters whose value was given have their priors.
    """
    q = len(observed)
    matrix = np.zeros((q + len(nuisances), q + len(nuisances)))
    matrix[q:, q:] = prior_information([model.parameter(n) for n in nuisances])
    if prior.information is not None:
        shared = [n for n in prior.names if n in observed]
        rows = [observed.index(n) for n in shared]
        earlier_rows = [prior.names.index(n) for n in shared]
        matrix[np.ix_(rows, rows)] += prior.information[np.ix_(earlier_rows, earlier_rows)]
    else:  # for example a thrust curve from the bench, which no mission can identify
        parameters = [model.parameter(n) for n in observed]
        given = np.array([p.provenance is not ESTIMATED for p in parameters], dtype=float)
        matrix[:q, :q] = prior_information(parameters) * given
    return matrix


def prior_from_fit(saved: SavedModel) -> ParameterPrior:
    """Return the prior that follows from a fitted model, for the design of the next experiment.

    Parameters
    ----------
    saved
        Fitted model with its covariance.

    Returns
    -------
    ParameterPrior
        Normal prior with the covariance of the shared dynamic parameters that have a standard error; it has no
        parameters if none has one. Its information is the pseudo-inverse of the covariance. Its inflation is that of
        the fit.
    """
    fitted = saved.covariance(dynamic_parameters(saved.model))
    information = None if fitted.covariance is None else scaled_pseudo_inverse(fitted.covariance)
    return ParameterPrior(
        fitted.names, covariance=fitted.covariance, information=information, inflation=saved.inflation
    )
