"""Rough fits of a search that estimate only those parameters which a change of the model moves.

The score equations of a fitted model tell how each estimate changes if an effect is added. A parameter that hardly
changes is held at its expected value. The time of a fit grows with the number of estimated parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from seatrial.ident.estimation import Fit, FittedModel
from seatrial.ident.model import Model, Parameter

# Least number of parameters that a rough fit estimates if others are held, and the multiple to which it is filled up:
# the time of a fit grows with the number of vectors of the processor that hold the parameters
FREE, FREE_AT_ONCE = 16, 8


def changed_estimates(fit: Fit, changes: Mapping[str, float]) -> dict[str, float]:
    """Return the estimates of a fit by full name, each plus its expected change, within its bounds.

    They are initial values of a fit with a further effect. Without them, the first step of the search would only make
    up for the effect. The result is empty if no change is expected.

    Parameters
    ----------
    fit
        Fit of the model before the change.
    changes
        Expected change of each estimate by full name. It is ignored for a parameter that has a logarithm as its
        coordinate, in which the likelihood is not quadratic.
    """
    if not changes:
        return {}
    values = fit.start_values(fit.model)
    for p in fit.parameters:
        if p.full_name in changes and p.full_name in values and p.transform != "log":
            low, high = p.bounds
            values[p.full_name] = min(max(values[p.full_name] + changes[p.full_name], low), high)
    return values


def with_held_parameters(
    model: Model, fit: Fit, changes: Mapping[str, float], estimated: Collection[str] = ()
) -> Model:
    """Return a model in which a rough search holds those parameters that it would hardly change.

    A held parameter has its estimate plus its expected change, in its coordinate of the search. The search estimates
    the noise, per-record parameters, the parameters that ``fit`` lacks, those in ``estimated``, and those others whose
    expected change exceeds one standard error. If these are fewer than 16, the parameters with the next largest changes
    are estimated, too. All parameters stay free if no change is expected.

    Parameters
    ----------
    model
        Model to fit.
    fit
        Fit of the model before the change.
    changes
        Expected change of each estimate by full name.
    estimated
        Names of parameters that are not held in any case.

    Notes
    -----
    The log-posterior is smaller by the square of what the expectation misses, which is one or two per cent of the gain
    of an effect. The search takes half of the time. A model that is kept is fitted with all parameters.
    """
    if not any(changes.values()):
        return model
    shares = {
        p.name: abs(changes.get(p.full_name, 0.0)) / error if error > 0 else 0.0
        for p, error in zip(fit.parameters, fit.errors.tolist(), strict=True)
        if p.segment is None and p.name not in model.noises and p.name not in estimated
    }
    moved = sorted((n for n in model.free if n in shares), key=lambda n: -shares[n])
    n_other = len(model.free) - len(moved)
    n_free = max(n_other + sum(shares[n] > 1.0 for n in moved), FREE)
    held = set(moved[-(-n_free // FREE_AT_ONCE) * FREE_AT_ONCE - n_other :])
    values = {}
    for p in (q for q in fit.parameters if q.name in held):
        estimate = fit.estimate(p.name)[0]
        coordinate = p.to_free(estimate) + changes.get(p.full_name, 0.0) / p.slope(estimate)
        values[p.name] = min(max(p.from_free(coordinate), p.bounds[0]), p.bounds[1])
    return model.with_values(values).with_free(n for n in model.free if n not in held)


def with_held_priors(fitted: FittedModel, searched: Model, model: Model) -> FittedModel:
    """Return a fitted model whose log-posterior contains the priors of held parameters, as if they were estimated.

    Its difference from that of a model in which they are estimated is then a gain with the same priors.

    Parameters
    ----------
    fitted
        Fitted model.
    searched
        Model that was fitted, with the held parameters (`with_held_parameters`).
    model
        The same model without held parameters.
    """
    held = [p for p in searched.parameters if not p.free and model.parameter(p.name).free]
    loss = 0.5 * sum(map(_squared_deviation, held))
    return replace(fitted, fit=replace(fitted.fit, log_posterior=fitted.fit.log_posterior - loss)) if loss else fitted


def _squared_deviation(parameter: Parameter) -> float:
    """Return ``((value - mean) / sd)^2`` of a parameter and its prior, 0 without a prior."""
    prior = parameter.free_prior()
    return 0.0 if prior is None else ((parameter.to_free(parameter.value) - prior[0]) / prior[1]) ** 2
