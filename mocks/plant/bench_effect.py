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
    "controller-dead-band": ("ignored",),
}


@dataclass(frozen=True)
class ShaftEffect:
    """Sizes of the hidden effects of the response of a bench's shaft to commands. Zero switches an effect off.

    Attributes
    ----------
    late : float
        Time constant [s] of a first-order lag between the reference and the shaft. It is 5 % longer at rest than at
        full speed.
    brisk : float
        Fraction by which the pole of the shaft is higher while the shaft speeds up.
    slew : float
        Inverse of the largest acceleration of the normalised shaft speed [s]: the time from rest to full speed at this
        acceleration. At full speed it is a sixth longer than at rest.
    droop : float
        Fraction of the shaft speed that is missing at full command.
    sag : float
        Fraction of the shaft speed that is lost when the battery is empty.
    ignored : float
        Command up to which the controller does not turn the shaft, as a fraction of full command. The controller
        spreads the other commands over all shaft speeds.
    """

    late: float = 0.0
    brisk: float = 0.0
    slew: float = 0.0
    droop: float = 0.0
    sag: float = 0.0
    ignored: float = 0.0

    @property
    def any(self) -> bool:
        """Whether at least one of the six effects of the shaft's response is switched on (its size is not zero)."""
        return bool(self.late or self.brisk or self.slew or self.droop or self.sag or self.ignored)


NO_SHAFT_EFFECT = ShaftEffect()


@dataclass(frozen=True)
class BenchEffect:
    """Hidden effect of the mock bench, or no effect (`NONE`). A size of zero switches the phenomenon off.

    Attributes
    ----------
    name : str
        Name of the effect, for example "rod-flex".
    sentence : str
        Description for the user.
    flex_hz : float
        Resonance frequency of the rod in its mount [Hz]; 0 for a rigid rod.
    flex_damping : float
        Damping ratio of the rod.
    flex_share : float
        Fraction of the thrust that reaches the load cell through the resonance, 0 to 1. The rest reaches it directly.
    wash : float
        Recirculation: fraction of the thrust that is lost when the pool is in full motion.
    wash_s : float
        Time constant [s] with which the pool gets into motion.
    drift : float
        Drift of the load cell after one minute [N]. It grows with the square root of time.
    smooth_s : float
        Sum of the time constants [s] of the load cell's filter, which has two equal poles.
    reverse : float
        Fraction of the thrust that is lost at full speed in reverse.
    slow_loss : float
        Fraction of the thrust that is lost at the lowest shaft speeds.
    band : float
        Normalised shaft speed below which there is almost no thrust.
    shaft : ShaftEffect
        Effect on the response of the shaft.
    """

    name: str
    sentence: str
    flex_hz: float = 0.0
    flex_damping: float = 0.04
    flex_share: float = 1.0
    wash: float = 0.0
    wash_s: float = 4.0
    drift: float = 0.0
    smooth_s: float = 0.0
    reverse: float = 0.0
    slow_loss: float = 0.0
    band: float = 0.0
    shaft: ShaftEffect = NO_SHAFT_EFFECT

    @property
    def parameters(self) -> dict[str, float]:
        """True sizes of this hidden effect, by the names of its fields and in their units, for the ground-truth file.

        Fields that belong to other effects are left out. The dict is empty for the effect "none". If the name of the
        effect is unknown, KeyError is raised.
        """
        values = asdict(self) | asdict(self.shaft)
        return {name: float(values[name]) for name in _PARAMETERS[self.name]}


NONE = BenchEffect("none", "no hidden effect: the nominal model is complete")
