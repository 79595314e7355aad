"""The keys of a [[device]] that belong to some protocols only, and what they become."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from daq.rig_mavlink import read_settings
from daq.toml_table import Table

if TYPE_CHECKING:  # the watchdog has no other use for it, and it takes longer to load than all the rest
    import numpy as np
    from numpy.typing import NDArray

DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"
DEFAULT_QUERY = "!001:SYS?"
ESC_FIELDS = ("rpm", "current", "duty", "voltage", "temperature")
OWN_NODE = 100  # ours on a DroneCAN bus; 10 is an autopilot's, 126 and 127 are for tools
SOURCE = "source"  # a signal's node is the sender's address (J1939, NMEA 2000)

Counts = TypeVar("Counts", float, "NDArray[np.float64]")


@dataclass(frozen=True)
class Calibration:
    """Load cell: counts -> force at the thruster."""

    newton_per_count: float
    zero_counts: float = 0.0
    lever_ratio: float = 1.0

    def force(self, counts: Counts) -> Counts:
        """Force at the thruster, N, of raw counts; a number or an array of any shape."""
        return (counts - self.zero_counts) * (self.newton_per_count * self.lever_ratio)


@dataclass(frozen=True)
class DbcSignal:
    """One signal of a DBC file and the field of `Esc` that it is: value = scale * (what the DBC says) + offset."""

    message: str
    signal: str
    field: str
    node: int | str  # a number, the signal that holds it, or SOURCE
    scale: float = 1.0
    offset: float = 0.0


def read_options(table: Table, names: Sequence[str], folder: Path) -> dict[str, Any]:
    """The fields of `daq.rig.Device` that these keys of a device's table give. Raises SeatrialError."""
    found: dict[str, Any] = {}
    for name in names:
        found |= _READ[name](table, folder)
    return found


def _bitrate(table: Table, folder: Path) -> dict[str, Any]:
    usual = 250_000 if table.values.get("protocol") == "nmea2000" else 500_000
    return {"bitrate": table.integer("bitrate", usual, low=10_000)}


def _own_node(table: Table, folder: Path) -> dict[str, Any]:
    return {"own_node": table.integer("own_node", OWN_NODE, low=1, high=127)}


def _pattern(table: Table, folder: Path) -> dict[str, Any]:
    pattern = table.text("pattern", DEFAULT_PATTERN)
    try:
        groups = re.compile(pattern).groupindex
    except re.error as error:
        raise table.error("pattern", f"not a regular expression: {error}") from error
    if "counts" not in groups:
        raise table.error("pattern", "must have a group (?P<counts>...) around the reading")
    return {"pattern": pattern}


def _saturation(table: Table, folder: Path) -> dict[str, Any]:
    return {"saturation": table.maybe_number("saturation", low=1.0)}


def _calibration(table: Table, folder: Path) -> dict[str, Any]:
    inner = table.table("calibration")
    if inner is None:
        return {}
    gain = inner.number("newton_per_count")
    if gain == 0.0:
        raise inner.error("newton_per_count", "must not be zero")
    zero, ratio = inner.number("zero_counts", 0.0), inner.number("lever_ratio", 1.0, positive=True)
    found = Calibration(gain, zero, ratio)
    inner.done()
    return {"calibration": found}


def _declination(table: Table, folder: Path) -> dict[str, Any]:
    degrees = table.maybe_number("declination_deg", low=-180.0, high=180.0)
    return {"declination": None if degrees is None else math.radians(degrees)}


def _query(table: Table, folder: Path) -> dict[str, Any]:
    query = table.text("query", DEFAULT_QUERY)
    if not (query.isascii() and query.isprintable() and query):
        raise table.error("query", "must be plain text, such as '!001:SYS?'")
    return {"query": query}


def _dbc(table: Table, folder: Path) -> dict[str, Any]:
    name = table.text("dbc")
    rows = table.tables("signal")
    if not rows:
        raise table.error("signal", "missing; a [[device.signal]] says which signal of the DBC is which field")
    # A bare word is one of the files that come with seatrial.
    path = Path(__file__).parent / "protocol" / f"{name}.dbc" if re.fullmatch(r"\w+", name) else folder / name
    if not path.is_file():
        raise table.error("dbc", f"there is no file {path}")
    return {"dbc": str(path), "signals": tuple(_signal(row) for row in rows)}


def _signal(table: Table) -> DbcSignal:
    by_name = isinstance(table.values.get("node"), str)
    node: int | str = table.text("node") if by_name else table.integer("node", low=0, high=255)
    found = DbcSignal(
        table.text("message"),
        table.text("signal"),
        table.text("field", choices=ESC_FIELDS),
        node,
        table.number("scale", 1.0),
        table.number("offset", 0.0),
    )
    table.done()
    return found


def _mavlink(table: Table, folder: Path) -> dict[str, Any]:
    return {"mavlink": read_settings(table, folder)}


_READ: dict[str, Callable[[Table, Path], dict[str, Any]]] = {
    "mavlink": _mavlink, "own_node": _own_node,
    "bitrate": _bitrate, "pattern": _pattern, "saturation": _saturation, "calibration": _calibration,
    "declination_deg": _declination, "query": _query, "dbc": _dbc,
}  # fmt: skip
