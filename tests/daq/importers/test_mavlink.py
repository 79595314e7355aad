"""Tests of the import of tlog and BIN: a tlog made of the mock's bytes, and a BIN written field by field."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink import DFReader
from pymavlink.dialects.v20.ardupilotmega import (
    MAVLink,
    MAVLink_attitude_message,
    MAVLink_heartbeat_message,
)
from rich.console import Console

from seatrial.daq.checks.device_checks import check_devices
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.dataflash import _MessageConverter
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.mavlink import STAMP, _tlog_frames, import_mavlink
from seatrial.daq.importers.write_log import Timed
from seatrial.daq.log.reader import Log, open_log
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Esc, Frame, Gnss, Servo
from seatrial.daq.tools.info import log_content, show_log
from seatrial.ident.checks import device_faults
from seatrial.ident.data.loading import PropulsionInput, TimeWindow, channels, load_run
from tests.daq.mavlink_ends import LEVEL, Ends, mav_rig, rig_text
from tests.dataflash import FMT, FORMATS, dataflash_head, dataflash_message

T0 = 1_790_000_000.0


def tlog(path: Path, garbage: bytes = b"") -> Ends:
    """Write eight seconds of the mock as a ground station does. Each message is read about 3 ms late."""
    ends = Ends(mav_rig())
    parts: list[bytes] = []
    heard = ends.to_ground

    def note(data: bytes) -> None:
        heard(data)
        at = 0
        while at < len(data):
            size = data[at + 1] + 12 + 13 * (data[at + 2] & 1)
            stamp = round((T0 + ends.t + 0.003 * ((len(parts) * 7) % 3)) * 1e6)
            parts.append(struct.pack(">Q", stamp) + data[at : at + size] + garbage)
            at += size

    ends.to_ground = note  # type: ignore[method-assign]
    ends.run(8.0)
    path.write_bytes(b"".join(parts))
    return ends


def test_a_tlog_becomes_a_log_with_the_times_of_the_autopilot(tmp_path: Path) -> None:
    ends = tlog(tmp_path / "run.tlog")
    out, message = import_mavlink(tmp_path / "run.tlog", rig=mav_rig(), out=tmp_path / "run.mcap")
    assert "system 1, " in message
    assert "0 bytes not understood" in message
    with open_log(out) as log:
        assert log.rig is not None
        ahrs = log.table(Ahrs, "autopilot")
        assert len(ahrs) == sum(isinstance(frame.sample, Ahrs) for frame in ends.frames)
        settled = ahrs[ahrs["t_device"] > 21.0]
        assert np.ptp(settled["t"] - settled["t_device"]) < 1e-3  # the autopilot's clock, not the times of arrival
        assert abs(np.median(ahrs["t"] - ahrs["t_device"] - (T0 - 20.0))) < 0.01  # the autopilot booted 20 s before
        yaw = ahrs["yaw"][np.isfinite(ahrs["yaw"])]
        assert yaw == pytest.approx(np.full(len(ahrs), LEVEL.yaw)[: len(yaw)], abs=1e-6)
        assert len(yaw) >= len(ahrs) - 1
        assert np.nanmean(ahrs["az"]) == pytest.approx(-9.8, abs=0.01)
        for kind in (Gnss, Battery, Autopilot):
            assert len(log.table(kind, "autopilot")) > 5
        assert log.nodes(Servo, "autopilot") == log.nodes(Esc, "autopilot") == [1, 3]
        assert log.metadata["source.1.name"] == "run.tlog"
        assert "imported_by" in log.metadata
        assert "operator" not in log.metadata
    with pytest.raises(SeatrialError, match="is the source of this import and is never replaced"):
        import_mavlink(tmp_path / "run.tlog", out=tmp_path / "run.tlog", force=True)


def test_damage_in_a_tlog_affects_only_the_damaged_messages(tmp_path: Path) -> None:
    tlog(tmp_path / "clean.tlog")
    tlog(tmp_path / "dirty.tlog", b"\xfd\x00garbage")
    clean, dirty = (import_mavlink(tmp_path / f"{n}.tlog", out=tmp_path / f"{n}.mcap")[0] for n in ("clean", "dirty"))
    with open_log(clean) as whole, open_log(dirty) as rest:
        assert len(rest.table(Ahrs, "autopilot")) == len(whole.table(Ahrs, "autopilot"))
    data = (tmp_path / "clean.tlog").read_bytes()
    (tmp_path / "cut.tlog").write_bytes(data[: len(data) // 2 + 5])
    import_mavlink(tmp_path / "cut.tlog", out=tmp_path / "cut.mcap")


@pytest.mark.parametrize("damaged", [1, 2**63])
def test_a_damaged_time_that_no_log_can_hold_gives_a_one_line_error(tmp_path: Path, damaged: int) -> None:
    """The device times are mapped by the arrival times, so they would be wrong too."""
    path = tmp_path / "run.tlog"
    tlog(path)
    data = bytearray(path.read_bytes())
    for at in [at - STAMP for _, at, _ in _tlog_frames(bytes(data))][-100:-50]:
        data[at : at + STAMP] = struct.pack(">Q", damaged)
    path.write_bytes(data)
    with pytest.raises(SeatrialError, match="are not between 1970 and 2038"):
        import_mavlink(path, out=tmp_path / "run.mcap")
    assert not (tmp_path / "run.mcap").exists()


def attitudes(*autopilots: tuple[int, float]) -> bytes:
    """Write a tlog of autopilots that send attitudes in turn, each given as (system number, seconds since its boot)."""
    links = [(MAVLink(None, system, 1), boot) for system, boot in autopilots]
    data = b""
    for k in range(60):
        for j, (link, boot) in enumerate(links):
            t = 0.05 * k + 0.01 * j
            messages = [MAVLink_attitude_message(round(1e3 * (boot + t)), 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)]
            if k % 20 == 0:
                messages.append(MAVLink_heartbeat_message(11, 3, 81, 0, 4, 3))
            for message in messages:
                data += struct.pack(">Q", round(1e6 * (T0 + t))) + message.pack(link)
                link.seq = (link.seq + 1) % 256
    return data


def test_one_of_two_autopilots_is_imported_and_the_omitted_autopilot_is_named(tmp_path: Path) -> None:
    path = tmp_path / "run.tlog"
    path.write_bytes(attitudes((1, 12.0), (2, 400.0)))
    with pytest.warns(
        SeatrialWarning, match=r"system 1 is imported; the log also contains system 2: choose one with --system"
    ):
        out, _ = import_mavlink(path, out=tmp_path / "run.mcap")
    with open_log(out) as log:
        assert len(log.table(Ahrs, "autopilot")) == 60
    import_mavlink(path, system=2, out=tmp_path / "second.mcap")


@pytest.mark.parametrize("boot", [12.5, 400.0])
def test_two_autopilots_with_the_same_number_give_a_one_line_error(tmp_path: Path, boot: float) -> None:
    path = tmp_path / "run.tlog"
    path.write_bytes(attitudes((1, 12.0), (1, boot)))
    with pytest.raises(SeatrialError, match="two autopilots send as system 1"):
        import_mavlink(path, out=tmp_path / "run.mcap")


def test_a_file_that_is_not_a_tlog_gives_a_one_line_error(tmp_path: Path) -> None:
    path = tmp_path / "x.tlog"
    path.write_bytes(b"hello" * 100)
    with pytest.raises(SeatrialError, match="no heartbeat of an autopilot"):
        import_mavlink(path, out=tmp_path / "x.mcap")
    tlog(path)
    with pytest.raises(
        SeatrialError, match=r"no samples of system 9 .* it contains systems 1: choose one with --system"
    ):
        import_mavlink(path, system=9, out=tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()


def dataflash(path: Path, firmware: str = "ArduRover V4.7.0 (1a2b3c4d)", rpm: float | None = None) -> None:
    """Write two seconds of a boat that turns, at 10 Hz. `rpm` is the speed of the third output; None for no speeds."""
    out, add = dataflash_head(), dataflash_message
    for k in range(20):
        us = 30_000_000 + 100_000 * k
        place = (423580000, -710856831, 150)
        out += add("GPS", us, 0, 4, 3_600_000 + 100 * k, 2400, 12, 80, *place, 1.5, 90.0, 0.1, 0.0, 0.0, 1)
        out += add("GPA", us, 0, us // 1000 - 17 - 20 * (k % 2))
        out += add("ATT", us, 0, 100, 0, -200, 0, 9000 + 100 * k, 0.0, 0.0)
        out += add("IMU", us + 90, 0, 0.0, 0.0, 0.1 * k, 0.0, 0.0, -9.8)  # written later in the same loop
        out += add("RCOU", us, 1700, 0, 1300)
        out += add("ESC", us, 2, rpm, 15.0, 3.0, 30.0) if rpm is not None else b""
        out += add("BAT", us, 0, 15.5, 15.5, 4.0, 0.0, 0.0, 2500, 0, 77)
        if k == 3:
            out += add("MODE", us, 4, 4, 1) + add("MSG", us, b"a text") + add("MSG", us, firmware.encode())
            out += add("ARM", us, 1) + add("EV", us, 10) + add("ERR", us, 12, 1)
            out += add("PARM", us, b"SERVO1_MIN", 1000.0) + add("PARM", us, b"SERVO3_MIN", 1100.0)
    path.write_bytes(out)


@pytest.mark.parametrize(
    ("firmware", "mode"),
    [("ArduRover V4.7.0", "HOLD"), ("ArduSub V4.5.0", "GUIDED"), ("ArduPlane V4.6.0", "ACRO"), ("strange", "mode 4")],
)
def test_modes_of_a_dataflash_log_have_the_names_of_its_vehicle(tmp_path: Path, firmware: str, mode: str) -> None:
    """The text that names the mode comes after the mode."""
    dataflash(tmp_path / "00000001.BIN", firmware)
    out, _ = import_mavlink(tmp_path / "00000001.BIN", out=tmp_path / "bin.mcap")
    with open_log(out) as log:
        assert next(text for _, kind, text in log.events() if kind == "autopilot") == mode


def test_rates_of_an_imported_autopilot_are_those_of_its_topics(tmp_path: Path) -> None:
    """Formerly, the check counted attitudes, fixes and battery together, and printed three times the rate of each."""
    dataflash(tmp_path / "00000001.BIN")
    out, _ = import_mavlink(tmp_path / "00000001.BIN", out=tmp_path / "bin.mcap")
    with open_log(out) as log:
        (rate,) = (f.text for f in check_devices(log) if f.check == "rate")
        shown = {topic.topic: topic.rate for topic in log_content(log).topics}
    kinds = {word.split()[0]: float(word.split()[1]) for word in rate.split(", ")}
    assert set(kinds) == {"imu", "gnss", "battery"}
    assert all(shown[f"/autopilot/{kind}"] == pytest.approx(value, rel=1e-3) for kind, value in kinds.items())


@pytest.mark.parametrize("source", ["BIN", "tlog"])
def test_a_mapped_log_keeps_the_autopilots_parameters_and_compares_the_rig(tmp_path: Path, source: str) -> None:
    path = tmp_path / f"run.{source}"
    if source == "BIN":
        dataflash(path)
    else:
        tlog(path)
    text = rig_text()
    if source == "tlog":
        text = text.replace("rc_channel = 1\n", "rc_channel = 1\npwm_us = [1000.0, 1500.0, 1900.0]\n")
    (tmp_path / "rig.toml").write_text(text)
    guess = guess_map(path)
    assert not guess.problem
    (tmp_path / "map.toml").write_text(f'{guess.text}\n[mavlink]\nrig = "rig.toml"\n')
    was, wanted = (1000, 1100) if source == "BIN" else (1100, 1000)
    message = rf"servo_1: differs from the rig: SERVO1_MIN is {was}, wanted {wanted}"
    with pytest.warns(SeatrialWarning, match=message):
        (out,) = import_files(tmp_path / "map.toml", [path], out=tmp_path / "run.mcap")
    direct, _ = import_mavlink(path, rig=load_rig(tmp_path / "rig.toml"), out=tmp_path / "direct.mcap")
    with open_log(out) as log, open_log(direct) as direct_log:
        reported = [(kind, text) for _, kind, text in log.events() if kind not in ("import", "clock")]
        assert reported == [(kind, text) for _, kind, text in direct_log.events() if kind not in ("import", "clock")]
        assert reported or source == "tlog"
        assert log.hold("n_left") == "sampled"
        by_map, by_rig = channels(log)["n_left"], channels(direct_log)["n_cmd_left"]
    assert by_map.sampled == pytest.approx(by_rig.sampled)
    assert by_map.sampled > 0.03
    assert by_map.hold == by_rig.hold == "average"
    assert load_run(out, "estimation").propulsion is PropulsionInput.COMMAND


def test_the_content_of_a_damaged_dataflash_log_is_not_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataflash(tmp_path / "00000001.BIN")
    data = (tmp_path / "00000001.BIN").read_bytes()
    number, form, code, columns = FORMATS["EV"]
    whole = FMT.pack(number, 3 + struct.calcsize(code), b"EV", form.encode(), columns.encode())
    assert whole in data
    hostile = FMT.pack(number, 3 + struct.calcsize(code), b"EV", b"Q\x02", columns.encode())
    (tmp_path / "00000001.BIN").write_bytes(data.replace(whole, hostile))
    with pytest.raises(SeatrialError, match="not a readable DataFlash log"):
        import_mavlink(tmp_path / "00000001.BIN", out=tmp_path / "bin.mcap")
    assert capsys.readouterr().out == ""


def test_a_message_of_unknown_form_does_not_affect_other_messages(tmp_path: Path) -> None:
    path = tmp_path / "00000001.BIN"
    dataflash(path)
    path.write_bytes(path.read_bytes().replace(b"TimeUS,ArmState", b"TimeUS,Arm_is__"))
    with pytest.warns(SeatrialWarning, match=r"00000001\.BIN: 1 message ARM of unknown form"):
        out, message = import_mavlink(path, out=tmp_path / "bin.mcap")
    assert "0 bytes not understood, 1 message ARM of unknown form" in message
    with open_log(out) as log:
        assert len(log.table(Ahrs, "autopilot")) == 20


def test_damage_in_a_dataflash_log_is_counted_and_not_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The indexer of pymavlink, written in C, prints a line for each byte."""
    path = tmp_path / "00000001.BIN"
    dataflash(path)
    data = path.read_bytes()
    path.write_bytes(data[:3000] + bytes(1000) + data[3000:])
    with pytest.warns(SeatrialWarning, match="1 damaged place"):
        out, message = import_mavlink(path, out=tmp_path / "bin.mcap")
    assert 1000 <= int(message.split(" bytes not understood")[0].rpartition(" ")[2]) < 1100
    assert capfd.readouterr() == ("", "")
    with open_log(out) as log:
        assert len(log.table(Ahrs, "autopilot")) >= 19


