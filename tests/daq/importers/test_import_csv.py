"""Tests of the import of CSV files with a map: times, gaps, pieces, and one line for each error in a file."""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.import_map import load_import_map, parse_import_map
from seatrial.daq.importers.write_log import replacing
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Scalar
from seatrial.ident.checks import invalidates_fit
from tests.bench.check_cases import findings
from tests.daq.csv_files import EXAMPLES, values, write


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_csv_file_becomes_a_log(folder: Path) -> None:
    csv_map, files = write(folder)
    (out,) = import_files(csv_map, files)
    assert out == Path("run.mcap")
    log = open_log(out)
    assert (log.complete, log.warnings, log.sources(Scalar)) == (True, [], ["n_left", "psi"])
    assert (log.unit("psi"), log.hold("psi"), log.role("psi")) == ("rad", "linear", "output")
    assert (log.unit("n_left"), log.hold("n_left"), log.role("n_left")) == ("1", "zero", "input")
    t, psi = values(out, "psi")
    assert t == [0.0, 0.1, 0.2]
    np.testing.assert_allclose(psi, np.radians([170.0, -170.0, -160.0]), atol=1e-15)
    assert values(out, "n_left")[1] == [0.5, 0.6, 0.7]
    assert log.attachments == {"import.toml": csv_map.read_bytes()}
    assert log.metadata["source.1.name"] == "run.csv"
    assert {"imported_by", "imported_on", "imported_at"} <= set(log.metadata)
    assert not {"operator", "host", "started"} & set(log.metadata)
    assert log.metadata["source.1.sha256"] == hashlib.sha256(files[0].read_bytes()).hexdigest()
    assert log.events() == [(0.0, "import", "run.csv by map.toml")]


def test_a_signal_may_have_its_own_clock_with_its_own_format(folder: Path) -> None:
    rows = "t,t_ms,cmd,heading\n0.0,100,0.5,170\n0.1,200,0.6,171\n"
    (out,) = import_files(*write(folder, rows, signal='time = "t_ms"\ntime_format = "ms"'))
    assert (values(out, "psi")[0], values(out, "n_left")[0]) == ([0.1, 0.2], [0.0, 0.1])
    wrong = (('time_format = "ms"', "needs `time`"), ('time = "t_ms"\ntime_format = "weeks"', "must be s,"))
    for signal, message in wrong:
        with pytest.raises(SeatrialError, match=rf"signal\[1\]\.time_format \(signal '\w+'\): {message}"):
            import_files(*write(folder, rows, signal=signal))


def test_the_import_never_replaces_its_sources(folder: Path) -> None:
    """The test also uses --force. The source could have the name of its log. The map must stay too."""
    csv_map, (file,) = write(folder)
    source = file.rename(folder / "run.mcap")
    (folder / "link.csv").symlink_to(source)
    (folder / "bag").mkdir()
    kept = [csv_map, source, folder / "link.csv"]
    before = [path.read_bytes() for path in kept]
    for out in (None, csv_map, folder / "link.csv"):
        with pytest.raises(SeatrialError, match="is the source of this import and is never replaced"):
            import_files(csv_map, [source], out=out, force=True)
    (folder / "bag/part.mcap").write_bytes(b"of a bag")
    with (
        pytest.raises(SeatrialError, match="never replaced"),
        replacing(folder / "bag/part.mcap", True, [folder / "bag"]),
    ):
        pass
    assert [path.read_bytes() for path in kept] == before
    assert (folder / "bag/part.mcap").read_bytes() == b"of a bag"
    import_files(csv_map, [source], out=folder / "log.mcap")
    import_files(csv_map, [source], out=folder / "log.mcap", force=True)


@pytest.mark.parametrize(
    ("signal", "degrees"),
    [
        ('angle = "unwrap"', [170.0, 190.0, 200.0]),
        ('angle = "wrap"\noffset = 20.0', [-170.0, -150.0, -140.0]),
        ("sign = -1\noffset = 10.0", [-180.0, 160.0, 150.0]),
        ("scale = 2.0\noffset = 1.0", [341.0, -339.0, -319.0]),
        ('scale = "4/2"\noffset = "-1 / -1"', [341.0, -339.0, -319.0]),
    ],
)
def test_scale_offset_sign_and_angle_units_are_applied(folder: Path, signal: str, degrees: list[float]) -> None:
    (out,) = import_files(*write(folder, signal=signal))
    np.testing.assert_allclose(values(out, "psi")[1], np.radians(degrees), atol=1e-14)


def test_wrap_includes_plus_pi_and_not_minus_pi(folder: Path) -> None:
    rows = "t,cmd,heading\n0,0,180\n1,0,-180\n2,0,540\n"
    (out,) = import_files(*write(folder, rows, signal='angle = "wrap"'))
    np.testing.assert_allclose(values(out, "psi")[1], [np.pi] * 3)


@pytest.mark.parametrize(
    ("time", "cells", "seconds"),
    [
        ('format = "ms"', ["2168103.825", "2168203.825"], [2168.103825, 2168.203825]),
        ('format = "us"', ["5", "7"], [5e-6, 7e-6]),
        ('format = "ns"', ["1500000000", "1600000000"], [1.5, 1.6]),
        ('origin = "1970-01-01T00:01:00Z"', ["1", "2"], [61.0, 62.0]),
        ('format = "iso"', ["2025-04-28T11:39:16.25Z", "2025-04-28T13:39:16.5+02:00"], [1745840356.25, 1745840356.5]),
        (
            'format = "%Y/%m/%d %H:%M:%S"\nfraction = "decimal"',
            ["2025/04/28 11:39:16.194751656", "2025/04/28 11:39:17"],
            [1745840356.194751656, 1745840357.0],
        ),
        (
            'format = "%Y/%m/%d %H:%M:%S"\nfraction = "unpadded-ns"',
            ["2025/04/28 11:39:16.994751656", "2025/04/28 11:39:17.99684877"],
            [1745840356.994751656, 1745840357.099684877],
        ),
        ('fraction = "unpadded-ns"', ["16.994751656", "17.99684877"], [16.994751656, 17.099684877]),
    ],
)
def test_each_time_format_is_read(folder: Path, time: str, cells: list[str], seconds: list[float]) -> None:
    rows = "t,cmd,heading\n" + "".join(f"{cell},0,0\n" for cell in cells)
    (out,) = import_files(*write(folder, rows, time=time))
    np.testing.assert_allclose(values(out, "psi")[0], seconds, rtol=0, atol=2.5e-7)


