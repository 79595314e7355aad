"""Tests of values in foreign files that would take gigabytes, minutes or cause an internal error: each is refused in
one line.
"""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path

import pytest

from seatrial.daq.config.mission_file import parse_mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log.mcap_writer import MAX_CHANNELS, RecordWriter
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol.dbc import load_dbc
from seatrial.daq.samples import Esc
from tests.daq.csv_files import write
from tests.daq.logs import write_everything

MISSION = """
format = "seatrial-mission 1"
name = "x"
kind = "mission"
thrusters = ["left"]
limits = {{ slew_per_s = {slew} }}
end = {{ t = {end} }}
[[segment]]
name = "a"
t = [0.0]
n = [[0.5]]
"""
DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ rpm : 0|16@1+ ({factor},0) [0|0] "rpm" A
"""


def test_an_extremely_small_slew_limit_is_refused() -> None:
    with pytest.raises(SeatrialError, match=r"limits\.slew_per_s: 1e-09 per second makes ramps of up to"):
        parse_mission(MISSION.format(slew=1e-9, end=1e9), "m.toml")
    assert parse_mission(MISSION.format(slew=0.001, end=1e9), "m.toml").setpoints()[0].size == 12_502


def test_the_number_of_rows_to_skip_is_limited_by_the_file(tmp_path: Path) -> None:
    csv_map, files = write(tmp_path, csv="skip_rows = 9000000000000000000")
    with pytest.raises(SeatrialError, match="the file is empty"):
        import_files(csv_map, files)


@pytest.mark.parametrize("name", ["rot13", "hex", "base64", "undefined", "nothing"])
def test_an_encoding_that_is_not_for_text_is_refused(tmp_path: Path, name: str) -> None:
    csv_map, files = write(tmp_path, csv=f'encoding = "{name}"')
    with pytest.raises(SeatrialError, match=f"'{name}' is not a text encoding"):
        import_files(csv_map, files)


@pytest.mark.parametrize(
    ("pattern", "why"), [("%Y %Y", "contains a field twice"), ("%Y %Q", "is not a strptime pattern")]
)
def test_an_invalid_pattern_of_times_is_refused(tmp_path: Path, pattern: str, why: str) -> None:
    csv_map, files = write(tmp_path, time=f'format = "{pattern}"')
    with pytest.raises(SeatrialError, match=rf"format: '{pattern}' {why}"):
        import_files(csv_map, files)


@pytest.mark.parametrize("factor", ["1e308", "-1e200", "1e400"])
def test_a_dbc_factor_that_overflows_is_refused(tmp_path: Path, factor: str) -> None:
    path = tmp_path / "x.dbc"
    path.write_text(DBC.format(factor="0.25"), encoding="utf-8")
    assert load_dbc(str(path)).messages[0].signals[0].scale == 0.25
    path.write_text(DBC.format(factor=factor), encoding="utf-8")
    with pytest.raises(SeatrialError, match=r"x\.dbc: signal 'rpm' of M has the factor") as caught:
        load_dbc(str(path))
    assert "\n" not in str(caught.value)


def test_a_dbc_that_is_not_a_regular_file_is_refused(tmp_path: Path) -> None:
    """A read of a pipe would wait for its writer, and a device has no end."""
    os.mkfifo(tmp_path / "pipe.dbc")
    for path in (tmp_path / "pipe.dbc", Path("/dev/zero"), tmp_path):
        with pytest.raises(SeatrialError, match="is not a file"):
            load_dbc(str(path))
    with pytest.raises(SeatrialError, match="cannot be read: No such file"):
        load_dbc(str(tmp_path / "nothing.dbc"))


def test_more_topics_than_a_file_can_number_are_refused() -> None:
    writer = RecordWriter(BytesIO(), chunk_bytes=1 << 20, profile="", library="")
    for k in range(MAX_CHANNELS):
        writer.register_channel(f"/c{k}", "cdr", 0, {})
    with pytest.raises(SeatrialError, match="at most 65535 topics"):
        writer.register_channel("/one-more", "cdr", 0, {})


def test_a_node_number_of_thousands_of_digits_is_ignored(tmp_path: Path) -> None:
    write_everything(tmp_path / "run.mcap", 3)
    with open_log(tmp_path / "run.mcap") as log:
        log.counts[f"/esc/{'1' * 5000}/state"] = 3
        assert "1" * 5000 not in map(str, log.nodes(Esc, "esc"))
