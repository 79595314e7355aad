"""The thruster's job where nobody measured the shaft: force and command in; a static curve out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from daq.errors import SeatrialError
from ident.curve_file import save_curve
from ident.dataset import Channel
from ident.jobs import Say
from ident.loading import Loaded, envelope
from ident.outcome import Json, plain, write_result
from ident.report import write_report
from ident.static_curve import (
    Curve,
    Levels,
    Quadratic,
    adequate,
    curve_left_out,
    find_levels,
    fit_curve,
    fit_quadratic,
)


def static_curve(
    loaded: Sequence[Loaded], out: Path, *, name: str | None, settle: float, command: str, say: Say
) -> Json:
    """Fit a curve to steady stretches of bench logs that have a force and a command but no shaft speed."""
    if len(loaded) != 1:
        raise SeatrialError(f"{loaded[1].about['path']}: a static curve is made of one log; give one")
    one = loaded[0]
    channels, where = one.run.channels, one.about["path"]
    names = _commands(one, name)
    if "force" not in channels:
        raise SeatrialError(f"{where}: no signal 'force'; it has {', '.join(sorted(channels))}")
    say(f"steady force against {' and '.join(names)}")
    try:
        levels = find_levels(channels[names[0]], channels["force"], settle)
        if levels.n.size < 4:
            raise ValueError(f"{levels.n.size} steady commands are too few for a curve; it takes four")
    except ValueError as problem:
        raise SeatrialError(f"{where}: {problem}") from problem
    curve, quadratic = fit_curve(levels), fit_quadratic(levels)
    result = envelope(loaded, command) | {
        "kind": "thruster",
        "answer": _answer(levels, curve, quadratic, len(names)),
        "static": _static(levels, curve, quadratic),
        "notes": _notes(levels, curve, quadratic),
    }
    out.mkdir(parents=True, exist_ok=True)
    provenance = {
        "made_by": command,
        "created": result["created"],
        "seatrial": result["seatrial"],
        "logs": [f"{where} sha256:{one.about['sha256'][:16]}"],
    }
    save_curve(out / "model.toml", curve, levels, quadratic, len(names), provenance)
    content = plain(result)
    write_result(content, out / "result.json")
    write_report(content, out / "report.html")
    return result


def is_static(loaded: Sequence[Loaded], name: str | None) -> bool:
    """Whether the logs have commands but no shaft speed that goes with one of them."""
    for one in loaded:
        names = [name] if name else [n.removeprefix("n_cmd_") for n in one.run.channels if n.startswith("n_cmd_")]
        if any(f"n_cmd_{n}" in one.run.channels and f"n_{n}" in one.run.channels for n in names):
            return False
    return "force" in loaded[0].run.channels and bool(_command_names(loaded[0].run.channels, name))


def _command_names(channels: Mapping[str, Channel], name: str | None) -> list[str]:
    sides = [name] if name else ["left", "right", *(n[6:] for n in channels if n.startswith("n_cmd_"))]
    found = [next((n for n in (f"n_cmd_{s}", f"n_{s}") if n in channels), "") for s in dict.fromkeys(sides)]
    return [n for n in found if n]


def _commands(one: Loaded, name: str | None) -> list[str]:
    """The commands that moved; several are one only where they are the same."""
    channels = one.run.channels
    moved = [n for n in _command_names(channels, name) if np.ptp(channels[n].value) > 0]
    if not moved:
        raise SeatrialError(f"{one.about['path']}: no command that changes; it has {', '.join(sorted(channels))}")
    first = channels[moved[0]]
    for other in moved[1:]:
        c = channels[other]
        if c.t.size != first.t.size or not np.allclose(c.value, first.value):
            raise SeatrialError(
                f"{one.about['path']}: {moved[0]} and {other} differ; name the thruster that was measured: --thruster"
            )
    return moved


def _static(levels: Levels, curve: Curve, quadratic: Quadratic) -> Json:
    grid = np.union1d(np.linspace(curve.n[0], curve.n[-1], 161), curve.n)
    return {
        "n": levels.n,
        "force": levels.force,
        "sd": levels.se,
        "n_model": grid,
        "force_model": curve(grid),
        "force_sd": curve.error(grid),
        "force_quadratic": quadratic(grid),
        "abscissa": "command n",
    }


def _answer(levels: Levels, curve: Curve, quadratic: Quadratic, thrusters: int) -> str:
    (low, high), words = curve.force[[0, -1]], {1: "The thruster gives", 2: "Both thrusters together give"}
    end = f"and {-low:.1f} ± {curve.se[0]:.1f} N astern " if curve.n[0] < 0 else ""
    told = (
        f"{words.get(thrusters, f'The {thrusters} thrusters together give')} {high:.1f} ± {curve.se[-1]:.1f} N ahead "
        f"{end}at the ends of the command, {levels.n.size} steady levels in all."
    )
    if adequate(quadratic):
        return f"{told} c1 n|n| + c2 n² describes them within their errors (c1 {quadratic.c1:.2f} N)."
    return (
        f"{told} c1 n|n| + c2 n² does not describe them: it misses them by {quadratic.rms:.1f} N (rms), by "
        f"{quadratic.largest:+.1f} N at n = {quadratic.at:g}; a level left out is missed by "
        f"{quadratic.left_out:.1f} N, by the monotone curve through the others by {curve_left_out(levels):.1f} N."
    )


def _notes(levels: Levels, curve: Curve, quadratic: Quadratic) -> list[str]:
    covariance = np.sqrt(np.diag(quadratic.covariance))
    notes = [
        f"Quadratic: c1 = {quadratic.c1:.2f} ± {covariance[0]:.2f} N, c2 = {quadratic.c2:.2f} ± {covariance[1]:.2f} N, "
        f"chi-square {quadratic.chi2:.3g} with {quadratic.df} degrees of freedom against the levels' own errors.",
        "Standard errors are of the readings alone, with their autocorrelation; they know nothing of the load cell's "
        "calibration, of friction in the rig, of the battery, or of another day.",
    ]
    moved = np.abs(curve.force - levels.force) > 1e-9
    if moved.any():
        pooled = zip(levels.n[moved], levels.force[moved], levels.se[moved], strict=True)
        said = ", ".join(f"{f:.2f} ± {s:.2f} N at {n:g}" for n, f, s in pooled)
        notes.append(f"Levels that do not rise with the command were made level: {said}.")
    return notes
