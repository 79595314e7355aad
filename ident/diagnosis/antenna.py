"""Error of the given position of the GNSS antenna, by one step from a fitted model, without a refit."""

from __future__ import annotations

import numpy as np

from seatrial.ident.diagnosis.search import score_equations
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import FIT_ERRORS, FittedModel

LEVER_ARMS = ("lever-arm", "lever-arm-attitude")


def antenna_error(fitted: FittedModel) -> dict[str, tuple[float, float]]:
    """Estimate the distance of the GNSS antenna from its given position by one step from the fitted model.

    Parameters
    ----------
    fitted
        Fitted model without the effect ``lever-arm``, with the innovations of its estimation records.

    Returns
    -------
    dict
        Estimate and standard error [m] of ``l_x`` (forward) and ``l_y`` (to starboard). Empty if no position was given,
        if the model does not accept the effect, or if the data do not show both.

    Notes
    -----
    The step is that of the score equations, in which all fitted parameters change too. The standard error is the larger
    one of that of the information and of that of the sandwich of the scores of blocks of time. The model lacks the
    small errors of all craft, so that its innovations are correlated and the information alone is too large. The mean
    of the block scores is subtracted. It is the effect itself, not an error.
    """
    effects = {n: catalogue()[n] for n in LEVER_ARMS if fitted.model.accepts(catalogue()[n])}
    if "antenna_x" not in fitted.model.values or not effects:
        return {}
    try:
        equations = score_equations(fitted, fitted.records, effects)
    except FIT_ERRORS:
        return {}
    placed = next((i for i in equations.indices if i.columns.name in effects), None)
    if placed is None:
        return {}
    names = [n for n in placed.names if n in ("l_x", "l_y")]
    at = np.array([k for n, k in zip(placed.names, placed.at, strict=True) if n in names])
    information = equations.projected[0][np.ix_(at, at)]
    blocks = np.concatenate(equations.normal.blocks)
    own = blocks[:, at] - blocks[:, : len(equations.parameters)] @ equations.coefficients_on_fitted[:, at]
    if len(own) < 2 or np.linalg.matrix_rank(information) < at.size:
        return {}
    covariance = np.linalg.inv(information)
    sandwich = covariance @ np.cov(own, rowvar=False) @ covariance * len(own)
    error = np.sqrt(np.maximum(np.diag(covariance), np.diag(sandwich)))
    step = equations.one_step(at, np.zeros(at.size))
    return {n: (float(value), float(se)) for n, value, se in zip(names, step, error, strict=True)}