def test_a_dataflash_log_whose_reader_fails_is_read_up_to_that_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "00000001.BIN"
    dataflash(path)
    read, size = DFReader.DFReader_binary.recv_match, path.stat().st_size

    def fails_half_way(log: Any, **how: Any) -> Any:
        if log.offset > size // 2:
            raise UnicodeDecodeError("utf-8", b"", 0, 1, "damaged")
        return read(log, **how)

    monkeypatch.setattr(DFReader.DFReader_binary, "recv_match", fails_half_way)
    with pytest.warns(SeatrialWarning, match=rf"00000001\.BIN: damaged, read only to byte \d+ of {size}"):
        _, message = import_mavlink(path, out=tmp_path / "bin.mcap")
    assert f"of {size}: " in message


def test_a_dataflash_log_becomes_a_log(tmp_path: Path) -> None:
    dataflash(tmp_path / "00000001.BIN")
    out, message = import_mavlink(tmp_path / "00000001.BIN", rig=mav_rig(), out=tmp_path / "bin.mcap")
    assert message.count("differs from the rig") == 1
    assert "SERVO1_MIN is 1000, wanted 1100" in message
    with open_log(out) as log:
        ahrs = log.table(Ahrs, "autopilot")
        assert len(ahrs) == 20
        assert np.degrees(ahrs["yaw"]) == pytest.approx(90.0 + np.arange(20), abs=0.01)
        assert np.degrees(ahrs["roll"][0]) == pytest.approx(1.0)
        assert np.diff(ahrs["t"]) == pytest.approx(np.full(19, 0.1), abs=1e-3)
        assert ahrs["t"][0] > 1.7e9  # calendar time from the GPS week
        assert ahrs["r"] == pytest.approx(0.1 * np.arange(20))
        fixes = log.table(Gnss, "autopilot")
        fix = fixes[0]
        # time of the fix in whole milliseconds, not the time at which a loop wrote it
        late = np.array([0.0165, 0.0365] * 10)
        assert fixes["t_device"] == pytest.approx(ahrs["t_device"] - late)
        assert fixes["t"] == pytest.approx(ahrs["t"] - late, abs=1e-3)
        assert (fix["lat"], fix["lon"], fix["fix"]) == (pytest.approx(42.358), pytest.approx(-71.0856831), 4)
        assert (fix["vel_n"], fix["vel_e"]) == (pytest.approx(0.0, abs=1e-6), pytest.approx(1.5))
        assert log.table(Servo, "autopilot", 1)["n"][0] == pytest.approx(0.5)
        assert log.table(Servo, "autopilot", 3)["n"][0] == pytest.approx(0.5)  # reversed in the rig
        assert log.table(Battery, "autopilot")["remaining"][0] == pytest.approx(0.77)
        reported = [text for _, kind, text in log.events() if kind == "autopilot"]
        assert reported == ["HOLD", "armed", "event 10 (LogEvent)", "error 1 of subsystem 12 (LogErrorSubsystem)"]
        state = log.table(Autopilot, "autopilot")[-1]
        assert (state["armed"], state["mode"], state["state"]) == (1, 4, 4)


