"""Models that can carry a given effect."""

from __future__ import annotations

from seatrial.ident.model.structure import Effect, Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import SENSORS, horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.thruster import thruster_model


def vehicle_for(effect: Effect) -> Model:
    """Return a vehicle model with the inputs and sensors that the effect needs.

    It is the horizontal model, the kinematic model with measured attitude, or the Nomoto model.
    """
    if "attitude" in effect.requires:
        return kinematic_model(yaw=True)
    if "nomoto" in effect.requires:
        return nomoto_model().with_values({"T": 0.5})  # Without a lag, the yaw rate r would equal r_ref.
    sensors = tuple(SENSORS)[: len(SENSORS) if "body_velocity" in effect.requires else -1]
    if "n_state" in effect.requires:
        return horizontal_model("command", sensors)
    return horizontal_model("force" if "f_input" in effect.requires else "shaft", sensors)


def carrier(effect: Effect) -> Model:
    """Return this model with disturbance forces, or a thruster model for an effect on the bench."""
    return with_disturbances(thruster_model(n_delays=9) if "bench" in effect.requires else vehicle_for(effect))
