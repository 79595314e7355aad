"""Tests of the import of captured bytes through the decoders of the live ports."""

from __future__ import annotations

import contextlib
import json
import math
import os
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq import cli
from seatrial.daq.checks.device_checks import check_devices
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.raw import import_raw
from seatrial.daq.importers.samples import sample_tables
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol import nmea, vectornav
from seatrial.daq.protocol.framing import crc16, sentence
from seatrial.daq.samples import Ahrs, Frame, Gnss, LoadCell, Scalar
from tests.measured.data import measured

SAMPLES = [Ahrs(0.1 * k, 0.01, -0.02, 0.001, 0.002, 0.003 * k, 0.1, 0.2, -9.8) for k in range(40)]


@pytest.fixture
def ascii_capture(tmp_path: Path) -> Path:
    path = tmp_path / "still.txt"
    body = b"".join(vectornav.encode_ascii(sample) for sample in SAMPLES)
    path.write_bytes(b"boot\r\n" + body[:500] + body[500:] + b"$VNYMR,1,2*00\r\n$VNYMR,half")
    return path


def test_samples_get_equally_spaced_times(ascii_capture: Path, tmp_path: Path) -> None:
    out, summary = import_raw("vectornav", ascii_capture, rate=40.0, out=tmp_path / "a.mcap")
    with open_log(out) as log:
        table = log.table(Ahrs, "ahrs")
        assert log.complete
        assert [kind for _, kind, _ in log.events()] == ["import"]
        assert log.metadata["source.1.name"] == "still.txt"
        assert len(log.metadata["source.1.sha256"]) == 64
        assert log.metadata["import.rate_hz"] == "40.0"
    assert table["t"].tolist() == pytest.approx([k / 40.0 for k in range(40)], abs=1e-9)
    assert table["r"].tolist() == pytest.approx([s.r for s in SAMPLES], abs=1e-6)
    assert "40 samples of 40 vectornav frames; 1 checksum error, " in summary
    assert not summary.endswith(" 0 bytes unparsed")  # the boot text, the damaged line and the half line


