"""Tests of the report of signals that the logs have and the model does not use, with the reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.loading import LoadedLog, PropulsionInput, load_run
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.estimation import EstimationOptions
from seatrial.ident.models import horizontal_model, make_model
from seatrial.ident.workflows.model_inputs import (
    hold_lines,
    inputs_sentence,
    thrust_from,
    unused_signals,
    with_derived_signals,
)
from seatrial.ident.workflows.vehicle_model import VehicleRequest, vehicle_problem
from tests.ident.sliders import slider
from tests.missions import boat_log, boat_with

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


SHAFTS, COMMANDS = ("n_left", "n_right"), ("n_cmd_left", "n_cmd_right")


def driven_log(name: str, *signals: str, propulsion: PropulsionInput, **holds: str) -> LoadedLog:
    """Return a log whose signals are arrays of their own, as those of a file."""
    channels = {s: Channel(np.arange(3.0), np.zeros(3), source=s) for s in signals}
    return LoadedLog(LogSegment(name, channels), {"path": name}, holds, None, propulsion=propulsion)


@pytest.mark.parametrize("source", ["horizontal:command", "horizontal:command:no-current", "horizontal:shaft"])
def test_fit_to_commands_names_the_model_of_the_measured_shaft_speeds(source: str) -> None:
    measured = driven_log("a", *SHAFTS, *COMMANDS, propulsion=PropulsionInput.MEASURED)
    slow = replace(measured, run=replace(measured.run, name="b"), propulsion=PropulsionInput.COMMAND)
    model = make_model(source)
    found = unused_signals(model, [measured], [slow])
    assert [(s.signal, s.logs, s.code) for s in found] == [
        (n, ("a", "b"), "not-in-model") for n in SHAFTS if "command" in source
    ]
    if found:
        other = source.replace("command", "shaft")
        assert f"fit again with --model {other}, and compare both models: samples of the" in found[0].reason
        assert found[0].reason.endswith("more than 0.15 s apart in b")
        assert unused_signals(model, [measured], [])[0].reason.endswith(f"--model {other}")
        assert "--model" not in thrust_from(model, [slow])  # one hint is enough
    chosen = inputs_sentence(model, [measured, slow])
    assert bool(chosen) == bool(found)
    assert inputs_sentence(model, [measured]) == ""  # their samples are close enough
    if chosen:
        assert "not of the measured n_left and n_right, whose samples are more than 0.15 s apart (b)" in chosen
        assert ": --model horizontal:shaft takes the measured ones" in chosen


@pytest.mark.parametrize(
    "log",
    [
        driven_log("a", *COMMANDS, propulsion=PropulsionInput.COMMAND),
        with_derived_signals(driven_log("a", *COMMANDS, propulsion=PropulsionInput.COMMAND), "auto", None),
        driven_log("a", *SHAFTS, *COMMANDS, propulsion=PropulsionInput.COMMAND, n_left="zero", n_right="zero"),
    ],
)
def test_log_without_measured_shaft_speeds_has_no_hint_of_their_model(log: LoadedLog) -> None:
    measured = driven_log("b", *SHAFTS, *COMMANDS, propulsion=PropulsionInput.MEASURED)
    assert unused_signals(make_model("horizontal:command"), [measured], [log]) == []


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


def test_answer_of_an_automatic_model_says_why_it_takes_the_commands(tmp_path: Path) -> None:
    path = boat_log(tmp_path / "run.mcap", boat_with(None, 1), 60.0, 7)
    measured = load_run(path, "estimation")
    slow = {n: Channel(c.t[::5], c.value[::5]) for n, c in measured.run.channels.items() if n in SHAFTS}
    log = replace(
        measured,
        run=replace(measured.run, channels=measured.run.channels | slow),
        propulsion=PropulsionInput.COMMAND,
    )
    request = VehicleRequest((), (), Path(), EstimationOptions(reml=True, mean_order=2))
    assert "whose samples are more than 0.15 s apart (run)" in vehicle_problem(request, [log], []).choice
    assert vehicle_problem(replace(request, model="horizontal:command"), [log], []).choice == ""


def test_a_fit_of_nomoto_says_first_that_its_time_constant_needs_a_prior(tmp_path: Path) -> None:
    """The user read T = 0 in the result, and only then that nothing had estimated it."""
    log = load_run(boat_log(tmp_path / "run.mcap", boat_with(None, 1), 60.0, 7), "estimation")
    request = VehicleRequest((), (), Path(), model="nomoto")

    def told(changed: VehicleRequest) -> list[str]:
        return [
            note for note in vehicle_problem(changed, [log], []).notes if "is held at 0 s and not estimated" in note
        ]

    (note,) = told(request)
    assert "give the value that you expect and its standard deviation, such as --prior T=0.5:0.5 (s)" in note
    assert told(replace(request, priors={"T": (0.5, 0.5)})) == []
    assert told(replace(request, fixed={"T": 0.0})) == []
    assert told(replace(request, model="horizontal:shaft")) == []
