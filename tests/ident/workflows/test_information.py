"""Tests of `seatrial ident information`: a segment informs the parameters that it excites."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from seatrial import command_line
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.samples import NAN, Ahrs, Frame
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.experiment_design.information import InformationSegment
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.commands import InformedParameter, SegmentInformation
from seatrial.ident.workflows.information import (
    _information_answer,
    _information_notes,
    _informed_parameter,
    _longest_mission_step,
)
from seatrial.mocks.offline_simulation import simulate
from tests.missions import T0, StandingClock, boat_with, rig_of

SECONDS = 90.0
MODEL = """
format = "seatrial-model 1"
name = "horizontal"
source = "horizontal:shaft"
sensors = ["attitude", "gyro", "accelerometer", "position", "ground_velocity"]
effects = []
[validity]
"""
TRUE = {
    "m_u": 37.0,
    "m_v": 47.0,
    "m_r": 9.69,
    "d_u": 0.2,
    "d_v": 50.0,
    "d_r": 4.14,
    "d_uu": 25.0,
    "d_vv": 20.0,
    "d_rr": 6.23,
    "V_x": 0.0,
    "V_y": 0.0,
    "c1": 40.05,
    "c2": 1.11,
    "y_left": -0.15,
    "y_right": 0.15,
    "s_u": 0.01,
    "s_v": 0.01,
    "s_r": 0.01,
    "e_psi": 0.01,
    "e_r": 0.005,
    "e_a": 0.05,
    "e_xy": 0.05,
    "e_vxy": 0.05,
}
FIXED = ("c1", "c2", "y_left", "y_right", "d_u")
STEPS = ((0.0, "static"), (30.0, "straight ahead"), (60.0, "turns"))


def write_model(path: Path) -> Path:
    rows = [
        f'[[parameter]]\nname = "{n}"\nvalue = {v}\nunit = ""\nfree = {str(n not in FIXED).lower()}\n'
        + ("per_record = true\nprior = [0.0, 0.5]\n" if n in ("V_x", "V_y") else "")
        for n, v in TRUE.items()
    ]
    path.write_text(MODEL + "".join(rows), encoding="utf-8")
    return path


def write_run(path: Path, seed: int) -> Path:
    """Record a run at rest, straight ahead at two speeds, and turning to both sides, with the names of the steps."""
    t = np.array([0.0, 30.0, 45.0, *np.arange(60.0, SECONDS, 5.0)])
    turns = [[0.5 + 0.3 * (-1) ** k, 0.5 - 0.3 * (-1) ** k] for k in range(t.size - 3)]
    readings = simulate(
        boat_with(None, seed), t, np.array([[0.0, 0.0], [0.4, 0.4], [0.8, 0.8], *turns]), SECONDS, 1
    ).readings
    recorder = Recorder(path, rig=rig_of("boat"), clock=StandingClock())
    steps = list(STEPS)
    for device, sample, at in readings:
        if steps and at >= steps[0][0]:
            recorder.event(T0 + at, "segment", steps.pop(0)[1])
        recorder.write(device, Frame(sample, T0 + at + 1e-3, at if isinstance(sample, Ahrs) else NAN), T0 + at)
    recorder.close()
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("information")
    write_model(found / "model.toml")
    write_run(found / "one.mcap", 3)
    return found


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as left:
        command_line.main(["ident", "information", *map(str, words)])
    captured = capsys.readouterr()
    return int(left.value.code or 0), captured.out, captured.err


def test_results_are_replaced_only_with_force(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = tmp_path / "out/result.json"
    before.parent.mkdir()
    before.write_text("mine", encoding="utf-8")
    words = (folder / "model.toml", folder / "one.mcap", "--from", 30, "--out", tmp_path / "out")
    status, _, err = run(capsys, *words)
    assert (status, err.count("\n")) == (1, 1)
    assert "--force" in err
    assert before.read_text(encoding="utf-8") == "mine"
    assert run(capsys, *words, "--force")[0] == 0
    assert before.read_text(encoding="utf-8") != "mine"


def test_time_window_limits_the_segments(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    window = ("--from", 30, "--to", 60)
    status, _, err = run(capsys, folder / "model.toml", folder / "one.mcap", *window, "--out", tmp_path / "out")
    assert status == 0, err
    result: dict[str, Any] = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))
    rows = [(row["what"], round(row["t_from"]), round(row["t_to"])) for row in result["information"]["segments"]]
    assert rows == [("straight ahead", 30, 60)]
    for words in ((30, 30), (30, 20), ("nan", 40)):
        window_options = ("--from", words[0], "--to", words[1])
        assert (
            run(capsys, folder / "model.toml", folder / "one.mcap", *window_options, "--out", tmp_path / "no")[0] == 2
        )


def test_segments_inform_the_parameters_that_they_excite(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, output, err = run(capsys, folder / "model.toml", folder / "one.mcap", "--out", tmp_path / "out")
    assert status == 0, err
    result: dict[str, Any] = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))
    part = result["information"]
    assert part["names"] == ["m_u", "m_v", "m_r", "d_v", "d_r", "d_uu", "d_vv", "d_rr"]
    rows = part["segments"]
    assert [row["what"] for row in rows] == ["static", "straight ahead", "turns"]
    assert [(round(row["t_from"]), round(row["t_to"])) for row in rows] == [(0, 30), (30, 60), (60, 90)]
    rest, ahead, turns = rows
    at = {name: k for k, name in enumerate(part["names"])}
    infinite = float("inf")
    weights = {row["what"]: [infinite if w is None else w for w in row["weight"]] for row in rows}
    assert max(weights["static"]) < 1.25  # A boat at rest drifts in the current and gives almost no information.
    assert max(rest["lost"]) < 0.35
    assert weights["straight ahead"][at["d_uu"]] > 1.3
    assert weights["turns"][at["d_rr"]] > 5.0 > weights["straight ahead"][at["d_rr"]]
    assert turns["lost"][at["d_rr"]] > 0.95 > ahead["lost"][at["d_rr"]]
    for row in part["parameters"]:
        assert row["se"] > 0
        assert row["what"] in ("turns", "straight ahead")
    assert "turns" in result["answer"] or "Only" in result["answer"]
    assert re.search(r"one, 60 to 90 s \(turns\)", output)
    assert "Information of these logs" in output
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    titles = ("Information in logs", "Information of these logs", "Segment by segment")
    for words in (*titles, "heatmap", "depends most on"):
        assert words in page
    assert "Inputs" in page


def test_no_segment_of_two_equal_logs_is_indispensable(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "two.mcap").write_bytes((folder / "one.mcap").read_bytes())
    words = (folder / "model.toml", folder / "one.mcap", tmp_path / "two.mcap", "--parameters", "m_r, d_rr")
    status, _, err = run(capsys, *words, "--seconds", 45, "--out", tmp_path / "out")
    assert status == 0, err
    part = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))["information"]
    assert part["names"] == ["m_r", "d_rr"]
    assert [row["record"] for row in part["segments"]] == ["one", "one", "two", "two"]
    for row in part["segments"]:
        # Without a segment of one log, the other log still has it. At most half of the information is lost.
        assert all(1.0 <= w < np.sqrt(2.0) + 1e-3 for w in row["weight"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--parameters", "mass"), "the model has no free parameter 'mass'; its free parameters are m_u, m_v"),
        (("--parameters", "c1"), "no free parameter 'c1'"),
    ],
)
def test_invalid_parameter_gives_a_one_line_error(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    status, _, err = run(capsys, folder / "model.toml", folder / "one.mcap", *words, "--out", tmp_path / "out")
    assert status == 1
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_segment_is_named_by_its_longest_step() -> None:
    steps = ((0.0, "static"), (10.0, "steps"), (40.0, "zigzag"), (90.0, "steps"))
    assert _longest_mission_step(steps, 0.0, 15.0) == "static"
    assert _longest_mission_step(steps, 5.0, 60.0) == "steps"
    assert _longest_mission_step(steps, 80.0, 120.0) == "steps"
    assert _longest_mission_step((), 0.0, 10.0) == ""
    assert _longest_mission_step(((50.0, "late"),), 0.0, 10.0) == ""


def test_answer_names_the_most_informative_segment() -> None:
    row = InformedParameter(record="a", t_from=0.0, t_to=30.0, what="", name="m_v", meaning="", unit="kg", value=40.0,
                            se=1.0, weight=2.5, alone=None, known=True)  # fmt: skip
    assert _information_answer([row], 2) == (
        "The most informative segment is a, 0 to 30 s: "
        "without it the standard error of m_v would be 2.5 times as large."
    )
    assert _information_answer([replace(row, weight=None)], 2) == "Only a, 0 to 30 s contains information about m_v."
    assert _information_answer([replace(row, weight=1.1)], 2).startswith("No segment matters much more")
    assert _information_answer([replace(row, se=30.0, known=False)], 2).endswith(
        "Poorly known from all logs together: m_v."
    )
    assert _information_answer([replace(row, se=None)], 2) == (
        "These logs contain no information about any parameter; record runs in which the commands change."
    )
    assert "--seconds" in _information_answer([row], 1)


def test_parameter_estimated_at_zero_is_known_if_its_error_is_small() -> None:
    """The error is compared with its prior, or with five characteristic steps."""
    model = horizontal_model() + catalogue()["reverse-thrust"]
    p = next(p for p in catalogue()["reverse-thrust"].parameters if p.value == 0.0)
    row = SegmentInformation(record="a", t_from=0.0, t_to=30.0, what="", weight=np.ones(1), lost=np.zeros(1),
                             alone=np.ones(1))  # fmt: skip
    for prior, size in ((p.prior or (0.0, 0.3), (p.prior or (0.0, 0.3))[1]), (None, 5.0 * p.step)):
        of_it = model.replace_parameters(dataclasses.replace(p, prior=prior))
        for share, known in ((0.4, True), (0.6, False)):
            segment = InformationSegment("a", 0.0, 30.0, np.eye(1), np.ones(1), np.ones(1), np.array([share * size]))
            assert _informed_parameter(of_it, p.name, 0, [segment], [row]).known == known


def test_design_is_recommended_only_for_models_that_it_supports() -> None:
    row = InformedParameter(record="a", t_from=0.0, t_to=30.0, what="", name="m_v", meaning="", unit="kg", value=40.0,
                            se=30.0, weight=2.5, alone=None, known=False)  # fmt: skip
    for model, advised in (("horizontal:shaft", True), ("kinematic:shaft", False), ("thruster", False)):
        assert (
            any("seatrial mission design" in line for line in _information_notes([row], [], make_model(model)))
            == advised
        )
