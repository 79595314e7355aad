"""Electrical signals of a thruster in a bench log: voltage, current and power of the supply."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from seatrial.daq.checks import SUPPLY
from seatrial.daq.log import open_log
from seatrial.daq.samples import Esc
from seatrial.ident.data import Channel, LoadedLog
from seatrial.ident.model import SignalId

# Protocols whose current is that of the motor. The supply's current is smaller by the duty cycle.
MOTOR_CURRENT = ("vesc",)
FORMULAS = {True: "voltage × motor current × duty cycle", False: "voltage × current of the supply"}
AS_IMPORTED = "the imported signal"  # formula of a power that the log has


def electrical_channels(path: Path, loaded: LoadedLog, name: str) -> tuple[dict[str, Channel], str]:
    """Return voltage, current and power of the supply of a thruster, from its speed controller or as imported.

    Parameters
    ----------
    path : Path
        File of the log.
    loaded : LoadedLog
        The log, with its rig.
    name : str
        Name of the thruster.

    Returns
    -------
    tuple
        Channels by name (``voltage``, ``current``, ``power``), with the times of ``loaded``, and the formula of the
        power in words. Both are empty if the power is unknown: for a controller, or an imported log, without a voltage
        or a current. An imported power is used as it is.
    """
    if loaded.rig is None:
        return _imported_supply(loaded.run.channels, name)
    voltage = loaded.run.channels.get(str(SignalId(name, "voltage")))
    thruster = next((x for x in loaded.rig.thrusters if x.name == name), None)
    if thruster is None or voltage is None or voltage.t.size == 0:
        return {}, ""
    protocol = next((d.protocol for d in loaded.rig.devices if d.name == thruster.device), "")
    with open_log(path) as log:
        table = log.table(Esc, thruster.device, node=thruster.node)
    t, volts = table["t"], table["voltage"]
    by_duty = protocol in MOTOR_CURRENT
    amperes = np.abs(table["current"]) * (np.abs(table["duty"]) if by_duty else 1.0)
    good = np.isfinite(volts) & np.isfinite(amperes)
    if not good.any():
        return {}, ""
    t = t[good] - loaded.zero
    found = {
        "voltage": Channel(t, volts[good], "V", thruster.device),
        "current": Channel(t, amperes[good], "A", thruster.device),
        "power": Channel(t, volts[good] * amperes[good], "W", thruster.device),
    }
    return found, FORMULAS[by_duty]


def _imported_supply(channels: Mapping[str, Channel], name: str) -> tuple[dict[str, Channel], str]:
    """Return voltage, current and power of the supply of an imported log, and the formula of the power in words.

    ``channels``: signals of the log. The signals of the supply have the name of their quantity, alone or with that of
    the thruster (``name``), which counts first. Without a power, it is the voltage times the size of the current, at
    the times of the current at which the voltage is known. Both results are empty if the power is unknown.
    """
    named = {quantity: channels.get(str(SignalId(name, quantity)), channels.get(quantity)) for quantity in SUPPLY}
    found = {quantity: channel for quantity, channel in named.items() if channel is not None and channel.t.size}
    if "power" in found:
        return found, AS_IMPORTED
    if not {"voltage", "current"} <= set(found):
        return {}, ""
    voltage, current = found["voltage"], found["current"]
    inside = (current.t >= voltage.t[0]) & (current.t <= voltage.t[-1])
    t = current.t[inside]
    watts = np.interp(t, voltage.t, voltage.value) * np.abs(current.value[inside])
    return {**found, "power": Channel(t, watts, "W", current.source)}, FORMULAS[False]
