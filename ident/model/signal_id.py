"""Identity of a signal: the thruster that it belongs to, its quantity, and its tap (steps of delay).

Files, models and the terminal write the identity as one name, for example ``n_cmd_left~3``. `SignalId` is the only code
that composes such names from their components and separates names into components.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

COMMAND, SHAFT_SPEED, THRUSTER_FORCE = "n_cmd", "n", "f"  # -1 to 1; relative to full speed; N
# Quantities of one thruster. `n_cmd` comes before `n`: `n_cmd_left` is the command of `left`.
THRUSTER_QUANTITIES = (COMMAND, SHAFT_SPEED, THRUSTER_FORCE, "voltage", "servo", "pwm")
DRIVE_WORDS = {COMMAND: "command", SHAFT_SPEED: "shaft speed", THRUSTER_FORCE: "thrust"}


class SignalId(NamedTuple):
    """Identity of one signal of a log or of a model.

    Attributes
    ----------
    source : str
        Name of the thruster, or number of the autopilot's output, for example ``left``. Empty for all other signals.
    quantity : str
        For a thruster one of `THRUSTER_QUANTITIES`, for example ``n_cmd``. For another signal its name, for example
        ``psi``.
    tap : int
        Delay of a delayed copy of the signal in steps (0.1 s each; 0.05 s for commands), positive for an earlier value.
        0 for the signal itself.
    """

    source: str
    quantity: str
    tap: int = 0

    @classmethod
    def parse(cls, name: str) -> SignalId:
        """Separate the name of a signal into its components.

        Parameters
        ----------
        name : str
            Name of a signal. A thruster's signal is ``QUANTITY_THRUSTER``, for example ``n_cmd_left``. A delayed input
            ends with ``~STEPS``.

        Returns
        -------
        SignalId
            Components; ``str`` of them is the name again. A name that does not begin with a quantity of
            `THRUSTER_QUANTITIES` and ``_`` has an empty source and is itself the quantity: ``psi``, ``X``, ``X_n``,
            ``n``. The name ``n_cmd`` without a thruster becomes the shaft speed of a thruster ``cmd``. Only ``~`` and a
            positive integer at the end is a tap; anything else, also ``~-1``, stays part of the source or quantity.
        """
        stem, mark, steps = name.rpartition("~")
        tapped = bool(mark) and steps.isdecimal() and str(int(steps)) == steps != "0"
        stem, tap = (stem, int(steps)) if tapped else (name, 0)
        for quantity in THRUSTER_QUANTITIES:
            source = stem.removeprefix(f"{quantity}_")
            if source and source != stem:
                return cls(source, quantity, tap)
        return cls("", stem, tap)

    def __str__(self) -> str:
        """Return the name of the signal in files, models and messages, for example ``n_cmd_left~3``."""
        name = f"{self.quantity}_{self.source}" if self.source else self.quantity
        return f"{name}~{self.tap}" if self.tap else name


def command_of(thruster: str) -> str:
    """Return the name of the signal with the command (-1 to 1) of a thruster, for example ``n_cmd_left``."""
    return str(SignalId(thruster, COMMAND))


def shaft_speed_of(thruster: str) -> str:
    """Return the name of the signal with the shaft speed (over full speed) of a thruster, for example ``n_left``."""
    return str(SignalId(thruster, SHAFT_SPEED))


def thrust_of(thruster: str) -> str:
    """Return the name of the signal with the thrust [N] of a thruster, for example ``f_left``."""
    return str(SignalId(thruster, THRUSTER_FORCE))


def is_of_thruster(name: str, *quantities: str) -> bool:
    """Return whether the signal ``name`` belongs to a thruster and has one of ``quantities``.

    The quantities are entries of `THRUSTER_QUANTITIES`. For example, ``n_left`` and its delayed copy ``n_left~3`` have
    the quantity ``n``, and ``n`` has no thruster. Any name of a thruster counts. Without ``quantities`` the result is
    False.
    """
    signal = SignalId.parse(name)
    return bool(signal.source) and signal.quantity in quantities


def drive_word(names: Iterable[str]) -> str:
    """Return what the inputs of a boat are, in words: ``command``, ``shaft speed`` or ``thrust``.

    The first signal of ``names`` with one of these quantities decides. Without one the result is ``command``.
    """
    quantities = (SignalId.parse(name).quantity for name in names)
    return next((DRIVE_WORDS[q] for q in quantities if q in DRIVE_WORDS), DRIVE_WORDS[COMMAND])


def commanded_thrusters(names: Iterable[str]) -> list[str]:
    """Return the names of the thrusters whose commands are among the signals ``names``, in the order of the signals.

    Delayed copies of a command (``n_cmd_left~3``) count too, so that the name of a thruster may occur several times.
    """
    return [signal.source for signal in map(SignalId.parse, names) if signal.source and signal.quantity == COMMAND]
