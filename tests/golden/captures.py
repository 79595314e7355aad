"""Captures that are not from gpsd, each checked against the decoding of another program or known values."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from seatrial.daq.protocol import dbc, mip, nmea, nmea2000, ubx, vectornav, vesc
from seatrial.daq.protocol.canframe import pack_can
from seatrial.daq.protocol.decoder import Decoder
from seatrial.daq.rig import DbcSignal
from seatrial.daq.samples import Ahrs, Esc, Frame, Gnss

GAUSS, DEG = 1e-4, math.pi / 180.0
# The parser of the logger itself left out this one of its 99 frames.
LOST = 78
KEPT = {
    "mx": ("MagX", GAUSS), "my": ("MagY", GAUSS), "mz": ("MagZ", GAUSS),
    "ax": ("AccX", 1.0), "ay": ("AccY", 1.0), "az": ("AccZ", 1.0),
    "p": ("GyroX", 1.0), "q": ("GyroY", 1.0), "r": ("GyroZ", 1.0),
    "yaw": ("Yaw", DEG), "pitch": ("Pitch", DEG), "roll": ("Roll", DEG),
}  # fmt: skip
NMEA2000 = (DbcSignal("EngineParametersRapid", "EngineSpeed", "rpm", "EngineInstance"),)


class Result(NamedTuple):
    """Result of one capture: the decoded content, and whether it is correct."""

    name: str
    samples: int
    checksum_errors: int
    unparsed_bytes: int
    summary: str
    right: bool


def results(folder: Path) -> Iterator[Result]:
    """Return the results of every capture below `folder`, the value of SEATRIAL_DATA."""
    yield _vn100(folder / "vectornav")
    yield _simulated(folder, "vn.bin", vectornav.Decoder, _gravity)
    yield _simulated(folder, "ms7.bin", mip.Decoder, _facing_east)
    for name in ("ubx.bin", "nmea.bin", "gnmea.bin"):
        yield _simulated(folder, name, ubx.Decoder if name == "ubx.bin" else nmea.Decoder, _place)
    yield _vesc(folder / "can/vesc_forum_frames.log")
    yield _engine(folder / "can/susteranna-actisense-serial.raw")
    yield _bus(folder / "can/susteranna-actisense-serial.raw")


def _read(path: Path, decoder: Decoder) -> list[Frame]:
    frames = decoder.feed(path.read_bytes(), 0.0)
    return frames + (decoder.flush() if isinstance(decoder, (nmea.Decoder, ubx.Decoder)) else [])


def _result(path: Path, decoder: Decoder, frames: list[Frame], summary: str, right: bool) -> Result:
    name = f"{path.parent.name}/{path.name}"
    right = right and decoder.checksum_errors == 0
    return Result(name, len(frames), decoder.checksum_errors, decoder.unparsed_bytes, summary, right)


def _vn100(folder: Path) -> Result:
    """Compare a real VN-100 with the decoding of its logger.

    The largest difference is relative to the value, or to 1e-6 (in Gauss) for smaller values.
    """
    decoder = vectornav.Decoder()
    frames = _read(folder / "F00294", decoder)
    samples = [frame.sample for k, frame in enumerate(frames) if k != LOST]
    with (folder / "parsed/F00294_B").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file, skipinitialspace=True))
    worst = 0.0
    for sample, row in zip(samples, rows, strict=True):
        for name, (column, scale) in KEPT.items():
            theirs = float(row[column])
            ours = getattr(sample, name) / scale
            worst = max(worst, abs(ours - theirs) / max(abs(theirs), 1e-6))
    return _result(folder / "F00294", decoder, frames, f"largest relative difference {worst:.1e}", worst <= 1e-6)


def _simulated(
    folder: Path, name: str, make: Callable[[], Decoder], check: Callable[[list[Frame]], tuple[str, bool]]
) -> Result:
    decoder = make()
    frames = _read(folder / "ardurover" / name, decoder)
    times = [frame.t_device for frame in frames if math.isfinite(frame.t_device)]
    summary, right = check(frames)
    right = right and all(b >= a for a, b in itertools.pairwise(times))
    return _result(folder / "ardurover" / name, decoder, frames, summary, right)


def _gravity(frames: list[Frame]) -> tuple[str, bool]:
    found = [f.sample.az for f in frames if isinstance(f.sample, Ahrs) and f.sample.az == f.sample.az]
    mean = sum(found) / len(found)
    return f"specific force down {mean:.3f} m/s2", abs(mean + 9.81) < 0.05


def _facing_east(frames: list[Frame]) -> tuple[str, bool]:
    """Check that ArduPilot's simulated boat lies still with its bow to the east."""
    found = [f.sample for f in frames if isinstance(f.sample, Ahrs)]
    yaw, down = math.degrees(found[0].yaw), sum(s.az for s in found) / len(found)
    right = abs(yaw - 90.0) < 1.0 and abs(down + 9.81) < 0.05 and len(found) > 180
    return f"bow at {yaw:.2f} degrees, specific force down {down:.3f} m/s2", right


