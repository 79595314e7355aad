"""Tests of the keys of a [[device]] that belong to single protocols, and of the resulting decoder."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import dbc, mantracourt
from seatrial.daq.protocol.catalogue import CAN, DEVICES, make_decoder
from seatrial.daq.rig import DbcSignal, Rig, Segments

SIGNAL = """
[[device.signal]]
message = "EngineParametersRapid"
signal = "EngineSpeed"
field = "rpm"
node = "EngineInstance"
scale = 0.5
"""


def rig(protocol: str, port: str = "port", more: str = "", before: str = "", *, recorded: bool = False) -> Rig:
    text = (
        f'format = "seatrial-rig 1"\nname = "r"\n{before}\n[[device]]\nname = "d"\nprotocol = "{protocol}"\n'
        f'port = "{port}"\nrate_hz = 10.0\n{more}\n'
    )
    return parse_rig(text, Path("/boat/rig.toml"), recorded=recorded)


@pytest.mark.parametrize("protocol", [name for name, row in DEVICES.items() if name not in ("dbc", "mavlink")])
def test_every_protocol_of_the_table_has_a_decoder_with_its_keys_at_their_defaults(protocol: str) -> None:
    bus = DEVICES[protocol].bus == CAN
    loaded = rig(protocol, "socketcan:can0" if bus else "port")
    decoder = make_decoder(loaded.devices[0], loaded)
    assert decoder.feed(b"", 0.0) == []
    with pytest.raises(SeatrialError, match=r"device\[1\]\.port: must be"):
        rig(protocol, "port" if bus else "socketcan:can0")


def test_a_dbc_and_its_signals_make_a_decoder() -> None:
    loaded = rig("dbc", "slcan:ports/can", f'dbc = "nmea2000"\nbitrate = 250000\n{SIGNAL}')
    device = loaded.devices[0]
    assert Path(device.dbc).name == "nmea2000.dbc"
    assert device.bitrate == 250_000
    assert device.signals == (DbcSignal("EngineParametersRapid", "EngineSpeed", "rpm", "EngineInstance", 0.5),)
    assert isinstance(make_decoder(device, loaded), dbc.Decoder)


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ('dbc = "nmea2000"', r"device\[1\]\.signal: missing"),
        (SIGNAL, r"device\[1\]\.dbc: missing"),
        (f'dbc = "own.dbc"\n{SIGNAL}', r"device\[1\]\.dbc: there is no file /boat/own\.dbc"),
        (f'dbc = "nmea2000"\n{SIGNAL}gain = 2', r"device\[1\]\.signal\[1\]\.gain: unknown key"),
        (f'dbc = "nmea2000"\n{SIGNAL.replace("rpm", "speed")}', r"signal\[1\]\.field: must be one of rpm, current"),
    ],
)
def test_an_error_with_a_dbc_gives_a_one_line_error(more: str, line: str) -> None:
    with pytest.raises(SeatrialError, match=line):
        rig("dbc", "socketcan:can0", more)


def test_the_rig_of_a_log_may_name_a_dbc_file_of_another_computer() -> None:
    loaded = rig("dbc", "socketcan:can0", f'dbc = "own.dbc"\n{SIGNAL}', recorded=True)
    assert loaded.devices[0].dbc == "/boat/own.dbc"
    with pytest.raises(SeatrialError, match=r"/boat/own\.dbc"):
        make_decoder(loaded.devices[0], loaded)


def test_a_declination_is_converted_to_radians() -> None:
    assert rig("nmea", more="declination_deg = -3.0").devices[0].declination == pytest.approx(math.radians(-3.0))
    assert rig("ubx").devices[0].declination is None
    with pytest.raises(SeatrialError, match="declination_deg: unknown key"):
        rig("vectornav", more="declination_deg = 1.0")


def test_a_query_is_plain_text() -> None:
    loaded = rig("mantracourt", more='query = "!007:SGAI?"')
    decoder = make_decoder(loaded.devices[0], loaded)
    assert isinstance(decoder, mantracourt.Decoder)
    assert decoder.request == b"!007:SGAI?\r"
    with pytest.raises(SeatrialError, match="query: must be plain text"):
        rig("mantracourt", more='query = "a\\tb"')


def test_the_segment_settings_of_a_rig_are_read() -> None:
    assert rig("nmea").segments == Segments(None, None, 50.0)
    log = "[log]\nsegment_mb = 200\nsegment_s = 600\nfree_mb = 0"
    assert rig("nmea", before=log).segments == Segments(200.0, 600.0, 0.0)
    with pytest.raises(SeatrialError, match=r"log\.segment_s: must be at least 1\.0, not"):
        rig("nmea", before="[log]\nsegment_s = 0.5")
    assert rig("nmea", before="[log]\nsegment_mb = 200\nkeep_gb = 20").segments.keep_gigabytes == 20.0
    with pytest.raises(SeatrialError, match=r"log\.keep_gb: .*segment_mb or segment_s"):
        rig("nmea", before="[log]\nkeep_gb = 20")
    with pytest.raises(SeatrialError, match=r"log\.keep_gb: must be at least 3 times segment_mb"):
        rig("nmea", before="[log]\nsegment_mb = 200\nkeep_gb = 0.5")
