"""Limits of stuck sensors, for the live warning and for the check of a log.

A sensor is stuck if its values stay exactly equal for more samples and a longer time than its noise allows. The live
warning (seatrial.daq.acquisition.sensor_health) waits longer than the check of a log
(seatrial.daq.checks.device_checks), because a false alarm during a run distracts the operator, and a false finding in a
log only costs a short look. Both use ``can_be_stuck`` to select the samples that can be stuck, except for load cells:
the check of a log has more data about them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from seatrial.daq.samples import Ahrs, Gnss, LoadCell


class StuckLimit(NamedTuple):
    """Limit of one kind of sample. A sensor is stuck if all `fields` repeat for so many samples and so many seconds.

    Attributes
    ----------
    fields
        Names of the compared fields of a sample.
    samples
        Number of samples in a row with equal values. The check of a log does not count the first of them.
    seconds
        Time from the first to the last equal sample [run s].
    """

    fields: tuple[str, ...]
    samples: int
    seconds: float


_MOTION = ("yaw", "p", "q", "r", "ax", "ay", "az")
# A receiver at rest may repeat its position, so the live warning compares only its time.
STUCK_LIVE: dict[type, StuckLimit] = {
    Ahrs: StuckLimit(_MOTION, 20, 5.0),
    Gnss: StuckLimit(("utc",), 20, 5.0),
    LoadCell: StuckLimit(("counts",), 20, 5.0),
}
STUCK_IN_LOG: dict[type, StuckLimit] = {
    Ahrs: StuckLimit(_MOTION, 10, 0.5),
    # A receiver at rest may repeat its position and velocity, but not its time.
    Gnss: StuckLimit(("utc", "lat", "lon", "vel_n", "vel_e"), 10, 3.0),
    LoadCell: StuckLimit(("counts",), 20, 3.0),
}
# Counts. A larger whole number is a raw number of a converter, which always has noise. A scaled reading such as 0.00 kg
# may stay constant.
FINE_COUNTS = 1000.0
FLAGGED_SHARE = 0.01  # limit of the share of saturated samples and spikes of a load cell


def can_be_stuck(kind: type, sample: Any) -> Any:
    """Return whether a sample, or each sample of a table, would change from sample to sample if its sensor works.

    An AHRS sample would if it has a roll rate, or a heading and a specific force forward. A GNSS sample would if it has
    a time. A load cell's would if its counts are a whole number of at least 1000 (FINE_COUNTS), positive or negative.

    Parameters
    ----------
    kind
        `Ahrs`, `Gnss` or `LoadCell`.
    sample
        A sample, or a record array (n_samples,) with the same fields.

    Returns
    -------
    bool or Array (n_samples,)

    Notes
    -----
    Some samples repeat without a fault. A compass rounds so coarsely that its heading alone may repeat for a minute.
    The same holds for the acceleration of an autopilot in thousandths of g. A receiver without a time repeats an empty
    sample, and a scale at rest repeats 0.00.
    """
    if kind is Ahrs:
        p, yaw, ax = sample.p, sample.yaw, sample.ax
        return (p == p) | ((yaw == yaw) & (ax == ax))
    if kind is Gnss:
        return sample.utc == sample.utc
    counts = sample.counts
    return (abs(counts) >= FINE_COUNTS) & (counts % 1.0 == 0.0)
