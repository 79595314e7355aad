"""Tests of runs of several files: the guess of one map with a [[file]] for each, and the import of folders."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import seatrial as st
from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers import guess
from seatrial.daq.importers.guess import guess_maps
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.run_files import match_pattern
from seatrial.daq.log import open_log, require_logs
from seatrial.daq.log.run_tables import run_folder_of
from seatrial.daq.samples import Scalar
from tests.daq.csv_files import values
from tests.page_runner import run_commands
from tests.test_docs import ROOT, blocks

N = 60
SIGNALS = ["n_left", "n_right", "psi", "r", "vx", "vy", "x", "y"]
START = 1.78e9  # s since 1970


def table(path: Path, t: np.ndarray, columns: dict[str, np.ndarray]) -> Path:
    """Write a CSV file with a column of times."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = ",".join(["timestamp", *columns])
    np.savetxt(path, np.column_stack([t, *columns.values()]), "%.13g", ",", header=names, comments="")
    return path


def run_of_files(folder: Path, start: float = START, prefix: str = "", full: float = 1.0) -> Path:
    """Write a run in three files, each with a clock that begins a little later than the one before."""
    t = 0.1 * np.arange(N)
    w = np.sin(t)
    table(folder / f"{prefix}ahrs.csv", start + t, {"yaw_deg": 9.0 * w, "gyro_z_deg_s": 9.0 * np.cos(t)})
    table(folder / f"{prefix}esc.csv", start + 0.02 + t, {"cmd_left": full * w, "cmd_right": 0.5 * full * w})
    fixes = {"latitude": 59.9 + 1e-6 * t, "longitude": 10.0 + 1e-6 * t, "sog_kn": 1.0 + 0 * t, "cog_deg": 45.0 + 0 * t}
    table(folder / f"{prefix}gnss.csv", start + 0.05 + t, fixes)
    return folder


def signals_of(text: str) -> dict[str, list[str]]:
    """Return the names of the signals of each [[file]] of a map by its pattern."""
    return {part["match"]: [signal["name"] for signal in part["signal"]] for part in tomllib.loads(text)["file"]}


def assert_has_all_signals(log: Path) -> None:
    assert sorted(open_log(log).sources(Scalar)) == SIGNALS


def test_a_folder_of_files_is_one_run(tmp_path: Path) -> None:
    folder = run_of_files(tmp_path / "run1")
    (folder / "notes.txt").write_text("Dear reader,\nwind from the north.\n")
    (guess,) = guess_maps([folder])
    assert signals_of(guess.text) == {
        "ahrs.csv": ["psi", "r"],
        "esc.csv": ["n_left", "n_right"],
        "gnss.csv": ["x", "y", "vx", "vy"],
    }
    assert guess.problem == ""
    assert f"# assumed: {folder / 'notes.txt'}: left out, as it is no table\n" in guess.text
    (map_path := tmp_path / "map.toml").write_text(guess.text)
    (log,) = import_files(map_path, [folder], out_dir=tmp_path / "logs")
    assert log.name == "run1.mcap"
    assert_has_all_signals(log)
    assert values(log, "psi")[0][0] == pytest.approx(START)
    assert values(log, "n_left")[0][0] == pytest.approx(START + 0.02)


def test_files_of_different_columns_at_the_same_time_are_one_run(tmp_path: Path) -> None:
    files = sorted(run_of_files(tmp_path / "run1").iterdir())
    (map_path := tmp_path / "map.toml").write_text(guess_maps(files)[0].text)
    (log,) = import_files(map_path, files, out_dir=tmp_path)
    assert log.name == "map.mcap"
    assert_has_all_signals(log)


def test_several_folders_are_runs_of_one_map_and_of_one_scale(tmp_path: Path) -> None:
    folders = [run_of_files(tmp_path / f"run{k}", START + 100.0 * k, full=400.0 * k) for k in (2, 1)]
    found = CliRunner().invoke(cli.import_, ["--guess", *map(str, folders), "-o", str(tmp_path / "map.toml")])
    assert (found.exit_code, found.stderr) == (0, "")
    text = (tmp_path / "map.toml").read_text()
    assert "the largest number of these 2 files" in text
    largest = 800.0 * np.abs(np.sin(0.1 * np.arange(N))).max()
    assert text.count(f"scale = {1.0 / largest:.9g},") == 2
    arguments = [tmp_path / "map.toml", *folders, "--out-dir", tmp_path / "logs"]
    found = CliRunner().invoke(cli.import_, list(map(str, arguments)))
    assert found.exit_code == 0, found.output
    logs = [Path(line) for line in found.stdout.splitlines()]
    assert [log.name for log in logs] == ["run2.mcap", "run1.mcap"]
    assert [values(log, "psi")[0][0] - START for log in logs] == pytest.approx([200.0, 100.0])
    for log in logs:
        assert_has_all_signals(log)


