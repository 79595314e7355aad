"""Example of a calibration for pages: overconfident, underconfident and insufficient data, from seeded numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.validation.calibration import calibration_test


def calibration(seed: int = 6) -> dict[str, Any]:
    """Return the key ``calibration`` of a result."""
    rng = np.random.default_rng(seed)
    sizes = {"psi": 1.0, "r": 1.4, "x": 0.8, "y": 1.05}
    found: dict[str, Any] = {}
    for role in ("estimation", "validation"):
        found[role] = {}
        for kind, n in (("one_step", 2000), ("horizon", 150), ("simulation", 12)):
            found[role][kind] = {}
            for channel, size in sizes.items():
                tested = calibration_test([size * rng.normal(size=n)], effective=5.0 if kind == "simulation" else None)
                assert tested is not None
                found[role][kind][channel] = vars(tested) | {"pit": tested.pit.tolist(), "verdict": tested.verdict}
    return found