def test_a_file_with_decimal_commas_and_semicolons_is_read(folder: Path) -> None:
    rows = "made by X\nt;cmd;heading\n0,5;1,0;90\n\n1,5;2,0;91,5\n"
    style = 'delimiter = ";"\ndecimal = ","\nskip_rows = 1'
    (out,) = import_files(*write(folder, "\ufeff" + rows, csv=style))
    np.testing.assert_allclose(values(out, "psi")[1], np.radians([90.0, 91.5]))
    assert values(out, "n_left") == ([0.5, 1.5], [1.0, 2.0])


def test_a_file_without_header_is_read(folder: Path) -> None:
    (out,) = import_files(*write(folder, "0,1,2\n1,2,3\n", csv='columns = ["t", "cmd", "heading"]'))
    assert values(out, "n_left") == ([0.0, 1.0], [1.0, 2.0])


GAPS = "t,cmd,heading\n0.0,1,1\n0.1,,2\n0.2,3,nan\n0.3,4,4\n"


def test_cells_without_a_number_are_left_out(folder: Path) -> None:
    with pytest.raises(SeatrialError, match=r"run\.csv: line 4, column 'heading': there is no number; nan = \"drop\""):
        import_files(*write(folder, GAPS))
    (out,) = import_files(*write(folder, GAPS, csv='nan = "drop"'))
    assert values(out, "n_left") == ([0.0, 0.2, 0.3], [1.0, 3.0, 4.0])
    assert len(values(out, "psi")[0]) == 3
    assert open_log(out).metadata["source.1.dropped"] == "2"
    (out,) = import_files(*write(folder, GAPS, csv='nan = "keep"', signal='angle = "unwrap"'), force=True)
    assert np.isnan(values(out, "psi")[1]).tolist() == [False, False, True, False]
    (out,) = import_files(*write(folder, GAPS, csv='nan = "drop"', signal='nan = "keep"'), force=True)
    assert (len(values(out, "psi")[0]), len(values(out, "n_left")[0])) == (4, 3)


def test_a_number_that_marks_a_missing_measurement_is_left_out(folder: Path) -> None:
    text = "t,cmd,heading\n0.0,1,10\n0.1,2,-999\n0.2,-999,30\n"
    (out,) = import_files(*write(folder, text, signal="missing = -999"))
    assert len(values(out, "psi")[0]) == 2
    assert values(out, "n_left") == ([0.0, 0.1, 0.2], [1.0, 2.0, -999.0])  # only in this column
    assert open_log(out).metadata["source.1.dropped"] == "1"


def test_a_number_that_marks_rest_becomes_zero(folder: Path) -> None:
    """A missing pulse is no measurement of the pulse, but the thruster stands. The last command must not hold on."""
    csv_map, files = write(folder, "t,cmd,heading\n0,1900,1\n1,0,2\n2,0,3\n")
    csv_map.write_text(csv_map.read_text() + "scale = 0.0025\noffset = -3.75\nmissing = 0\nmissing_is = 0\n")
    (out,) = import_files(csv_map, files)
    assert values(out, "n_left") == ([0.0, 1.0, 2.0], [1.0, 0.0, 0.0])
    assert open_log(out).metadata["source.1.dropped"] == "0"
    (out,) = import_files(*write(folder, signal="missing = -170\nmissing_is = 90"), force=True)
    np.testing.assert_allclose(values(out, "psi")[1], np.radians([170.0, 90.0, -160.0]))  # in the unit of the signal


def test_rows_with_repeated_or_decreasing_times_are_omitted(folder: Path) -> None:
    repeats = "t,cmd,heading\n0.0,1,1\n0.1,2,2\n0.1,3,3\n0.2,4,4\n"
    with pytest.raises(SeatrialError, match=r"line 4, column 't': time repeats; csv\.time_order = \"drop\""):
        import_files(*write(folder, repeats))
    backwards = "t,cmd,heading\n0.0,1,1\n0.5,2,2\n0.1,3,3\n0.4,4,4\n0.6,5,5\n"
    with pytest.raises(SeatrialError, match=r"line 4, column 't': time runs back by 0\.4 s"):
        import_files(*write(folder, backwards))
    with pytest.warns(SeatrialWarning, match=r"run\.csv: 1 row of \d+ left out, because times repeat or run back"):
        (out,) = import_files(*write(folder, backwards, csv='time_order = "drop"'))
    assert values(out, "n_left") == ([0.0, 0.1, 0.4, 0.6], [1.0, 3.0, 4.0, 5.0])
    with pytest.warns(SeatrialWarning, match=r"1 row of \d+ left out"):
        (out,) = import_files(*write(folder, repeats, csv='time_order = "drop"'), force=True)
    assert values(out, "n_left") == ([0.0, 0.1, 0.2], [1.0, 2.0, 4.0])  # the first of the repeated rows


def test_a_single_wrong_time_removes_a_single_row(folder: Path) -> None:
    rows = "t,cmd,heading\n" + "".join(f"{5000 if k == 50 else k},0,{k}\n" for k in range(100))
    with pytest.warns(SeatrialWarning, match=r"1 row of \d+ left out"):
        (out,) = import_files(*write(folder, rows, csv='time_order = "drop"'))
    assert values(out, "psi")[0] == [float(k) for k in range(100) if k != 50]
    log = open_log(out)
    assert (log.metadata["source.1.dropped"], log.metadata["source.1.disordered"]) == ("1", "1")


