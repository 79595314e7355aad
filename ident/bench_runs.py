"""Bench logs as runs of the thruster model: which thruster, and its command with the delayed copies of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq.errors import SeatrialError
from ident.dataset import Channel
from ident.loading import Loaded
from ident.model import Model
from ident.models.thruster import delay_step, delayed_channels
from ident.stage import Run

RATE = 50.0  # rows a second for the load cell and the shaft speed


def thruster_name(loaded: Loaded) -> str:
    """The one thruster of a log that was commanded and whose shaft was measured.

    Raises SeatrialError where there is none, or more than one.
    """
    names = [n.removeprefix("n_cmd_") for n in loaded.run.channels if n.startswith("n_cmd_")]
    moved = [
        n for n in names if f"n_{n}" in loaded.run.channels and np.ptp(loaded.run.channels[f"n_cmd_{n}"].value) > 0
    ]
    if len(moved) != 1:
        said = ", ".join(moved) if moved else "none"
        raise SeatrialError(
            f"{loaded.about['path']}: thrusters with commands and shaft speed: {said}; name one with --thruster"
        )
    return moved[0]


def thruster_channels(loaded: Loaded, model: Model, name: str) -> dict[str, Channel]:
    """``n_cmd_0`` ..., ``n`` and, with a load cell, ``force``. Raises SeatrialError for what is not there."""
    found = loaded.run.channels
    for needed in (f"n_cmd_{name}", f"n_{name}"):
        if needed not in found:
            raise SeatrialError(f"{loaded.about['path']}: no signal {needed!r}; it has {', '.join(sorted(found))}")
    channels = delayed_channels(found[f"n_cmd_{name}"], delay_step(model)) | {"n": found[f"n_{name}"]}
    return channels | ({"force": found["force"]} if "force" in found else {})


def thruster_runs(loaded: Sequence[Loaded], model: Model, name: str | None) -> list[Run]:
    """The logs as runs for a bench model, all of one thruster.

    Raises SeatrialError where a log lacks the force that the model has.
    """
    runs = []
    for x in loaded:
        name = name or thruster_name(x)
        channels = thruster_channels(x, model, name)
        if "thrust" in model.provides and "force" not in channels:
            raise SeatrialError(f"{x.about['path']}: no load cell in the log, but the model has its force; it "
                                "was fitted to other logs: fit these with `seatrial ident thruster` first")
        runs.append(replace(x.run, channels=channels))
    return runs