@pytest.mark.parametrize(
    ("has_rig", "node", "reported", "found"),
    [
        (False, 1, (-1200.0, 900.0), (-1200.0, 900.0)),
        (True, 1, (-1200.0, 900.0), (-1200.0, 900.0)),  # astern while the output is ahead: the shaft still turns
        (True, 3, (-1200.0, 900.0), (1200.0, -900.0)),  # reversed in the rig, as for MAVLink
        (True, 1, (1200.0, 900.0), (1200.0, -900.0)),  # speeds are magnitudes
        (True, 3, (1200.0, 900.0), (-1200.0, 900.0)),  # the commands of a reversed thruster have the other sign
        (False, 1, (1200.0, 900.0), (1200.0, 900.0)),
    ],
)
def test_the_sign_of_a_shaft_speed_follows_from_the_rig_or_the_data(
    has_rig: bool, node: int, reported: tuple[float, ...], found: tuple[float, ...]
) -> None:
    rig = mav_rig() if has_rig else None
    reader = _MessageConverter(rig, None if rig is None else rig.device("autopilot"))
    rows = []
    for rpm, pulse in zip(reported, (1700, 1300), strict=True):
        reader.take["RCOU"](SimpleNamespace(C1=pulse, C3=pulse))
        (esc,) = reader.take["ESC"](SimpleNamespace(Instance=node - 1, RPM=rpm, Curr=3.0, Volt=15.0, Temp=30.0))
        rows.append(Timed(Frame(esc, 1.0, 1.0), 1.0))
    assert tuple(row.frame.sample.rpm for row in reader.joined(rows) if isinstance(row.frame.sample, Esc)) == found


