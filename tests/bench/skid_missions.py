"""Study from the rig that `devices` writes for an autopilot to a model, compared with the physics of its simulator.

    python -m tests.bench.skid_missions runs --docs docs/examples/ardurover/README.md

Each frame of ArduPilot Rover's simulator (SEATRIAL_ARDUROVER) goes through the public commands: `devices --toml`, link
test, and missions of 300 s. The live log, the tlog of a second station and the autopilot's BIN of all missions but the
last are fitted and diagnosed, and the last mission is simulated. Existing recordings and fits in the folder are not
repeated. `--docs` writes the table between its marks in a page.

The program prints each deviation and ends with exit status 1 if there is one. A deviation is an estimate beyond 3
standard errors or 3 %, a simulation error beyond 10 degrees or 1 m, or a diagnosis that names an effect that the
simulator lacks.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from seatrial.daq.log import open_log
from seatrial.ident.data import channels
from seatrial.ident.results import read_result, to_json
from tests.bench.simulator_delays import delays
from tests.daq.ardurover import MISSING, PROGRAM, Rover

SEATRIAL = [sys.executable, "-m", "seatrial"]
SECONDS, N_MAX, AHEAD_S, FILTERED_S = 300.0, 0.5, 60.0, 15.0  # FILTERED_S: filtering time before a simulation begins
CHANCES = 6  # attempts for each mission
SLEW = 1.0  # 1/s: the samples at 10 Hz determine a ramp, but not a step
SOURCES = ("live", "tlog", "BIN")
SETTINGS = {"LOG_FILE_DSRMROT": 1}  # a new BIN at each arming
WAVES = "-waves"  # suffix of a frame with waves: the boat rolls and pitches, which keeps a part of its sideslip
MARKS = ("<!-- python -m tests.bench.skid_missions -->", "<!-- end of the missions -->")
STEER = math.radians(360 / (1.8 * math.pi) * 70) / math.sin(math.radians(35)) * math.pi / 180  # rad/m, for small angles
ANGLE = math.radians(70)  # steering angle at full difference
WITHIN_SE, WITHIN_PERCENT, WITHIN_DEG, WITHIN_M = 3.0, 3.0, 10.0, 1.0
THERE = {"sideslip"}  # effects of the simulator that the fitted model lacks
TINY = {"tau_s": 1e-3}  # differences that are too small for a percentage: the truth of tau_s is half a step
ODE_STEP_S = 1 / 1200  # s, of the simulator: each step drops the velocity that is not along the heading
# GIVEN: thrust that is fixed, so that masses are in kg. TRUTH: the parameters in the source of the simulator.
GIVEN = {"motorboat-skid": {"c1": 25.0, "c2": 0.0}, "rover-skid": {"c1": 70.0, "c2": 0.0}}
TRUTH: Mapping[str, Mapping[str, float]] = {
    "motorboat-skid": {"m_u": 2.0, "d_u": 0.0, "d_uu": 0.5, "tau_s": ODE_STEP_S / 2, "lambda_n": 1.0, "K": 0.0,
                       "K_u": STEER, "k_3": ANGLE**2 / 6},
    "rover-skid": {"m_u": 10.0, "d_u": 35.0, "d_uu": 0.0, "tau_s": ODE_STEP_S / 2, "lambda_n": 1.0,
                   "K": math.radians(280), "K_u": 0.0, "k_3": 0.0},
}  # fmt: skip


class Row(NamedTuple):
    """Estimate and true value of one parameter."""

    frame: str
    source: str
    name: str
    value: float
    se: float
    truth: float

    @property
    def z(self) -> float:
        return (self.value - self.truth) / self.se

    @property
    def percent(self) -> float:
        return 100 * (self.value / self.truth - 1) if self.truth else math.nan


def command(*words: object, cwd: Path) -> str:
    """Run a public command and return its output. Raise CalledProcessError if it fails."""
    done = subprocess.run([*SEATRIAL, *map(str, words)], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"seatrial {' '.join(map(str, words))}: {done.stderr}")
    return done.stdout


def record(frame: str, folder: Path, seconds: float, missions: int) -> None:
    """Record rig, link test and missions of one frame, with the tlog and the BIN of each mission."""
    settings = {**SETTINGS, "SIM_WAVE_ENABLE": float(frame.endswith(WAVES))}
    with Rover(folder / "autopilot", settings, frame.removesuffix(WAVES)) as rover:
        rover.until_ready()
        (folder / "rig.toml").write_text(command("devices", f"udp:127.0.0.1:{rover.port}", "--toml", cwd=folder))
        command("check", "rig.toml", "--actuators", "--link-test", "--arm", "--yes", "-o", "link.mcap", cwd=folder)
        for k in range(1, missions + 1):
            words = ("--seconds", seconds, "--seed", k, "--n-max", N_MAX, "--slew", SLEW, "-o", f"mission{k}.toml")
            command("mission", "generate", "--kind", "mixed", *words, cwd=folder)
            words = (f"mission{k}.toml", "rig.toml", "--arm", "-o", f"live{k}.mcap")
            for chance in range(CHANCES):
                rover.record(folder / f"{k}.tlog")
                try:
                    command("mission", "run", *words, cwd=folder)
                    break
                except RuntimeError as error:  # a run ends, correctly, if a busy machine delays the simulator
                    print(error, file=sys.stderr)
                    if chance == CHANCES - 1:
                        raise
                    (folder / f"live{k}.mcap").unlink(missing_ok=True)
    kept = sorted((folder / "autopilot" / "logs").glob("*.BIN"), key=lambda path: path.stat().st_size)[-missions:]
    for k, path in enumerate(sorted(kept), start=1):
        path.rename(folder / f"{k}.BIN")


def fit(frame: str, source: str, folder: Path, missions: int) -> dict[str, Any]:
    """Return the result of `ident vehicle` on all missions of a source but the last, which is used for validation."""
    return identified(source, folder, missions, f"fit-{source}-sideslip", *fitting(frame), "--effect", "sideslip")


def diagnosed(frame: str, source: str, folder: Path, missions: int) -> dict[str, Any]:
    """Return the result of `ident diagnose` on the same missions, for a fit without the effect."""
    identified(source, folder, missions, f"plain-{source}", *fitting(frame))
    return identified(source, folder, missions, f"diag-{source}", "diagnose", f"plain-{source}/model.toml")


def fitting(frame: str) -> list[str]:
    """Return the command `vehicle` with the fixed thrust."""
    thrust = GIVEN[frame.removesuffix(WAVES)]
    fixed = (word for name, value in thrust.items() for word in ("--fix", f"{name}={value:g}"))
    return ["vehicle", "--model", "nomoto", *fixed]


def identified(source: str, folder: Path, missions: int, out: str, *words: str) -> dict[str, Any]:
    """Return the result of a command of ident with the logs of a source."""
    if not (folder / out / "result.json").exists():
        for k in range(1, missions + 1) if source != "live" and not (folder / f"{source}1.mcap").exists() else ():
            how = ("--rig", "rig.toml", "-o", f"{source}{k}.mcap", "--force")
            command("import", "mavlink", f"{k}.{source}", *how, cwd=folder)
        logs = (*(f"{source}{k}.mcap" for k in range(1, missions)), "--validate", f"{source}{missions}.mcap")
        # a busy machine now and then delays the simulator, which appears as a jump of its clock
        command("ident", *words, *logs, "--despite-faults", "--out", out, "--force", cwd=folder)
    result: dict[str, Any] = msgspec.json.decode(to_json(read_result(folder / out / "result.json")))
    return result


def of_the_mission(frame: str, folder: Path) -> dict[str, float]:
    """Return the true values of the first mission.

    The delays [s] follow from the state in the BIN. The cubic is the best fit to the sine of the steering angles; a
    weight by speed would change k_3 by 0.05 %.
    """
    found = delays(folder / "BIN1.mcap", folder / "1.BIN")
    if TRUTH[frame.removesuffix(WAVES)]["k_3"]:
        with open_log(folder / "BIN1.mcap") as log:
            n = channels(log)
        delta = (n["n_cmd_left"].value - n["n_cmd_right"].value) / 2
        terms = np.column_stack((delta, -(delta**3)))
        first, third = np.linalg.lstsq(terms, STEER / ANGLE * np.sin(ANGLE * delta), rcond=None)[0]
        found |= {"K_u": float(first), "k_3": float(third / first)}
    return found


def rows(frame: str, source: str, result: Mapping[str, Any], known: Mapping[str, float]) -> Iterator[Row]:
    """Yield a row for each parameter with a known true value.

    ``known`` contains the true values of the mission. A parameter at its bound has no standard error. The simulator
    drops sideslip and the speed lost with it, so its velocity is along the heading. The model turns the velocity
    outwards by ``tau_s`` r, and therefore estimates a delay that is smaller by ``tau_s``.
    """
    found = {p["name"]: (p["value"], p["se"]) for p in result["fit"]["parameters"]}
    known = {**known, "tau_gnss": known["tau_gnss"] - found["tau_s"][0]}
    for name, truth in {**TRUTH[frame.removesuffix(WAVES)], **known}.items():
        value, se = found[name]
        yield Row(frame, source, name, value, se if se else math.nan, truth)


def off_after(result: Mapping[str, Any], seconds: float) -> tuple[float, float]:
    """Return the errors of heading [deg] and position [m] of the simulated validation mission after `seconds`."""
    errors = {}
    for trace in result["traces"]:
        if trace["role"] == "validation" and trace["channel"] in ("psi", "x", "y"):
            both = [np.array([math.nan if v is None else v for v in trace[key]]) for key in ("model", "measured")]
            seen = np.isfinite(both[1])
            t, error = np.array(trace["t"])[seen], (both[0] - both[1])[seen]
            errors[trace["channel"]] = np.interp(FILTERED_S + seconds, t, error)
    turn = (errors["psi"] + math.pi) % (2 * math.pi) - math.pi
    return abs(math.degrees(turn)), float(np.hypot(errors["x"], errors["y"]))


UNITS = {"m_u": "kg", "d_u": "kg/s", "d_uu": "kg/m", "tau_s": "s", "lambda_n": "-", "K": "rad/s", "K_u": "rad/m",
         "k_3": "-", "T_r": "s", "tau_gnss": "s", "sigma_gnss": "s"}  # fmt: skip


Results = Mapping[tuple[str, str], Mapping[str, Any]]  # by frame and source


def missed(results: Results, diagnoses: Results, known: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return the deviations, one line each."""
    found = []
    for (frame, source), result in results.items():
        where = f"{frame}, {source}"
        for row in rows(frame, source, result, known[frame]):
            if abs(row.z) > WITHIN_SE:
                found.append(f"{where}: {row.name} is {row.z:+.1f} standard errors from the truth")
            if abs(row.percent) > WITHIN_PERCENT and abs(row.value - row.truth) > TINY.get(row.name, 0.0):
                found.append(f"{where}: {row.name} is {row.percent:+.1f} % from the truth")
        turn, place = off_after(result, AHEAD_S)
        if turn > WITHIN_DEG or place > WITHIN_M:
            found.append(f"{where}: {turn:.1f} degrees and {place:.2f} m off after {AHEAD_S:g} s")
        named = [effect["name"] for effect in diagnoses[frame, source]["effects"] if effect["name"] not in THERE]
        if named:
            found.append(f"{where}: the diagnosis names {', '.join(named)}")
    return found


