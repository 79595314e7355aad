"""Signals that a model needs and a log does not have as such: thrust from a static curve, total thrust, speed ahead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from daq.errors import SeatrialError
from ident.curve_file import ThrustCurve, load_curve, thrust_channels, total
from ident.dataset import Channel
from ident.loading import Loaded

CURVE_INPUTS = ("f_left", "f_right", "X", "X_n")  # what a static curve makes of commands


def known_curve(thruster: Path | None) -> ThrustCurve | None:
    """The static curve of a file. Raises SeatrialError where it holds something else."""
    curve = load_curve(thruster) if thruster is not None else None
    if thruster is not None and curve is None:
        raise SeatrialError(f"{thruster}: holds no static curve; a model on shaft speeds has its thrust in itself")
    return curve


def complete(
    channels: Mapping[str, Channel], holds: Mapping[str, str], source: str, curve: ThrustCurve | None, path: str | Path
) -> tuple[dict[str, Channel], dict[str, str]]:
    """Channels and holds of one log with what follows from them for a model ``source``.

    ``f_left``, ``f_right`` and ``X`` from commands by a curve; ``X`` from thrusts; for motion in a straight line
    ``u`` from the speed over ground. What is in the log stays, except that a curve's thrust goes before it.
    """
    found, held = dict(channels), dict(holds)
    if curve is not None:
        try:
            found |= thrust_channels(channels, curve)
        except ValueError as problem:
            raise SeatrialError(f"{path}: {problem}; the log has {', '.join(sorted(channels))}") from problem
        held |= dict.fromkeys(CURVE_INPUTS, "zero")
    if "X" not in found and {"f_left", "f_right"} <= set(found):
        found["X"] = total(found["f_left"], found["f_right"])
        held["X"] = "zero"
    if "u" not in found and "speed" in found and source.partition(":")[0] == "surge":
        found["u"] = found["speed"]
    return found, held


def completed(one: Loaded, source: str, curve: ThrustCurve | None) -> Loaded:
    """A log with what follows from its signals for a model ``source`` (``complete``)."""
    found, held = complete(one.run.channels, one.holds, source, curve, one.about["path"])
    return replace(one, run=replace(one.run, channels=found), holds=held)
