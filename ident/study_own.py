"""Cases of ``seatrial ident study`` that are the user's: a fitted model.toml, or a ``Case`` of a Python file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError
from ident.dataset import TIME_INPUT
from ident.euler import Inputs
from ident.model import Model
from ident.modelfile import load_model
from ident.own import own_object, tried
from ident.study import Case

Array = NDArray[np.float64]
STEP = 0.1  # s
HOLD = (3.0, 10.0)  # s, of a level
LAG = 2.794  # 1/s, how fast measured shaft speeds and thrusts follow (thesis Table 2)
GNSS = ("position", "ground_velocity")
SECONDS = 400.0


def is_own(source: str) -> bool:
    """Whether a MODEL of the command is a file."""
    return source.endswith(".toml") or ":" in source


def own_case(source: str, seconds: float | None, seed: int) -> Case:
    """``model.toml``: random levels within the inputs' ranges that its data covered, estimated as it was fitted; or
    ``FILE.py:NAME``, a ``Case``, estimated as `ident vehicle` does.

    Raises SeatrialError where there is no such file, or a mission cannot be made of it.
    """
    if source.endswith(".toml"):
        path = Path(source)
        if not path.is_file():
            raise SeatrialError(f"{source}: no such file")
        saved = load_model(path)
        case = _of_model(saved.model, saved.validity, source, seconds or SECONDS, seed)
        return _marked(replace(case, restricted=saved.restricted), path)
    file, _, name = source.rpartition(":")
    case = own_object(source)
    if isinstance(case, Model):
        raise SeatrialError(f"{file}: {name} is a Model; a study needs its mission, too: make it an ident.study.Case")
    if not isinstance(case, Case):
        raise SeatrialError(f"{file}: {name} is no ident.study.Case but {type(case).__name__}")
    if seconds is not None:
        raise SeatrialError(f"--seconds: {file} says how long {name} is")
    tried(case.model, Path(file))
    return _marked(replace(case, model=replace(case.model, second_order=True)), Path(file))  # as `ident vehicle` does


def _marked(case: Case, path: Path) -> Case:
    """With the file's content in what tells one study from another, so that a changed file begins anew."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return replace(case, model=replace(case.model, source=f"{case.model.source} {digest}"))


def _of_model(
    model: Model, ranges: Mapping[str, tuple[float, float]], source: str, seconds: float, seed: int
) -> Case:
    t = np.asarray(np.arange(round(seconds / STEP) + 1) * STEP, dtype=np.float64)
    rng = np.random.default_rng(seed)
    u = np.empty((t.size, len(model.inputs)))
    for j, signal in enumerate(model.inputs):
        if signal.name == TIME_INPUT:
            u[:, j] = t
        elif signal.name not in ranges:
            raise SeatrialError(
                f"{source}: no range of the input {signal.name!r} under [validity], so no mission can be made up; "
                "write a Case in a Python file instead (docs/how-to/study.md)"
            )
        else:
            levels = _levels(t, *ranges[signal.name], rng)
            u[:, j] = levels if signal.hold == "zero" else _lagged(levels)
    u_next = u.copy()
    for j, signal in enumerate(model.inputs):
        if signal.hold != "zero":
            u_next[:-1, j] = u[1:, j]
    every = {s.name: 2 for s in model.sensors if s.name in GNSS}
    rates = "sensors 10 Hz" + ", GNSS 5 Hz" * bool(every)
    about = f"{seconds:g} s, inputs in steps of 3-10 s within the fitted ranges, {rates}"
    return Case(f"{model.name}-{Path(source).parent.name or 'own'}", model, Inputs(t, u, u_next), every, about)


def _levels(t: Array, low: float, high: float, rng: np.random.Generator) -> Array:
    """Random levels, each held for a random time."""
    out, until = np.empty(t.size), 0.0
    while until <= t[-1]:
        out[t >= until - 1e-9] = rng.uniform(low, high)
        until += rng.uniform(*HOLD)
    return out


def _lagged(levels: Array) -> Array:
    """A first-order lag behind them, as measured speeds and forces have."""
    out, decay = levels.copy(), float(np.exp(-LAG * STEP))
    for k in range(1, out.size):
        out[k] = levels[k - 1] + (out[k - 1] - levels[k - 1]) * decay
    return out
