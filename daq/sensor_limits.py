"""Limits beyond which a sensor's values are implausible, shared by the live warning and the check of a log.

A sensor is stuck when its values stay exactly the same for more samples and longer than its noise allows. The live
warning (seatrial.daq.acquisition.sensor_health) waits longer than the check of a log
(seatrial.daq.checks.device_checks): a false alarm during a run distracts, a section of a log that is found in vain
costs a glance. Which samples can be stuck at all is one rule for both, ``can_be_stuck``, but for load cells, of which a
log tells more.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from seatrial.daq.samples import Ahrs, Gnss, LoadCell


class StuckLimit(NamedTuple):
    """Values of these fields that repeat for at least so many samples and seconds (run time) are stuck."""

    fields: tuple[str, ...]
    samples: int
    seconds: float


_MOTION = ("yaw", "p", "q", "r", "ax", "ay", "az")
# A receiver at rest may repeat its position: live, its time is compared.
STUCK_LIVE: dict[type, StuckLimit] = {
    Ahrs: StuckLimit(_MOTION, 20, 5.0),
    Gnss: StuckLimit(("utc",), 20, 5.0),
    LoadCell: StuckLimit(("counts",), 20, 5.0),
}
STUCK_IN_LOG: dict[type, StuckLimit] = {
    Ahrs: StuckLimit(_MOTION, 10, 0.5),
    Gnss: StuckLimit(("utc", "lat", "lon", "vel_n", "vel_e"), 10, 3.0),  # a receiver at rest may hold its position
    LoadCell: StuckLimit(("counts",), 20, 3.0),
}
FINE_COUNTS = 1000.0  # a whole number beyond is a converter's own, which always flickers; 0.00 kg may well stay
FLAGGED_SHARE = 0.01  # of a load cell's samples: saturated or spikes


def can_be_stuck(kind: type, sample: Any) -> Any:
    """Whether a sample, or each of a table (a record array), would change if its sensor were alive.

    A compass rounds so coarsely that it alone may repeat for a minute, and so may the thousandths of g of an
    autopilot's accelerometer. A receiver without a time repeats that it knows nothing, a scale at rest its 0.00.
    """
    if kind is Ahrs:
        p, yaw, ax = sample.p, sample.yaw, sample.ax
        return (p == p) | ((yaw == yaw) & (ax == ax))
    if kind is Gnss:
        return sample.utc == sample.utc
    counts = sample.counts
    return (abs(counts) >= FINE_COUNTS) & (counts % 1.0 == 0.0)
