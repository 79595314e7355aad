"""Units of imported columns, and their conversion to SI units and radians."""

from __future__ import annotations

import math

_SI: tuple[str, ...] = (
    "1",
    "m",
    "m/s",
    "m/s2",
    "rad",
    "rad/s",
    "rad/s2",
    "N",
    "Nm",
    "kg",
    "s",
    "us",
    "Hz",
    "rev/min",
    "rev/s",
)
_SI += ("A", "V", "W", "T", "Pa", "degC")
_RAD = math.pi / 180.0
_G = 9.80665  # m/s2, standard gravity (CGPM 1901)
_LBF = 4.4482216152605  # N
UNITS: dict[str, tuple[str, float]] = {  # unit of the column -> (unit in the log, factor)
    **{unit: (unit, 1.0) for unit in _SI},
    "deg": ("rad", _RAD),
    "degE7": ("rad", 1e-7 * _RAD),  # latitude and longitude of MAVLink and PX4
    "cdeg": ("rad", 1e-2 * _RAD),
    "deg/s": ("rad/s", _RAD),
    "deg/s2": ("rad/s2", _RAD),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "km": ("m", 1e3),
    "ft": ("m", 0.3048),
    "cm/s": ("m/s", 1e-2),
    "mm/s": ("m/s", 1e-3),
    "km/h": ("m/s", 1.0 / 3.6),
    "kn": ("m/s", 1852.0 / 3600.0),
    "g": ("m/s2", _G),
    "kgf": ("N", _G),
    "gf": ("N", 1e-3 * _G),
    "lbf": ("N", _LBF),
    "mA": ("A", 1e-3),
    "mV": ("V", 1e-3),
    "uT": ("T", 1e-6),
    "ms": ("s", 1e-3),
    "%": ("1", 1e-2),
}
