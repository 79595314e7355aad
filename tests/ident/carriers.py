"""A model that can carry an effect, whatever the effect needs."""

from __future__ import annotations

from seatrial.ident.model.structure import Effect, Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import SENSORS, horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.thruster import thruster_model


def vehicle_for(effect: Effect) -> Model:
    """The horizontal model with the inputs and sensors that the effect wants, or the one with measured attitude, or
    without sway."""
    if "attitude" in effect.requires:
        return kinematic_model(yaw=True)
    if "nomoto" in effect.requires:
        return nomoto_model().with_values({"T": 0.5})  # without a lag its r is a copy of r_ref
    sensors = tuple(SENSORS)[: len(SENSORS) if "body_velocity" in effect.requires else -1]
    if "n_state" in effect.requires:
        return horizontal_model("command", sensors)
    return horizontal_model("force" if "f_input" in effect.requires else "shaft", sensors)


def carrier(effect: Effect) -> Model:
    """The same with disturbance forces; a bench for what is found on one."""
    return with_disturbances(thruster_model(n_delays=9) if "bench" in effect.requires else vehicle_for(effect))
