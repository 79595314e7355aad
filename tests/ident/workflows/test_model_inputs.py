"""Tests of the report of signals that the logs have and the model does not use, with the reason."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.loading import LoadedLog
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.models import horizontal_model
from seatrial.ident.workflows.model_inputs import hold_lines, unused_signals
from tests.ident.sliders import slider

C = Channel(np.arange(3.0), np.zeros(3))


def log(name: str, *signals: str) -> LoadedLog:
    return LoadedLog(LogSegment(name, dict.fromkeys(signals, C)), {}, {}, None)


def test_sensor_that_only_a_validation_log_has_is_not_used_unless_its_noise_is_known() -> None:
    free = slider().replace_parameters(replace(slider().parameter("e_s"), free=True))
    logs = [log("a", "w", "speed")], [log("b", "w", "speed"), log("c", "w", "speed", "place")]
    (found,) = unused_signals(free, *logs)
    assert (found.signal, found.logs, found.code) == ("place", ("c",), "validation-only")
    assert unused_signals(slider(), *logs) == []
    assert unused_signals(free, [log("a", "w", "speed", "place")], logs[1]) == []


@pytest.mark.parametrize(
    ("model", "name", "fitted", "in_log", "differs"),
    [
        ("command", "n_cmd_left", "average", "zero", False),  # this model averages held commands
        ("command", "n_cmd_left", "average", "linear", True),
        ("shaft", "n_left", "linear", "zero", True),
        ("shaft", "n_left", "zero", "zero", False),
        ("shaft", "n_left", "zero", "average", True),
        ("shaft", "n_left", "linear", "", False),  # a recorded log has the usual kind of the model
    ],
)
def test_log_with_another_kind_of_input_is_named(
    model: str, name: str, fitted: str, in_log: str, differs: bool
) -> None:
    saved: Any = SimpleNamespace(model=horizontal_model(model), holds={name: fitted})
    run = SimpleNamespace(channels={name: None})
    log: Any = SimpleNamespace(holds={name: in_log}, run=run, about={"path": "run.mcap"})
    lines = hold_lines(saved, [log])
    assert bool(lines) is differs
    assert all(line.startswith(f"run.mcap: {name}: ") for line in lines)


@pytest.mark.parametrize(("fitted", "differs"), [("linear", True), ("zero", False)])
def test_log_with_commands_in_place_of_shaft_speeds_is_named(fitted: str, differs: bool) -> None:
    saved: Any = SimpleNamespace(model=horizontal_model("shaft"), holds={"n_left": fitted, "n_right": fitted})
    run = SimpleNamespace(channels={"n_cmd_left": None, "n_cmd_right": None, "psi": None})
    log: Any = SimpleNamespace(holds={}, run=run, about={"path": "run.mcap"})
    lines = hold_lines(saved, [log])
    assert bool(lines) is differs
    assert all("n_left and n_right: held commands, but the model was fitted to measured values" in x for x in lines)
