"""Limits beyond which a sensor's values are implausible, shared by the live warning and the check of a log.

A sensor is stuck when its values stay exactly the same for more samples and longer than its noise allows. The live
warning (daq.acquisition.sensor_health) waits longer than the check of a log (daq.checks.device_checks): a false alarm
during a run distracts, a section of a log that is found in vain costs a glance.
"""

from __future__ import annotations

from typing import NamedTuple

from daq.samples import Ahrs, Gnss, LoadCell


class StuckLimit(NamedTuple):
    """Values of these fields that repeat for at least so many samples and seconds (run time) are stuck."""

    fields: tuple[str, ...]
    samples: int
    seconds: float


# A compass rounds so coarsely that it may repeat for a minute, hence the rates and accelerations beside yaw. A receiver
# at rest may repeat its position: live, its time is compared.
STUCK_LIVE: dict[type, StuckLimit] = {
    Ahrs: StuckLimit(("yaw", "p", "q", "r", "ax", "ay", "az"), 20, 5.0),
    Gnss: StuckLimit(("utc",), 20, 5.0),
    LoadCell: StuckLimit(("counts",), 20, 5.0),
}
STUCK_IN_LOG: dict[type, StuckLimit] = {
    Ahrs: StuckLimit(("yaw", "r", "ax"), 10, 0.5),
    Gnss: StuckLimit(("utc", "lat", "lon", "vel_n", "vel_e"), 10, 3.0),  # a receiver at rest may hold its position
    LoadCell: StuckLimit(("counts",), 20, 3.0),
}
FLAGGED_SHARE = 0.01  # of a load cell's samples: saturated or spikes
