"""Scale-factor error of the yaw gyro."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, directed_in_sentence


def scale(s: Signals) -> None:
    """Add the relative scale error ``k_gyro`` times the yaw rate (state) to the output ``r`` [rad/s], in place."""
    s.y["r"] = s.y["r"] + s.p.k_gyro * s.x.r


EFFECT = Effect(
    name="gyro-scale",
    title="a scale-factor error of the yaw gyro",
    place="sensor",
    hooks={"output": scale},
    parameters=(Parameter("k_gyro", 0.0, "", "relative scale-factor error of the gyro", prior=(0.0, 0.1), step=0.005),),
    formula="r_measured = (1 + k) r",
    source="IEEE Std 1293",
    causes="a gyro without a calibrated scale, a wrong unit in the import map",
    experiment="several full turns in one direction, then as many in the other",
    requires=("hull",),
    alternatives=("compass",),
    in_words=directed_in_sentence("k_gyro", "%", "the yaw rate reads {}", "too high", "too low"),
)
