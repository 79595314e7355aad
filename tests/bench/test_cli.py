"""Tests of the commands of bench as typed by a user: help with an example, created files, one line for each error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial import command_line
from seatrial.bench.cli import next_command
from seatrial.bench.mission_generators import HOLD_S, bench_plan, make_mission
from seatrial.daq.config.mission_file import Mission, Segment, load_mission, save_mission
from seatrial.daq.errors import SeatrialError
from tests.bench.standin import RIG
from tests.daq.mavlink_ends import mav_rig
from tests.missions import rig_of


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Return a function that runs a command line and returns exit status, stdout and stderr."""
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    captured = capsys.readouterr()
    return int(left.value.code or 0), captured.out, captured.err


@pytest.mark.parametrize(
    "words",
    [
        *(["bench", kind] for kind in ("static", "steps", "chirp", "all")),
        *(["mission", name] for name in ("run", "show", "generate")),
        ["bench"],
        ["mission"],
        ["check"],
        ["demo"],
    ],
    ids=" ".join,
)
def test_every_command_helps_with_an_example(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    status, out, _ = run(capsys, *words, "--help")
    assert status == 0
    assert f"Example: seatrial {words[0]}" in " ".join(out.split())


def test_steps_are_held_for_the_requested_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plans: list[Mission] = []
    monkeypatch.setattr("seatrial.bench.cli._run_plan", lambda plan, *_: plans.append(plan))
    rig = str(Path(__file__).resolve().parents[2] / "mocks/rigs/bench.toml")
    for words in (["steps", rig], ["steps", rig, "--hold", "5"]):
        assert run(capsys, "bench", *words)[0] == 0
    assert [round(float(np.diff(plan.segments[1].t)[0]), 3) for plan in plans] == [HOLD_S, 5.0]
    assert run(capsys, "bench", "chirp", rig, "--hold", "5")[0] == 2


def test_a_run_names_thrusters_command_and_duration_before_it_starts(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before: list[str] = []

    def refused(*_: object) -> None:
        before.append(capsys.readouterr().out)
        raise SeatrialError("no device")

    monkeypatch.setattr("seatrial.bench.execution.run_mission", refused)
    bench, boat = (str(Path(__file__).resolve().parents[2] / f"mocks/rigs/{name}.toml") for name in ("bench", "boat"))
    plan = Mission("two steps", "steps", ("left", "right"), (
        Segment("steps", np.array([0.0, 5.0]), np.array([[0.5, 0.0], [0.1, -0.625]])),
    ), 12.0, n_max=0.9)  # fmt: skip
    save_mission(plan, tmp_path / "m.toml")
    for words in (["mission", "run", str(tmp_path / "m.toml"), boat], ["bench", "static", bench]):
        assert run(capsys, *words, "-o", str(tmp_path / "run.mcap"))[0] == 1
    assert "two steps: thrusters left and right up to n = 0.625 of full command, for 12 s\n" in before[0]
    assert "at rest, without a command, for " in before[1]


def test_make_and_show_a_mission(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    words = ["--kind", "zigzag", "--seconds", "60", "--seed", "4", "--thrusters", "port,starboard", "-o", str(path)]
    status, out, _ = run(capsys, "mission", "generate", *words)
    assert status == 0
    assert "60 s" in out
    mission = load_mission(path)
    assert mission.thrusters == ("port", "starboard")
    assert mission.segments == make_mission("zigzag", 60.0, 4).segments
    assert mission.made_by.startswith("seatrial mission generate --kind zigzag --seconds 60 --seed 4")
    status, out, _ = run(capsys, "mission", "show", str(path))
    assert status == 0
    assert "n_cmd_starboard" in out
    before = path.read_bytes()
    status, _, err = run(capsys, "mission", "generate", *words)
    assert status == 1
    assert err == f"seatrial: {path}: the file exists already; --force replaces it, -o names another\n"
    assert path.read_bytes() == before
    status, out, err = run(capsys, "mission", "generate", *words, "--kind", "steps", "--force", "--json")
    again = load_mission(path)
    assert (status, err) == (0, f"{path}: {again.name}, {len(again.segments)} segments, 60 s\n")
    made = json.loads(out)
    assert (made["format"], made["path"], made["seed"], made["seconds"]) == ("seatrial-plan 1", str(path), 4, 60.0)
    status, shown, err = run(capsys, "mission", "show", str(path), "--json")
    assert (status, err) == (0, "")
    assert json.loads(shown) == made
    assert [(s["begin"], s["end"], s["name"]) for s in made["segments"]] == again.segment_times()
    low, high = made["segments"][-1]["commands"]["port"]
    assert -1.0 <= low <= high <= 1.0
    assert made["slew_per_s"] is None


@pytest.mark.parametrize(
    "words",
    [
        ["mission", "generate", "--kind", "tour", "--seed", "1", "-o", "m.toml"],
        ["mission", "generate", "--seed", "1"],
        ["mission", "generate", "-o", "m.toml"],
        ["mission", "generate", "--seed", "1", "--thrusters", "left", "-o", "m.toml"],
        ["mission", "run", "m.toml"],
        ["bench", "steps"],
        ["bench", "steps", "rig.toml", "--n-max", "1.5"],
        ["mission", "generate", "--seed", "1", "--slew", "nan", "-o", "m.toml"],
        ["demo", "--speed", "0"],
    ],
)
def test_wrong_usage_is_status_2(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    status, _, err = run(capsys, *words)
    assert status == 2
    assert err.startswith(f"seatrial {words[0]}")
    assert err.count("\n") == 1


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG.format(speed=1.0), encoding="utf-8")
    return path


def test_errors_have_one_line_and_name_the_key(capsys: pytest.CaptureFixture[str], tmp_path: Path, rig: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('format = "seatrial-mission 1"\nthrusters = ["left"]\nname = 3\n', encoding="utf-8")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    latin = tmp_path / "latin.toml"
    latin.write_bytes("name = 'Tromsø'".encode("latin-1"))
    for path, words in ((bad, "end: missing"), (binary, "not a text file"), (latin, "UTF-8")):
        status, out, err = run(capsys, "mission", "run", str(path), str(rig), "-o", str(tmp_path / "x.mcap"))
        assert (status, out) == (1, "")
        assert err.startswith(f"seatrial: {path}: ")
        assert words in err
        assert err.count("\n") == 1
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.parametrize("words", [["mission", "show"], ["bench", "all"], ["check"], ["mock", "boat"], ["log"]])
def test_a_missing_file_gives_a_one_line_usage_error(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: list[str]
) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        status, out, err = run(capsys, *words, str(path))
        assert (status, out) == (2, "")
        assert err.startswith(f"seatrial {' '.join(words)}: ")
        assert str(path) in err
        assert err.count("\n") == 1


def test_a_thruster_has_to_be_named_when_there_are_two(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, rig: Path
) -> None:
    text = rig.read_text(encoding="utf-8")
    block = text[text.index("[[thruster]]") : text.index("[limits]")]
    second = block.replace('"left"', '"right"').replace("node = 1", "node = 2")
    rig.write_text(text.replace("[limits]", second + "[limits]"), encoding="utf-8")
    status, _, err = run(capsys, "bench", "steps", str(rig))
    assert status == 1
    assert "a bench run drives one thruster, and the rig has: left, right; name one with --thruster" in err
    status, _, err = run(capsys, "bench", "steps", str(rig), "--thruster", "middle")
    assert status == 1
    assert "no thruster 'middle'" in err


def test_a_larger_command_than_the_rig_allows_is_refused_before_anything_opens(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, rig: Path
) -> None:
    log = tmp_path / "x.mcap"
    status, _, err = run(capsys, "bench", "chirp", str(rig), "--n-max", "0.95", "-o", str(log))
    assert status == 1
    assert "limits.n_max is 0.9" in err
    assert not log.exists()


def test_a_run_ends_with_a_hint_at_the_fit_for_the_rig(tmp_path: Path) -> None:
    log = tmp_path / "my run.mcap"
    boat, bench, autopilot = rig_of("boat"), rig_of("bench"), mav_rig()
    lines = [
        next_command(make_mission("mixed", 60.0, 1), boat, log),
        next_command(bench_plan("all", "thruster"), bench, log),
        next_command(make_mission("mixed", 60.0, 1), autopilot, log),
    ]
    quoted = f"'{log}'"
    assert lines == [
        f"seatrial ident vehicle {quoted}",
        f"seatrial ident thruster {quoted}",
        f"seatrial ident vehicle {quoted} --model nomoto",
    ]


def test_a_bench_run_says_its_largest_command_and_refuses_one_beyond_the_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(RIG.format(speed=1.0).replace("n_max = 0.9", "n_max = 0.5"), encoding="utf-8")
    plans: list[Any] = []
    monkeypatch.setattr("seatrial.bench.cli._run_plan", lambda plan, *rest: plans.append(plan))

    def status(*words: str) -> int | str | None:
        with pytest.raises(SystemExit) as left:
            command_line.main(["bench", *words])
        return left.value.code

    assert status("steps", str(path)) == 0
    said = "bench steps: commands up to n = 0.5 (limits.n_max of rig.toml, which is below the default 0.9)"
    assert said in capsys.readouterr().out
    assert plans[0].n_max == 0.5
    assert status("steps", str(path), "--n-max", "0.4") == 0
    assert "bench steps: commands up to n = 0.4 (by --n-max)" in capsys.readouterr().out
    assert status("steps", str(path), "--n-max", "0.6") == 1
    assert "rig.toml: --n-max 0.6 of bench steps is too large, as limits.n_max is 0.5; give at most 0.5" in (
        capsys.readouterr().err
    )
    assert len(plans) == 2
    assert status("steps", "--help") == 0
    assert "default: 0.9, or limits.n_max of RIG if that is smaller" in " ".join(capsys.readouterr().out.split())