def test_the_log_of_an_import_as_json(ascii_capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    words = ["raw", "vectornav", str(ascii_capture), "--rate", "40", "-o", str(out), "--json"]
    done = CliRunner().invoke(cli.import_, words)
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert "40 samples of 40 vectornav frames" in printed.pop("content")
    assert printed == {"format": "seatrial-import 1", "sources": [str(ascii_capture)], "logs": [str(out)]}


@pytest.mark.parametrize("rate", [None, 50.0])
def test_a_vectornav_that_sends_ascii_and_binary_gives_each_sample_once(rate: float | None, tmp_path: Path) -> None:
    """The factory settings enable both. Each sample came twice, and the ASCII sample has no time."""
    capture = tmp_path / "both.bin"
    parts = [vectornav.encode_binary(s, 5.0 + 0.02 * k) for k, s in enumerate(SAMPLES)]
    ascii_parts = [vectornav.encode_ascii(s) if k % 2 else b"" for k, s in enumerate(SAMPLES)]
    capture.write_bytes(b"".join(a + b for a, b in zip(ascii_parts, parts, strict=True)))
    out, summary = import_raw("vectornav", capture, rate=rate, out=tmp_path / "b.mcap")
    assert summary.endswith("; 20 ASCII samples left out, contained in binary samples")
    with open_log(out) as log:
        table = log.table(Ahrs, "ahrs")
    start = 5.0 if rate is None else 0.0
    np.testing.assert_allclose(table["t"], start + 0.02 * np.arange(len(SAMPLES)), atol=1e-6)
    np.testing.assert_allclose(table["r"], [s.r for s in SAMPLES], atol=1e-5)


def test_data_that_only_the_ascii_of_a_vectornav_contains_is_kept(tmp_path: Path) -> None:
    binary = struct.pack("<3f", 10.0, 1.0, 2.0)  # only yaw, pitch and roll, with the time since startup
    body = b"\xfa" + struct.pack("<BH", 1, 0b1001) + struct.pack("<Q", 5_000_000_000) + binary
    body += struct.pack(">H", crc16(body[1:]))
    (tmp_path / "both.bin").write_bytes(body + vectornav.encode_ascii(SAMPLES[3]))
    out, _ = import_raw("vectornav", tmp_path / "both.bin", out=tmp_path / "b.mcap")
    with open_log(out) as log:
        table = log.table(Ahrs, "ahrs")
    assert np.isnan(table["yaw"]).tolist() == [False, True]
    assert table["r"][1] == pytest.approx(SAMPLES[3].r, abs=1e-6)


def test_the_transducers_of_nmea_keep_their_names(tmp_path: Path) -> None:
    """Pitch and roll are parts of the attitude. The other transducers were lost."""
    parts = []
    for k in range(20):
        parts.append(nmea.encode(Gnss(1.7e9 + k, 59.0, 10.0, fix=3)))
        parts.append(sentence(f"IIXDR,T,{900 + k},R,ENGINE#0,C,40.5,C,ENGINE#0_OIL,A,2.0,D,PTCH,P,1.5,B,Oil Pressure"))
    (tmp_path / "boat.nmea").write_bytes(b"".join(parts))
    for rate in (None, 1.0):
        out, _ = import_raw("nmea", tmp_path / "boat.nmea", rate=rate, out=tmp_path / "b.mcap", force=True)
        with open_log(out) as log:
            assert sorted(log.sources(Scalar)) == ["xdr_ENGINE_0", "xdr_ENGINE_0_OIL", "xdr_Oil_Pressure"]
            table = log.table(Scalar, "xdr_ENGINE_0")
            assert (log.unit("xdr_ENGINE_0"), log.unit("xdr_Oil_Pressure")) == ("rev/min", "Pa")
            assert log.table(Scalar, "xdr_Oil_Pressure")["value"][0] == pytest.approx(1.5e5)
        assert table["value"].tolist() == [900.0 + k for k in range(20)]
        start = 1.7e9 if rate is None else 0.0
        np.testing.assert_allclose(table["t"], start + np.arange(20), atol=1e-6)


def test_two_receivers_in_one_stream_are_named(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    """The receivers have 5 Hz and 1 Hz, with equal epochs. Formerly, one position of an epoch was dropped silently."""
    both, single = b"", b""
    for k in range(50):
        fix = nmea.encode(Gnss(1.7e9 + 0.2 * k, 59.0, 10.0, fix=3))
        single += fix
        both += fix + (nmea.encode(Gnss(1.7e9 + 0.2 * k, 59.0, 10.0001, fix=3)) if k % 5 == 0 else b"")
    (tmp_path / "one.nmea").write_bytes(single)
    import_raw("nmea", tmp_path / "one.nmea", out=tmp_path / "one.mcap")
    assert not recwarn.list
    (tmp_path / "both.nmea").write_bytes(both)
    with pytest.warns(SeatrialWarning, match="two receivers send in one stream"):
        import_raw("nmea", tmp_path / "both.nmea", out=tmp_path / "both.mcap")


@pytest.mark.parametrize(
    ("start", "written", "word"),
    [
        (1.73e9 - 619_315_200.0, 1.73e9 + 7200.0, "probably"),  # the file is of the day of the recording
        (1.73e9 - 619_315_200.0, 1.76e9, "perhaps"),  # a copy of a year later
        (1.74e9 - 619_315_200.0 + 9e7, 1.74e9 + 9e7, "probably"),  # true dates of 2028 give dates after 2007
        (1.73e9, 1.73e9, ""),
        (1.2e9, 1.76e9, ""),  # an old log
        (3600.0, 1.73e9, ""),  # not a date
    ],
)
def test_dates_of_an_earlier_gps_era_are_named(start: float, written: float, word: str, tmp_path: Path) -> None:
    """Formerly, they were imported without a warning."""
    (tmp_path / "old.nmea").write_bytes(b"".join(nmea.encode(Gnss(start + k, 59.0, 10.0, fix=3)) for k in range(60)))
    os.utime(tmp_path / "old.nmea", (written, written))
    out, expected = tmp_path / "old.mcap", f"its dates are {word} 1024 weeks too early"
    with pytest.warns(SeatrialWarning, match=expected) if word else contextlib.nullcontext():
        import_raw("nmea", tmp_path / "old.nmea", out=out)
    with open_log(out) as log:
        assert any(expected in text for _, _, text in log.events()) == bool(word)
        assert log.start == pytest.approx(start)  # unchanged


def test_a_rate_counts_one_kind_of_sentence(tmp_path: Path) -> None:
    """A heading beside each fix does not halve the rate.

    If only one fix in ten has a heading, the heading keeps its place.
    """
    fixes = [nmea.encode(Gnss(1.7e9 + 0.1 * k, 59.0, 10.0, fix=3)) for k in range(20)]
    headings = [sentence(f"HEHDT,{90 + k}.0,T") for k in range(20)]
    for every in (1, 10):
        pairs = (fix + (headings[k] if k % every == 0 else b"") for k, fix in enumerate(fixes))
        (tmp_path / "both.txt").write_bytes(b"".join(pairs))
        out, _ = import_raw("nmea", tmp_path / "both.txt", rate=10.0, out=tmp_path / "g.mcap", force=True)
        with open_log(out) as log:
            (gnss,), (ahrs,) = log.sources(Gnss), log.sources(Ahrs)
            t, t_heading = log.table(Gnss, gnss)["t"], log.table(Ahrs, ahrs)["t"]
        assert t.tolist() == pytest.approx([0.1 * k for k in range(20)])
        assert t_heading.tolist() == pytest.approx([0.1 * every * k for k in range(20 // every)], abs=0.11)


def test_samples_get_the_time_of_the_device(tmp_path: Path) -> None:
    capture = tmp_path / "imu.bin"
    capture.write_bytes(b"".join(vectornav.encode_binary(s, 5.0 + 0.02 * k) for k, s in enumerate(SAMPLES)))
    out, _ = import_raw("vectornav", capture, out=tmp_path / "b.mcap")
    with open_log(out) as log:
        t = log.table(Ahrs, "ahrs")["t"]
    assert t.tolist() == pytest.approx([5.0 + 0.02 * k for k in range(40)], abs=1e-8)


def test_samples_get_the_time_of_a_gnss_receiver(tmp_path: Path) -> None:
    capture = tmp_path / "gnss.txt"
    fixes = [Gnss(1.7e9 + k, 59.0, 10.0 + 1e-5 * k, 3.0, 0.5, 0.1, fix=3, n_sat=9, hdop=1.0) for k in range(5)]
    capture.write_bytes(b"".join(nmea.encode(fix) for fix in fixes))
    out, _ = import_raw("nmea", capture, out=tmp_path / "g.mcap")
    with open_log(out) as log:
        t = log.table(Gnss, "gnss")["t"]
    assert len(t) >= 4  # the last epoch may still have been incomplete
    assert t[0] == pytest.approx(1.7e9)


@pytest.mark.parametrize("before_midnight", [0, 2])
def test_epochs_before_the_first_date_get_its_day(tmp_path: Path, before_midnight: int) -> None:
    start = 1_700_006_400.0 - before_midnight  # midnight in UTC
    fixes = [Gnss(start + k, 59.0, 10.0 + 1e-5 * k, 3.0, 0.5, 0.1, fix=3, n_sat=9, hdop=1.0) for k in range(8)]
    gga = [nmea.encode(fix).split(b"\r\n")[0] + b"\r\n" for fix in fixes[:4]]
    (tmp_path / "gnss.txt").write_bytes(b"".join(gga) + b"".join(nmea.encode(fix) for fix in fixes[4:]))
    out, _ = import_raw("nmea", tmp_path / "gnss.txt", out=tmp_path / "g.mcap")
    with open_log(out) as log:
        table = log.table(Gnss, "gnss")
    assert table["t"].tolist() == pytest.approx([fix.utc for fix in fixes])
    assert table["utc"].tolist() == pytest.approx([fix.utc for fix in fixes])


def test_without_any_date_the_day_is_1970_01_01(tmp_path: Path) -> None:
    gga = [nmea.encode(Gnss(1.7e9 + k, 59.0, 10.0, fix=3)).split(b"\r\n")[0] + b"\r\n" for k in range(4)]
    (tmp_path / "gnss.txt").write_bytes(b"".join(gga))
    out, _ = import_raw("nmea", tmp_path / "gnss.txt", out=tmp_path / "g.mcap")
    with open_log(out) as log:
        assert log.table(Gnss, "gnss")["t"].tolist() == pytest.approx([(1.7e9 + k) % 86400.0 for k in range(4)])


def test_an_attitude_with_its_own_time_keeps_this_time(tmp_path: Path) -> None:
    fixes = [nmea.encode(Gnss(1_700_006_400.0 + k, 59.0, 10.0, fix=3)) for k in range(3)]
    attitudes = [sentence(f"PASHR,00000{k}.{m:02d},90.0,T,0.0,0.0,0.0") for k in range(3) for m in (20, 40, 60, 80)]
    body = b"".join(fixes[k] + b"".join(attitudes[4 * k : 4 * k + 4]) for k in range(3))
    (tmp_path / "both.txt").write_bytes(sentence("PASHR,235959.80,90.0,T,0.0,0.0,0.0") + body)
    out, _ = import_raw("nmea", tmp_path / "both.txt", out=tmp_path / "g.mcap")
    with open_log(out) as log:
        t = log.table(Ahrs, "gnss" if "gnss" in log.sources(Ahrs) else "ahrs")["t"]
    want = [-0.2, *(k + 0.01 * m for k in range(3) for m in (20, 40, 60, 80))]
    assert (t - 1_700_006_400.0).tolist() == pytest.approx(want, abs=1e-6)


def test_a_capture_of_a_load_cell_is_imported(tmp_path: Path) -> None:
    capture = tmp_path / "cell.txt"
    capture.write_text("".join(f"{k}\r\n" for k in range(1000, 1010)))
    out, _ = import_raw("loadcell", capture, rate=80.0, out=tmp_path / "c.mcap")
    with open_log(out) as log:
        table = log.table(LoadCell, "load_cell")
    assert table["counts"].tolist() == list(range(1000, 1010))
    assert all(math.isnan(f) for f in table["force"])


def test_errors_of_a_raw_import_are_one_line_each(ascii_capture: Path, tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match=r"still\.txt: its samples have no times; .*--rate"):
        import_raw("vectornav", ascii_capture, out=tmp_path / "x.mcap")
    with pytest.raises(SeatrialError, match=r"still\.txt: \d+ complete nmea messages?, and no sample in them"):
        import_raw("nmea", ascii_capture, rate=1.0, out=tmp_path / "x.mcap")
    assert not list(tmp_path.glob("*.mcap"))
    with pytest.raises(SeatrialError, match="cannot be read"):
        import_raw("nmea", tmp_path / "nowhere", rate=1.0)
    import_raw("vectornav", ascii_capture, rate=40.0, out=tmp_path / "x.mcap")
    with pytest.raises(SeatrialError, match="the file exists already"):
        import_raw("vectornav", ascii_capture, rate=40.0, out=tmp_path / "x.mcap")
    with pytest.raises(SeatrialError, match="is the source of this import and is never replaced"):
        import_raw("vectornav", ascii_capture, rate=40.0, out=ascii_capture, force=True)


def test_the_import_command_writes_a_log(ascii_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(cli.import_, ["raw", "vectornav", str(ascii_capture), "--rate", "40"])
    assert done.exit_code == 0
    assert done.output.startswith("still.mcap: 40 samples")
    assert (tmp_path / "still.mcap").is_file()
    assert CliRunner().invoke(cli.import_, ["raw", "vesc", str(ascii_capture)]).exit_code == 2
    assert CliRunner().invoke(cli.import_, ["raw", "nmea", str(ascii_capture), "--rate", "0"]).exit_code == 2


@pytest.mark.measured
def test_a_capture_of_a_vectornav_at_rest_is_imported(tmp_path: Path) -> None:
    capture = measured("static/vn100_stationary_40Hz_vnymr.txt")
    out, summary = import_raw("vectornav", capture, rate=40.0, out=tmp_path / "vn.mcap")
    assert summary == "30178 samples of 30178 vectornav frames; 0 checksum errors, 0 bytes unparsed"
    first = [float(word) for word in capture.read_text().splitlines()[0].split("*")[0].split(",")[1:]]
    with open_log(out) as log:
        row = log.table(Ahrs, "ahrs")[0]
    assert math.degrees(row["yaw"]) == pytest.approx(first[0])
    assert [row[n] for n in ("ax", "ay", "az", "p", "q", "r")] == pytest.approx(first[6:12])


def test_a_clock_that_ran_backwards_is_a_fault_of_a_mapped_log_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One topic contains two receivers whose clocks are 100 s apart. The rows are sorted, which mixes two tracks."""
    fixes = [(t, Gnss(1.7e9 + t, 59.0, 10.0, 3.0, 0.5, 0.1, fix=3)) for t in (0, 100, 1, 101, 2)]
    rows = [("", 1.7e9 + t, Frame(fix, t, t)) for t, fix in fixes]
    (table,) = sample_tables(tmp_path / "run.log", rows)
    assert table.full_remark == "gnss: its times ran back 2 times, by up to 99.0 s"
    (tmp_path / "map.toml").write_text(
        'format = "seatrial-import 1"\nsignal = [{ name = "vx", topic = "gnss", field = "vel_n", unit = "m/s" }]\n'
    )
    (tmp_path / "run.log").write_text("")
    kind = SimpleNamespace(name="can", read=lambda path, options: [table])
    monkeypatch.setattr("seatrial.daq.importers.import_files.source_kind", lambda path: kind)
    with pytest.warns(SeatrialWarning, match="ran back 2 times"):
        (out,) = import_files(tmp_path / "map.toml", [tmp_path / "run.log"], out=tmp_path / "run.mcap")
    with open_log(out) as log:
        assert [f.code for f in check_devices(log) if f.level == "fault"] == ["clock-ran-back"]


def test_a_clock_that_is_set_back_or_a_second_clock_is_reported(tmp_path: Path) -> None:
    capture, out = tmp_path / "gnss.txt", tmp_path / "g.mcap"
    for times in ([0, 1, 2, 3, 4, 1, 2, 3, 4, 5], [0, 100, 1, 101, 2, 102]):
        fixes = [Gnss(1.7e9 + t, 59.0, 10.0 + 1e-5 * k, 3.0, 0.5, 0.1, fix=3) for k, t in enumerate(times)]
        capture.write_bytes(b"".join(nmea.encode(fix) for fix in fixes))
        with pytest.warns(SeatrialWarning, match="ran back"):
            import_raw("nmea", capture, out=out, force=True)
        with open_log(out) as log:
            assert [f.code for f in check_devices(log)].count("clock-ran-back") == 1
        assert "ran back" in CliRunner().invoke(cli.info, [str(out)], catch_exceptions=False).stdout


WEEKS = 1024 * 7 * nmea.DAY  # seconds


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("early", [WEEKS, 16204 * nmea.DAY])
def test_wrong_dates_of_a_receiver_are_moved_to_the_other_dates(tmp_path: Path, when: str, early: float) -> None:
    """The first date of a receiver is that of its firmware, and its week number overflows after 1024 weeks."""
    true = [1.7e9 + 1.0 * k for k in range(40)]
    wrong = range(10) if when == "before" else range(30, 40)
    fixes = [Gnss(t - early * (k in wrong), 59.0 + 1e-6 * k, 10.0, fix=3) for k, t in enumerate(true)]
    path = tmp_path / "run.nmea"
    path.write_bytes(b"".join(map(nmea.encode, fixes)))
    with pytest.warns(SeatrialWarning, match="wrong dates.*10 samples moved"):
        out, _ = import_raw("nmea", path, out=tmp_path / "run.mcap")
    with open_log(out) as log:
        table = log.table(Gnss, log.sources(Gnss)[0])
    assert table["t"].tolist() == pytest.approx(true, abs=0.02)


def test_a_first_date_with_a_wrong_time_of_day_is_left_out(tmp_path: Path) -> None:
    fixes = [Gnss(3.2e8 + 1.0 * k if k < 10 else 1.7e9 + 1.0 * k, 59.0, 10.0, fix=3) for k in range(40)]
    path = tmp_path / "run.nmea"
    path.write_bytes(b"".join(map(nmea.encode, fixes)))
    with pytest.warns(SeatrialWarning, match="10 samples left out"):
        out, _ = import_raw("nmea", path, out=tmp_path / "run.mcap")
    with open_log(out) as log:
        assert log.end - log.start < 40.0


def test_two_days_in_one_capture_stay_two_days(tmp_path: Path) -> None:
    fixes = [Gnss(1.7e9 + 1.0 * k + 2 * nmea.DAY * (k > 20), 59.0, 10.0, fix=3) for k in range(40)]
    path = tmp_path / "run.nmea"
    path.write_bytes(b"".join(map(nmea.encode, fixes)))
    out, _ = import_raw("nmea", path, out=tmp_path / "run.mcap")
    with open_log(out) as log:
        assert log.end - log.start > 2 * nmea.DAY


@pytest.mark.parametrize("protocol", ["nmea", "ubx"])
def test_magnetic_headings_that_are_left_out_are_reported(protocol: str, tmp_path: Path) -> None:
    capture = tmp_path / "boat.nmea"
    fixes = [sentence(f"GPGGA,1200{k:02}.00,4110.80,N,00842.00,W,1,10,0.9,10.0,M,50.0,M,,") for k in range(5)]
    date = sentence("GPZDA,120000.00,05,05,2025,00,00")
    capture.write_bytes(date + b"".join(fix + sentence("HCHDG,90.0,,,,") for fix in fixes))
    with pytest.warns(
        SeatrialWarning, match=r"boat.nmea: its magnetic headings are left out, .* set the compass to true"
    ):
        out, _ = import_raw(protocol, capture, out=tmp_path / "a.mcap")
    with open_log(out) as log:
        assert len(log.table(Gnss, "gnss")) == 5
        assert not log.sources(Ahrs)
    known = [sentence("HCHDG,90.0,,,2.0,W") for _ in fixes]  # with a variation they are used
    capture.write_bytes(date + b"".join(a + b for a, b in zip(fixes, known, strict=True)))
    import_raw(protocol, capture, out=tmp_path / "b.mcap")
