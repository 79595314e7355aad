"""Names of signals in a log: those that the built-in models use, and the names of other programs for them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from seatrial.daq.errors import closest_name


class OtherName(NamedTuple):
    """What a name of another program means.

    Attributes
    ----------
    meant
        Signal of a model whose place it takes; ``n`` stands for the input of a thruster.
    advice
        Name or unit to use instead.
    """

    meant: str
    advice: str


_POSITION = "import positions as x, y in metres north and east"
_OVER_GROUND = "import the velocity over ground as vx, vy (m/s, north and east)"
_PULSE = OtherName("n", "a pulse width is no shaft speed: import it as n_left, n_right (-1..1) by scale and offset")
_HEADING = OtherName("psi", "import the heading by the name psi")
_YAW_RATE = OtherName("r", "import the yaw rate by the name r")
# Names that other programs use for signals, alone or followed by _ and any text
OTHER_NAMES = {
    "speed_x": OtherName("vx", "import the velocity over ground to the north by the name vx"),
    "speed_y": OtherName("vy", "import the velocity over ground to the east by the name vy"),
    "lat": OtherName("x", _POSITION),
    "lon": OtherName("y", _POSITION),
    "latitude": OtherName("x", _POSITION),
    "longitude": OtherName("y", _POSITION),
    "sog": OtherName("vx", _OVER_GROUND),
    "cog": OtherName("vx", _OVER_GROUND),
    "pwm": _PULSE,
    "servo": _PULSE,
    "yaw": _HEADING,
    "heading": _HEADING,
    "hdg": _HEADING,
    "yaw_rate": _YAW_RATE,
    "yawrate": _YAW_RATE,
    "roll": OtherName("phi", "import the roll angle by the name phi"),
    "pitch": OtherName("theta", "import the pitch angle by the name theta"),
}
# Signals that a built-in model uses. Those of a thruster have its name after the quantity, such as n_cmd_left.
OF_MODELS = frozenset(
    {"x", "y", "psi", "r", "vx", "vy", "u", "v", "ax", "ay", "phi", "theta", "p", "q", "X", "X_n", "N"}
)
OF_MODELS |= {"n", "force", "speed", "speed_x", "speed_y"}
OF_THRUSTERS = ("n", "n_cmd", "f", "voltage", "force")
SUPPLY = ("voltage", "current", "power")  # of the supply of the thruster of a bench log, alone or with its name


def advice_on_other_name(name: str) -> str | None:
    """Return advice on a signal with a name that other programs use, for example ``sog`` or ``yaw``.

    The names are those of the table `OTHER_NAMES`, alone or followed by ``_`` and more. The longest one counts. None
    for other names.
    """
    other = _other_name(name)
    return None if other is None else other.advice


def _other_name(name: str) -> OtherName | None:
    """Return the meaning of a signal's name by the longest entry of `OTHER_NAMES` that it begins with, else None."""
    found = [alias for alias in OTHER_NAMES if name == alias or name.startswith(f"{alias}_")]
    return OTHER_NAMES[max(found, key=len)] if found else None


def supply_signals(names: Iterable[str]) -> list[str]:
    """Return the signals of a bench log from which `seatrial ident thruster` knows the electrical power.

    They are ``voltage``, ``current`` and ``power`` in this order, alone or with the name of the thruster, as
    ``voltage_thruster``. The list is empty for a log without the force of a load cell, or without a command or a shaft
    speed.
    """
    names = list(names)
    thrusters = {name.removeprefix("n_").removeprefix("cmd_") for name in names if name.startswith("n_")}
    if "force" not in names or not (thrusters or "n" in names):
        return []
    known = [name for q in SUPPLY for name in (q, *(f"{q}_{thruster}" for thruster in sorted(thrusters)))]
    return [name for name in known if name in names]


def supply_line(names: Iterable[str]) -> str:
    """Return a line on the use of the electrical signals of a bench log (`supply_signals`); empty without any."""
    found = supply_signals(names)
    if not found:
        return ""
    listed, quantities = ", ".join(found), {name.partition("_")[0] for name in found}
    use = "`seatrial ident thruster` writes the electrical power and the efficiency into steady.csv"
    if "power" in quantities:
        return f"{listed}: {use}"
    if {"voltage", "current"} <= quantities:
        return f"{listed}: {use}, with power = voltage * current"
    missing = "current" if "voltage" in quantities else "voltage"
    return f"{listed}: {use} if the map has the {missing} too, or the power"


def unknown_names(names: Iterable[str]) -> dict[str, str]:
    """Return the signals that no built-in model uses by this name, each with advice on the name to use.

    The advice is empty if the name resembles none of a model, or if the log has the signal that is meant: a log may
    contain ``pwm_left`` beside ``n_left``. A user-defined model may use any name.
    """
    names, found = list(names), {}
    of_supply = supply_signals(names)
    quantities = {name.rpartition("_")[0] for name in names}
    present = {*names, *["n"] * (not quantities.isdisjoint(OF_THRUSTERS))}
    for name in names:
        if name in OF_MODELS or name.rpartition("_")[0] in OF_THRUSTERS or name in of_supply:
            continue
        near = closest_name(name, OF_MODELS)
        other = _other_name(name) or (None if near is None else OtherName(near, f"did you mean {near!r}?"))
        found[name] = "" if other is None or other.meant in present else other.advice
    return found


def unknown_names_text(names: Iterable[str]) -> str:
    """Return a line on the unknown signals that resemble those of a model, with the advice; empty without any."""
    advised = {name: advice for name, advice in unknown_names(names).items() if advice}
    texts = [
        f"{', '.join(n for n, own in advised.items() if own == advice)}: no model uses this name; {advice}"
        for advice in dict.fromkeys(advised.values())
    ]
    return "; ".join(texts)