def test_speeds_of_unknown_direction_are_reported(tmp_path: Path) -> None:
    """Without a rig nobody knows whether the third thruster is reversed; with it, its speed is positive forward."""
    path = tmp_path / "00000001.BIN"
    dataflash(path, rpm=-900.0)
    with pytest.warns(SeatrialWarning, match=r"BIN: the shaft speeds have a sign, .* reversed .* import with the rig"):
        out, _ = import_mavlink(path, out=tmp_path / "alone.mcap")
    with open_log(out) as log:
        assert set(log.table(Esc, "autopilot", 3)["rpm"]) == {-900.0}
    out, _ = import_mavlink(path, rig=mav_rig(), out=tmp_path / "rig.mcap")
    with open_log(out) as log:
        assert set(log.table(Esc, "autopilot", 3)["rpm"]) == {900.0}
    dataflash(path, rpm=900.0)
    import_mavlink(path, out=tmp_path / "magnitude.mcap")


def test_lost_frames_and_parameters_of_a_tlog_are_reported(tmp_path: Path) -> None:
    tlog(tmp_path / "run.tlog")
    data = (tmp_path / "run.tlog").read_bytes()
    places = [at for at in range(len(data) - 9) if data[at + 8] == 0xFD and data[at : at + 2] == b"\x00\x06"]
    first, second = places[100:102]
    (tmp_path / "cut.tlog").write_bytes(data[:first] + data[second:])
    rig = mav_rig()
    left = rig.thrusters[0]
    assert left.output is not None
    other_rig = replace(rig, thrusters=(replace(left, output=replace(left.output, pwm_us=(1000.0, 1500.0, 2000.0))),))
    _, message = import_mavlink(tmp_path / "cut.tlog", rig=other_rig, out=tmp_path / "cut.mcap")
    assert " 1 lost," in message
    assert "SERVO1_MIN is 1100, wanted 1000" in message
    _, message = import_mavlink(tmp_path / "run.tlog", rig=rig, out=tmp_path / "run.mcap")
    assert " 0 lost," in message
    assert "differs from the rig" not in message


