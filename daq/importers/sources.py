"""Kinds of sources: a file or folder is recognised by its contents, not by its name, and read as tables."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.table import SourceOptions, Table
from seatrial.daq.importers.text_table import TextTable, wide_encoding

_HEAD_BYTES = 65536
_UNWRITTEN = re.compile(rb"\0{64,}")  # blocks of a card that a power cut left empty, also in text
LABVIEW, FLYSIGHT = b"LabVIEW Measurement", b"$FLYS"
BAG_DESCRIPTION = b"rosbag2_bagfile_information"  # first key of the metadata.yaml of a bag of ROS 2


class SourceKind(NamedTuple):
    """Kind of source file, for example a ROS bag, with the function that reads it.

    Attributes
    ----------
    name : str
        Name of the kind, as in the metadata of logs: csv, ros, ulog, matlab, parquet, mavlink, can, labview or
        flysight.
    read : callable
        Function that takes the path of the source and the options of the map, and returns the tables of the source.
    """

    name: str  # in the metadata of logs
    read: Callable[[Path, SourceOptions], list[Table]]  # reader of its tables


def source_kind(path: Path) -> SourceKind:
    """Return the kind of a source, recognised by the first bytes of the file, not by its name.

    Any folder is "ros", and any text of no known format is "csv"; whether it is a table shows only when it is read. A
    text may contain blocks of at least 64 zero bytes in up to half of its first 65536 bytes, or have two bytes per
    character (UTF-16). Any other file with zero bytes is of an unknown kind. A DataFlash log that was converted to text
    is refused, and so is the metadata.yaml of a bag.

    Parameters
    ----------
    path
        A file, or the folder of a ROS bag.

    Returns
    -------
    SourceKind
        The kind, with its reader.

    Raises
    ------
    SeatrialError
        If the file cannot be read or its kind is unknown.
    """
    if path.is_dir():
        return _bag_kind()
    head = _first_bytes(path)
    if head.startswith((b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0")):
        return _bag_kind()
    if head.startswith(b"ULog\x01\x12\x35"):
        from seatrial.daq.importers.ulog import read_ulog

        return SourceKind("ulog", read_ulog)
    if head.startswith((b"MATLAB 5.0", b"MATLAB 7.3", b"\x89HDF\r\n\x1a\n")):
        from seatrial.daq.importers.columnar import read_matlab

        return SourceKind("matlab", read_matlab)
    if head.startswith(b"PAR1"):
        from seatrial.daq.importers.columnar import read_parquet

        return SourceKind("parquet", read_parquet)
    from seatrial.daq.importers.mavlink import DATAFLASH, is_tlog

    if head.startswith(DATAFLASH) or is_tlog(head):
        from seatrial.daq.importers.samples import read_autopilot_log

        return SourceKind("mavlink", read_autopilot_log)
    from seatrial.daq.importers.can_log import is_can_log, read_can

    if is_can_log(head):
        return SourceKind("can", read_can)
    if head.removeprefix(b"\xef\xbb\xbf").startswith(LABVIEW):
        from seatrial.daq.importers.labview import read_lvm

        return SourceKind("labview", read_lvm)
    if head.removeprefix(b"\xef\xbb\xbf").startswith(FLYSIGHT):
        from seatrial.daq.importers.flysight import read_flysight

        return SourceKind("flysight", read_flysight)
    if head.lstrip().startswith(BAG_DESCRIPTION):
        raise SeatrialError(f"{path}: describes a bag of ROS 2; give the folder of the bag, {path.parent}")
    if head.startswith(b"FMT,"):
        raise SeatrialError(f"{path}: is a DataFlash log that was converted to text; import the original .BIN file")
    written = _UNWRITTEN.sub(b"", head)
    if not wide_encoding(head) and (b"\0" in written or len(written) < len(head) / 2):
        raise SeatrialError(
            f"{path}: unknown kind of file; give one that import reads: text, bags of ROS 1 and 2, PX4 (.ulg), "
            "ArduPilot (tlog, BIN), MATLAB (.mat), LabVIEW (.lvm), FlySight 2, Parquet, CAN (candump, .asc, .blf, "
            "BusMaster, NMEA 2000 text)"
        )
    return SourceKind("csv", _read_text_table)


def _bag_kind() -> SourceKind:
    """Return "ros", the kind of source of a ROS bag, with its reader."""
    from seatrial.daq.importers.ros import read_bag

    return SourceKind("ros", read_bag)


def _read_text_table(path: Path, options: SourceOptions) -> list[Table]:
    """Read a text file as one table, in the text style (delimiter, decimal mark, ...) of the import map."""
    return [TextTable(path, options.style)]


def _first_bytes(path: Path) -> bytes:
    """Return the first 65536 bytes of a source file. Raise SeatrialError if the file cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(_HEAD_BYTES)
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error


def text_head(path: Path) -> bytes:
    """Return the first 65536 bytes of a text file, without blocks of zeros, to recognise its style.

    A power cut leaves such blocks on a memory card.

    Parameters
    ----------
    path
        The text file.

    Returns
    -------
    bytes
        The first bytes.

    Raises
    ------
    SeatrialError
        If the file cannot be read.
    """
    return _UNWRITTEN.sub(b"", _first_bytes(path))
