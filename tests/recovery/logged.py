"""Cases through user commands: both missions as recorded logs, and the commands of the tutorial in separate
processes.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from seatrial.ident.data.loading import load_run
from seatrial.ident.data.record import LogSegment
from seatrial.ident.results.result_file import AnyResult, read_result
from seatrial.mocks.offline_simulation import Recording
from tests.missions import write_log

THRUST = ("--fix", "c1=40.05", "--fix", "c2=1.11")  # Thrust of these simulated boats.
# A bench knows the thrust of a real thruster to a few per cent: its curve is not exactly quadratic.
UNCERTAIN_THRUST = ("--prior", "c1=40.05:2", "--fix", "c2=1.11")
ESTIMATION, VALIDATION = "estimation.mcap", "validation.mcap"


def write_logs(folder: Path, recordings: Sequence[Recording]) -> list[LogSegment]:
    """Write ``estimation.mcap`` and ``validation.mcap`` to the folder. Return the segments that ident reads from
    them.
    """
    paths = [folder / name for name in (ESTIMATION, VALIDATION)]
    for path, recording in zip(paths, recordings, strict=True):
        write_log(path, "boat", recording.readings)
    return [load_run(path, path.stem).run for path in paths]


def diagnosed(
    folder: Path, thrust: Sequence[str] = THRUST, further: Sequence[str] = (), out: str = "found"
) -> tuple[AnyResult, float]:
    """Return the result of `seatrial ident diagnose` with the model of `seatrial ident vehicle`, and the CPU time [s]
    of the diagnosis. ``thrust`` are the options that give the thrust, ``further`` are logs of the folder that are used
    for estimation too, and ``out`` is the folder of the diagnosis.

    RuntimeError contains the error line of a failed command.
    """
    nominal, logs = "vehicle" if out == "found" else f"vehicle-{out}", (ESTIMATION, *further)
    seatrial(folder, "ident", "vehicle", *logs, *thrust, "--validate", VALIDATION, "--out", nominal)
    before = spent()
    seatrial(folder, "ident", "diagnose", f"{nominal}/model.toml", *logs, "--validate", VALIDATION, "--out", out)
    return read_result(folder / out / "result.json"), spent() - before


def seatrial(folder: Path, *words: str) -> None:
    """Run a command in its own process. If it fails, raise RuntimeError with its last line.

    The process stores and reads compiled Python modules, as an installed seatrial does. Otherwise each command would
    compile a thousand modules, which takes a tenth of the CPU time of a diagnosis.
    """
    own = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-m", "seatrial", *words]
    done = subprocess.run(command, cwd=folder, env=own, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"seatrial {' '.join(words[:2])}: {(done.stderr.strip() or 'no message').splitlines()[-1]}")


def spent() -> float:
    """Return the CPU time [s] of the processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime
