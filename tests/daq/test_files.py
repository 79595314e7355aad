"""Tests of the writer of outputs: whole files, no followed link, only files are replaced, and only files are read."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import append_to, new_file, require_file, write_output
from seatrial.daq.importers.write_log import replacing
from seatrial.daq.log import open_log
from seatrial.daq.log.recovery import recover_log
from seatrial.daq.tools.export import export_log
from seatrial.daq.tools.ros_export import export_ros
from tests.daq.logs import write_everything


def planted(out: Path) -> Path:
    """Make the output a dangling link, and return its target."""
    aim = out.parent / "elsewhere"
    out.symlink_to(aim)
    return aim


def recovered(folder: Path, out: Path) -> None:
    recover_log(folder / "run.mcap", out, force=True)


def imported(folder: Path, out: Path) -> None:
    with replacing(out, True, ()) as part:
        part.write_bytes(b"x")


def appended(folder: Path, out: Path) -> None:
    append_to(out).close()


WRITERS: list[Callable[[Path, Path], None]] = [
    lambda folder, out: write_output(out, "x"), lambda folder, out: write_output(out, "x", force=False),
    recovered, imported, appended,
]  # fmt: skip


@pytest.mark.parametrize("write", WRITERS)
def test_a_planted_link_is_not_followed(tmp_path: Path, write: Callable[[Path, Path], None]) -> None:
    write_everything(tmp_path / "run.mcap", 3)
    out = tmp_path / "out.file"
    aim = planted(out)
    with pytest.raises(SeatrialError, match=r"out\.file: is a symbolic link"):
        write(tmp_path, out)
    assert not aim.exists()
    assert out.is_symlink()


@pytest.mark.parametrize("form", ["csv", "parquet", "mat", "netcdf", "ros"])
def test_no_form_of_export_follows_a_planted_link(tmp_path: Path, form: str) -> None:
    """A dangling link takes each name that an export writes, one after the other."""
    write_everything(tmp_path / "run.mcap", 3)
    with open_log(tmp_path / "run.mcap") as log:

        def write(folder: Path) -> list[Path]:
            return export_ros(log, folder, True) if form == "ros" else export_log(log, form, folder, True)

        for name in [path.name for path in write(tmp_path / "whole")]:
            folder = tmp_path / f"out-{name}"
            folder.mkdir()
            aim = planted(folder / name)
            with pytest.raises(SeatrialError, match="is a symbolic link"):
                write(folder)
            assert not aim.exists()


def write_half(out: Path) -> None:
    with new_file(out) as part:
        part.write_text("half")
        raise RuntimeError


def write_late(out: Path) -> None:
    """Write an output while another program makes a file of the same name."""
    with new_file(out, force=False) as part:
        part.write_text("ours")
        out.write_text("theirs")


def test_an_output_is_complete_or_absent(tmp_path: Path) -> None:
    out = tmp_path / "out.txt"
    with pytest.raises(RuntimeError):
        write_half(out)
    assert list(tmp_path.iterdir()) == []
    write_output(out, "a\r\n")
    write_output(out, "b\n")
    assert out.read_bytes() == b"b\n"
    assert out.stat().st_mode & 0o777 == 0o666 & ~os.umask(os.umask(0o022))
    with pytest.raises(SeatrialError, match="the file exists already; --force replaces it"):
        write_output(out, "c", force=False)
    assert list(tmp_path.iterdir()) == [out]


def test_an_error_without_a_number_keeps_its_text(tmp_path: Path) -> None:
    """Libraries raise OSError for damaged files, for example of gzip."""
    with pytest.raises(OSError, match=r"^CRC check failed$"), new_file(tmp_path / "out.txt", force=False):
        raise OSError("CRC check failed")


def test_a_file_created_in_the_meantime_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out.txt"
    with pytest.raises(SeatrialError, match="exists already"):
        write_late(out)
    assert out.read_text() == "theirs"


def test_only_a_regular_file_is_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/null")):
        with pytest.raises(SeatrialError, match="exists already, and is a folder, a pipe or a device"):
            write_output(path, "x")


def test_only_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        for name in ("pipe", "link", "socket", ""):
            with pytest.raises(SeatrialError, match="is not a file"):
                require_file(tmp_path / name)
    with pytest.raises(SeatrialError, match="cannot be read: No such file"):
        require_file(tmp_path / "nothing")


@pytest.mark.parametrize("write", WRITERS)
def test_the_folder_of_an_output_is_created(tmp_path: Path, write: Callable[[Path, Path], None]) -> None:
    write_everything(tmp_path / "run.mcap", 3)
    write(tmp_path, tmp_path / "new/folder/out.file")
    assert (tmp_path / "new/folder/out.file").is_file()


@pytest.mark.parametrize("write", WRITERS)
def test_an_output_below_a_file_is_reported(tmp_path: Path, write: Callable[[Path, Path], None]) -> None:
    write_everything(tmp_path / "run.mcap", 3)
    for out in (tmp_path / "run.mcap/x.py", tmp_path / "run.mcap/new/x.py"):
        with pytest.raises(SeatrialError, match=r"x.py: .*/run.mcap is a file and no folder; name another output"):
            write(tmp_path, out)


def test_a_folder_that_cannot_be_created_is_reported() -> None:
    with pytest.raises(SeatrialError, match=r"x: the folder /proc/new cannot be created: .*; name another output"):
        write_output(Path("/proc/new/x"), "text")


def test_a_failed_output_leaves_no_folder_that_was_made_for_it(tmp_path: Path) -> None:
    """A folder that existed before, or that has other files, stays."""
    (tmp_path / "old").mkdir()

    def fails(folder: str) -> None:
        with new_file(tmp_path / folder / "log.mcap") as scratch:
            scratch.write_text("half a log", encoding="utf-8")
            if folder == "shared":
                (tmp_path / "shared/other").write_text("", encoding="utf-8")
            raise SeatrialError("broken")

    for folder in ("new/inner", "old", "shared"):
        with pytest.raises(SeatrialError, match="broken"):
            fails(folder)
    assert sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*")) == ["old", "shared", "shared/other"]
    with new_file(tmp_path / "made/log.mcap") as scratch:
        scratch.write_text("a log", encoding="utf-8")
    assert (tmp_path / "made/log.mcap").exists()