def test_a_signal_without_a_sample_is_named(folder: Path) -> None:
    with pytest.warns(
        SeatrialWarning, match=r"run\.csv: not in the log, because they have no samples: psi; check their"
    ):
        (out,) = import_files(*write(folder, "t,cmd,heading\n0,1,\n1,2,nan\n", csv='nan = "drop"'))
    assert open_log(out).sources(Scalar) == ["n_left"]


def test_times_of_day_continue_after_midnight(folder: Path) -> None:
    """Times count from 1970-01-01, or from the day of `origin`, and continue after midnight."""
    rows = "t,cmd,heading\n11:00:00,0,1\n23:59:59,0,2\n00:00:01,0,3\n11:00:00,0,4\n"
    seconds = np.array([39600.0, 86399.0, 86401.0, 126000.0])
    (out,) = import_files(*write(folder, rows, time='format = "%H:%M:%S"'))
    assert values(out, "psi")[0] == seconds.tolist()
    (out,) = import_files(*write(folder, rows, time='format = "%H:%M:%S"\norigin = "2025-05-01"'), force=True)
    assert values(out, "psi")[0] == (1746057600.0 + seconds).tolist()


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        (
            "time,cmd,heading\n0,1,2\n",
            "column 't' is not in the header; name one of these in the import map: time, cmd, heading",
        ),
        ("t,cmd,heading,cmd\n0,1,2,3\n", "column 'cmd' appears twice in the header"),
        ("t,cmd,heading\n0,x1,2\n", "line 2, column 'cmd': 'x1' is not a number"),
        ("t,cmd,heading\n0,1_0,2\n", "line 2, column 'cmd': '1_0' is not a number"),
        ("t,cmd,heading\n0,1,2\n1,1e999,2\n", "line 3, column 'cmd': '1e999' is not a finite number"),
        ("t,cmd,heading\n,1,2\n", "line 2, column 't': there is no time; remove this line of the table"),
        ("t,cmd,heading\n0,1,2\n1,2\n", "line 3: 2 values, but the header has 3"),
        # a cell has two lines: lines are counted as in an editor
        ('t,cmd,heading\n0," 1\n",2\n1,2,z\n', "line 4, column 'heading': 'z' is not a number"),
        ("t,cmd,heading\n", "no lines with data below the header"),
        ("", "the file is empty"),
        (
            "t,cmd,heading\n-1e8,1,2\n",
            "its first time is negative, -100000000 s, but times must be",
        ),
        ("t,cmd,heading\n-5,1,2\n1.7e9,1,2\n", "its first time is negative, -5 s, but times must be between 1970 and"),
        ("t,cmd,heading\n1e12,1,2\n", "times must be between 1970 and 2038"),
    ],
)
def test_an_error_in_a_csv_file_gives_a_one_line_error(folder: Path, rows: str, line: str) -> None:
    with pytest.raises(SeatrialError, match=re.escape(line)) as caught:
        import_files(*write(folder, rows))
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in folder.iterdir()) == ["map.toml", "run.csv"]


def test_relative_times_that_begin_below_zero_are_shifted_as_a_whole(folder: Path) -> None:
    rows = "t,cmd,heading\n-5.25,0.1,1\n-5,0.2,2\n0,0.3,3\n1.5,0.4,4\n"
    with pytest.warns(
        SeatrialWarning, match=r"run\.csv: its times begin at -5\.25 s, before zero.* 5\.25 s are added"
    ) as got:
        (out,) = import_files(*write(folder, rows))
    assert len(got) == 1
    log = open_log(out)
    assert values(out, "psi")[0] == values(out, "n_left")[0] == [0.0, 0.25, 5.25, 6.75]
    assert log.metadata["import.time_shift_s"] == "5.25"
    # A clock event would be reported as a clock that was set back.
    assert log.events() == [(0.0, "import", "run.csv by map.toml, times shifted by 5.25 s")]


def test_times_that_the_pieces_leave_out_do_not_shift_a_log(folder: Path) -> None:
    """The pieces of a file have one shift, so that they can be placed on one axis of time."""
    rows = "t,cmd,heading\n-5,0.1,1\n-4,0.2,2\n1,0.3,3\n2,0.4,4\n"
    csv_map, files = write(folder, rows)
    text = csv_map.read_text(encoding="utf-8")
    csv_map.write_text(text + '\n[[log]]\nname = "after"\nt_from = 0.5\n', encoding="utf-8")
    (out,) = import_files(csv_map, files)
    assert values(out, "psi")[0] == [1.0, 2.0]
    assert "import.time_shift_s" not in open_log(out).metadata
    pieces = '\n[[log]]\nname = "before"\nt_to = -3.5\n[[log]]\nname = "after"\nt_from = 0.5\n'
    csv_map.write_text(text + pieces, encoding="utf-8")
    with pytest.warns(SeatrialWarning, match="5 s are added to all times"):
        before, after = import_files(csv_map, files, force=True)
    assert (values(before, "psi")[0], values(after, "psi")[0]) == ([0.0, 1.0], [6.0, 7.0])


