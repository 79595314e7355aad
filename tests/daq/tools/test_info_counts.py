"""Test that `seatrial info` counts the same samples as `seatrial log`, beside the messages made of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from seatrial.command_line import cli
from seatrial.daq.importers.write_log import SignalRow, write_frames
from seatrial.daq.log import open_log
from seatrial.daq.samples import Ahrs, Esc, Frame, Gnss, PortHealth, Sample, Scalar
from seatrial.daq.tools import log_content, show_log


def test_info_counts_samples_and_their_messages(tmp_path: Path) -> None:
    samples: list[tuple[str, Sample]] = [
        *[("ahrs", Ahrs(0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8, 1e-5, 0.0, 4e-5))] * 5,
        *[("gnss", Gnss(1.0, 54.1, 10.8, fix=3, vel_n=1.0, vel_e=0.0))] * 3,
        *[("esc", Esc(1, 1000.0, 2.0, 0.5, 16.0, 30.0))] * 2,
    ]
    rows = [SignalRow(1.0 + k, device, Frame(sample, 1.0 + k, 1.0)) for k, (device, sample) in enumerate(samples)]
    write_frames(tmp_path / "run.mcap", rows, metadata={}, note="test")
    console = Console(width=200, highlight=False)
    with open_log(tmp_path / "run.mcap") as log, console.capture() as capture:
        show_log(log_content(log), console)
    n_messages = sum(log.counts.values())
    assert n_messages > 2 * len(samples)  # time, IMU and magnetometer of an AHRS, for example
    assert f"9.000 s, {len(samples)} samples in {n_messages} messages" in capture.get()


def test_json_has_null_for_what_is_unknown(tmp_path: Path) -> None:
    rows = [SignalRow(1.0 + k, "wind", Frame(Scalar(2.0), 1.0 + k, 1.0)) for k in range(3)]
    write_frames(tmp_path / "run.mcap", rows, metadata={"mission": ""}, note="test")
    done = CliRunner().invoke(cli, ["info", str(tmp_path / "run.mcap"), "--json"], catch_exceptions=False)
    content = json.loads(done.stdout)
    assert content["first_segment"] is None
    assert content["metadata"]["mission"] is None
    (signal,) = [row for row in content["topics"] if row["topic"] == "/signal/wind"]
    assert (signal["signal"], signal["unit"], signal["hold"]) == ("wind", None, "linear")
    others = [row for row in content["topics"] if row is not signal]
    assert others
    assert all(row[key] is None for row in others for key in ("signal", "role", "unit", "hold"))
    assert '""' not in done.stdout
    shown = CliRunner().invoke(cli, ["info", str(tmp_path / "run.mcap")], catch_exceptions=False)
    assert "None" not in shown.stdout


@pytest.mark.parametrize("terminal", [False, True])
def test_tables_and_addresses_fit_into_80_columns(tmp_path: Path, terminal: bool) -> None:
    signals = [SignalRow(1.0 + k, "n_starboard", Frame(Scalar(2.0), 1.0 + k, 1.0)) for k in range(3)]
    write_frames(tmp_path / "run.mcap", signals, metadata={}, note="test")
    address = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0"
    port = PortHealth(address, 12_345_678, 123_456, 123, 4567, 89, 12, 0.02134, 0.0104)
    console = Console(width=80, highlight=False, force_terminal=terminal, color_system=None)
    with open_log(tmp_path / "run.mcap") as log, console.capture() as capture:
        show_log(replace(log_content(log), path="run.mcap", ports={"autopilot": port}), console)
    lines = [line.rstrip() for line in capture.get().splitlines()]
    assert f"  port of autopilot: {address}" in lines
    assert "autopilot 12345678 123456 123 4567 89 12 21.34 ± 10.40" in [" ".join(line.split()) for line in lines]
    assert any(line.split()[:5] == ["/signal/n_starboard", "Scalar", "3", "1.00", "1.0000"] for line in lines)
    assert "imported by" in capture.get()
    assert "operator" not in capture.get()
