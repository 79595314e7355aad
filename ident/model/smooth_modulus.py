"""Modulus of a speed or yaw rate with a continuous derivative, for products such as |v| r.

The derivative of |v| r by v jumps by 2 r where v changes its sign. The extended Kalman filter linearises the model at
its estimate. Its likelihood would therefore jump whenever a change of a parameter moves a zero of v over a step of the
integration, and a maximum of such a likelihood cannot be found to the tolerance. |v| v needs no smoothing, because its
derivative is continuous.
"""

from __future__ import annotations

from typing import Any

import numpy as np

SPEED_WIDTH = 0.02  # m/s: about the uncertainty of a filtered speed; forces at such a speed are negligible
YAW_RATE_WIDTH = 0.02  # rad/s: the same for the yaw rate


def smooth_modulus(x: Any, width: float) -> Any:
    """Return ``sqrt(x^2 + width^2)``: a modulus of ``x`` without the kink at zero.

    It is about |x| for ``|x|`` much larger than ``width``, and ``width`` at zero. ``x`` is a number, an array or a
    symbol. ``width`` has the same unit.
    """
    return np.sqrt(x * x + width * width)
