"""Tests of `seatrial check --report`: the answer, its evidence from a real log, and missing parts that are left out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial import command_line
from seatrial.daq.checks.check_report import CheckReport
from seatrial.daq.checks.findings import Finding
from seatrial.daq.log import open_log
from seatrial.ident.checks.log_checks import CheckEvidence, log_evidence, sides_of, thrust_response_curves
from seatrial.ident.checks.motion import YAW_LAGS, delayed_forces
from seatrial.ident.data import channels
from seatrial.ident.report.check_page import _staircase, check_answer, write_check_page
from tests.bench.check_cases import CASES, logged
from tests.ident import page_examples
from tests.ident.pages import HOSTILE, Page, numbers

EVIDENCE = ["push", "shafts", "sensors", "signals", "intervals", "all", "made"]


def page(report: CheckReport, logs: list[CheckEvidence], folder: Path, command: str = "") -> Page:
    write_check_page(report, logs, command, folder / "check.html")
    return Page((folder / "check.html").read_text(encoding="utf-8"))


def test_swapped_sides_have_a_negative_correlation(tmp_path: Path) -> None:
    """The curves of the page agree with the finding."""
    for case, sign in ((None, 1.0), (CASES[0], -1.0)):
        log = logged(tmp_path / f"{sign:g}.mcap", 3, case, actuators=True)
        curves = {row.title: row for row in log_evidence(log)[0].thrust_response}
        turning, ahead = curves["yaw rate"], curves["speed ahead over ground"]
        both = np.corrcoef(turning.measured, turning.expected)[0, 1]
        assert sign * both > 0.8
        assert np.corrcoef(ahead.measured, ahead.expected)[0, 1] > 0.8


def test_turning_is_shown_by_heading_or_course_without_a_gyro(tmp_path: Path) -> None:
    with open_log(logged(tmp_path / "run.mcap", 3, None, actuators=True)) as log:
        every = channels(log)
        sides = sides_of(log)
    compass = {n: c for n, c in every.items() if n in ("psi", "x", "y") or n.startswith("n_")}  # Only GNSS and compass.
    course = {n: c for n, c in compass.items() if n != "psi"}
    by_gyro, by_heading, by_course = (thrust_response_curves(c, sides)[0] for c in (every, compass, course))
    assert {row.title for row in (by_gyro, by_heading, by_course)} == {"yaw rate"}
    assert np.corrcoef(by_heading.measured, np.interp(by_heading.t, by_gyro.t, by_gyro.measured))[0, 1] > 0.8
    assert np.isfinite(by_course.measured).all()
    assert by_course.t.size == by_course.expected.size < by_gyro.t.size  # At low speed there is no course.


def test_delayed_force_is_scaled_and_lagged_to_the_motion() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    push = np.sign(np.sin(t / 4))
    y = np.zeros(t.size)
    for k in range(1, t.size):
        y[k] = y[k - 1] + 0.1 / 1.0 * (0.3 * push[k - 1] - y[k - 1])
    assert delayed_forces(y, push, YAW_LAGS) == pytest.approx(y, abs=0.02)
    assert delayed_forces(-y, push, YAW_LAGS) == pytest.approx(y - 2 * y.mean(), abs=0.02)


def test_command_is_drawn_as_held() -> None:
    """One command holds for 50 s, followed by hundreds. Thinned corners were joined by a slope over the 50 s."""
    t = np.concatenate([[0.0], 50.0 + 0.02 * np.arange(2000)])
    n = np.concatenate([[0.8], np.sin(0.5 * t[1:])])
    for limit in (600, 10_000):
        x, y = _staircase(t, n, 95.0, limit)
        assert x.size <= limit
        assert np.interp([10.0, 49.8, 94.0], x, y) == pytest.approx([0.8, 0.8, n[-1]])
        assert np.interp(t[101::100] + 0.01, x, y) == pytest.approx(n[101::100], abs=0.12)


def test_check_page_of_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = logged(tmp_path / "run.mcap", 3, CASES[5], actuators=True)  # The GNSS is late.
    out = tmp_path / "reports" / "check.html"
    with pytest.raises(SystemExit) as left:
        command_line.main(["check", str(log), "--report", str(out)])
    captured = capsys.readouterr()
    assert left.value.code == 1
    assert f"report: {out}" in captured.out
    found = Page(out.read_text(encoding="utf-8"))
    assert found.headings() == EVIDENCE
    assert "run.mcap cannot be trusted yet: " in found.words
    assert "after acceleration" in " ".join(found.words.split())
    figures = found.figures()
    assert len(figures) == 5
    for figure in figures.values():
        assert all(len(numbers(trace["x"])) == len(numbers(trace["y"])) > 1 for trace in figure["data"])
    assert out.stat().st_size < 8_000_000


def test_each_log_has_a_tab(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [str(logged(tmp_path / f"{name}.mcap", seed, None, actuators=True)) for name, seed in (("a", 3), ("b", 4))]
    with pytest.raises(SystemExit) as left:
        command_line.main(["check", *logs, "--report", str(tmp_path / "check.html"), "--json"])
    assert left.value.code == 0
    captured = capsys.readouterr()
    # The line about the report is not part of the JSON output.
    assert json.loads(captured.out)["format"] == "seatrial-check 1"
    found = Page((tmp_path / "check.html").read_text(encoding="utf-8"))
    assert "is in order" in found.words
    assert len(found.figures()) == 10
    assert sum(attrs.get("role") == "tab" for _, attrs in found.tags) == 10


def test_check_page_of_a_rig_with_a_mission(tmp_path: Path) -> None:
    found = page(page_examples.check(), [page_examples.checked_log()], tmp_path, "seatrial check")
    assert found.headings() == ["mission", *EVIDENCE]
    words = " ".join(found.words.split())
    assert "boat.toml is not ready: left and right are swapped: the boat turns against its thrust difference" in words
    assert "Predicted by the design, by model horizontal" in words


def test_answer_is_one_sentence() -> None:
    report = page_examples.check()
    rows = report.findings
    ok = tuple(row for row in rows if row.level == "ok")
    warned = tuple(row for row in rows if row.level != "fault")
    assert check_answer(replace(report, findings=ok)) == "boat.toml is ready: 2 checks, no faults or warnings."
    assert (
        check_answer(replace(report, findings=warned))
        == "boat.toml can be used for a run; read these warnings first: gnss (late)."
    )
    assert check_answer(CheckReport("a.mcap", ok)) == "a.mcap is in order: 2 checks, no faults or warnings."
    assert check_answer(replace(report, findings=3 * rows[:2])).endswith(
        "difference. Other faults: gnss (rate), left and right (sides), gnss (rate) and 2 more."
    )


def test_answer_names_the_signal_unless_the_finding_does() -> None:
    fault = Finding("fault", "angle-in-degrees", "units", "r", "86 rad/s: in deg/s?")
    assert check_answer(CheckReport("a.mcap", (fault,))) == "a.mcap cannot be trusted yet: r, 86 rad/s: in deg/s?"
    swapped = fault._replace(where="a: left and right", text="left and right are swapped")
    assert check_answer(CheckReport("a.mcap", (swapped,))).endswith("yet: left and right are swapped.")


def test_missing_parts_are_left_out_and_text_is_escaped(tmp_path: Path) -> None:
    least = page(CheckReport(HOSTILE, ()), [], tmp_path)
    assert least.headings() == []
    assert HOSTILE in least.words
    assert len(least.scripts) == 2  # The data of the figures and the script of the page, without plotly.
    whole = page_examples.check()
    assert whole.mission is not None
    bare = replace(whole, mission=replace(whole.mission, track=None))
    found = page(bare, [CheckEvidence(HOSTILE, 1.0, None)], tmp_path, "seatrial check")
    assert found.headings() == ["mission", "all", "made"]
    assert len(found.figures()) == 1