def test_a_damaged_dataflash_log_gives_a_one_line_error(tmp_path: Path) -> None:
    path = tmp_path / "bad.BIN"
    path.write_bytes(b"\xa3\x95" + bytes(range(200)))
    with pytest.raises(SeatrialError, match=r"bad\.BIN: .*DataFlash"):
        import_mavlink(path, out=tmp_path / "bad.mcap")


def test_zeroed_blocks_of_a_dataflash_log_lose_only_their_messages(tmp_path: Path) -> None:
    path = tmp_path / "00000001.BIN"
    dataflash(path)
    data = bytearray(path.read_bytes())
    for begin in (2000, 2900, 3700):
        data[begin : begin + 64] = bytes(64)
    path.write_bytes(data)
    with pytest.warns(SeatrialWarning, match="3 damaged places: the messages there are left out"):
        out, _ = import_mavlink(path, out=tmp_path / "bin.mcap")
    with open_log(out) as log:
        assert len(log.table(Ahrs, "autopilot")) >= 15


def test_a_flipped_bit_in_a_time_removes_one_message(tmp_path: Path) -> None:
    path = tmp_path / "00000001.BIN"
    dataflash(path)
    data = bytearray(path.read_bytes())
    att = bytes([0xA3, 0x95, 1])
    place = data.index(att, 2500)
    data[place + 3 + 6] ^= 0x40  # a bit of TimeUS
    path.write_bytes(data)
    with pytest.warns(SeatrialWarning, match="1 message with an impossible time left out"):
        out, _ = import_mavlink(path, out=tmp_path / "bin.mcap")
    with open_log(out) as log:
        attitude = log.table(Ahrs, "autopilot")
    assert len(attitude) == 19
    np.testing.assert_allclose(np.ptp(attitude["t"]), 1.9, atol=0.01)