@pytest.mark.parametrize(("most", "n_reads"), [(100_000_000, 1), (0, 3)])
def test_each_file_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int, n_reads: int) -> None:
    """Files that do not fit into memory together are read again, with the same map."""
    folders = [run_of_files(tmp_path / f"run{k}", START + 100.0 * k, full=400.0 * k) for k in (1, 2)]
    expected, read, reads = guess_maps(folders)[0].text, guess._read_file, list[Path]()

    def counting(path: Path, dbc: Path | None) -> guess._ReadFile:
        reads.append(path)
        return read(path, dbc)

    monkeypatch.setattr(guess, "_read_file", counting)
    monkeypatch.setattr(guess, "MOST_KEPT_BYTES", most)
    assert guess_maps(folders)[0].text == expected
    assert sorted(reads) == sorted(n_reads * [file for folder in folders for file in folder.iterdir()])


def test_an_interval_of_a_map_with_several_files_may_name_its_run(tmp_path: Path) -> None:
    folders = [run_of_files(tmp_path / f"run{k}", 0.0) for k in (1, 2)]
    guessed = guess_maps(folders)[0].text
    pieces = [f'[[log]]\nname = "{n}"\nmatch = "{m}"\nt_from = {a}\n' for n, m, a in (("a", "run1", 2), ("b", "*2", 4))]
    (map_path := tmp_path / "map.toml").write_text(guessed + "".join(pieces))
    logs = import_files(map_path, folders, out_dir=tmp_path / "logs")
    assert [log.name for log in logs] == ["run1_a.mcap", "run2_b.mcap"]
    assert [values(log, "psi")[0][0] for log in logs] == pytest.approx([2.0, 4.0])
    map_path.write_text(guessed + pieces[0].replace("run1", "*_a"))
    with pytest.warns(SeatrialWarning, match=r"\[\[log\]\] match = '\*_a' matches none of the given files or folders"):
        logs = import_files(map_path, folders, out_dir=tmp_path / "whole")
    assert [log.name for log in logs] == ["run1.mcap", "run2.mcap"]


def test_the_python_interface_takes_folders(tmp_path: Path) -> None:
    folders = [run_of_files(tmp_path / f"run{k}", START + 100.0 * k, full=400.0) for k in (1, 2)]
    text = st.guess_map(folders, tmp_path / "map.toml")
    assert list(signals_of(text)) == ["ahrs.csv", "esc.csv", "gnss.csv"]
    logs = st.import_log(folders, tmp_path / "map.toml", tmp_path / "by_map")
    with pytest.warns(SeatrialWarning, match="run1, run2: without an import map, this was inferred"):
        logs += st.import_log(folders, out_dir=tmp_path / "guessed")
    assert [log.name for log in logs] == 2 * ["run1.mcap", "run2.mcap"]
    files = sorted(folders[0].iterdir())
    with pytest.warns(
        SeatrialWarning, match=r"^ahrs\.csv, esc\.csv, gnss\.csv: without .*'[^ ]*esc\.csv', '[^ ]*gnss\.csv'\]"
    ):
        logs += st.import_log(files, out_dir=tmp_path / "of_files")
    assert logs[-1].name == "run1.mcap"
    for log in logs:
        assert_has_all_signals(log)


def test_the_commands_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for k in (1, 2):
        run_of_files(Path(f"data/april_run{k}"), START + 100.0 * k)
    run_commands(blocks(ROOT / "docs/formats/import.md", "sh")[1])
    assert sorted(path.name for path in Path("logs").iterdir()) == ["april_run1.mcap", "april_run2.mcap"]


