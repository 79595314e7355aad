"""First-order wave forces: narrow-band forces with a spectral peak that no input explains.

Each force is the output of a second-order filter driven by white noise (linear approximation of the wave spectrum,
Fossen 2011, section 8.2). The size A of a force is a standard deviation. The likelihood is therefore an even function
of A, and its score at zero vanishes. A score test cannot detect waves. Waves are detected as a peak in the spectrum of
the innovations (``seatrial.ident.numerics.spectral_peak``). The refit starts at the frequency of the peak
(``seatrial.ident.diagnosis.candidates.wave_peak_score``).
"""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, Parameter, Signals, State

FORCES = {"X": ("N", 5.0), "Y": ("N", 5.0), "N": ("N m", 0.6)}  # units and typical standard deviations


def push(s: Signals) -> None:
    """Add the wave forces to the surge and sway forces [N] and the yaw moment [N m] of the signals, in place.

    Each wave force is the state of a second-order filter that unit white noise drives, times a gain. The variance of
    the state is 1 / (4 zeta omega), with the damping ratio zeta and the angular frequency omega of the filter. The gain
    makes the parameter ``A_X``, ``A_Y`` or ``A_N`` the standard deviation of the force.
    """
    gain = np.sqrt(4 * s.p.zeta_wave * 2 * np.pi * s.p.f_wave)
    for force in FORCES:
        setattr(s, force, getattr(s, force) + getattr(s.p, f"A_{force}") * gain * getattr(s.x, f"wave_{force}"))


def shape(s: Signals) -> None:
    """Set the rates of the two states of the second-order filter of each wave force, in place.

    The natural frequency ``f_wave`` [Hz] and the damping ratio ``zeta_wave`` are common to all forces.
    """
    omega = 2 * np.pi * s.p.f_wave
    for force in FORCES:
        wave, quadrature = getattr(s.x, f"wave_{force}"), getattr(s.x, f"wave_{force}_rate")
        s.rate[f"wave_{force}"] = omega * quadrature
        s.rate[f"wave_{force}_rate"] = -omega * wave - 2 * s.p.zeta_wave * omega * quadrature


EFFECT = Effect(
    name="waves",
    title="first-order wave forces",
    place="environment",
    hooks={"force": push, "rate": shape},
    parameters=(
        *(
            Parameter(
                f"A_{force}",
                0.0,
                unit,
                f"standard deviation of the wave force {force}",
                prior=(0.0, 2 * size),
                bounds=(0.0, INF),
                step=0.1 * size,
            )
            for force, (unit, size) in FORCES.items()
        ),
        Parameter("f_wave", 0.5, "Hz", "peak frequency", "log", prior=(0.5, 0.4), bounds=(0.1, 2.5), scales=False),
        Parameter(
            "zeta_wave",
            0.1,
            "",
            "relative width of the peak, as a damping ratio",
            "log",
            prior=(0.1, 0.1),
            bounds=(0.01, 0.7),
        ),
    ),
    states=tuple(
        state
        for force in FORCES
        for state in (
            State(f"wave_{force}", "", f"wave filter of {force}", 0.0, sd0=1.0),
            State(f"wave_{force}_rate", "", f"quadrature of the wave filter of {force}", 1.0, sd0=1.0),
        )
    ),
    formula="F += A sqrt(4 zeta w) z, z'' + 2 zeta w z' + w^2 z = w e(t), e white; F each of X, Y, N",
    source="Fossen 2011, section 8.2: linear approximation of the wave spectrum",
    causes="waves or wakes",
    experiment="drifting without thrust in beam seas and head seas: the spectral peak remains at zero inputs",
    requires=("hull",),
    one_sided=True,
    alternatives=("pendulum",),
    at_lower_bound={
        "zeta_wave": (
            "the motion at this frequency is nearly periodic, as of a machine (a motor, a pump, a turning antenna), of "
            "a gyro that swings on its mounting, or of regular swell; the waves of wind have a wider peak. See whether "
            "the frequency follows the shaft speeds, and whether it is also there at rest with the motors off"
        ),
        **{
            f"A_{force}": (
                "the data show no such force. If only one of A_X, A_Y and A_N is larger than zero, the cause may be a "
                "machine or the mounting of a sensor instead of waves"
            )
            for force in FORCES
        },
    },
)
WAVES = EFFECT  # the name in the package `seatrial.ident.effects`, which exports no other effect
