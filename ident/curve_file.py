"""A thruster's static curve as model.toml, and what it makes of the commands in a log. See docs/formats/curve.md."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from daq.errors import SeatrialError
from ident.dataset import Channel, sample_and_hold
from ident.static_curve import Curve, Levels, Quadratic, adequate

FORMAT = "seatrial-curve 1"
Array = NDArray[np.float64]


@dataclass(frozen=True)
class ThrustCurve:
    """Force [N] against command, of ``thrusters`` thrusters together at one command."""

    curve: Curve
    thrusters: int

    def of_one(self, n: Array) -> Array:
        """Force of one thruster [N] at commands n (n_samples,)."""
        return np.asarray(self.curve(n) / self.thrusters)


def save_curve(
    path: Path, curve: Curve, levels: Levels, quadratic: Quadratic, thrusters: int, provenance: Mapping[str, Any]
) -> None:
    """Write a curve, the levels it goes through, and the quadratic it was compared with."""
    document = tomlkit.document()
    document["format"] = FORMAT
    document["thrusters"] = thrusters
    document["provenance"] = dict(provenance)
    document["curve"] = {
        "n": _rounded(curve.n),
        "force": _rounded(curve.force),
        "se": _rounded(curve.se),
        "between": "monotone cubic (Fritsch and Carlson); constant beyond the ends",
    }
    document["measured"] = {
        "n": _rounded(levels.n),
        "force": _rounded(levels.force),
        "se": _rounded(levels.se),
        "n_samples": [int(k) for k in levels.n_samples],
        "memory": _rounded(levels.memory),
    }
    document["quadratic"] = {
        "c1": float(f"{quadratic.c1:.7g}"),
        "c2": float(f"{quadratic.c2:.7g}"),
        "rms": float(f"{quadratic.rms:.4g}"),
        "largest": float(f"{quadratic.largest:.4g}"),
        "adequate": adequate(quadratic),
    }
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _rounded(values: Sequence[float] | Array) -> list[float]:
    return [float(f"{v:.7g}") for v in values]


def load_curve(path: Path) -> ThrustCurve | None:
    """Read a curve; None where the file says it is something else. Raises SeatrialError for a broken curve."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return None  # whoever reads it as something else says what is wrong
    if table.get("format") != FORMAT:
        return None
    try:
        n, force, se = (np.array(table["curve"][k], dtype=float) for k in ("n", "force", "se"))
        thrusters = int(table["thrusters"])
    except (KeyError, TypeError, ValueError) as problem:
        raise SeatrialError(f"{path}: not a complete curve: {problem}") from problem
    if not (n.size == force.size == se.size >= 2 and thrusters >= 1 and np.all(np.diff(n) > 0)):
        raise SeatrialError(f"{path}: a curve needs two or more rising n, with as many force and se")
    if not all(np.isfinite(a).all() for a in (n, force, se)):
        raise SeatrialError(f"{path}: a curve has numbers only")
    return ThrustCurve(Curve(n, force, se), thrusters)


def thrust_channels(channels: Mapping[str, Channel], curve: ThrustCurve) -> dict[str, Channel]:
    """``f_left``, ``f_right`` and their sum ``X`` [N] from the commands of a log; a command holds until the next.

    ``X_n`` [N] is what X gains for commands further from zero by one: ``X - d X_n`` is the thrust with a dead band
    wider by d, to first order. Commands are ``n_cmd_left``, or ``n_left`` where a log has no other. Raises
    ValueError where there are none.
    """
    found: dict[str, Channel] = {}
    slopes: list[Channel] = []
    for side in ("left", "right"):
        name = next((n for n in (f"n_cmd_{side}", f"n_{side}") if n in channels), None)
        if name is None:
            raise ValueError(f"no command for the thrust curve: there is no n_cmd_{side} and no n_{side}")
        command = channels[name]
        found[f"f_{side}"] = Channel(command.t, curve.of_one(command.value), "N", command.source)
        outward = np.sign(command.value) * curve.curve.slope(command.value) / curve.thrusters
        slopes.append(Channel(command.t, outward, "N", command.source))
    return found | {"X": total(found["f_left"], found["f_right"]), "X_n": total(*slopes)}


def total(left: Channel, right: Channel) -> Channel:
    """Sum of two held signals, on the times of both."""
    t = np.union1d(left.t, right.t)
    return Channel(t, sample_and_hold(left, t) + sample_and_hold(right, t), left.unit, left.source)
