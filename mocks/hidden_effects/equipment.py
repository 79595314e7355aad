"""Hidden effects of the equipment of every boat: signals that are late or rounded, and shafts that brake slowly."""

from __future__ import annotations

import numpy as np

from seatrial.mocks.plant import PLANT_STEP_S, HeadingFilter, HiddenEffect, Maker, Telemetry


def _heading_lag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "heading-lag": a heading that is filtered by the AHRS and reported late.

    The heading is the output of a complementary filter with the time constant ``time_constant`` [s] and is reported
    ``lag`` [s] later (``HeadingFilter`` in seatrial.mocks.plant). ``time_constant`` is uniform between 3 and 10 s, and
    ``lag`` between 0.03 and 0.08 s; both are multiplied by ``scale``.
    """
    time_constant, lag = scale * float(rng.uniform(3.0, 10.0)), scale * float(rng.uniform(0.03, 0.08))  # s
    return HiddenEffect(
        "heading-lag",
        "the AHRS filters the heading and delivers it late",
        {"time_constant": time_constant, "lag": lag},
        heading_filter=HeadingFilter(time_constant, lag),
    )


def _telemetry_age(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "telemetry-age": late and rounded telemetry of the speed controllers.

    All values are ``age`` [s] old at their time stamp. ``age`` is uniform between 0.05 and 0.12 s, multiplied by
    ``scale`` and rounded to steps of the plant (5 ms). The shaft speed is a multiple of ``resolution = 0.005 scale`` of
    the full shaft speed.
    """
    age = round(scale * float(rng.uniform(0.05, 0.12)) / PLANT_STEP_S) * PLANT_STEP_S  # s
    telemetry = Telemetry(age, 0.005 * scale)
    return HiddenEffect(
        "telemetry-age",
        "the speed controllers report old shaft speeds, and in steps",
        {"age": age, "resolution": telemetry.resolution},
        telemetry=telemetry,
    )


def _velocity_resolution(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "velocity-resolution": a GNSS velocity in steps of ``0.01 scale`` [m/s].

    North and east are rounded separately. Nothing is drawn from ``rng``.
    """
    resolution = 0.01 * scale  # m/s
    parameters = {"resolution": resolution}
    sentence = "the GNSS receiver rounds the velocity"
    return HiddenEffect("velocity-resolution", sentence, parameters, velocity_resolution=resolution)


def _shaft_braking(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "shaft-braking": shafts that slow down with another lag than they speed up.

    While a shaft slows down, its time constant is multiplied by ``1 + slower``. ``slower`` is uniform between 0.2 and
    0.5, multiplied by ``scale``.
    """
    slower = scale * float(rng.uniform(0.2, 0.5))
    sentence = "the shafts take longer to slow down than to speed up"
    return HiddenEffect("shaft-braking", sentence, {"slower": slower}, braking=1.0 + slower)


MAKERS: dict[str, Maker] = {
    "heading-lag": _heading_lag,
    "telemetry-age": _telemetry_age,
    "velocity-resolution": _velocity_resolution,
    "shaft-braking": _shaft_braking,
}