def _place(frames: list[Frame]) -> tuple[str, bool]:
    """Check that ArduPilot's simulated boat stays within 60 m of its start."""
    fixes = [f.sample for f in frames if isinstance(f.sample, Gnss) and f.sample.fix >= 2]
    north = max(abs(s.lat - 42.358) for s in fixes) * 111e3
    east = max(abs(s.lon + 71.08705) for s in fixes) * 82e3
    return f"{len(fixes)} fixes, {max(north, east):.0f} m from home at most", max(north, east) < 60.0 and len(
        fixes
    ) > 40


def _vesc(path: Path) -> Result:
    """Check five frames of a motor at rest with a supply of 23.9 V and a controller at 25.3 degrees."""
    decoder = vesc.Decoder({4: 7})
    frames: list[Frame] = []
    # the voltage comes after the state to which it belongs
    for line in [*path.read_text(encoding="ascii").splitlines()] * 2:
        identifier, data = line.split()[2].split("#")
        frames += decoder.feed(pack_can(int(identifier, 16), bytes.fromhex(data)), 0.0)
    last = frames[-1].sample
    assert isinstance(last, Esc)
    summary = f"{last.rpm:.0f} rpm, {last.voltage:.1f} V, {last.temperature:.1f} deg C"
    return _result(path, decoder, frames, summary, summary == "0 rpm, 23.9 V, 25.3 deg C")


def _engine(path: Path) -> Result:
    """Check NMEA 2000 of a ship under way: canboat reads 781 to 818 rpm in its 314 messages of PGN 127488."""
    decoder = dbc.Decoder(dbc.load_dbc(str(Path(dbc.__file__).with_name("nmea2000.dbc"))), NMEA2000)
    frames: list[Frame] = []
    for line in path.read_text(encoding="ascii").splitlines():
        words = line.split(",")
        priority, pgn, source, target, length = map(int, words[1:6])
        if pgn >= 1 << 18 or length > 8:
            continue  # messages of the adapter itself, and messages that take several frames
        address = pgn | (target if pgn >> 8 & 0xFF < 0xF0 else 0)
        frames += decoder.feed(pack_can(priority << 26 | address << 8 | source, bytes.fromhex("".join(words[6:]))), 0.0)
    speeds = [f.sample.rpm for f in frames if isinstance(f.sample, Esc)]
    summary = f"{min(speeds):.0f} to {max(speeds):.0f} rpm"
    return _result(
        path, decoder, frames, summary, (len(speeds), round(min(speeds)), round(max(speeds))) == (314, 781, 818)
    )


# Count and sums of the capture's values, read by the package nmea2000 2026.10.3 with canboat's database.
N2K_HEADINGS, N2K_RATES = (619, 3077.1234), (628, 0.02511749999999999)  # address 15, from the first variation on
N2K_FIXES = (31, (45266822604.0, 1629.128736, 169.30805016666667, -207.319997, 372.0, 19.6))  # address 18
N2K_FIELDS = ("utc", "lat", "lon", "alt", "n_sat", "hdop")


def _bus(path: Path) -> Result:
    """Check the compasses and receivers of the same ship.

    The adapter has joined the fast packets; they are split again.
    """
    decoder = nmea2000.Decoder(settle=0.0)
    frames: list[Frame] = []
    variation: list[float] = []  # variation that was added to each heading
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines()):
        words = line.split(",")
        pgn, source, data = int(words[2]), int(words[3]), bytes.fromhex("".join(words[6:]))
        if pgn >= 1 << 18 or (len(data) > 8 and pgn != nmea2000.FIX) or (pgn, source) == (nmea2000.HEADING, 128):
            continue  # the second compass is used only until the first one has a variation
        parts = [(nmea2000.identifier(pgn, source), data)]
        if len(data) > 8:
            size = bytes((len(data),))
            parts = [
                (parts[0][0], bytes((number % 8 << 5 | k,)) + (size + data)[7 * k : 7 * k + 7].ljust(7, b"\xff"))
                for k in range(len(data) // 7 + 1)
            ]
        for part in parts:
            found = decoder.feed(pack_can(*part), float(words[0][17:-1]))
            variation += [decoder._bus_variation] * len(_yaws(found))
            frames += found
    yaws = _yaws(frames)
    headings = math.fsum((yaw - east) % math.tau for yaw, east in zip(yaws, variation, strict=True))
    rates = [f.sample.r for f in frames if isinstance(f.sample, Ahrs) and math.isfinite(f.sample.r)]
    fixes = [f.sample for f in frames if isinstance(f.sample, Gnss) and f.sample.n_sat == 12]
    sums = [math.fsum(getattr(fix, name) for fix in fixes) for name in N2K_FIELDS]
    right = (len(yaws), len(rates), len(fixes)) == (N2K_HEADINGS[0], N2K_RATES[0], N2K_FIXES[0])
    right = right and math.isclose(headings, N2K_HEADINGS[1], rel_tol=1e-12)
    right = right and math.isclose(math.fsum(rates), N2K_RATES[1], rel_tol=1e-9)
    right = right and all(math.isclose(a, b, rel_tol=1e-12) for a, b in zip(sums, N2K_FIXES[1], strict=True))
    summary = f"{len(yaws)} headings, {len(rates)} rates of turn, {len(fixes)} fixes"
    return _result(path, decoder, frames, summary, right)


def _yaws(frames: list[Frame]) -> list[float]:
    return [f.sample.yaw for f in frames if isinstance(f.sample, Ahrs) and math.isfinite(f.sample.yaw)]
