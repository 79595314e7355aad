"""Tests of the latency timer of FTDI adapters: set if permitted, otherwise reported once."""

from __future__ import annotations

from pathlib import Path

import pytest

from seatrial.daq.transport.ftdi_latency import UDEV_RULE, VENDOR, set_latency_timer


@pytest.fixture
def timer(tmp_path: Path) -> Path:
    """Make the file that the kernel has for /dev/ttyUSB3."""
    path = tmp_path / "ttyUSB3/latency_timer"
    path.parent.mkdir()
    path.write_text("16\n")
    return path


def report(timer: Path, vendor: int | None = VENDOR) -> str:
    return set_latency_timer("/dev/ttyUSB3", timer.parent.parent, lambda path: vendor)


def test_the_latency_is_set_to_one_millisecond(timer: Path) -> None:
    assert report(timer) == ""
    assert timer.read_text() == "1"


@pytest.mark.parametrize("value", ["1\n", "0\n"])
def test_a_low_latency_is_not_changed(timer: Path, value: str) -> None:
    timer.write_text(value)
    timer.chmod(0o444)
    assert report(timer) == ""
    assert timer.read_text() == value


def test_without_permission_the_command_to_set_the_timer_is_named(timer: Path) -> None:
    timer.unlink()
    timer.symlink_to("/proc/sys/kernel/ngroups_max")  # a file that no user, not even root, may write
    assert report(timer) == f"the adapter keeps bytes for up to 65536 ms (Permission denied): echo 1 | sudo tee {timer}"
    assert UDEV_RULE.endswith('ATTR{latency_timer}="1"')


def test_a_missing_latency_file_is_reported_for_ftdi_only(timer: Path, tmp_path: Path) -> None:
    timer.unlink()
    assert "has no latency_timer" in report(timer)
    assert report(timer, vendor=0x10C4) == ""  # an adapter of another maker has no timer
    assert report(timer, vendor=None) == ""
    pseudo = tmp_path / "pts7"
    pseudo.touch()
    assert set_latency_timer(str(pseudo), tmp_path, lambda path: VENDOR) == ""
    assert set_latency_timer("/dev/ttyUSB9", tmp_path) == ""  # the real /sys of this machine, which has no such port
