"""Tests of the import of CAN logs as text: candump, ASC with its date, BusMaster, and NMEA 2000 of three gateways."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.can_log import read_can, read_frames
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.sources import source_kind
from seatrial.daq.importers.table import SourceOptions
from seatrial.daq.protocol import EXTENDED
from seatrial.daq.protocol.nmea2000 import FIX, HEADING, identifier

N = 60
RATE_HZ = 10.0
START = datetime(2024, 5, 12, 9, 0, 0, tzinfo=UTC)
T0 = START.timestamp()
T = np.arange(N) / RATE_HZ
YAW = np.radians(10.0 + np.arange(N))
SOURCE = 4


def heading(k: int) -> bytes:
    return struct.pack("<BHhhB", 0xFF, round(1e4 * YAW[k]), 0x7FFF, 0x7FFF, 0)


def fix(k: int) -> bytes:
    days, seconds = divmod(T0 + T[k], 86400.0)
    place = [round(1e16 * angle) for angle in (54.1 + 1e-5 * k, 10.8)]
    values = (int(days), round(1e4 * seconds), *place, 0, 0x10, 0xFC, 9, 80, 150, 0, 0)
    return b"\xff" + struct.pack("<HIqqqBBBhhiB", *values)


def lines_of_frames(line: Callable[[int, str, bytes], str]) -> list[str]:
    """Return a line for each heading: its number, its identifier in hexadecimal, its data."""
    return [line(k, f"{identifier(HEADING, SOURCE):08X}", heading(k)) for k in range(N)]


def spaced(data: bytes) -> str:
    return data.hex(" ").upper()


def clock(k: int) -> str:
    return datetime.fromtimestamp(T0 + T[k], UTC).strftime("%H:%M:%S.%f")


BUSMASTER = [
    "***BUSMASTER Ver 3.2.2***", "***PROTOCOL CAN***", "***[START LOGGING SESSION]***",
    "***START DATE AND TIME 12:5:2024 9:0:0:000***", "***HEX***", "***SYSTEM MODE***",
    "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***",
]  # fmt: skip
ASC = ["date Sun May 12 09:00:00.000 am 2024", "base hex  timestamps absolute", "no internal events logged",
       "Begin Triggerblock Sun May 12 09:00:00.000 am 2024", "   0.000000 Start of measurement"]  # fmt: skip
MIDNIGHT = 86400.0 * (T0 // 86400.0)
DIALECTS: dict[str, tuple[list[str], float]] = {  # the lines of a log and its first time [s]
    "candump -L": (lines_of_frames(lambda k, i, d: f"({T0 + T[k]:.6f}) can0 {i}#{d.hex()}"), T0),
    "candump -ta": (lines_of_frames(lambda k, i, d: f" ({T0 + T[k]:.6f})  can0  {i}   [8]  {spaced(d)}"), T0),
    "candump -ta -a": (
        lines_of_frames(lambda k, i, d: f" ({T0 + T[k]:.6f})  can0  {i}   [8]  {spaced(d)}   '........'"), T0
    ),
    "candump -tA": (lines_of_frames(lambda k, i, d: f" (2024-05-12 {clock(k)})  can0  {i}   [8]  {spaced(d)}"), T0),
    "candump -tz": (lines_of_frames(lambda k, i, d: f" ({T[k]:010.6f})  can0  {i}   [8]  {spaced(d)}"), 0.0),
    "candump -td": (
        lines_of_frames(
            lambda k, i, d: f" ({0.0 if k == 0 else 0.05 if k % 2 else 0.15:010.6f})  can0  {i}   [8]  {spaced(d)}"
        ),
        0.0,
    ),
    "ASC": (
        ASC + lines_of_frames(lambda k, i, d: f"   {T[k]:.6f} 1  {i}x       Rx   d 8 {spaced(d)}  Length = 1 ID = 2x"),
        T0,
    ),
    "ASC, relative": (
        [
            *(ASC[0], "base dec  timestamps relative"),
            *lines_of_frames(lambda k, i, d: f"{0.1 * (k > 0):.6f} 1  {int(i, 16)}x  Rx   d 8 {' '.join(map(str, d))}"),
        ],
        T0,
    ),
    "ASC, German": (
        [
            *("date Son Mai 12 09:00:00 2024", "base hex  timestamps absolute"),
            *lines_of_frames(lambda k, i, d: f"   {T[k]:.6f} 1  {i}x  Rx   d 8 {spaced(d)}"),
        ],
        T0,
    ),
    "BusMaster": (
        BUSMASTER
        + lines_of_frames(lambda k, i, d: f"9:00:{k // 10:02d}:{k % 10 * 1000:04d} Rx 1 0x{i} x 8 {spaced(d)}"),
        T0,
    ),
    "BusMaster, since the start": (
        [
            *(line.replace("SYSTEM", "ABSOLUTE") for line in BUSMASTER),
            *lines_of_frames(lambda k, i, d: f"0:00:{k // 10:02d}:{k % 10 * 1000:04d} Rx 1 0x{i} x 8 {spaced(d)}"),
        ],
        T0,
    ),
    "Yacht Devices": (lines_of_frames(lambda k, i, d: f"{clock(k)[:-3]} R {i} {spaced(d)}"), T0 - MIDNIGHT),
    "N2K": (
        lines_of_frames(lambda k, i, d: f"A{clock(k)[:-3].replace(':', '')} {SOURCE:02X}FF2 {HEADING:05X} {d.hex()}"),
        T0 - MIDNIGHT,
    ),
    "canboat": (
        lines_of_frames(lambda k, i, d: f"2024-05-12T{clock(k)[:-3]}Z,2,{HEADING},{SOURCE},255,8,{d.hex(',')}"), T0
    ),
    "canboat, older": (
        lines_of_frames(lambda k, i, d: f"2024-05-12-{clock(k)[:-3]},2,{HEADING},{SOURCE},255,8,{d.hex(',')}"), T0
    ),
}  # fmt: skip


def write(folder: Path, lines: Sequence[str]) -> Path:
    path = folder / "bus.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("dialect", DIALECTS)
def test_each_dialect_gives_all_frames_with_their_times(dialect: str, tmp_path: Path) -> None:
    lines, first = DIALECTS[dialect]
    path = write(tmp_path, lines)
    assert source_kind(path).name == "can"
    frames = read_frames(path)
    assert [(frame.word, frame.data) for frame in frames] == [
        (identifier(HEADING, SOURCE) | EXTENDED, heading(k)) for k in range(N)
    ]  # the first frame is included
    if dialect == "candump -td":
        np.testing.assert_allclose(np.diff([frame.t for frame in frames])[:2], [0.05, 0.15], atol=1e-9)
    else:
        np.testing.assert_allclose([frame.t for frame in frames], first + T, atol=2e-6)
    (table,) = read_can(path, SourceOptions())
    np.testing.assert_allclose(table.numbers("yaw")[-5:], YAW[-5:], atol=1e-4)


@pytest.mark.parametrize("name", ["N2K", "canboat"])
def test_a_message_longer_than_a_frame_is_split_into_frames(name: str, tmp_path: Path) -> None:
    """A gateway writes a fix in one line. The decoder of the bus needs it as several frames."""
    lines = []
    for k in range(N):
        if name == "N2K":
            lines.append(f"A{clock(k)[:-3].replace(':', '')} {SOURCE:02X}FF3 {FIX:05X} {fix(k).hex().upper()}")
        else:
            lines.append(f"2024-05-12T{clock(k)[:-3]}Z,3,{FIX},{SOURCE},255,{len(fix(k))},{fix(k).hex(',')}")
    (table,) = read_can(write(tmp_path, lines), SourceOptions())
    assert table.topic == "gnss"
    np.testing.assert_allclose(table.numbers("lat")[-3:], 54.1 + 1e-5 * np.arange(N - 3, N), atol=1e-9)


def test_frames_after_midnight_belong_to_the_next_day(tmp_path: Path) -> None:
    lines, _ = DIALECTS["Yacht Devices"]
    late = [line.replace("09:00:0", "23:59:5", 1) for line in lines[:10]]
    early = [line.replace("09:00:0", "00:00:0", 1) for line in lines[10:]]
    t = np.array([frame.t for frame in read_frames(write(tmp_path, late + early))])
    assert np.all(np.diff(t) > 0.0)
    assert t[10] == pytest.approx(86401.0)


def test_a_log_without_times_is_refused_with_advice(tmp_path: Path) -> None:
    """candump without options writes lines without times."""
    path = write(tmp_path, lines_of_frames(lambda k, i, d: f"  can0  {i}   [8]  {spaced(d)}"))
    with pytest.raises(SeatrialError, match=r"its frames have no times; record again with times: candump -ta can0"):
        guess_map(path)


def test_lines_without_a_frame_are_counted(tmp_path: Path) -> None:
    lines = DIALECTS["candump -ta"][0].copy()
    lines[7] = lines[7][:40]  # the data is missing
    lines[9] = " (1715504401.000000)  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME"
    with pytest.warns(SeatrialWarning, match="1 line left out, not CAN frames; check the first, line 8"):
        frames = read_frames(write(tmp_path, lines))
    assert len(frames) == N - 2


def test_a_heading_with_a_date_that_does_not_exist_is_left_out(tmp_path: Path) -> None:
    for dialect, heading_line in (("ASC", "date Fri Feb 30 09:00:00.000 am 2024"), ("BusMaster", "")):
        lines = DIALECTS[dialect][0].copy()
        at = next(k for k, line in enumerate(lines) if "date" in line.lower())
        lines[at] = heading_line or lines[at].replace("12:5:2024", "30:2:2024")
        assert lines[at] != DIALECTS[dialect][0][at]
        with pytest.warns(SeatrialWarning, match=f"1 line left out, not CAN frames; check the first, line {at + 1}"):
            assert len(read_frames(write(tmp_path, lines))) == N


def test_a_text_without_can_frames_is_read_as_a_table(tmp_path: Path) -> None:
    path = write(tmp_path, ["t,yaw", *(f"{t:.1f},{t:.2f}" for t in T)])
    assert source_kind(path).name == "csv"
