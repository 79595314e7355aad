"""Hidden effect of the mock bench: the sizes by which it acts on the force and on the response of the shaft."""

from __future__ import annotations

from dataclasses import asdict, dataclass

# Fields of BenchEffect and ShaftEffect that belong to each effect
_PARAMETERS: dict[str, tuple[str, ...]] = {
    "none": (),
    "rod-flex": ("flex_hz", "flex_damping", "flex_share"),
    "recirculation": ("wash", "wash_s"),
    "cell-drift": ("drift",),
    "cell-lag": ("smooth_s",),
    "reverse-loss": ("reverse",),
    "thrust-exponent": ("slow_loss",),
    "thrust-dead-band": ("band",),
    "supply-sag": ("sag",),
    "speed-curve": ("droop",),
    "second-lag": ("late",),
    "spin-up": ("brisk",),
    "slew-limit": ("slew",),
}


@dataclass(frozen=True)
class ShaftEffect:
    """Hidden effects of the shaft's response to commands. A size of zero switches the effect off."""

    late: float = 0.0  # s, time constant of a lag in front of the shaft; 5 % longer at rest than at full speed
    brisk: float = 0.0  # fraction by which the pole is higher while the shaft speeds up
    slew: float = 0.0  # s, inverse of the highest acceleration at rest; at full speed a sixth longer
    droop: float = 0.0  # fraction of the speed that is missing at full command
    sag: float = 0.0  # fraction of the speed that is lost with an empty battery

    @property
    def any(self) -> bool:
        """Return whether one of the effects is switched on."""
        return bool(self.late or self.brisk or self.slew or self.droop or self.sag)


NO_SHAFT_EFFECT = ShaftEffect()


@dataclass(frozen=True)
class BenchEffect:
    """Hidden effect of the bench, or no effect. A size of zero switches a part of the effect off."""

    name: str
    sentence: str  # description for the user
    flex_hz: float = 0.0  # Hz, resonance of the rod in its mount
    flex_damping: float = 0.04  # damping ratio of the rod
    flex_share: float = 1.0  # share of the force that passes the resonance
    wash: float = 0.0  # recirculation: fraction of the thrust that is lost if the pool is in full motion
    wash_s: float = 4.0  # s, time constant in which the pool gets into motion
    drift: float = 0.0  # N/min^1/2, drift of the load cell with the square root of time
    smooth_s: float = 0.0  # s, total time constant of the load cell's filter, which has two equal poles
    reverse: float = 0.0  # fraction of the thrust that is lost in reverse at full speed
    slow_loss: float = 0.0  # fraction of the thrust that is lost at the lowest shaft speeds
    band: float = 0.0  # shaft speed (normalised) below which there is almost no thrust
    shaft: ShaftEffect = NO_SHAFT_EFFECT

    @property
    def parameters(self) -> dict[str, float]:
        """Return the true sizes that belong to this effect (SI)."""
        values = asdict(self) | asdict(self.shaft)
        return {name: float(values[name]) for name in _PARAMETERS[self.name]}


NONE = BenchEffect("none", "no hidden effect: the nominal model is complete")
