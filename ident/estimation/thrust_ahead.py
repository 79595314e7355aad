"""First fit of a model whose thrust is known ahead only: it finds the ratio of the thrusts astern and ahead."""

from __future__ import annotations

from collections.abc import Sequence

from seatrial.ident.data import LogSegment
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, SearchSettings
from seatrial.ident.estimation.thrust_scale import scaled_to_ahead
from seatrial.ident.model import Model
from seatrial.ident.reporter import Reporter

FIRST_SEARCH = SearchSettings(tolerance=0.05, robust_errors=False)


def with_thrust_ahead(
    model: Model,
    segments: Sequence[LogSegment],
    options: EstimationOptions,
    ahead: tuple[float, float],
    *,
    rate: float,
    reporter: Reporter,
) -> tuple[Model, str]:
    """Return the model with a c1 by which the given thrust ahead is c1 + c2, and a note on it, by a first fit.

    Parameters
    ----------
    model
        Model with an estimated c2 and any c1.
    segments
        Logs to which the model is fitted.
    options
        Method, outliers and noise of the fit.
    ahead
        Thrust of one thruster at full speed ahead, and its standard uncertainty [N]; 0 for an exact thrust.
    rate
        Rate of the rows of a record [Hz].
    reporter
        Receives the progress.

    Returns
    -------
    model, note
        The model of `scaled_to_ahead`, and a sentence for the reader. Without a positive thrust ahead by the first fit,
        the model is unchanged and the sentence says so.
    """
    first = fit_nominal_model(model, segments, [], options, rate=rate, settings=FIRST_SEARCH, reporter=reporter).fit
    (c1, _), (c2, _), (given, sd) = first.estimate("c1"), first.estimate("c2"), ahead
    if c1 + c2 <= 0.0:
        return model, (
            f"The thrust ahead was given, {given:.4g} N, but a first fit finds none: c1 is taken as {c1:.4g} N."
        )
    astern = given * (c1 - c2) / (c1 + c2)
    return scaled_to_ahead(model, first, given, sd), (
        f"The thrust ahead was given, {given:.4g} N. By a first fit, that astern is {astern:.3g} N, so that c1 is "
        f"{(given + astern) / 2.0:.4g} N (their mean); c2 is estimated."
    )
