"""Bank effect: a boat that passes a shore or a wall is drawn towards it, and its bow is turned away."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Parameter, Signals


def draw(s: Signals) -> None:
    """Add a sideways force [N] and a yaw moment [N m] near a bank, in proportion to the squared surge speed u.

    The force to starboard is ``(Y_bank + Y_slope d) u^2 sin(psi_bank - psi)``, and the moment ``-(N_bank + N_slope d)
    u^2 sin(psi_bank - psi)``. They are added to ``s.Y`` and ``s.N``, in place. psi_bank is the bearing of the bank, and
    d [m] the distance of the boat from the origin in this direction. Both are largest if the boat moves along the bank.
    """
    p, x = s.p, s.x
    towards = x.x * np.cos(p.psi_bank) + x.y * np.sin(p.psi_bank)  # distance from the origin, in m
    along = x.u * x.u * np.sin(p.psi_bank - x.psi)  # positive if the bank is to starboard
    s.Y = s.Y + (p.Y_bank + p.Y_slope * towards) * along
    s.N = s.N - (p.N_bank + p.N_slope * towards) * along


EFFECT = Effect(
    name="bank",
    title="the suction of a bank or a wall",
    place="environment",
    hooks={"force": draw},
    parameters=(
        Parameter("N_bank", 0.0, "kg", "yaw moment at the origin, away from the bank", prior=(0.0, 1.0), step=0.02),
        Parameter("N_slope", 0.0, "kg/m", "increase per metre towards the bank", prior=(0.0, 0.05), step=1e-3),
        Parameter("Y_bank", 0.0, "kg/m", "force at the origin, towards the bank", prior=(0.0, 3.0), step=0.1),
        Parameter("Y_slope", 0.0, "kg/m2", "increase per metre towards the bank", prior=(0.0, 0.15), step=5e-3),
        Parameter("psi_bank", 0.0, "rad", "bearing of the bank from the origin", prior=(0.0, 3.0), step=0.05),
    ),
    # The opposite bearings need no test: with them the forces only change their sign.
    scan={"psi_bank": (0.0, 0.524, 1.047, 1.571, 2.094, 2.618)},
    formula="Y += (Y_bank + Y_slope d) u^2 sin(psi_bank - psi), N -= (N_bank + N_slope d) u^2 sin(psi_bank - psi), "
    "d = x cos(psi_bank) + y sin(psi_bank)",
    source="bank suction and bow-out moment: Norrbin 1974; Vantorre, Delefortrie and Eloot 2003",
    causes="a shore, a wall or a pontoon beside the track",
    experiment="straight runs in both directions along the bank, near to it and far from it",
    requires=("hull",),
    fixed_point=True,
    alternatives=("yaw-bias", "heading-moment", "wind", "current-shear"),
)
