"""Tests of the checks before a fit: faults of signals that the model does not use are no reason to refuse a log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from seatrial.daq.checks import Finding
from seatrial.daq.errors import SeatrialError
from seatrial.daq.samples import Esc
from seatrial.ident.checks import check_signals, device_faults
from seatrial.ident.data.loading import LoadedLog, TimeWindow, load_run
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.workflows import check
from seatrial.ident.workflows.check import check_first, require_thrust_and_length
from tests.missions import boat_log, boat_with, sail, write_log


def test_stuck_telemetry_of_a_shaft_refuses_only_models_with_shaft_speeds(tmp_path: Path) -> None:
    recording, _ = sail(boat_with(None, 3), 150.0, 103)
    at = next(r.sample.rpm for r in recording.readings if isinstance(r.sample, Esc) and r.sample.rpm > 1000.0)
    readings = [
        r._replace(sample=replace(r.sample, rpm=at))
        if isinstance(r.sample, Esc) and r.sample.node == 1 and 40.0 < r.t < 100.0
        else r
        for r in recording.readings
    ]
    path = write_log(tmp_path / "run.mcap", "boat", readings)
    log = load_run(path, "estimation", device_faults=device_faults)
    with pytest.raises(SeatrialError, match=r"\[shaft-speed-stuck\].*fit by the commands"):
        check_first([log], [], horizontal_model("shaft"), False)
    ((checked,), _) = check_first([log], [], horizontal_model("command"), False)
    stuck = [f for f in checked.about["findings"] if f["code"] == "shaft-speed-stuck"]
    assert stuck
    assert not any(f["spoils"] for f in stuck)


def test_slower_shafts_are_named_only_for_models_of_commands(tmp_path: Path) -> None:
    logs = []
    for run, factor in ((1, 1.0), (2, 0.88)):
        recording, _ = sail(boat_with(None, 3), 150.0, 100 + run, run, "steps")
        readings = [
            r._replace(sample=replace(r.sample, rpm=factor * r.sample.rpm)) if isinstance(r.sample, Esc) else r
            for r in recording.readings
        ]
        path = write_log(tmp_path / f"run{run}.mcap", "boat", readings)
        logs.append(load_run(path, "estimation", device_faults=device_faults))
    for source, named in (("command", True), ("shaft", False)):
        checked, _ = check_first(logs, [], horizontal_model(source), False)
        codes = [f["code"] for log in checked for f in log.about["findings"]]
        assert ("shaft-speed-differs" in codes) == named


def test_shaft_that_slows_down_is_named_only_for_models_of_commands(tmp_path: Path) -> None:
    """A model of shaft speeds is right for each of them, as the text of the finding says."""
    recording, _ = sail(boat_with(None, 3), 300.0, 101, 1, "steps")
    readings = [
        r._replace(sample=replace(r.sample, rpm=(1.0 - 0.002 * r.t) * r.sample.rpm)) if isinstance(r.sample, Esc) else r
        for r in recording.readings
    ]
    log = load_run(write_log(tmp_path / "run.mcap", "boat", readings), "estimation", device_faults=device_faults)
    for source, named in (("command", True), ("shaft", False)):
        ((checked,), _) = check_first([log], [], horizontal_model(source), False)
        assert ("shaft-speed-drifts" in [f["code"] for f in checked.about["findings"]]) == named


def test_a_log_is_checked_again_only_if_its_samples_or_the_options_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fit and the diagnosis of a log load it, and check it, one after the other."""
    path = write_log(tmp_path / "run.mcap", "boat", sail(boat_with(None, 3), 20.0, 104)[0].readings)
    model, checks = horizontal_model("command"), []

    def counted(*arguments: Any) -> Iterator[Finding]:
        checks.append(arguments)
        return check_signals(*arguments)

    monkeypatch.setattr(check, "check_signals", counted)
    log = load_run(path, "estimation", device_faults=device_faults)
    found = []
    for again in (log, load_run(path, "estimation", device_faults=device_faults)):
        ((checked,), _) = check_first([again], [], model, False)
        found.append(checked.about["findings"])
    assert found[0] == found[1]
    assert len(checks) == 1
    gyro = log.run.channels["r"]
    moved = replace(log.run, channels={**log.run.channels, "r": replace(gyro, t=gyro.t + 1e-9)})
    check_first([replace(log, run=moved)], [], model, False)
    assert len(checks) == 2
    check_first([log], [], model.with_values({"y_left": 0.9 * model.values["y_left"]}), False)
    assert len(checks) == 3


def test_logs_without_thrust_or_of_a_few_seconds_are_refused(tmp_path: Path) -> None:
    recording, _ = sail(boat_with(None, 3), 60.0, 103)
    run = load_run(write_log(tmp_path / "run.mcap", "boat", recording.readings), "estimation").run
    model = horizontal_model("command")
    commands = {n: c for n, c in run.channels.items() if n in ("n_cmd_left", "n_cmd_right")}
    assert len(commands) == 2
    resting = replace(
        run, channels={**run.channels, **{n: replace(c, value=0.0 * c.value) for n, c in commands.items()}}
    )
    require_thrust_and_length([run], model, False)
    require_thrust_and_length([resting, run], model, False)  # drifting beside a run with thrust
    with pytest.raises(
        SeatrialError, match=r"n_cmd_left, n_cmd_right: no thrust in the whole time, .*--despite-faults"
    ):
        require_thrust_and_length([resting], model, False)
    require_thrust_and_length([resting], model, True)

    start = max(float(c.t[0]) for c in run.channels.values())
    short = replace(run, t_from=start + 20.0, t_to=start + 22.0)
    with pytest.raises(SeatrialError, match=r": 2\.0 s of data, and a fit needs 10 s or more"):
        require_thrust_and_length([short], model, False)
    require_thrust_and_length([short, run], model, False)
    # The command that was given before the start of the part is still held in it.
    held = {n: replace(c, t=c.t[[0, -1]], value=0.0 * c.value[[0, -1]] + [0.5, 0.0]) for n, c in commands.items()}
    part = replace(run, channels={**run.channels, **held}, t_from=start + 20.0, t_to=start + 40.0)
    require_thrust_and_length([part], model, False)


def test_parts_of_one_log_that_overlap_are_refused_and_others_are_not(tmp_path: Path) -> None:
    """A part is read with a minute of the log on both sides, which does not count as an overlap."""
    path = boat_log(tmp_path / "run.mcap", boat_with(None, 3), 200.0, 103)
    model = horizontal_model("shaft")

    def parts(*spans: tuple[float, float]) -> list[LoadedLog]:
        return [load_run(path, "estimation", TimeWindow(*s), device_faults=device_faults) for s in spans]

    checked, _ = check_first(parts((0.0, 100.0), (100.0, 200.0)), [], model, False)
    assert not [f for log in checked for f in log.about["findings"] if f["code"] == "log-copied"]
    with pytest.raises(SeatrialError, match=r"overlaps with run\.mcap\[0:110\] for 10 s.*\[log-copied\]"):
        check_first(parts((0.0, 110.0), (100.0, 200.0)), [], model, False)
    with pytest.raises(SeatrialError, match=r"\[log-copied\]"):
        check_first(parts((0.0, 100.0)), [load_run(path, "validation", device_faults=device_faults)], model, False)
