"""Logs of simulated boats with one mistake each. Each log is rejected before a fit by a line that names the mistake.

python -m tests.recovery.misuse --boats 5 --seed 1 [--docs]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_map import Signal
from seatrial.daq.importers.signals import SignalData
from seatrial.daq.importers.write_log import write_signals
from seatrial.ident.checks.log_checks import device_faults
from seatrial.ident.data.loading import load_all
from seatrial.ident.data.record import Channel
from seatrial.ident.workflows.check import check_first
from seatrial.ident.workflows.vehicle_model import VehicleRequest, vehicle_problem
from tests.missions import T0, boat_with, channels_of, sail

SECONDS, VALIDATION_SECONDS = 240.0, 120.0
ROOT = Path(__file__).parents[2]
Channels = dict[str, Channel]
SHAFTS = ("n_left", "n_right")
UNITS = {"psi": "rad", "r": "rad/s", "ax": "m/s2", "ay": "m/s2", "x": "m", "y": "m"}
# Logged signals: all; no velocity and accelerometer; no gyro either; positions, attitude and body velocities.
SENSORS = {
    "full": ("psi", "r", "ax", "ay", "x", "y", "vx", "vy"),
    "position": ("psi", "r", "x", "y"),
    "compass": ("psi", "x", "y"),
    "body": ("psi", "r", "x", "y", "u", "v"),
}


class Kind(NamedTuple):
    """A mistake: the function that applies it to channels, the codes of its findings, and the rigs that can show it."""

    of: Callable[[Channels], Channels]
    codes: tuple[str, ...]
    rigs: tuple[str, ...] = ("full", "position", "compass", "body")


def each(of: Callable[[np.ndarray], np.ndarray], *names: str) -> Callable[[Channels], Channels]:
    """Return a function that changes the values of some signals, if they are logged."""
    return lambda c: c | {n: Channel(c[n].t, of(c[n].value), c[n].unit) for n in names if n in c}


def swapped(*pairs: tuple[str, str]) -> Callable[[Channels], Channels]:
    """Return a function that exchanges two signals, for each pair that is logged."""
    return lambda c: c | {n: c[m] for a, b in pairs if a in c for n, m in ((a, b), (b, a))}


def timed(factor: float) -> Callable[[Channels], Channels]:
    """Return a function that changes the unit of time."""
    return lambda c: {n: Channel(factor * s.t, s.value, s.unit) for n, s in c.items()}


def frozen(*names: str) -> Callable[[Channels], Channels]:
    """Return a function that holds the value at 40 s for 30 s."""

    def of(c: Channels) -> Channels:
        found = {}
        for n in names:
            t, value = c[n].t, c[n].value.copy()
            value[(t >= 40.0) & (t < 70.0)] = value[np.searchsorted(t, 40.0)]
            found[n] = Channel(t, value, c[n].unit)
        return c | found

    return of


def then(*steps: Callable[[Channels], Channels]) -> Callable[[Channels], Channels]:
    """Return a function that applies the steps in order."""

    def of(c: Channels) -> Channels:
        for step in steps:
            c = step(c)
        return c

    return of


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Wrap an angle to -pi to pi."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def earth_fixed(c: Channels) -> Channels:
    """Return channels with velocities north and east under the names u and v."""
    psi = np.interp(c["u"].t, c["psi"].t, np.unwrap(c["psi"].value))
    w = (c["u"].value + 1j * c["v"].value) * np.exp(1j * psi)
    return c | {"u": Channel(c["u"].t, w.real, "m/s"), "v": Channel(c["v"].t, w.imag, "m/s")}


def body_fixed(c: Channels) -> Channels:
    """Return channels with velocities forward and to starboard under the names vx and vy."""
    psi = np.interp(c["vx"].t, c["psi"].t, np.unwrap(c["psi"].value))
    w = (c["vx"].value + 1j * c["vy"].value) * np.exp(-1j * psi)
    return c | {"vx": Channel(c["vx"].t, w.real, "m/s"), "vy": Channel(c["vy"].t, w.imag, "m/s")}


def mounted(quarters: int) -> Callable[[Channels], Channels]:
    """Return a function that turns the AHRS clockwise by quarter turns. This changes its heading and its forward
    axis.
    """
    turn = quarters * np.pi / 2

    def of(c: Channels) -> Channels:
        w = (c["ax"].value + 1j * c["ay"].value) * np.exp(-1j * turn)
        psi = replace(c["psi"], value=wrapped(c["psi"].value + turn))
        return c | {"psi": psi, "ax": replace(c["ax"], value=w.real), "ay": replace(c["ay"], value=w.imag)}

    return of


negated = np.negative
HEADED, GYRO, FULL, BODY = ("full", "position", "compass", "body"), ("full", "position", "body"), ("full",), ("body",)
KINDS: dict[str, Kind] = {
    "left and right swapped": Kind(swapped(SHAFTS), ("thruster-sides-swapped",)),
    "both shafts reversed": Kind(each(negated, *SHAFTS), ("thruster-sign-reversed", "thruster-sides-swapped")),
    "left shaft reversed": Kind(each(negated, "n_left"), ("thruster-sign-reversed",)),
    "right shaft reversed": Kind(each(negated, "n_right"), ("thruster-sign-reversed",)),
    "n in per cent": Kind(each(lambda n: 100.0 * n, *SHAFTS), ("n-out-of-range",)),
    "n in us": Kind(each(lambda n: 1500.0 + 400.0 * n, *SHAFTS), ("n-out-of-range",)),
    "n with the offset of another formula": Kind(each(lambda n: n - 1496.0, *SHAFTS), ("n-out-of-range",)),
    "x and y swapped": Kind(swapped(("x", "y")), ("position-axes",)),
    "y negated": Kind(each(negated, "y"), ("position-axes",)),
    "x negated": Kind(each(negated, "x"), ("position-axes",)),
    "positions east, north": Kind(swapped(("x", "y"), ("vx", "vy")), ("position-axes",)),
    "positions in degrees": Kind(
        then(each(lambda x: 41.18 + x / 111200.0, "x"), each(lambda y: -8.7 + y / 83700.0, "y")),
        ("positions-in-degrees",),
    ),
    "depth for y": Kind(
        each(lambda y: 3.0 + 0.05 * np.random.default_rng(1).standard_normal(y.size), "y"),
        ("position-axes", "position-and-velocity-axes"),
    ),
    "vx and vy swapped": Kind(swapped(("vx", "vy")), ("velocity-axes",), FULL),
    "vy negated": Kind(each(negated, "vy"), ("velocity-axes",), FULL),
    "velocity in body axes": Kind(body_fixed, ("velocity-body-fixed",), FULL),
    "velocity in knots": Kind(each(lambda v: v / 0.5144, "vx", "vy"), ("velocity-unit",), FULL),
    "u and v north and east": Kind(earth_fixed, ("velocity-earth-fixed",), BODY),
    "u and v in km/h": Kind(each(lambda v: 3.6 * v, "u", "v"), ("velocity-unit",), BODY),
    "u alone in knots": Kind(each(lambda u: u / 0.5144, "u"), ("velocity-unit",), BODY),
    "u and v swapped": Kind(swapped(("u", "v")), ("body-velocity-axes",), BODY),
    "v to port": Kind(each(negated, "v"), ("body-velocity-axes",), BODY),
    "heading negated": Kind(each(negated, "psi"), ("heading-sense",)),
    "heading 90 deg off": Kind(each(lambda psi: wrapped(psi + np.pi / 2), "psi"), ("heading-offset",)),
    "heading half a turn off": Kind(each(lambda psi: wrapped(psi + np.pi), "psi"), ("heading-half-turn",)),
    "heading from east, counter-clockwise": Kind(each(lambda psi: wrapped(np.pi / 2 - psi), "psi"), ("heading-sense",)),
    "heading and yaw rate counter-clockwise": Kind(each(negated, "psi", "r"), ("heading-sense",), GYRO),
    "all east, north, up": Kind(
        then(swapped(("x", "y"), ("vx", "vy")), each(negated, "r", "ay", "v"),
             each(lambda psi: wrapped(np.pi / 2 - psi), "psi")), ("thruster-sides-swapped",)),
    "heading in degrees": Kind(each(lambda psi: np.degrees(psi) % 360.0, "psi"), ("angle-in-degrees",)),
    "heading converted twice": Kind(each(np.radians, "psi"), ("angle-in-degrees",), GYRO),
    "yaw rate in deg/s": Kind(each(np.degrees, "r"), ("angle-in-degrees",), GYRO),
    "yaw rate converted twice": Kind(each(np.radians, "r"), ("angle-in-degrees",), GYRO),
    "yaw rate negated": Kind(each(negated, "r"), ("gyro-sign-reversed",), GYRO),
    "acceleration in g": Kind(each(lambda a: a / 9.81, "ax", "ay"), ("velocity-and-acceleration-scale",), FULL),
    "ax and ay swapped": Kind(swapped(("ax", "ay")), ("acceleration-axes",), FULL),
    "ay negated": Kind(each(negated, "ay"), ("acceleration-axes",), FULL),
    "AHRS turned by 90 deg": Kind(mounted(1), ("heading-offset",), FULL),
    "AHRS turned by 180 deg": Kind(mounted(2), ("heading-half-turn",), FULL),
    "AHRS turned by 270 deg": Kind(mounted(3), ("heading-offset",), FULL),
    "time in ms": Kind(timed(1e3), ("time-scale",)),
    "time in us": Kind(timed(1e6), ("time-scale",)),
    "time doubled": Kind(timed(2.0), ("time-scale", "gyro-scale"), GYRO),
    "yaw rate frozen for 30 s": Kind(frozen("r"), ("channel-frozen",), GYRO),
    "heading frozen for 30 s": Kind(frozen("psi"), ("channel-frozen",)),
    "positions frozen for 30 s": Kind(frozen("x", "y"), ("channel-frozen",)),
    "yaw rate constant": Kind(each(np.zeros_like, "r"), ("channel-constant",), GYRO),
    "heading constant": Kind(each(np.ones_like, "psi"), ("channel-constant",)),
    "y constant": Kind(each(np.zeros_like, "y"), ("channel-constant",)),
    "a copy to validate": Kind(dict, ("log-copied",)),
}  # fmt: skip
COPY = "a copy to validate"


def logged(seed: int, rig: str, seconds: float, run: int) -> Channels:
    """Return a mission of the boat of a seed, as channels of a rig."""
    c = channels_of(sail(boat_with(None, seed), seconds, 100 * run + seed, run)[0])
    psi = np.interp(c["vx"].t, c["psi"].t, np.unwrap(c["psi"].value))
    w = (c["vx"].value + 1j * c["vy"].value) * np.exp(-1j * psi)
    c |= {"u": Channel(c["vx"].t, w.real), "v": Channel(c["vx"].t, w.imag)}
    return {n: Channel(c[n].t, c[n].value, UNITS.get(n, "")) for n in (*SENSORS[rig], *SHAFTS)}


def written(path: Path, channels: Channels) -> Path:
    """Write the log that `seatrial import` would make of these channels."""
    signals = []
    for name, c in channels.items():
        role, hold = ("input", "zero") if name in SHAFTS else ("output", "linear")
        signal = Signal(name, (name,), c.unit or "1", role=role, hold=hold)
        signals.append(SignalData(signal, c.unit, T0 + c.t - c.t[0], c.value))
    write_signals(path, signals, metadata={"import": "csv"}, attachments={}, note=path.stem, force=True)
    return path


def refusal(path: Path, validation: Path) -> str | None:
    """Return the line with which `seatrial ident vehicle` rejects the log. Return None if it accepts the log."""
    request = VehicleRequest([path], [validation], path.parent / "out")
    try:
        loaded, unseen = load_all(request.logs, request.validation, device_faults=device_faults)
        check_first(loaded, unseen, vehicle_problem(request, loaded, unseen).model, False)
    except SeatrialError as refused:
        return str(refused)
    return None


class Outcome(NamedTuple):
    """Outcome of a mistake. ``line`` is the rejection, if any. ``named`` is whether it contains a code of the
    mistake.
    """

    kind: str
    rig: str
    seed: int
    line: str | None
    named: bool


def outcomes(seeds: Sequence[int], kinds: Sequence[str], rigs: Sequence[str], folder: Path) -> Iterator[Outcome]:
    """Yield the outcome of each kind on each boat and rig that can show it. Kind "" is the boat without a mistake."""
    for seed in seeds:
        for rig in rigs:
            whole, second_run = (logged(seed, rig, s, run) for s, run in ((SECONDS, 1), (VALIDATION_SECONDS, 2)))
            validation = written(folder / "validation.mcap", second_run)
            for kind in ("", *(k for k in kinds if rig in KINDS[k].rigs)):
                path = written(folder / "run.mcap", KINDS[kind].of(whole) if kind else whole)
                judge = written(folder / "copy.mcap", whole) if kind == COPY else validation
                line = refusal(path, judge)
                codes = KINDS[kind].codes if kind else ()
                yield Outcome(kind, rig, seed, line, any(f"[{code}]" in (line or "") for code in codes))


def table(rows: Sequence[Outcome]) -> str:
    """Return a Markdown table with one line per kind."""
    lines = ["| mistake | rigs | refused with its code | refused | code |", "|---|---|---|---|---|"]
    for kind in dict.fromkeys(r.kind for r in rows if r.kind):
        its = [r for r in rows if r.kind == kind]
        rigs = ", ".join(dict.fromkeys(r.rig for r in its))
        codes = ", ".join(f"`{code}`" for code in KINDS[kind].codes)
        refused = sum(r.line is not None for r in its)
        lines.append(f"| {kind} | {rigs} | {sum(r.named for r in its)} of {len(its)} | {refused} | {codes} |")
    return "\n".join(lines)


def summary(rows: Sequence[Outcome]) -> str:
    """Return a summary of the outcomes in a sentence."""
    right, wrong = [r for r in rows if not r.kind], [r for r in rows if r.kind]
    kinds = len({r.kind for r in wrong})
    refused = sum(r.line is not None for r in wrong)
    return (
        f"{kinds} kinds of mistakes were tested in {len(wrong)} logs. {refused} logs were "
        f"refused, {sum(r.named for r in wrong)} of them with the code of the mistake. Of {len(right)} logs without a "
        f"mistake, {sum(r.line is not None for r in right)} were refused."
    )


def main(words: Sequence[str] | None = None) -> int:
    """Print the table. The status is 1 if a mistake was accepted or a correct log was rejected."""
    parser = argparse.ArgumentParser("python -m tests.recovery.misuse", description=__doc__)
    parser.add_argument("--boats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1, help="the first boat's")
    parser.add_argument("--docs", action="store_true", help="write docs/misuse.md")
    arguments = parser.parse_args(words)
    with TemporaryDirectory(prefix="seatrial-misuse-") as folder:
        seeds = range(arguments.seed, arguments.seed + arguments.boats)
        rows = list(outcomes(seeds, list(KINDS), list(SENSORS), Path(folder)))
    for r in rows:
        if bool(r.kind) != r.named:
            print(f"{r.kind or 'no mistake'}, {r.rig}, boat {r.seed}: {r.line or 'not refused'}")
    print(summary(rows), table(rows), sep="\n\n")
    if arguments.docs:
        text = (
            "# Logs with a mistake\n\n"
            "Each log is a mission of a mock boat, imported with one mistake, and passed to `seatrial ident vehicle`. "
            "The command [checks](how-to/check.md) its logs first and refuses logs for which a fit would be "
            "meaningless. One line states the finding, its place, and the entry to correct. The rigs are: all sensors "
            "of a mock boat (full); heading, yaw rate and positions (position); heading and positions (compass); "
            "heading, yaw rate, positions and velocities of the body (body).\n\n"
            f"    python -m tests.recovery.misuse --boats {arguments.boats} --seed {arguments.seed} --docs\n\n"
            f"{summary(rows)}\n\n{table(rows)}\n\n"
            "The scale of a signal is only checked against a second sensor. Time that runs twice as fast, with heading "
            "and positions only, is therefore not found.\n"
        )
        (ROOT / "docs/misuse.md").write_text(text, encoding="utf-8")
    return int(any(bool(r.kind) != (r.line is not None) for r in rows))


if __name__ == "__main__":
    sys.exit(main())
