"""Tests of the acquisition process on real ptys: the logged samples, and the messages about a port that fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol.framing import sentence
from seatrial.daq.samples import Ahrs, Esc, Gnss, LoadCell, Scalar
from tests.daq.acquiring import acquiring, is_closed
from tests.daq.ptys import TestBoat, wait_for


def test_every_device_is_logged(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
        clock = RunClock(rig.speed)
        path = tmp_path / "new" / "run.mcap"
        about = {"operator": "somebody"}
        with Acquisition(
            rig, path, clock=clock, attachments={"mission.toml": b"plan \xff"}, metadata=about
        ) as acquisition:
            wait_for(lambda: all(port.samples >= 40 for port in acquisition.status().ports.values()))
            acquisition.mark("note", "half way, at 3 °C")
            status = acquisition.status()
        last = acquisition.status()
        assert is_closed(path)
        sent = dict(boat.sent)
    assert status.warnings == ()
    assert {name: port.unparsed_bytes for name, port in last.ports.items()} == dict.fromkeys(last.ports, 0)
    assert last.bytes == path.stat().st_size
    log = open_log(path)
    assert log.warnings == []
    assert log.attachments["mission.toml"] == b"plan \xff"
    assert log.metadata["operator"] == "somebody"
    assert ("note", "half way, at 3 °C") in [(kind, text) for _, kind, text in log.events()]
    ahrs, gnss = log.table(Ahrs, "ahrs"), log.table(Gnss, "gnss")
    left, right, cell = log.table(Esc, "esc", node=1), log.table(Esc, "esc", node=2), log.table(LoadCell, "cell")
    for table, name in ((ahrs, "ahrs"), (gnss, "gnss"), (left, "can"), (cell, "cell")):
        assert 40 <= len(table) <= sent[name]
        assert np.all(np.diff(table["t"]) >= 0)
        assert np.all(table["t"] <= table["t_rx"] + 1e-6)
    # Each sample carries its number, so no sample is missing between the first and the last.
    assert np.allclose(np.diff(ahrs["r"]), 1e-3, atol=1e-6)
    assert set(np.diff(cell["counts"])) <= {1.0, -99.0}
    assert np.allclose(cell["force"], (cell["counts"] - 1000.0) * 0.01)
    assert np.allclose(left["rpm"], 100.0)
    assert np.allclose(right["rpm"], -200.0)  # reversed in the rig
    assert np.allclose(gnss["lat"], 41.0)


def test_garbage_is_counted_and_no_message_is_lost(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, _):
        boat.write("ahrs", b"\x00" * 100)
        boat.write("gnss", b"garbage")
        boat.write("can", b"\xffgarbage\r")
        boat.write("cell", b"garbage\n")

        def counted() -> dict[str, int]:
            return {name: port.unparsed_bytes for name, port in acquisition.status().ports.items()}

        expected = {"ahrs": 100, "gnss": 7, "esc": 8, "cell": 7}
        wait_for(lambda: counted() == expected, what="the count")
    assert np.allclose(np.diff(open_log(tmp_path / "run.mcap").table(Ahrs, "ahrs")["r"]), 1e-3, atol=1e-6)


def test_transducers_of_nmea_are_in_the_log(tmp_path: Path) -> None:
    """Formerly, only an import kept the transducers."""
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, _):
        before = acquisition.status().messages
        boat.write("gnss", sentence("IIXDR,U,12.5,V,CELL,T,900,R,ENGINE#0"))
        wait_for(lambda: acquisition.status().messages > before + 50, what="the log")
        assert not [source for source in acquisition.status().latest if source[0] == "gnss/transducer"]
    log = open_log(tmp_path / "run.mcap")
    assert sorted(log.sources(Scalar)) == ["xdr_CELL", "xdr_ENGINE_0"]
    assert log.table(Scalar, "xdr_CELL")["value"].tolist() == [12.5]
    assert (log.unit("xdr_ENGINE_0"), log.role("xdr_ENGINE_0"), log.hold("xdr_CELL")) == ("rev/min", "output", "linear")


def test_a_cable_that_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, _):
        boat.pull("cell")
        wait_for(lambda: any("is not there" in warning for warning in acquisition.status().warnings))
        wait_for(lambda: acquisition.status().ports["cell"].age > 0.5, what="the age")
        before = acquisition.status().ports["cell"].samples
        assert acquisition.status().ports["ahrs"].age < 0.5
        boat.plug("cell")
        wait_for(lambda: acquisition.status().ports["cell"].samples > before + 10, what="the return")
        port = acquisition.status().ports["cell"]
        assert (port.reconnects, port.message, port.unparsed_bytes) == (1, "", 0)
    events = open_log(tmp_path / "run.mcap").events()
    assert any(kind == "warning" and "cell" in text and "is not there" in text for _, kind, text in events)


def test_the_acquisition_waits_for_a_port_that_is_missing_at_the_start(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        boat.pull("gnss")
        rig = load_rig(boat.rig_path)
        with Acquisition(rig, tmp_path / "run.mcap", clock=RunClock()) as acquisition:
            wait_for(lambda: acquisition.status().ports["gnss"].message.startswith("the port is not there"))
            boat.plug("gnss")
            wait_for(lambda: acquisition.status().ports["gnss"].samples > 3)
            assert acquisition.status().ports["gnss"].reconnects == 0


def test_bytes_without_a_frame_are_reported(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        boat.silent.add("ahrs")
        rig = load_rig(boat.rig_path)
        with Acquisition(rig, tmp_path / "run.mcap", clock=RunClock()) as acquisition:
            wait_for(lambda: acquisition.status().ports["esc"].samples > 0)

            def reported() -> bool:
                boat.write("ahrs", b"\x55\xaa" * 200)
                return "check baud and protocol" in acquisition.status().ports["ahrs"].message

            wait_for(reported)
            wait_for(lambda: not reported() or acquisition.status().ports["ahrs"].bytes_in > 10_000)
    warned = [text for _, kind, text in open_log(tmp_path / "run.mcap").events() if kind == "warning"]
    assert warned == [
        f"ahrs ({tmp_path / 'ahrs'}): no valid frame in 2000 bytes: check baud and protocol of this device in the rig"
    ]