def test_files_of_one_log_are_shifted_by_the_same_amount(folder: Path) -> None:
    (folder / "a.csv").write_text("t,cmd\n-3,0.1\n1,0.2\n", encoding="utf-8")
    (folder / "b.csv").write_text("t_ms,heading\n-1500,1\n2000,2\n", encoding="utf-8")
    lines = 'format = "seatrial-import 1"\nname = "both"\n[[file]]\nmatch = "a.csv"\ntime = { column = "t" }\n'
    lines += 'signal = [{ name = "n_left", column = "cmd", unit = "1", role = "input" }]\n[[file]]\nmatch = "b.csv"\n'
    lines += (
        'time = { column = "t_ms", format = "ms" }\nsignal = [{ name = "psi", column = "heading", unit = "deg" }]\n'
    )
    (folder / "map.toml").write_text(lines, encoding="utf-8")
    files = [folder / "a.csv", folder / "b.csv"]
    with pytest.warns(SeatrialWarning, match="3 s are added"):
        (out,) = import_files(folder / "map.toml", files)
    assert (values(out, "n_left")[0], values(out, "psi")[0]) == ([0.0, 4.0], [1.5, 5.0])
    # With dates in one of the files there is no common relative clock.
    dated = lines.replace('format = "ms" }', 'format = "ms", origin = "2025-05-01" }')
    (folder / "map.toml").write_text(dated, encoding="utf-8")
    with pytest.raises(SeatrialError, match="its first time is negative, -3 s"):
        import_files(folder / "map.toml", files, force=True)


def test_bytes_that_are_not_text_are_refused(folder: Path) -> None:
    csv_map, files = write(folder)
    files[0].write_bytes(b"t,cmd,heading\n0,1,\xff\xfe\n")
    with pytest.raises(SeatrialError, match=r"run\.csv: is not UTF-8 text"):
        import_files(csv_map, files)
    files[0].write_bytes(b't,cmd,heading\n0,1,"' + b"9" * 300_000)
    with pytest.raises(SeatrialError, match=r"run\.csv: is not a CSV file: field larger"):
        import_files(csv_map, files)


