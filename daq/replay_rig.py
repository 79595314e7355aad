"""The rig of a log with the ports of its replay, so that `seatrial log` records it anew as it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import tomlkit

from daq.errors import SeatrialError
from daq.log import Log
from daq.rig import parse_rig

NAME = "replay.toml"
HEAD = "# Made by `seatrial replay`, and taken away when it ends: the log's own rig with the ports of the replay.\n"


def write_rig(log: Log, devices: Sequence[str], folder: Path, speed: float) -> Path | None:
    """Write FOLDER/replay.toml for `devices`, whose ports are FOLDER/DEVICE; None where the log has no rig for them.

    Logs go to the folder of `log`. Raises SeatrialError where another file is in the way.
    """
    path = folder / NAME
    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(HEAD):
        raise SeatrialError(f"{path}: exists and is of no replay; --dir names another folder")
    try:
        text = _text(log, devices, speed)
        if text is None:
            return None
        parse_rig(text, path)
    except (SeatrialError, tomlkit.exceptions.TOMLKitError):
        return None  # the rig of another version: the bytes are replayed all the same
    path.write_text(text, encoding="utf-8")
    return path


def _text(log: Log, devices: Sequence[str], speed: float) -> str | None:
    rig = log.rig()
    if rig is None or not {device.name for device in rig.devices}.issuperset(devices):
        return None
    document = tomlkit.parse(rig.text).unwrap()
    here = [table for table in document["device"] if table["name"] in devices]
    for table in here:
        bus = "slcan:" if str(table["port"]).startswith(("slcan:", "socketcan:")) else ""
        table["port"] = f"{bus}{table['name']}"
        device = rig.device(table["name"])
        if device.dbc:
            table["dbc"] = device.dbc  # relative paths count from another folder now
        table.pop("key_file", None)  # the log does not hold it: signatures are not checked
    document["device"] = here
    document["thruster"] = [table for table in document.get("thruster", []) if table["device"] in devices]
    document["clock"] = {"speed": speed}
    document["log"] = {**document.get("log", {}), "directory": str(log.path.parent.absolute())}
    return HEAD + tomlkit.dumps(document)
