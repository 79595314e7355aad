"""Tests of the latency timer of FTDI adapters: it is set if possible, otherwise one message is returned."""

from __future__ import annotations

from pathlib import Path

import pytest

from seatrial.daq.transport.ftdi_latency import UDEV_RULE, VENDOR, set_latency_timer


@pytest.fixture
def timer(tmp_path: Path) -> Path:
    """Return the file of the latency timer that the kernel has for /dev/ttyUSB3."""
    path = tmp_path / "ttyUSB3/latency_timer"
    path.parent.mkdir()
    path.write_text("16\n")
    return path


def message_of(timer: Path, vendor: int | None = VENDOR) -> str:
    return set_latency_timer("/dev/ttyUSB3", timer.parent.parent, lambda path: vendor)


def test_latency_timer_is_set_to_one_millisecond(timer: Path) -> None:
    assert message_of(timer) == ""
    assert timer.read_text() == "1"


@pytest.mark.parametrize("value", ["1\n", "0\n"])
def test_a_latency_timer_that_is_already_low_is_not_changed(timer: Path, value: str) -> None:
    timer.write_text(value)
    timer.chmod(0o444)
    assert message_of(timer) == ""
    assert timer.read_text() == value


def test_a_timer_that_may_not_be_written_names_the_command_that_does(timer: Path) -> None:
    timer.unlink()
    timer.symlink_to("/proc/sys/kernel/ngroups_max")  # a file that nobody, root or not, may write
    assert (
        message_of(timer)
        == f"the adapter delays bytes by up to 65536 ms (Permission denied); to set 1 ms: echo 1 | sudo tee {timer}"
    )
    assert UDEV_RULE.endswith('ATTR{latency_timer}="1"')


def test_a_system_without_the_file(timer: Path, tmp_path: Path) -> None:
    timer.unlink()
    assert "has no latency_timer" in message_of(timer)
    assert message_of(timer, vendor=0x10C4) == ""  # an adapter of another make has none
    assert message_of(timer, vendor=None) == ""
    pseudo = tmp_path / "pts7"
    pseudo.touch()
    assert set_latency_timer(str(pseudo), tmp_path, lambda path: VENDOR) == ""
    assert set_latency_timer("/dev/ttyUSB9", tmp_path) == ""  # asked of this machine, which has no such port
