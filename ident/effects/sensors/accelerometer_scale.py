"""Scale-factor error of the horizontal accelerometers."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, directed_in_sentence


def scale(s: Signals) -> None:
    """Multiply the accelerometer outputs ``ax`` and ``ay`` by one plus the relative scale error ``k_acc``, in place."""
    s.y["ax"] = s.y["ax"] * (1 + s.p.k_acc)
    s.y["ay"] = s.y["ay"] * (1 + s.p.k_acc)


EFFECT = Effect(
    name="accelerometer-scale",
    title="a scale-factor error of the accelerometers",
    place="sensor",
    hooks={"axes": scale},
    parameters=(
        Parameter("k_acc", 0.0, "", "relative scale-factor error of the accelerometers", prior=(0.0, 0.2), step=0.01),
    ),
    formula="a_measured = (1 + k) a",
    source="IEEE Std 1293",
    experiment="hard starts and stops, and turning circles at speed; or the sensor on each of its faces on a table",
    requires=("hull",),
    alternatives=("accelerometer-tilt", "lag"),
    in_words=directed_in_sentence("k_acc", "%", "the accelerations read {}", "too high", "too low"),
)
