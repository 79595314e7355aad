"""Signal processing without domain: angles, first-order lags."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from ident.numerics.arrays import Array


def first_order_lag(f: Array, tau: float, dt: float) -> Array:
    """First-order low-pass, exact for inputs held over each step: x' = (f - x) / tau.

    Parameters: f (n, ...) input, time along the first axis; tau [s] time constant; dt [s] step.
    Returns: x (n, ...), zero at the start.
    """
    keep = np.exp(-dt / tau)
    return np.asarray(lfilter([0.0, 1.0 - keep], [1.0, -keep], f, axis=0))


def wrap(e: Array, angle: bool) -> Array:
    return np.mod(e + np.pi, 2 * np.pi) - np.pi if angle else e