def table(results: Results, diagnoses: Results, known: Mapping[str, Mapping[str, float]]) -> str:
    """Return the Markdown table of estimates, simulations and diagnoses of all frames and sources.

    ``known`` contains the true values of the first mission by frame.
    """
    lines = ["| frame | log | parameter | estimate | truth | z | % |", "|---|---|---|---|---|---|---|"]
    for (frame, source), result in results.items():
        for row in rows(frame, source, result, known[frame]):
            z, percent = (f"{x:.1f}" if math.isfinite(x) else "" for x in (row.z, row.percent))
            error = f" ± {row.se:.2g}" if math.isfinite(row.se) else ""
            estimate = f"{row.value:.4g}{error} | {row.truth:.4g}"
            name = f"{row.name} [{UNITS[row.name]}]"
            lines.append(f"| {frame} | {source} | {name} | {estimate} | {z} | {percent} |")
    lines += ["", f"| frame | log | error of the heading after {AHEAD_S:g} s of simulation | of the position |"]
    lines += ["|---|---|---|---|"]
    for (frame, source), result in results.items():
        turn, place = off_after(result, AHEAD_S)
        lines.append(f"| {frame} | {source} | {turn:.1f} deg | {place:.2f} m |")
    lines += ["", "| frame | log | what the diagnosis answers |", "|---|---|---|"]
    lines += [f"| {frame} | {source} | {found['answer']} |" for (frame, source), found in diagnoses.items()]
    wrong = missed(results, diagnoses, known)
    tiny = ", ".join(f"{name}: {size:g} {UNITS[name]}" for name, size in TINY.items())
    bounds = f"{WITHIN_SE:g} standard errors and {WITHIN_PERCENT:g} % ({tiny}), {WITHIN_DEG:g} degrees, {WITHIN_M:g} m"
    lines += ["", f"Beyond {bounds}, or named though it is not there:" if wrong else f"All within {bounds}."]
    lines += ["", *(f"- {line}" for line in wrong)] if wrong else []
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    frames = [*TRUTH, f"motorboat-skid{WAVES}"]
    parser.add_argument("--frames", nargs="+", default=frames, choices=frames)
    parser.add_argument("--missions", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--docs", type=Path)
    options = parser.parse_args()
    results, diagnoses, known = {}, {}, {}
    for frame in options.frames:
        folder = (options.folder / frame).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / f"{options.missions}.BIN").exists():
            if not os.access(PROGRAM, os.X_OK):
                raise SystemExit(MISSING)
            record(frame, folder, options.seconds, options.missions)
        results |= {(frame, source): fit(frame, source, folder, options.missions) for source in SOURCES}
        diagnoses |= {(frame, source): diagnosed(frame, source, folder, options.missions) for source in SOURCES}
        known[frame] = of_the_mission(frame, folder)
    text = table(results, diagnoses, known)
    print(text)
    if options.docs is not None:
        page = options.docs.read_text(encoding="utf-8")
        pattern = re.escape(MARKS[0]) + ".*?" + re.escape(MARKS[1])
        page = re.sub(pattern, lambda _: f"{MARKS[0]}\n\n{text}\n\n{MARKS[1]}", page, flags=re.DOTALL)
        options.docs.write_text(page, encoding="utf-8")
    raise SystemExit(1 if missed(results, diagnoses, known) else 0)


if __name__ == "__main__":
    main()