def test_files_of_equal_columns_are_runs_of_their_own(tmp_path: Path) -> None:
    """So they are with equal relative times, and in a folder; a file that is alone in a folder has its name."""
    columns = {"yaw_deg": np.arange(N), "pwm_left": 1500.0 + np.arange(N), "pwm_right": 1500.0 - np.arange(N)}
    files = [table(tmp_path / "data" / f"{name}.csv", 0.1 * np.arange(N), columns) for name in ("a", "b")]
    for sources in (files, [tmp_path / "data"]):
        guesses = guess_maps(sources)
        assert [guess.run.paths for guess in guesses] == [(file,) for file in files]
        assert "file" not in tomllib.loads(guesses[0].text)
        (map_path := tmp_path / "map.toml").write_text(guesses[0].text)
        logs = import_files(map_path, sources, out_dir=tmp_path / "logs", force=True)
        assert [log.name for log in logs] == ["a.mcap", "b.mcap"]
        with pytest.warns(SeatrialWarning, match="without an import map"):
            logs = st.import_log(sources, out_dir=tmp_path / "guessed", force=True)
        assert [log.name for log in logs] == ["a.mcap", "b.mcap"]
    alone = table(tmp_path / "run7" / "log.csv", 0.1 * np.arange(N), columns).parent
    assert [log.name for log in import_files(map_path, [alone], out_dir=tmp_path)] == ["run7.mcap"]


def test_files_of_different_columns_and_times_are_no_run(tmp_path: Path) -> None:
    files = sorted(run_of_files(tmp_path / "run1").iterdir())
    later = sorted(run_of_files(tmp_path / "run2", START + 1e4).iterdir())
    guesses = guess_maps([files[0], later[2]])
    assert "file" not in tomllib.loads(guesses[0].text)
    line = f"{later[2]}: has other columns than {files[0]}, so this map is not for it; guess its map alone"
    assert guesses[0].assumed == [line]
    assert f"# assumed: {line}\n" in guesses[0].text
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    (mixed / "esc.csv").write_bytes(files[1].read_bytes())
    (mixed / "gnss.csv").write_bytes(later[2].read_bytes())
    (guess,) = guess_maps([mixed])
    assert list(signals_of(guess.text)) == ["esc.csv"]
    assert "gnss.csv: left out, as its times do not overlap with those of esc.csv; guess its map" in guess.assumed[0]
    (map_path := tmp_path / "map.toml").write_text(guess.text)
    (log,) = import_files(map_path, [mixed], out_dir=tmp_path)
    assert open_log(log).sources(Scalar) == ["n_left", "n_right"]


