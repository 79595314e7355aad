"""Tests of the demo: its folder, its last line, its interruption, and once the whole procedure."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from seatrial.bench import demo
from seatrial.bench.demo import DemoSteps, StepFailed
from seatrial.bench.execution.sequencer import describe_losses
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.errors import SeatrialError
from tests.bench.guard_replay import replay
from tests.daq.logs import T0, recorder
from tests.quick_kernels import quick_environment

RESULT = {
    "answer": "The residual is explained by advance-ratio loss.",
    "effects": [{"name": "advance-ratio"}],
    "horizon_seconds": 10.0,
    "errors": {
        "validation": {
            "horizon": {
                "x": {"before": 0.21, "after": 0.034, "unit": "m"},
                "r": {"before": 0.1, "after": 0.01, "unit": "rad/s"},
            }
        }
    },
}
TRUTH = {"effect": "advance-ratio", "parameters": {"k_J": 12.5}, "sentence": "thrust falls with speed"}


def filled(folder: Path, result: object, truth: object) -> Path:
    (folder / "diagnosis").mkdir()
    (folder / demo.ANSWER).write_text(json.dumps(result), encoding="utf-8")
    (folder / demo.TRUTH).write_text(json.dumps(truth), encoding="utf-8")
    return folder


def test_the_ground_truth_is_the_very_last_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demo.print_outcome(filled(tmp_path, RESULT, TRUTH))
    lines = capsys.readouterr().out.splitlines()
    effect = "advance-ratio (thrust falls with speed; k_J = 12.5)"
    assert lines[-1] == f"ground truth: the plant's hidden effect was {effect}"
    assert lines[-2].endswith("and the hidden effect match")
    assert not any("advance-ratio (" in line for line in lines[:-1])
    assert any("5.73 deg/s before, 0.573 deg/s after" in line for line in lines)
    assert any("x      error 10 s ahead on validation data 0.21 m before, 0.034 m after" in line for line in lines)


def test_the_small_effects_of_a_realistic_boat_are_printed_before_the_hidden_effect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = {**TRUTH, "minor_effects": [{"effect": "compass"}, {"effect": "lift"}]}
    demo.print_outcome(filled(tmp_path, RESULT, truth))
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2].endswith("which the diagnosis may name as well: compass, lift")
    assert lines[-1].startswith("ground truth: the plant's hidden effect was advance-ratio")


@pytest.mark.parametrize("realistic", [False, True])
def test_only_the_realistic_demo_asks_for_a_realistic_boat(monkeypatch: pytest.MonkeyPatch, realistic: bool) -> None:
    mocks: list[tuple[str, ...]] = []
    monkeypatch.setattr(demo, "_record_with_mock", lambda steps, rig, mock, *words: mocks.append(mock))
    monkeypatch.setattr(DemoSteps, "run", lambda self, name, *words: None)
    assert demo.run_steps(DemoSteps(Path()), 3, realistic) == []
    assert [mock[1] for mock in mocks] == ["bench", "boat", "boat"]
    assert [("--realistic" in mock) for mock in mocks] == [False, realistic, realistic]


@pytest.mark.parametrize(
    ("effects", "truth", "match"),
    [
        (["delay"], "advance-ratio", False),
        ([], "advance-ratio", False),
        (["delay", "advance-ratio"], "advance-ratio", True),
        ([], "none", True),
        (["delay"], "none", False),
    ],
)
def test_a_match_is_printed_only_if_the_effects_match(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], effects: list[str], truth: str, match: bool
) -> None:
    demo.print_outcome(filled(tmp_path, {**RESULT, "effects": effects}, {"effect": truth}))
    assert ("do not match" not in capsys.readouterr().out) == match


def test_a_result_without_errors_is_printed_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match="lacks the prediction errors before and after"):
        demo.print_outcome(filled(tmp_path, {"answer": "x"}, TRUTH))


def test_the_demo_makes_a_new_folder_or_refuses_a_used_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert demo.fresh_folder(None, 5) == Path("seatrial-demo-5")
    second = demo.fresh_folder(None, 5)
    assert second.is_dir()
    assert second != Path("seatrial-demo-5")
    (second / "log.mcap").write_bytes(b"precious")
    with pytest.raises(SeatrialError, match="is not empty"):
        demo.fresh_folder(second, 5)
    assert (second / "log.mcap").read_bytes() == b"precious"


@pytest.mark.parametrize("name", ["bench", "boat"])
def test_the_packaged_rigs_get_the_speed(tmp_path: Path, name: str) -> None:
    demo.write_demo_rig(name, tmp_path, 7.5)
    assert load_rig(tmp_path / f"{name}-rig.toml").speed == 7.5


def test_a_failing_step_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    steps = DemoSteps(tmp_path)
    with pytest.raises(StepFailed, match=r"`seatrial mission show` failed with exit status 2"):
        steps.run("show", "mission", "show", "nowhere.toml")
    assert "$ seatrial mission show nowhere.toml" in capfd.readouterr().out
    assert not steps.has("ident", "no-such-command")
    assert steps.has("mission", "show")


def descendants(pid: int) -> list[int]:
    """Return the live processes below `pid`, listed by ps."""
    out = subprocess.run(["ps", "-eo", "pid=,ppid=,stat="], capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in out.splitlines()]
    below = {pid}
    for _ in range(6):
        below |= {int(row[0]) for row in rows if int(row[1]) in below and not row[2].startswith("Z")}
    return sorted(below - {pid})


def alive(pid: int) -> bool:
    """Return whether a process runs. A zombie that is not yet reaped does not count."""
    out = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
    return bool(out.strip()) and not out.strip().startswith("Z")


@pytest.mark.slow
@pytest.mark.parametrize("after", ["devices ready", "steps forward"])
def test_ctrl_c_stops_everything(tmp_path: Path, after: str) -> None:
    command = [sys.executable, "-u", "-m", "seatrial", "demo", "--seed", "3", "--out", str(tmp_path / "demo")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        printed = ""
        while after not in printed:
            line = process.stdout.readline()
            assert line, printed
            printed += line
        running = descendants(process.pid)
        assert running
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=30)[0]
    assert process.returncode == 130
    assert rest.splitlines()[-1].startswith("seatrial: demo: interrupted")
    assert "Traceback" not in rest
    deadline = time.monotonic() + 5.0
    while any(alive(pid) for pid in running) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(alive(pid) for pid in running)


# The installed demo with a bench run of short steps, missions of 70 and 50 s and one effect (`make study`: the whole).
# At ten times real time a busy machine keeps up, and no recording is repeated.
SHORT_DEMO = """
import sys
from seatrial import command_line
from seatrial.bench import demo
demo.ESTIMATION_S, demo.VALIDATION_S = 70.0, 50.0
whole = demo._record_with_mock
steps = ["steps", "--hold", "1.2"]
demo._record_with_mock = lambda *words: whole(*(w for word in words for w in (steps if word == "all" else [word])))
fitted, shorter = demo._run_ident, {"vehicle": ("--no-score-tests",), "diagnose": ("--max-effects", "1")}
demo._run_ident = lambda *words: fitted(*words, *shorter.get(words[4], ()))
command_line.main(sys.argv[1:])
"""


@pytest.mark.slow
@pytest.mark.pages
def test_the_demo_runs_from_recording_to_diagnosis(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SHORT_DEMO, "demo", "--seed", "1", "--speed", "10"]
    command += ["--out", str(tmp_path / "demo")]
    environment = quick_environment(tmp_path / "quick")
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=280, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("ground truth: the plant's hidden effect was ")
    for name in ("bench.mcap", "estimation.mcap", "validation.mcap", "diagnosis/report.html"):
        assert (tmp_path / "demo" / name).stat().st_size > 1000
    logs = sorted((tmp_path / "demo").glob("*.mcap"))
    assert [log.name for log in logs if (found := replay(log)).stop and not found.recorded] == []


class Rehearsal:
    """Replacement of the demo's steps. It reports the delay of its mock, and whether the run failed."""

    def __init__(self, folder: Path, late: list[float], fails: bool = False) -> None:
        self.folder, self._late, self._fails = folder, late, fails
        self.late_ms = 0.0
        self.speeds: list[str] = []

    @contextmanager
    def mock(self, *words: str) -> Iterator[None]:
        try:
            yield
        finally:
            self.late_ms = self._late[len(self.speeds) - 1]

    def run(self, name: str, *words: str) -> None:
        self.speeds.append(
            next(x for x in (self.folder / "boat-rig.toml").read_text().splitlines() if x.startswith("speed"))
            .partition("#")[0]
            .strip()
        )
        (self.folder / words[-1]).write_text("log")
        if self._fails and len(self.speeds) == 1:
            raise StepFailed("demo: `seatrial mission run` failed with exit status 3 (see above)")