def armed_boat(path: Path, off: tuple[float, float], more: tuple[float, float] | None = None) -> Path:
    """Import a BIN of 60 s without data in `off` and `more` [s], armed from 10.0 to 25.0 s and from 40.0 s on."""
    out, add = dataflash_head(), dataflash_message
    place = (423580000, -710856831, 150)
    for k in range(600):
        us, t = 30_000_000 + 100_000 * k, 0.1 * k
        if k in (100, 250, 400):
            out += add("ARM", us, int(k != 250))
        if any(a <= t < b for a, b in (off, more or off)):
            continue
        out += add("GPS", us, 0, 4, 3_600_000 + 100 * k, 2400, 12, 80, *place, 1.5, 90.0, 0.1, 0.0, 0.0, 1)
        out += add("ATT", us, 0, 100, 0, -200, 0, 9000 + 10 * k, 0.0, 0.0)
        out += add("RCOU", us, 1700, 0, 1300)
    path.with_suffix(".BIN").write_bytes(out)
    return import_mavlink(path.with_suffix(".BIN"), out=path)[0]


def gaps(log: Log) -> list[tuple[str, str]]:
    return [(f.level, f.text) for f in check_devices(log) if f.code == "sections-missing" and f.where == "autopilot"]


def test_gaps_of_a_disarmed_autopilot_are_no_warning(tmp_path: Path) -> None:
    with open_log(armed_boat(tmp_path / "off.mcap", (24.8, 40.1))) as log:  # it logs only while armed
        assert gaps(log) == [("ok", "data missing: 1 section, 15.4 s in all, while disarmed")]
    with open_log(armed_boat(tmp_path / "both.mcap", (24.8, 40.1), (45.0, 50.0))) as log:
        ((level, text),) = gaps(log)
    assert level == "warning"
    assert text.startswith("data missing: 1 section, 5.1 s in all, the longest (5.1 s) from 44.9 s on")
    assert text.endswith("; beside them 1 section, 15.4 s in all, while disarmed")


