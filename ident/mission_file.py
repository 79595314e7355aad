"""mission.toml as a design writes it; `bench.mission` reads it back (docs/formats/mission.md).

Written here because ident and bench meet only through files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import tomlkit
from numpy.typing import NDArray

from daq.errors import SeatrialError
from ident.design import Track

Array = NDArray[np.float64]
FORMAT = "seatrial-mission 1"
STATIC_S = 5.0  # s at rest before the steps: noise of the sensors, and the boat comes to rest


def mission_text(name: str, thrusters: Sequence[str], levels: Array, durations: Array, *, n_max: float, slew: float,
                 made_by: str, seed: int, predicted: Mapping[str, float], before: Mapping[str, float], model: str,
                 track: Track | None) -> str:
    """The text of a mission of steps: levels (n_steps, n_thrusters), durations (n_steps,) s, after a rest."""
    edges = np.round(STATIC_S + np.concatenate([[0.0], np.cumsum(durations)]), 3)
    lines = [
        f"format = {_quoted(FORMAT)}", f"name = {_quoted(name)}", 'kind = "mission"',
        f"thrusters = [{', '.join(_quoted(t) for t in thrusters)}]", 'hold = "zero"  # a command holds until the next',
        "", "[provenance]", f"made_by = {_quoted(made_by)}", f"seed = {seed}",
        f"predicted_errors = {_table(predicted)}", "", "[limits]", f"n_max = {float(n_max)!r}",
    ]
    lines += [f"slew_per_s = {float(slew)!r}"] if np.isfinite(slew) else []
    if track is not None:
        lines += ["", "[prediction]", f"model = {_quoted(model)}", f"t = {_row(track.t + STATIC_S)}"]
        lines += [f"x = {_row(track.x.round(2))}", f"y = {_row(track.y.round(2))}"]
        lines += [f"radius = {_row(track.radius.round(2))}", f"errors_before = {_table(before)}"]
    rows = [f"    {_row(row)}," for row in levels]
    lines += [
        "", "[[segment]]", 'name = "static"', "t = [0.0]", f"n = [{_row(np.zeros(len(thrusters)))}]", "",
        "[[segment]]", 'name = "designed steps"', f"t = {_row(edges[:-1])}", "n = [", *rows, "]", "",
        "[end]", f"t = {float(edges[-1])!r}  # zero thrust from here on", "",
    ]
    return "\n".join(lines)


def write_new(path: Path, text: str) -> None:
    """Write a file that must not exist yet; raises SeatrialError where it does or cannot be written."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise SeatrialError(f"{path} exists; give another name with --out") from None
    except OSError as problem:
        raise SeatrialError(f"{path}: {problem.strerror}; the mission was not saved") from problem


def _quoted(text: str) -> str:
    return str(tomlkit.item(text).as_string())


def _row(values: Array) -> str:
    return "[" + ", ".join(repr(float(f"{v:.6g}")) for v in values) + "]"


def _table(values: Mapping[str, float]) -> str:
    return "{" + ", ".join(f"{_quoted(k)} = {float(f'{v:.4g}')!r}" for k, v in values.items() if np.isfinite(v)) + "}"
