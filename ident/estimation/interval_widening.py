"""Widening of prediction intervals for runs that a model has not seen, from its errors on validation data.

The scale of a channel is the root mean square of its errors over their predicted standard deviations. The logarithm of
the scale of a run differs from that of the next run of the same boat, and the number of independent errors limits how
well one run shows it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from seatrial.ident.numerics import normal_ppf, student_ppf

# Standard deviation of the logarithm of the scale between runs of one craft, beyond that of few errors, on realistic
# mock boats (0.07 to 0.17 with 95 %): `python -m tests.recovery.interval_study`.
RUN_SCATTER = 0.12
# Standard deviation between craft of the logarithm of the scale of simulations, about that of a calibrated model, which
# is zero (0.50 to 0.79 with 95 %): the same study.
BOAT_SCATTER = 0.65
SAME_HORIZON = 0.01  # part of a horizon by which another one may differ and still have its widening
P95 = 0.975  # probability below the upper end of a central 95 % interval


@dataclass(frozen=True)
class ErrorScale:
    """Scale of the errors of one channel on validation data, and how well it is known.

    Attributes
    ----------
    scale
        Root mean square of error over predicted standard deviation; infinite if a prediction diverged.
    n_effective
        Number of independent errors with the same information (effective sample size).
    n_records
        Number of records (runs) with errors.
    """

    scale: float
    n_effective: float
    n_records: int

    @property
    def widening(self) -> float:
        """Factor by which 95 % intervals of a further run have to be wider than the predicted ones; at least 1.

        An error of a further run over the predicted standard deviation and the scale follows Student's t distribution,
        because the scale is estimated from few independent errors, and because every run has a scale of its own. The
        factor is thus the scale times the ratio of the 97.5 % quantiles of this distribution and the normal one. It is
        infinite if a prediction diverged.

        Notes
        -----
        The logarithm of a scale from n independent errors has the variance 1 / (2 n). That of a run differs from the
        mean of ``n_records`` runs with the variance ``RUN_SCATTER**2 (1 + 1 / n_records)``. The degrees of freedom are
        those of a scale with the sum of both variances.
        """
        between_runs = RUN_SCATTER**2 * (1.0 + 1.0 / self.n_records)
        return _factor(self.scale, 0.5 / max(self.n_effective, 1.0) + between_runs)

    @property
    def simulation_widening(self) -> float:
        """Factor by which 95 % intervals of a simulation of a further run have to be wider; at least 1.

        A simulation has so few independent errors that Student's t by them alone would give useless intervals. The
        logarithm of the scale is therefore shrunk towards zero, that of a calibrated model, by its scatter between
        craft (``BOAT_SCATTER``). The factor is infinite if a prediction diverged.

        Notes
        -----
        The logarithm of a scale from n independent errors has the variance 1 / (2 n), and that of the scale of a craft
        has the variance ``BOAT_SCATTER**2``. The prior thus counts as ``m = 1 / (2 BOAT_SCATTER**2)`` errors of a
        calibrated model: the scale has the exponent n / (n + m), and Student's t has n + m degrees of freedom. There is
        no further scatter between runs, because the few errors explain the measured one.
        """
        return self.simulation_widening_by(BOAT_SCATTER)

    def simulation_widening_by(self, boat_scatter: float) -> float:
        """Return the factor of `simulation_widening` for another scatter of the log scale between craft."""
        n, prior = max(self.n_effective, 1.0), 0.5 / boat_scatter**2
        return _factor(self.scale ** (n / (n + prior)), 0.5 / (n + prior))


def _factor(scale: float, variance: float) -> float:
    """Return the factor for 95 % intervals, at least 1, from a scale and the variance of its logarithm."""
    return max(1.0, scale * float(student_ppf(P95, 0.5 / variance) / normal_ppf(P95)))


@dataclass(frozen=True)
class IntervalCalibration:
    """Scales of a model's errors on its validation data, from which the intervals for further runs follow.

    Attributes
    ----------
    horizon
        Prediction horizon [s].
    ahead
        Scale by channel of the predictions over the horizon.
    simulation
        Scale by channel of the simulation from the inputs alone. All channels have the same number of independent
        errors, because their errors are correlated with each other.
    """

    horizon: float
    ahead: Mapping[str, ErrorScale]
    simulation: Mapping[str, ErrorScale]

    def widening(self, seconds: float | None) -> dict[str, float]:
        """Return the factors by channel for predictions over ``seconds`` [s], or in simulation (None).

        The dictionary is empty for a horizon that differs from that of the validation by more than 1 %: its factors are
        not known.
        """
        if seconds is None:
            return {name: found.simulation_widening for name, found in self.simulation.items()}
        if abs(seconds - self.horizon) > SAME_HORIZON * self.horizon:
            return {}
        return {name: found.widening for name, found in self.ahead.items()}