def test_the_current_folder_and_a_log_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log that an import has written into the folder of its run is no bag of ROS."""
    monkeypatch.chdir(run_of_files(tmp_path / "run1"))
    (guess,) = guess_maps([Path()])
    assert tomllib.loads(guess.text)["name"] == "run1"
    Path("map.toml").write_text(guess.text)
    for _ in range(2):
        assert import_files(Path("map.toml"), [Path()], force=True) == [Path("run1.mcap")]
    assert guess_maps([Path()])[0].text == guess.text


def test_a_table_that_is_no_log_names_the_folder_of_its_run(tmp_path: Path) -> None:
    folder = run_of_files(tmp_path / "run1")
    advice = f"`seatrial import --guess {folder} -o map.toml`, then `seatrial import map.toml {folder}`"
    with pytest.raises(SeatrialError) as caught:
        require_logs([folder / "gnss.csv", folder / "esc.csv"])
    assert str(caught.value).endswith(f"{advice}; {folder}: has further tables of the same time")
    later = run_of_files(tmp_path / "run2", START + 1e4)
    (mixed := tmp_path / "mixed").mkdir()
    (mixed / "esc.csv").write_bytes((folder / "esc.csv").read_bytes())
    (mixed / "gnss.csv").write_bytes((later / "gnss.csv").read_bytes())
    with pytest.raises(SeatrialError, match=r"then `seatrial import map\.toml [^ ]*mixed/gnss\.csv`$"):
        require_logs([mixed / "gnss.csv"])
    for text in ("x,y\n", "", "2026-06-01T09:00:00Z;1\n" * 3):
        (mixed / "gnss.csv").write_text(text)
        assert run_folder_of(mixed / "gnss.csv") is None


def runs_and_a_pool(folder: Path, start: float = 0.5) -> list[Path]:
    """Write three runs of equal columns, and the shorter log of a thruster in a pool. All times begin at the start."""
    for k, n in enumerate((90, 80, 70), 1):
        t = 0.1 * np.arange(n)
        columns = {"yaw_deg": 9.0 * np.sin(t), "rpm_left": 900.0 * np.sin(t), "rpm_right": 950.0 * np.cos(t)}
        table(folder / f"run{k}.csv", start + t, columns)
    t = 0.05 * np.arange(100)
    table(folder / "pool.csv", t, {"command_pct": 100.0 * np.sin(t), "rpm": 900.0 * np.sin(t), "force_N": np.sin(t)})
    return sorted(folder.glob("run*.csv"))


def test_runs_that_begin_at_zero_are_no_run_with_a_table_of_other_columns(tmp_path: Path) -> None:
    """Files of equal columns are runs. Times from the start do not show that another table was recorded with them."""
    files = runs_and_a_pool(tmp_path / "data")
    for file in (*files, tmp_path / "data/pool.csv"):
        assert run_folder_of(file) is None
        with pytest.raises(SeatrialError, match=rf"then `seatrial import map\.toml [^ ]*{file.name}`$"):
            require_logs([file])
    # a single table of each kind: it is of the same run if it begins and ends together with the other one
    for file in files[1:]:
        file.unlink()
    assert run_folder_of(files[0]) is None
    together = run_of_files(tmp_path / "together", 0.0)
    assert run_folder_of(together / "gnss.csv") == together
    run_of_files(together, 0.0, prefix="run2_")
    assert run_folder_of(together / "gnss.csv") == together


def test_the_map_of_a_folder_of_runs_and_a_table_of_other_columns(tmp_path: Path) -> None:
    files = runs_and_a_pool(tmp_path / "data")
    arguments = ["--guess", str(tmp_path / "data"), "-o", str(tmp_path / "map.toml")]
    found = CliRunner().invoke(cli.import_, arguments)
    assert found.exit_code == 0, found.output
    left_out = "pool.csv: left out, as its times count from its start, as those of run1.csv and 2 more of other columns"
    assert f"{left_out}; if it is a recording of its own, guess its map alone; " in found.stderr
    text = (tmp_path / "map.toml").read_text()
    content = tomllib.loads(text)
    assert [signal["name"] for signal in content["signal"]] == ["psi", "n_left", "n_right"]
    assert "then run `seatrial import MAP run1.csv run2.csv run3.csv`.\n" in text
    logs = import_files(tmp_path / "map.toml", files, out_dir=tmp_path / "logs")
    with pytest.warns(SeatrialWarning) as warned:
        logs += st.import_log(tmp_path / "data", out_dir=tmp_path / "guessed")
    texts = [str(warning.message) for warning in warned]
    assert left_out in texts[0]
    assert texts[1].startswith("run1.csv, run2.csv, run3.csv: without an import map, this was inferred")
    assert [log.name for log in logs] == 2 * ["run1.mcap", "run2.mcap", "run3.mcap"]
    for k in (4, 5):
        (tmp_path / "data" / f"run{k}.csv").write_bytes(files[0].read_bytes())
    assert "then run `seatrial import MAP FILE...` with the 5 files" in guess_maps([tmp_path / "data"])[0].text


@pytest.mark.parametrize("start", [0.0, START])
def test_several_runs_in_one_folder(tmp_path: Path, start: float) -> None:
    """With times since 1970 they decide which files belong together, with relative times the order of the files."""
    for k in (1, 2):
        run_of_files(tmp_path / "all", start + 100.0 * k * bool(start), prefix=f"run{k}_")
    guesses = guess_maps([tmp_path / "all"])
    assert [[path.name for path in guess.run.paths] for guess in guesses] == [
        [f"run{k}_{kind}.csv" for kind in ("ahrs", "esc", "gnss")] for k in (1, 2)
    ]
    assert list(signals_of(guesses[0].text)) == ["run*_ahrs.csv", "run*_esc.csv", "run*_gnss.csv"]
    assert f"the files in {tmp_path / 'all'} are 2 runs of several files; move each run" in guesses[0].assumed[-1]
    by_order = (
        "run1_ahrs.csv with run1_esc.csv, .*, run2_ahrs.csv with run2_gnss.csv: assumed to be of one run by their"
    )
    assert "then run `seatrial import MAP FOLDER...` with a folder of each run.\n" in guesses[0].text
    assert [bool(re.match(by_order, line)) for line in guesses[0].assumed] == ([False] if start else [True, False])
    with pytest.warns(SeatrialWarning) as warned:
        logs = st.import_log(tmp_path / "all", out_dir=tmp_path / "logs")
    assert [str(warning.message) for warning in warned][: len(guesses[0].assumed)] == guesses[0].assumed
    assert [log.name for log in logs] == ["run1.mcap", "run2.mcap"]
    for log in logs:
        assert_has_all_signals(log)


def test_a_second_sensor_of_equal_columns_is_left_out(tmp_path: Path) -> None:
    folder = run_of_files(tmp_path / "run1")
    (folder / "gnss_aft.csv").write_bytes((folder / "gnss.csv").read_bytes())
    (guess,) = guess_maps([folder])
    assert list(signals_of(guess.text)) == ["ahrs.csv", "esc.csv", "gnss.csv"]
    assert "gnss_aft.csv: left out, as it has the columns and the times of gnss.csv" in guess.assumed[0]


def test_a_file_without_a_signal_is_not_in_the_map(tmp_path: Path) -> None:
    folder = run_of_files(tmp_path / "run1")
    table(folder / "power.csv", START + 0.1 * np.arange(N), {"volt": np.full(N, 25.0)})
    text = guess_maps(sorted(folder.iterdir()))[0].text
    assert list(signals_of(text)) == ["ahrs.csv", "esc.csv", "gnss.csv"]
    assert "# not in the map, as no signal was recognised: power.csv\n" in text
    assert '# { name = "NAME", column = "volt", unit = "1" },' in text
    assert "run `seatrial import MAP FILE...` with all of them except power.csv.\n" in text
    (folder / "ahrs.csv").unlink()
    text = guess_maps(sorted(folder.iterdir()))[0].text
    assert "run `seatrial import MAP esc.csv gnss.csv`.\n" in text


def test_a_wrong_selection_of_files_names_them_with_their_folders(tmp_path: Path) -> None:
    folders = [run_of_files(tmp_path / f"run{k}") for k in (1, 2)]
    (map_path := tmp_path / "map.toml").write_text(guess_maps(folders)[0].text)
    one, two = folders
    files = [path for folder in folders for path in sorted(folder.iterdir())]
    with pytest.raises(SeatrialError) as caught:
        import_files(map_path, files, out_dir=tmp_path)
    assert str(caught.value).endswith(
        f"it matches: {one / 'ahrs.csv'}, {two / 'ahrs.csv'}; for several runs, give their folders: {one}, {two}"
    )
    (one / "esc.csv").unlink()
    with pytest.raises(SeatrialError, match=r"'esc\.csv' must match exactly one of the files in .*run1; correct it"):
        import_files(map_path, folders, out_dir=tmp_path)


def test_a_folder_of_folders_names_these(tmp_path: Path) -> None:
    for k in (1, 2):
        run_of_files(tmp_path / "data" / f"run{k}")
    with pytest.raises(SeatrialError, match=r"data: has no files; give the folders in it, .*: .*run1, .*run2$"):
        guess_maps([tmp_path / "data"])


@pytest.mark.parametrize(
    ("own", "others", "pattern"),
    [
        (["gnss.csv"], ["esc.csv"], "gnss.csv"),
        (["2026-06-01_gnss.csv"], ["2026-06-01_esc.csv"], "*_gnss.csv"),
        (["run1_gnss.csv", "run2_gnss.csv"], ["run1_esc.csv"], "run*_gnss.csv"),
        (["imu1.csv"], ["imu2.csv"], "imu1.csv"),
        (["a_x.csv", "b_x.csv"], ["a_y.csv"], "*_x.csv"),
        (["1.csv"], ["2.csv"], "1.csv"),
        (["x[1].csv"], [], "x[[]*].csv"),
    ],
)
def test_the_pattern_of_a_kind_of_file(own: list[str], others: list[str], pattern: str) -> None:
    assert match_pattern([*map(Path, own)], [*map(Path, others)]) == pattern