def test_a_map_keeps_the_arming_of_a_dataflash_log(tmp_path: Path) -> None:
    armed_boat(tmp_path / "run.mcap", (24.8, 40.1))
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "run.BIN").text)
    (path,) = import_files(tmp_path / "map.toml", [tmp_path / "run.BIN"], out=tmp_path / "mapped.mcap")
    with open_log(path) as log:
        assert not log.sources(Autopilot)
        assert [(round(row.begin, 1), round(row.end, 1)) for row in log_content(log).armed] == [
            (10.0, 25.0),
            (40.0, 59.9),
        ]
        found = [f for f in check_devices(log) if f.code == "sections-missing"]
    assert [(f.level, f.text) for f in found] == [("ok", "data missing: 1 section, 15.4 s in all, while disarmed")]


def test_gaps_outside_the_window_of_a_fit_are_not_reported(tmp_path: Path) -> None:
    path = armed_boat(tmp_path / "run.mcap", (45.0, 50.0))
    for window, n in ((TimeWindow(5.0, 40.0), 0), (TimeWindow(30.0, 55.0), 1)):
        found = load_run(path, "estimation", window, device_faults).device_faults
        assert found is not None
        assert sum(f.code == "sections-missing" and f.where == "autopilot" for f in found) == n


def test_info_lists_the_armed_intervals_in_the_times_of_a_fit(tmp_path: Path) -> None:
    with open_log(armed_boat(tmp_path / "run.mcap", (0.0, 2.0))) as log:
        content = log_content(log)
    assert [(row.device, round(row.begin, 1), round(row.end, 1)) for row in content.armed] == [
        ("autopilot", 8.0, 23.0),
        ("autopilot", 38.0, 57.9),
    ]
    console = Console(record=True, width=200)
    show_log(content, console)
    assert "armed: autopilot, 15.0 s: --from 8.0 --to 23.0 (seatrial ident)" in console.export_text()