@pytest.mark.parametrize("fails", [False, True])
def test_a_recording_disturbed_by_a_busy_machine_is_repeated_at_half_the_speed(tmp_path: Path, fails: bool) -> None:
    demo.write_demo_rig("boat", tmp_path, 20.0)
    steps = Rehearsal(tmp_path, [90.0, 3.0], fails)
    demo._record_with_mock(steps, "boat", ("mock", "boat"), "run", "mission", "run", "-o", "a.mcap")
    assert steps.speeds == ["speed = 20.0", "speed = 10.0"]
    assert (tmp_path / "a-late.mcap").exists()
    assert "speed = 20.0" in (tmp_path / "boat-rig.toml").read_text()


def test_a_run_with_skipped_set_points_is_repeated_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    demo.write_demo_rig("boat", tmp_path, 20.0)
    skipped = iter([demo.SKIPPED_MAX + 1, demo.SKIPPED_MAX])
    monkeypatch.setattr(demo, "n_skipped", lambda log: next(skipped))
    steps = Rehearsal(tmp_path, [3.0, 3.0])
    demo._record_with_mock(steps, "boat", ("mock", "boat"), "run", "mission", "run", "-o", "a.mcap")
    assert steps.speeds == ["speed = 20.0", "speed = 10.0"]


def test_skipped_set_points_are_counted_from_the_output_of_a_run(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for counts in ((1, 0, 0), (12, 3, 0), (0, 5, 0)):
        log.event(T0, "invalid", f"chirp: {describe_losses((0, 0, 0), counts)}")
    log.close()
    assert demo.n_skipped(tmp_path / "run.mcap") == 13
    assert demo.n_skipped(tmp_path / "none.mcap") == 0


def test_after_a_second_stall_the_recording_is_repeated_at_a_quarter_of_the_speed(tmp_path: Path) -> None:
    demo.write_demo_rig("boat", tmp_path, 20.0)
    steps = Rehearsal(tmp_path, [90.0, 90.0, 90.0], fails=True)
    demo._record_with_mock(steps, "boat", ("mock", "boat"), "run", "mission", "run", "-o", "a.mcap")
    assert steps.speeds == ["speed = 20.0", "speed = 10.0", "speed = 5.0"]
    assert {p.name for p in tmp_path.glob("*.mcap")} == {"a.mcap", "a-late.mcap", "a-late2.mcap"}


def test_a_run_that_failed_on_an_idle_machine_is_a_failure(tmp_path: Path) -> None:
    demo.write_demo_rig("boat", tmp_path, 20.0)
    steps = Rehearsal(tmp_path, [3.0], fails=True)
    with pytest.raises(StepFailed, match="exit status 3"):
        demo._record_with_mock(steps, "boat", ("mock", "boat"), "run", "mission", "run", "-o", "a.mcap")
