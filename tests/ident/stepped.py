"""A thruster whose set-points do not determine the end of its dead zone."""

from __future__ import annotations

import numpy as np

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.estimation.maximum_likelihood import Fit, fit
from seatrial.ident.models.thruster import delayed_channels, thruster_model

LEVELS = np.array([0.0, 0.3, 0.06, -0.5, 0.12, 0.4, -0.06, -0.12, 0.8, 0.06])  # No level lies between 0.06 and 0.12.


def stepped_record(dead_zone: float, seed: int = 1) -> Record:
    """Return a record of a few levels of the set-point, held for two seconds each."""
    rng = np.random.default_rng(seed)
    t_cmd, n, rows = np.arange(0.0, 60.0, 2.0), 0.0, []
    held = np.tile(LEVELS, 3)
    for k in range(1500):
        t = 0.04 * k
        command = held[np.searchsorted(t_cmd, t - 0.119, side="right") - 1] if t >= 0.119 else 0.0
        rows.append((t, n, 40.0 * n * abs(n)))
        n += (1.0 - np.exp(-3.0 * 0.04)) * (command * (abs(command) > dead_zone) - n)
    log = np.array(rows)
    channels = delayed_channels(Channel(t_cmd, held), 0.0125) | {
        "n": Channel(log[:, 0], log[:, 1] + 0.004 * rng.standard_normal(len(log))),
        "force": Channel(log[:, 0], log[:, 2] + 0.2 * rng.standard_normal(len(log))),
    }
    return build_record(thruster_model(), channels, rate=50.0)


def steps(dead_zone: float) -> Fit:
    """Fit this record with the end of the dead zone free."""
    model = thruster_model()
    return fit(
        model.with_free([*model.free, "d"]),
        [stepped_record(dead_zone)],
        start={"d": 0.09, "tau": 0.1, "a": 3.0, "c1": 40.0},
    )