def test_an_invalid_iso_time_is_refused(folder: Path) -> None:
    with pytest.raises(SeatrialError, match="line 2, column 't': 'noon' is not a time of format iso"):
        import_files(*write(folder, "t,cmd,heading\nnoon,1,2\n", time='format = "iso"'))
    with pytest.raises(SeatrialError, match=r"'1\.5x' is not a time of format s"):
        import_files(*write(folder, "t,cmd,heading\n1.5x,1,2\n", time='fraction = "decimal"'))


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('unit = "deg"', 'unit = "degs"', r"signal\[1\]\.unit \(signal '\w+'\): 'degs' is not a known unit"),
        ('unit = "deg"', 'unit = "m"\nangle = "wrap"',
         r"signal\[1\]\.angle \(signal '\w+'\): works only with a unit of angle \(deg, rad\), not m"),
        ('column = "t"', 'colum = "t"', r"time\.column: give one of column and rate_hz"),
        ('name = "psi"', 'name = "n_left"',
         r"signal: 'n_left' appears twice .*, as signal\[1\] \(heading\) and as signal\[2\] \(cmd\); .*: n_cmd_left "),
        ('unit = "deg"', 'unit = "deg"\nmissing_is = 0', r"signal\[1\]\.missing_is \(signal '\w+'\): needs `missing`"),
        ('name = "psi"', 'name = "p/si"', r"signal\[1\]\.name: 'p/si' is not a valid name"),
        ('column = "t"', 'column = "t"\nformat = "weeks"', r"time\.format: must be s, ms, us, ns, min, h, day, iso"),
        ('column = "t"', 'column = "t"\nformat = "gps"', r"time\.format: gps needs `date`, the name of the column"),
        ('column = "t"', 'column = "t"\ndate = "day"', r"time\.date: works only with format iso, gps, .*, not s"),
        ('column = "t"', 'column = "t"\norigin = "today"', r"time\.origin: must be an ISO date and .* not 'today'"),
        ("[time]", "[tims]", r"tims: unknown key"),
        ('column = "t"', 'colum = "t"', r"rate_hz; the table has 'colum': rename it to 'column'"),
        ('column = "heading"', 'colum = "heading"', r"signal\[1\]\.column \(signal '\w+'\): missing; the table has"),
        ("[csv]", "[geometry]\ny_left = -25.0\ny_right = 25.0\nlength = 1.2\n[csv]",
         r"geometry\.y_left: 25 m from the middle of a hull of 1\.2 m; write positions in metres"),
        ("[csv]", "[geometry]\nx_thrusters = -45.0\nlength = 1.2\n[csv]",
         r"geometry\.x_thrusters: 45 m from the middle of a hull of 1\.2 m; write positions in metres, positive"),
        ("[csv]", "[geometry]\nlever_arm_sd = 0.1\n[csv]", r"lever_arm_sd: is the standard uncertainty of lever_arm_m"),
        ("[csv]", "[geometry]\nlever_arm_m = [0.1, 0, 0]\nlever_arm_sd = 0\n[csv]", r"lever_arm_sd: must be above"),
        ("[csv]", "[geometry]\nx_thrusters_sd = 0.1\n[csv]", r"x_thrusters_sd: is the standard uncertainty of x_th"),
        ("[csv]", '[csv]\ndelimiter = ", "', r"csv\.delimiter: must be one character"),
        ("[csv]", '[csv]\ndecimal = ","', r"csv\.decimal: is also the delimiter"),
        ('role = "input"', 'role = "input"\nsign = 2', r"signal\[2\]\.sign \(signal '\w+'\): must be 1 or -1"),
        ("[csv]", '[[log]]\nname = "a"\nt_from = 3\nt_to = 2\n[csv]', r"log\[1\]\.t_to: must be later than t_from"),
        ('unit = "deg"', 'unit = "deg"\nscale = "1:2200"',
         r"signal\[1\]\.scale \(signal '\w+'\): must be a number, or a fraction of two numbers such as '1/2200', not"),
        ('unit = "deg"', 'unit = "deg"\nscale = "1/0"', r"scale .*: must be a number, or .*, not '1/0'"),
        ('unit = "deg"', 'unit = "deg"\nscale = "1/2/3"', r"scale .*: must be a number, or .*, not '1/2/3'"),
        ('unit = "deg"', 'unit = "deg"\noffset = "inf/2"', r"offset .*: must be a number, or .*, not 'inf/2'"),
        ("[csv]", "[scale]\nc1 = -12.0\n[csv]", r"scale\.c1: must be positive, not -12"),
        ("[csv]", "[scale]\nc1 = 6.85\nc2 = 12.0\n[csv]", r"scale\.c2: 12 N is not smaller than c1 = 6\.85 N: the"),
        ("[csv]", "[scale]\nc1_sd = 0.3\n[csv]", r"scale\.c1_sd: is the standard uncertainty of c1; give c1 too"),
        ("[csv]", "[scale]\nC1 = 6.0\n[csv]", r"did you mean 'c1'\? Known here: ahead, astern, "),
        ("[csv]", "[scale]\nahead = 6.0\nc2 = 1.0\n[csv]", r"scale\.c2: follows from ahead and astern; give either"),
        ("[csv]", "[scale]\nastern = 6.0\n[csv]", r"scale\.ahead: missing; give the thrust of one thruster at full"),
        ("[csv]", "[scale]\nahead = 6.0\nastern = 5.0\nahead_sd = 0.2\n[csv]", r"scale\.astern_sd: missing; give"),
        ("[csv]", "[scale]\nahead = 6.0\nastern = -5.0\n[csv]", r"scale\.astern: "),
        ("[csv]", "[scale]\nc1 = 6.0\nc2 = -6.0\n[csv]", r"scale\.c2: -6 N is not smaller than c1 = 6 N: the thrust"),
        ("[csv]", "[scale]\nthrust = 12.0\n[csv]", r"scale\.thrust: unknown key"),
        ("[csv]", "[geometry]\ny_left = 0.2\ny_right = -0.2\n[csv]", r"geometry\.y_left: must be less than y_right"),
        ("[csv]", "[csv]\nskiprows = 2", r"csv\.skiprows: unknown key 'skiprows'; did you mean 'skip_rows'\?"),
    ],
)  # fmt: skip
def test_an_invalid_import_map_gives_a_one_line_error(folder: Path, old: str, new: str, line: str) -> None:
    path, _ = write(folder)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(SeatrialError, match=line) as caught:
        load_import_map(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_two_signals_with_the_same_name_in_the_log_are_refused(folder: Path) -> None:
    csv_map, files = write(folder)
    text = csv_map.read_text().replace('"deg"', '"m"').replace('"n_left"', '"y"')
    csv_map.write_text(text.replace('name = "psi"', 'name = "x"\nframe = "ENU"'))
    with pytest.raises(SeatrialError, match=r"signal: 'y' appears twice \(after conversion to NED\)"):
        import_files(csv_map, files)


def test_pieces_begin_with_the_command_that_holds(folder: Path) -> None:
    path, files = write(folder, "t,cmd,heading\n0,0.1,0\n1,0.2,10\n2,0.3,20\n3,0.4,30\n")
    pieces = '[[log]]\nname = "a"\nt_from = 0.5\nt_to = 2\n[[log]]\nname = "b"\nt_from = 3\n'
    path.write_text(path.read_text() + pieces)
    a, b = import_files(path, files, out_dir=folder / "logs")
    assert (a.name, b.name) == ("run_a.mcap", "run_b.mcap")
    assert values(a, "n_left") == ([0.5, 1.0, 2.0], [0.1, 0.2, 0.3])
    assert values(a, "psi")[0] == [1.0, 2.0]
    assert values(b, "n_left") == ([3.0], [0.4])
    with pytest.raises(SeatrialError, match="-o names one log, but this import makes 2; use --out-dir"):
        import_files(path, files, out=folder / "x.mcap")


def test_merged_files_must_each_have_their_part(folder: Path) -> None:
    path = EXAMPLES / "kingfisher" / "surge.toml"
    one, two = folder / "surge_1_cmd.csv", folder / "surge_1_odomvel.csv"
    one.write_text("t_s,cmd_left,cmd_right\n49.4,0.1,0.2\n50.4,0.3,0.4\n")
    two.write_text("t_s,vel_x,vel_y\n0.0,0.5,0\n49.5,0.6,-0.1\n")
    (out,) = import_files(path, [two, one])
    assert out.name == "surge.mcap"
    assert open_log(out).sources(Scalar) == ["n_left", "n_right", "speed_x", "speed_y"]
    assert values(out, "n_right") == ([49.4, 50.4], [0.2, 0.4])
    assert values(out, "speed_y") == ([0.0, 49.5], [0.0, -0.1])
    with pytest.raises(
        SeatrialError,
        match=r"'surge_\*_odomvel\.csv' must match exactly one of the given files; correct it, as it matches: none",
    ):
        import_files(path, [one], force=True)
    notes = folder / "notes.csv"
    notes.write_text("a\n1\n")
    with pytest.raises(SeatrialError, match=r"notes\.csv must match exactly one \[\[file\]\], and it matches 0"):
        import_files(path, [one, two, notes], force=True)


def test_repeated_values_are_left_out(folder: Path) -> None:
    rows = "t,cmd,heading\n0.0,0.5,10\n0.1,0.5,10\n0.2,0.5,11\n0.3,0.6,11\n0.4,0.6,11\n0.5,0.6,10\n"
    csv_map, files = write(folder, rows, csv='repeats = "drop"')
    (out,) = import_files(csv_map, files)
    assert values(out, "n_left") == ([0.0, 0.2, 0.3, 0.5], [0.5, 0.5, 0.6, 0.6])
    assert open_log(out).metadata["source.1.dropped"] == "2"
    csv_map, files = write(folder, rows)
    (out,) = import_files(csv_map, files, force=True)
    assert len(values(out, "n_left")[0]) == 6


def test_a_command_that_is_not_repeated_times_out(folder: Path) -> None:
    rows = "t,cmd,heading\n0.0,0.5,1\n0.1,0.5,1\n2.0,0.6,1\n2.1,0.7,1\n"
    csv_map, files = write(folder, rows)
    csv_map.write_text(csv_map.read_text() + "timeout = 0.25\n")
    (out,) = import_files(csv_map, files)
    assert values(out, "n_left") == ([0.0, 0.1, 0.35, 2.0, 2.1, 2.35], [0.5, 0.5, 0.0, 0.6, 0.7, 0.0])
    assert len(values(out, "psi")[0]) == 4
    csv_map, files = write(folder, rows, signal="timeout = 0.25")
    with pytest.raises(SeatrialError, match=r"timeout.* needs hold"):
        import_files(csv_map, files, force=True)


def test_times_of_one_signal_are_shifted(folder: Path) -> None:
    """A logger that stores the command after the shaft speed writes it one row late."""
    rows = "t,cmd,heading\n" + "".join(f"{1 + 0.1 * k:.1f},{0.1 * k:.1f},{k}\n" for k in range(6))
    csv_map, files = write(folder, rows)
    csv_map.write_text(csv_map.read_text() + "time_shift = -0.1\n")
    (out,) = import_files(csv_map, files)
    (t_command, _), (t_heading, _) = values(out, "n_left"), values(out, "psi")
    assert len(t_command) == len(t_heading) == 6
    np.testing.assert_allclose(np.subtract(t_heading, t_command), 0.1, atol=1e-9)


def test_a_shift_that_the_map_asks_for_gives_no_warning(folder: Path) -> None:
    """The first command is before zero by its own shift only; all times of the log are later by it, without a word."""
    rows = "t,cmd,heading\n" + "".join(f"{0.05 * k:.2f},{0.1 * k:.1f},{k}\n" for k in range(6))
    csv_map, files = write(folder, rows)
    csv_map.write_text(csv_map.read_text() + "time_shift = -0.05\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (out,) = import_files(csv_map, files)
    np.testing.assert_allclose(values(out, "n_left")[0], 0.05 * np.arange(6), atol=1e-9)
    np.testing.assert_allclose(values(out, "psi")[0], 0.05 * np.arange(1, 7), atol=1e-9)
    assert open_log(out).metadata["import.time_shift_s"] == "0.05"


def test_repeats_that_are_left_out_extend_a_command(folder: Path) -> None:
    rows = "t,cmd,heading\n" + "".join(f"{0.1 * k:.1f},0.5,1\n" for k in (0, 1, 2, 3, 9, 10))
    csv_map, files = write(folder, rows, csv='repeats = "drop"')
    csv_map.write_text(csv_map.read_text() + "timeout = 0.15\n")
    (out,) = import_files(csv_map, files)
    t, n = values(out, "n_left")
    np.testing.assert_allclose(t, [0.0, 0.1, 0.2, 0.3, 0.45, 0.9, 1.0, 1.15], atol=1e-9)
    assert n == [0.5, 0.5, 0.5, 0.5, 0.0, 0.5, 0.5, 0.0]
    assert len(values(out, "psi")[0]) == 1
    assert open_log(out).metadata["source.1.dropped"] == "5"


def test_the_time_column_of_a_signal_has_the_common_format(folder: Path) -> None:
    rows = "t,t2,cmd,heading\n17.5,17.99684877,0,1\n18.5,18.99684877,0,2\n"
    (out,) = import_files(*write(folder, rows, time='fraction = "unpadded-ns"', signal='time = "t2"'))
    np.testing.assert_allclose(values(out, "psi")[0], [17.099684877, 18.099684877], atol=1e-7)


def test_a_piece_contains_the_command_that_holds_at_both_ends(folder: Path) -> None:
    csv_map, files = write(folder, "t,cmd,heading\n" + "".join(f"{k},{k},{k}\n" for k in range(10)))
    csv_map.write_text(csv_map.read_text() + '[[log]]\nname = "a"\nt_from = 2.5\nt_to = 4.5\n')
    (out,) = import_files(csv_map, files)
    assert values(out, "n_left") == ([2.5, 3.0, 4.0, 4.5], [2.0, 3.0, 4.0, 4.0])
    assert values(out, "psi")[0] == [3.0, 4.0]
    # After the last command the value is unknown.
    csv_map.write_text(csv_map.read_text().replace("t_to = 4.5", "t_to = 20.0"))
    (out,) = import_files(csv_map, files, force=True)
    assert values(out, "n_left")[0][-1] == 9.0


def test_the_import_command_writes_a_log(folder: Path) -> None:
    path, files = write(folder)
    run = CliRunner()
    arguments = [str(path), str(files[0]), "--out-dir", "logs"]
    done = run.invoke(cli.import_, arguments, catch_exceptions=False)
    assert (done.exit_code, done.stdout) == (0, "logs/run.mcap\n")
    with pytest.raises(SeatrialError, match="the file exists already; --force replaces it"):
        run.invoke(cli.import_, arguments, catch_exceptions=False)
    assert run.invoke(cli.import_, [*arguments, "--force"], catch_exceptions=False).exit_code == 0
    assert run.invoke(cli.import_, [*arguments, "-o", "x.mcap"]).exit_code == 2
    assert os.listdir("logs") == ["run.mcap"]


def shuffled(n: int = 400) -> str:
    """Return rows at 10 Hz in random order."""
    order = np.random.default_rng(1).permutation(n)
    return "t,cmd,heading\n" + "".join(f"{0.1 * k:.1f},0,{k % 90}\n" for k in order)


def test_a_mass_in_grams_is_named_at_the_import_and_in_the_check(folder: Path) -> None:
    csv_map, files = write(folder)
    text = csv_map.read_text()
    csv_map.write_text(text.replace("[csv]", "[geometry]\nlength = 1.5\nmass = 17400.0\n[csv]"))
    problem = "mass = 17400 kg, but boats of length = 1.5 m weigh 1.7 to 1700 kg"
    with pytest.warns(SeatrialWarning, match=rf"map\.toml: {problem}; correct mass \[kg\] or length"):
        (out,) = import_files(csv_map, files)
    (found,) = [f for f in findings(out) if f.code == "mass-of-length"]
    assert (found.level, found.text) == ("warning", problem)


def test_an_antenna_beyond_the_boat_is_refused(folder: Path) -> None:
    csv_map, files = write(folder)
    geometry = "[geometry]\nlength = 1.6\nlever_arm_m = [200, 50, 0]\n[csv]"
    csv_map.write_text(csv_map.read_text().replace("[csv]", geometry))
    problem = r"lever_arm_m: antenna: 200 m ahead of the centre of gravity, but the length is 1.6 m; write positions"
    with pytest.raises(SeatrialError, match=problem):
        import_files(csv_map, files)


def test_shuffled_rows_are_a_fault(folder: Path) -> None:
    csv_map, files = write(folder, shuffled(), csv='time_order = "drop"')
    with pytest.raises(SeatrialError, match=r"\d+ rows of 400 left out, because times repeat .* sort the rows"):
        import_files(csv_map, files)
    assert CliRunner().invoke(cli.import_, [str(csv_map), *map(str, files), "--force"]).exit_code != 0
    (found,) = [f for f in findings(folder / "run.mcap") if f.code == "rows-left-out"]
    assert found.level == "fault"
    assert invalidates_fit(found)


def test_two_clocks_in_one_column_are_a_fault(folder: Path) -> None:
    rows = "t,cmd,heading\n" + "".join(f"{100 + 0.1 * k - 3.0 * (k % 2):.1f},0,{k % 90}\n" for k in range(400))
    with pytest.raises(SeatrialError, match=r"200 rows of \d+ left out"):
        import_files(*write(folder, rows, csv='time_order = "drop"'))


def test_two_receivers_with_equal_times_in_one_table_are_named(folder: Path) -> None:
    """The receivers have 5 Hz and 1 Hz. The former advice, a rate, is right only for coarse stamps."""
    rows = "t,cmd,heading\n"
    for k in range(400):
        rows += f"{0.2 * k:.1f},0,{k % 90}\n" + (f"{0.2 * k:.1f},0,{k % 90 + 5}\n" if k % 5 == 0 else "")
    with pytest.raises(SeatrialError, match="two receivers or sensors write into one table"):
        import_files(*write(folder, rows, csv='time_order = "drop"'))
    (found,) = [f for f in findings(folder / "run.mcap") if f.code == "rows-left-out"]
    assert "two receivers or sensors of unequal rate" in found.advice


@pytest.mark.parametrize("rate", [4.0, 10.0, 12.5])
def test_stamps_in_whole_seconds_need_a_rate(folder: Path, rate: float) -> None:
    rows = "time,cmd,heading\n" + "".join(f"{50 + int(k / rate)},0,{k % 90}\n" for k in range(round(60 * rate)))
    csv_map, (file,) = write(folder, rows)
    csv_map.write_text(csv_map.read_text().replace('column = "t"', 'column = "time"'))
    with pytest.raises(SeatrialError, match=r"too coarse: time = \{ rate_hz = ") as caught:
        import_files(csv_map, [file])
    suggested = float(str(caught.value).partition("rate_hz = ")[2].split()[0])
    assert suggested == pytest.approx(rate, rel=0.03)
    text = guess_map(file).text
    assert "caveat: the stamps of 'time' are coarser than the rows" in text
    assert float(text.partition("rate_hz = ")[2].split()[0]) == pytest.approx(rate, rel=0.01)


def test_a_clock_named_in_the_map_is_used_although_out_of_order(folder: Path) -> None:
    path = folder / "run.csv"
    path.write_text(shuffled().replace("t,", "time,", 1))
    assert 'column = "time"' in guess_map(path).text


def test_a_date_in_whole_seconds_keeps_its_day(folder: Path) -> None:
    rows = "time,cmd,heading\n" + "".join(f"2025-05-01 12:00:{k // 10:02d},0,{k % 90}\n" for k in range(3, 300))
    (folder / "run.csv").write_text(rows)
    (folder / "guess.toml").write_text(guess_map(folder / "run.csv").text)
    (out,) = import_files(folder / "guess.toml", [folder / "run.csv"])
    t = np.array(values(out, "psi")[0])
    np.testing.assert_allclose(t[[0, -1]], np.array([0.3, 29.9]) + 1746100800.0, atol=0.06)


def test_rows_of_several_sensors_may_share_their_times(folder: Path) -> None:
    """Each row is a message with the cells of one sensor. No cell is lost, and the rows are in order."""
    rows = "t,cmd,heading\n" + "".join(f"{0.1 * k:.1f},,{k % 90}\n{0.1 * k:.1f},{k % 7},\n" for k in range(200))
    (out,) = import_files(*write(folder, rows, csv='time_order = "drop"\nnan = "drop"'))
    assert (len(values(out, "psi")[0]), len(values(out, "n_left")[0])) == (200, 200)
    assert not [f for f in findings(out) if f.code == "rows-left-out"]


def test_a_signal_without_a_value_is_left_out_with_a_warning(folder: Path) -> None:
    """The times are out of order as well."""
    rows = "t,cmd,heading\n" + "".join(f"{0.1 * (k + (k == 9)):.1f},,{k % 90}\n" for k in range(200))
    with (
        pytest.warns(SeatrialWarning, match="not in the log, because they have no samples: n_left"),
        pytest.warns(SeatrialWarning, match="1 row of 200 left out, because times repeat"),
    ):
        (out,) = import_files(*write(folder, rows, csv='time_order = "drop"\nnan = "drop"'))
    assert len(values(out, "psi")[0]) == 199


def test_rows_written_twice_are_not_counted_as_lost(folder: Path) -> None:
    rows = "t,cmd,heading\n" + "".join(2 * f"{0.1 * k:.1f},{k % 7},{k % 90}\n" for k in range(200))
    (out,) = import_files(*write(folder, rows, csv='time_order = "drop"'))
    assert len(values(out, "psi")[0]) == 200
    assert not [f for f in findings(out) if f.code == "rows-left-out"]


def test_an_interval_may_be_cut_from_some_of_the_files_only(folder: Path) -> None:
    path, (first,) = write(folder, "t,cmd,heading\n0,0.1,0\n1,0.2,10\n2,0.3,20\n")
    second, third = folder / "other.csv", folder / "third.csv"
    for copy in (second, third):
        copy.write_text(first.read_text())
    text = path.read_text()
    pieces = '[[log]]\nname = "a"\nmatch = "run*"\nt_to = 1\n[[log]]\nname = "a"\nmatch = "other.csv"\nt_from = 1\n'
    path.write_text(text + pieces)
    logs = import_files(path, [first, second, third], out_dir=folder / "logs")
    assert [log.name for log in logs] == ["run_a.mcap", "other_a.mcap", "third.mcap"]
    assert [values(log, "psi")[0] for log in logs] == [[0.0, 1.0], [1.0, 2.0], [0.0, 1.0, 2.0]]
    with pytest.warns(SeatrialWarning, match=r"\[\[log\]\] match = 'other.csv' matches none of the given files"):
        (one,) = import_files(path, [first], out=folder / "one.mcap")
    assert values(one, "psi")[0] == [0.0, 1.0]


def test_an_interval_without_a_run_is_cut_from_those_with_its_times(folder: Path) -> None:
    """The commands hold, but a held value alone makes no log of a run that ended before."""
    path, (first,) = write(folder, "t,cmd,heading\n0,0.1,0\n1,0.2,10\n2,0.3,20\n")
    second, third = folder / "b.csv", folder / "c.csv"
    second.write_text("t,cmd,heading\n10,0.1,0\n11,0.2,10\n12,0.3,20\n")
    third.write_text("t,cmd,heading\n20,0.1,0\n21,0.2,10\n22,0.3,20\n")
    text, piece = path.read_text(), '[[log]]\nname = "{}"\nt_from = {}\nt_to = {}\n'
    path.write_text(text + piece.format("p", 1, 3) + piece.format("q", 11, 13))
    with pytest.warns(SeatrialWarning) as caught:
        logs = import_files(path, [first, second, third], out_dir=folder / "logs")
    assert [str(warning.message) for warning in caught] == [
        f"{third}: no [[log]] has its times, so it becomes one log as a whole"
    ]
    assert [log.name for log in logs] == ["run_p.mcap", "b_q.mcap", "c.mcap"]
    path.write_text(text + piece.format("p", 1, 11))
    advice = r'\[\[log\]\] p: cut from 2 runs \(run, b\), .*, as match = "run"; for all of them, match = "\*"'
    with pytest.warns(SeatrialWarning, match=advice):
        logs = import_files(path, [first, second], out_dir=folder / "both")
    assert [log.name for log in logs] == ["run_p.mcap", "b_p.mcap"]
    path.write_text(text + piece.format("p", 1, 11) + 'match = "*"\n')
    logs = import_files(path, [first, second], out_dir=folder / "meant")  # without a warning, which would be an error
    assert [log.name for log in logs] == ["run_p.mcap", "b_p.mcap"]
    path.write_text(text + piece.format("p", 1, 11) + 'match = "b"\n')
    assert [log.name for log in import_files(path, [first, second], out_dir=folder / "b")] == ["run.mcap", "b_p.mcap"]


def test_mistakes_in_the_numbers_of_the_boat_are_told_together(tmp_path: Path) -> None:
    """A boat with the signs of REP-103, two unknown keys and a standard uncertainty without its number."""
    text = (
        'format = "seatrial-import 1"\n[time]\ncolumn = "t"\n[[signal]]\nname = "u"\ncolumn = "u"\nunit = "m/s"\n'
        "[geometry]\ny_left = 0.5\ny_right = -0.5\nmass = -3\nlever_arm = [0.3, 0, 0]\nwidth = 1.2\n"
        "[scale]\nc1 = 20.0\nc2_sd = 1.0\n"
    )
    with pytest.raises(SeatrialError) as caught:
        parse_import_map(text, tmp_path / "map.toml")
    message = str(caught.value)
    assert message.count("map.toml: ") == 1
    assert message.startswith(
        f"{tmp_path / 'map.toml'}: geometry.mass: must be positive, not -3; geometry.y_left: must"
    )
    assert "unknown key 'lever_arm'; did you mean 'lever_arm_m'?" in message
    assert "also unknown: 'width'" in message
    assert message.endswith("scale.c2_sd: is the standard uncertainty of c2; give c2 too")


def test_the_page_has_each_key_that_the_message_of_a_wrong_one_names(tmp_path: Path) -> None:
    """The message named mass_sd, which no page had."""
    signal = '[[signal]]\ntime = "t"\ncolumn = "x"\nname = "psi"\nunit = "rad"\n'
    text = f'format = "seatrial-import 1"\n[geometry]\nwidth = 0.7\n{signal}'
    with pytest.raises(SeatrialError, match=r"geometry.width: unknown key") as raised:
        parse_import_map(text, tmp_path / "map.toml")
    known = re.search(r"geometry\.width: unknown key.*? here: ([\w, ]+)", str(raised.value))
    assert known is not None
    page = (EXAMPLES.parent / "formats/import.md").read_text(encoding="utf-8")
    keys = known[1].split(", ")
    assert "mass_sd" in keys
    assert [key for key in keys if not re.search(rf"\b{key}\b", page)] == []
