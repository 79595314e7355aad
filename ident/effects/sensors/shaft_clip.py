"""Shaft telemetry that saturates: the true shaft speed, and so the thrust, is larger than the largest reported one."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, Parameter, Signals

WIDTH = 0.03  # width of the step in shaft speed (1: full speed); the likelihood needs a derivative by the limit


def exceed(s: Signals) -> None:
    """Increase the thrust of each thruster whose reported shaft speed is at the limit of the telemetry or above.

    The thrust in ``s.f`` is multiplied by ``1 + k_clip``, in place, if the size of the normalised shaft speed is at
    least the limit ``n_clip``. The transition is a ramp over 0.03, which is half way at the limit.
    """
    for side, n in s.n.items():
        saturated = np.minimum(np.maximum((abs(n) - s.p.n_clip) / WIDTH + 0.5, 0.0), 1.0)
        s.f[side] = s.f[side] * (1 + s.p.k_clip * saturated)


EFFECT = Effect(
    name="shaft-clip",
    title="shaft telemetry that saturates below the full shaft speed",
    place="sensor",
    hooks={"thrust_loss": exceed},
    parameters=(
        Parameter(
            "k_clip",
            0.0,
            "",
            "relative increase of the thrust where the telemetry saturates",
            prior=(0.0, 0.4),
            bounds=(0.0, INF),
            step=0.02,
        ),
        Parameter("n_clip", 0.8, "", "largest reported shaft speed", prior=(0.8, 0.2), bounds=(0.1, 1.2), step=0.01),
    ),
    scan={"n_clip": (0.4, 0.44, 0.48, 0.52, 0.56, 0.6, 0.64, 0.68, 0.72, 0.76, 0.8, 0.84, 0.88, 0.92, 0.96)},
    formula="f_i *= 1 + k_clip (|n_i| >= n_clip)",
    source="telemetry with a fixed number of bits or a limit on the reported speed",
    experiment="levels of steady command up to full command, with the speed of the boat at each level",
    requires=("n", "f", "n_input"),
    one_sided=True,
    alternatives=("thrust-power", "thrust-linearity", "advance-ratio", "hump"),
)
