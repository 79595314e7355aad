"""Names of signals in a log: those that the built-in models use, and the names of other programs for them."""

from __future__ import annotations

from collections.abc import Iterable

from seatrial.daq.errors import closest_name

# Names that other programs use for signals (also followed by _ and any text), and advice on the name or unit to use
OTHER_NAMES = {
    "speed_x": "import the velocity over ground to the north by the name vx",
    "speed_y": "import the velocity over ground to the east by the name vy",
    "lat": "import positions as x, y in metres north and east",
    "lon": "import positions as x, y in metres north and east",
    "latitude": "import positions as x, y in metres north and east",
    "longitude": "import positions as x, y in metres north and east",
    "sog": "import the velocity over ground as vx, vy (m/s, north and east)",
    "cog": "import the velocity over ground as vx, vy (m/s, north and east)",
    "pwm": "a pulse width is no shaft speed: import it as n_left, n_right (-1..1) by scale and offset",
    "servo": "a pulse width is no shaft speed: import it as n_left, n_right (-1..1) by scale and offset",
    "yaw": "import the heading by the name psi",
    "heading": "import the heading by the name psi",
    "hdg": "import the heading by the name psi",
    "yaw_rate": "import the yaw rate by the name r",
    "yawrate": "import the yaw rate by the name r",
    "roll": "import the roll angle by the name phi",
    "pitch": "import the pitch angle by the name theta",
}
# The signal of a model whose place each of these names takes; ``n`` stands for the input of a thruster
MEANT = {
    "speed_x": "vx", "speed_y": "vy", "lat": "x", "lon": "y", "latitude": "x", "longitude": "y", "sog": "vx",
    "cog": "vx", "pwm": "n", "servo": "n", "yaw": "psi", "heading": "psi", "hdg": "psi", "yaw_rate": "r",
    "yawrate": "r", "roll": "phi", "pitch": "theta",
}  # fmt: skip
# Signals that a built-in model uses. Those of a thruster have its name after the quantity, such as n_cmd_left.
OF_MODELS = frozenset(
    {"x", "y", "psi", "r", "vx", "vy", "u", "v", "ax", "ay", "phi", "theta", "p", "q", "X", "X_n", "N"}
)
OF_MODELS |= {"n", "force", "speed", "speed_x", "speed_y"}
OF_THRUSTERS = ("n", "n_cmd", "f", "voltage", "force")


def advice_on_other_name(name: str) -> str | None:
    """Return advice on a signal with a name that other programs use, for example ``sog`` or ``yaw``.

    The names are those of the table `OTHER_NAMES`, alone or followed by ``_`` and more. The longest one counts. None
    for other names.
    """
    alias = _alias(name)
    return None if alias is None else OTHER_NAMES[alias]


def _alias(name: str) -> str | None:
    """Return the longest name in `OTHER_NAMES` that a signal has, alone or followed by ``_`` and more; else None."""
    found = [alias for alias in OTHER_NAMES if name == alias or name.startswith(f"{alias}_")]
    return max(found, key=len, default=None)


def unknown_names(names: Iterable[str]) -> dict[str, str]:
    """Return the signals that no built-in model uses by this name, each with advice on the name to use.

    The advice is empty if the name resembles none of a model, or if the log has the signal that is meant: a log may
    contain ``pwm_left`` beside ``n_left``. A user-defined model may use any name.
    """
    names, found = list(names), {}
    quantities = {name.rpartition("_")[0] for name in names}
    present = {*names, *["n"] * (not quantities.isdisjoint(OF_THRUSTERS))}
    for name in names:
        if name in OF_MODELS or name.rpartition("_")[0] in OF_THRUSTERS:
            continue
        alias, near = _alias(name), closest_name(name, OF_MODELS)
        meant = near if alias is None else MEANT[alias]
        advice = f"did you mean {near!r}?" if alias is None else OTHER_NAMES[alias]
        found[name] = "" if meant is None or meant in present else advice
    return found


def unknown_names_text(names: Iterable[str]) -> str:
    """Return a line on the unknown signals that resemble those of a model, with the advice; empty without any."""
    advised = {name: advice for name, advice in unknown_names(names).items() if advice}
    texts = [
        f"{', '.join(n for n, own in advised.items() if own == advice)}: no model uses this name; {advice}"
        for advice in dict.fromkeys(advised.values())
    ]
    return "; ".join(texts)
