"""Yaw moment as a function of heading: wind or waves on an asymmetric hull."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Estimates, ForceCurve, Parameter, Signals, directed_size, largest_of_headings


def add(s: Signals) -> None:
    """Add a moment that depends on the heading psi to the yaw moment ``s.N`` [N m], in place.

    The moment is ``N_s sin psi + N_c cos psi + N_2s sin 2psi + N_2c cos 2psi``, with parameters as coefficients.
    """
    psi = s.x.psi
    s.N = s.N + s.p.N_s * np.sin(psi) + s.p.N_c * np.cos(psi) + s.p.N_2s * np.sin(2 * psi) + s.p.N_2c * np.cos(2 * psi)


def largest(estimates: Estimates) -> str:
    """Return a clause for reports: the largest moment [N m] with its direction, and the heading at which it acts.

    Its standard error leaves out the correlations of the coefficients.
    """
    moment, error, heading = largest_of_headings(estimates, ("N_s", "N_c", "N_2s", "N_2c"))
    return f"at most {directed_size((moment, error), 'N m', 'to starboard', 'to port')}, on heading {heading} deg"


EFFECT = Effect(
    name="heading-moment",
    title="a heading-dependent yaw moment",
    place="environment",
    hooks={"force": add},
    parameters=(
        Parameter("N_s", 0.0, "N m", "amplitude of sin psi in the moment", prior=(0.0, 2.0), step=0.05),
        Parameter("N_c", 0.0, "N m", "amplitude of cos psi in the moment", prior=(0.0, 2.0), step=0.05),
        Parameter("N_2s", 0.0, "N m", "amplitude of sin 2 psi in the moment", prior=(0.0, 2.0), step=0.05),
        Parameter("N_2c", 0.0, "N m", "amplitude of cos 2 psi in the moment", prior=(0.0, 2.0), step=0.05),
    ),
    formula="N += N_s sin psi + N_c cos psi + N_2s sin 2psi + N_2c cos 2psi",
    source="wind and waves on an asymmetric hull; Fossen 2011, section 8.2",
    causes="wind or waves from one side on a hull or a superstructure that is not symmetric",
    experiment="slow turns through all headings, in both directions",
    requires=("hull",),
    nonparametric_of=ForceCurve("N", "psi"),
    alternatives=("wind", "yaw-bias", "compass"),
    in_words=largest,
)
