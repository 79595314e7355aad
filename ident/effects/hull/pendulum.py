"""Lightly damped pendulum or sloshing mass that the acceleration of the hull drives: bilge water, a suspended load.

The moving mass takes its part of the total force. The effect therefore hooks in after all other effects. Together with
the effect cg-offset, the moving mass is assumed at the origin.
"""

from __future__ import annotations

import math

from seatrial.ident.model import Effect, ModelFunction, Parameter, Signals, State

# Natural frequencies to try. They are 12 % apart, the width of a resonance with the damping ratio of 0.06
FREQUENCIES_HZ = tuple(round(0.25 * 1.12**k, 2) for k in range(16))
# Upper bound of the moving mass on a boat of 37 kg; it scales with the boat (`seatrial.ident.models.scaling`). If the
# whole mass moved freely, the force would be infinite
LARGEST_MASS_KG = 30.0


def _moving_mass_hooks(force: str, of: str) -> dict[str, ModelFunction]:
    """Return the two hooks of a sprung mass that moves along one axis of the boat, by the place at which they run.

    A hook is a function of the model's signals, which it changes in place. That at ``loose_mass``, after all forces,
    adds the force of the mass. That at ``carried``, after all rates, sets the rates of its displacement and velocity.

    Parameters
    ----------
    force : str
        ``X`` for motion along the boat, ``Y`` for motion across it.
    of : str
        Letter at the end of the names of the parameters and states, for example ``p`` in ``m_p``.

    Notes
    -----
    The moving mass m_p is a part of the mass m (``m_u`` or ``m_v``). Along one axis it moves freely, and only its
    spring and damper accelerate it: (m - m_p) a = F + m_p (2 zeta w z' + w^2 z). The hook adds the force that gives the
    whole mass m this acceleration a.
    """

    def pull(s: Signals) -> None:
        """Add the force [N] of the moving mass to the total surge or sway force, in place.

        The whole mass then accelerates as the rest of the boat does, which spring and damper of the moving mass push.
        """
        omega, x, p = 2 * math.pi * getattr(s.p, f"f_{of}"), s.x, s.p
        z, z_rate = getattr(x, f"swing_{of}"), getattr(x, f"swing_rate_{of}")
        spring = 2 * getattr(p, f"zeta_{of}") * omega * z_rate + omega * omega * z
        free, mass = getattr(p, f"m_{of}"), p.m_u if force == "X" else p.m_v
        rigid = getattr(s, force) + (p.m_v - p.m_u) * (x.v if force == "X" else x.u) * x.r  # mass times acceleration
        setattr(s, force, getattr(s, force) + free * (rigid + mass * spring) / (mass - free))

    def swing(s: Signals) -> None:
        """Set the rates of the displacement [m/s] and velocity [m/s2] of the moving mass, in place.

        Both are relative to the boat: spring, damper and minus the acceleration of the boat along the axis act on it.
        """
        omega = 2 * math.pi * getattr(s.p, f"f_{of}")
        z, z_rate = getattr(s.x, f"swing_{of}"), getattr(s.x, f"swing_rate_{of}")
        acceleration = s.rate["u"] - s.x.v * s.x.r if force == "X" else s.rate["v"] + s.x.u * s.x.r
        s.rate[f"swing_{of}"] = z_rate
        s.rate[f"swing_rate_{of}"] = -2 * getattr(s.p, f"zeta_{of}") * omega * z_rate - omega * omega * z - acceleration

    return {"loose_mass": pull, "carried": swing}


def _moving_mass_effect(name: str, title: str, force: str, of: str, alternatives: tuple[str, ...]) -> Effect:
    """Return the effect of a sloshing or suspended mass that moves along one axis of the boat.

    Parameters
    ----------
    name, title : str
        Name in the catalogue, and name in reports.
    force : str
        ``X`` for motion along the boat, ``Y`` for motion across it.
    of : str
        Letter at the end of the names of the parameters and states, for example ``p`` in ``m_p``.
    alternatives : tuple[str, ...]
        Names of competing effects.
    """
    axis, chirp = ("x", "equal") if force == "X" else ("y", "opposite")
    return Effect(
        name=name,
        title=title,
        hooks=_moving_mass_hooks(force, of),
        parameters=(
            Parameter(
                f"m_{of}", 0.0, "kg", "oscillating mass", prior=(0.0, 10.0), bounds=(0.0, LARGEST_MASS_KG), step=0.2
            ),
            Parameter(f"f_{of}", 0.6, "Hz", "natural frequency", "log", prior=(0.6, 0.4), bounds=(0.15, 2.5)),
            Parameter(f"zeta_{of}", 0.06, "", "damping ratio", "log", prior=(0.06, 0.06), bounds=(0.005, 0.7)),
        ),
        states=(
            State(f"swing_{of}", "m", "displacement of the oscillating mass", 0.0, sd0=0.02),
            State(f"swing_rate_{of}", "m/s", "velocity of the oscillating mass", 0.0, sd0=0.05),
        ),
        scan={f"f_{of}": FREQUENCIES_HZ},
        formula=f"z'' + 2 zeta w z' + w^2 z = -a_{axis}, {force} += m_p (a_{axis} + 2 zeta w z' + w^2 z)",
        source="thesis section 6 names sloshing; Ibrahim 2005, equivalent mechanical models",
        causes="liquid in a tank or in the bilge, a payload that hangs",
        experiment=f"chirp of {chirp} thrust through 0.2 to 1.5 Hz",
        requires=("hull",),
        one_sided=True,
        alternatives=alternatives,
    )


EFFECTS = (
    _moving_mass_effect("pendulum", "a sloshing or suspended mass", "X", "p", ("waves", "lag")),
    _moving_mass_effect(
        "sway-slosh", "a sloshing mass that moves sideways", "Y", "s", ("waves", "pendulum", "sway-yaw")
    ),
)
