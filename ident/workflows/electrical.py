"""Electrical signals of a thruster in a bench log: voltage, current and power of the supply."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from seatrial.daq.log import open_log
from seatrial.daq.samples import Esc
from seatrial.ident.data import Channel, LoadedLog
from seatrial.ident.model import SignalId

# Protocols whose current is that of the motor. The supply's current is smaller by the duty cycle.
MOTOR_CURRENT = ("vesc",)
FORMULAS = {True: "voltage × motor current × duty cycle", False: "voltage × current of the supply"}


def electrical_channels(path: Path, loaded: LoadedLog, name: str) -> tuple[dict[str, Channel], str]:
    """Return voltage, current and power of the supply of a thruster, from its speed controller.

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
        power in words. Both are empty for an imported log, and for a controller without a voltage or a current.
    """
    voltage = loaded.run.channels.get(str(SignalId(name, "voltage")))
    thruster = next((x for x in loaded.rig.thrusters if x.name == name), None) if loaded.rig else None
    if loaded.rig is None or thruster is None or voltage is None or voltage.t.size == 0:
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
