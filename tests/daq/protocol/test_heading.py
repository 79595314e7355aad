"""Tests of NMEA headings: priority of the sentences, true heading from magnetic, and void sentences."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol import make_decoder, nmea
from seatrial.daq.protocol.framing import sentence
from seatrial.daq.samples import Ahrs, Frame, Scalar, Transducer
from tests.daq.logs import T0, recorder
from tests.daq.streams import check_splits
from tests.measured.data import measured


def read(*bodies: str, declination: float | None = None) -> list[Ahrs]:
    decoder = nmea.Decoder(declination)
    frames = [frame for body in bodies for frame in decoder.feed(sentence(body), 5.0)]
    return [frame.sample for frame in frames if isinstance(frame.sample, Ahrs)]


def yaws(*bodies: str, declination: float | None = None) -> list[float]:
    return [round(math.degrees(sample.yaw), 6) for sample in read(*bodies, declination=declination)]


def test_true_headings_are_read() -> None:
    assert yaws("GPHDT,123.456,T") == [123.456]
    assert yaws("GNTHS,350.00,A") == [-10.0]
    assert yaws("GNTHS,,V", "GNTHS,12.0,V", "GPHDT,,T") == []


def test_a_heading_marked_as_void_is_left_out() -> None:
    assert yaws("GPTHS,123.4,") == []  # without a mode
    assert yaws("HEHDT,999.9,T") == []
    assert yaws("PSTI,036,054314.000,030521,191.69,-16.35,0.00,N") == []
    assert len(yaws("PSTI,036,054314.000,030521,191.69,-16.35,0.00,F")) == 1
    pashr = "PASHR,054314.00,123.40,T,+1.00,-2.00,+0.10,0.5,0.5,9.9,"
    assert yaws(pashr + "0,0") == []
    assert yaws(pashr + "0,1") == yaws(pashr + "1,0") == yaws(pashr + "2") == [123.4]  # inertial, with a fix, unknown


def test_a_magnetic_heading_needs_a_declination() -> None:
    decoder = nmea.Decoder()
    assert decoder.feed(sentence("HCHDM,100.0,M"), 5.0) == []
    assert "declination_deg" in decoder.remark
    assert decoder.frames == 1
    assert yaws("HCHDM,100.0,M", declination=math.radians(-2.5)) == [97.5]
    assert yaws("SDHDG,100.0,1.0,W,2.5,E") == [101.5]
    assert yaws("SDHDG,100.0,,,,", declination=math.radians(3.0)) == [103.0]
    # the device supplies its own declination
    assert yaws("SDHDG,100.0,,,2.0,E", declination=math.radians(3.0)) == [102.0]


def test_the_best_of_several_sentences_is_used_once_per_epoch() -> None:
    burst = ("GPHDT,10.0,T", "GPHDM,12.0,M", "GPHDG,12.0,,,2.0,W")
    assert yaws(*burst, *burst, declination=0.0) == [10.0, 10.0]


def test_attitude_and_rate_of_turn_are_added_to_the_heading() -> None:
    attitude, heading = read(
        "PASHR,085335.000,224.19,T,-01.26,+00.83,+00.00,0.101,0.113,0.267,1,0", "PASHR,085336.000,90.0,T,0.0,0.0,0.0"
    )
    assert (attitude.roll, attitude.pitch) == pytest.approx((math.radians(-1.26), math.radians(0.83)))
    assert math.degrees(attitude.yaw) == pytest.approx(224.19 - 360.0)
    assert math.degrees(heading.yaw) == pytest.approx(90.0)
    first, second = read("APROT,-60.0,A", "APHDT,10.0,T", "APHDT,10.0,T")
    assert first.r == pytest.approx(math.radians(-1.0))
    assert math.isnan(second.r)  # not repeated
    assert math.isnan(read("APROT,-60.0,V", "APHDT,10.0,T")[0].r)


def test_attitude_of_transducers_is_added_to_the_next_heading() -> None:
    first, second = read("APXDR,A,0.5,D,PTCH,A,-3.5,D,ROLL", "APHDT,10.0,T", "APHDT,11.0,T")
    assert (first.pitch, first.roll) == pytest.approx((math.radians(0.5), math.radians(-3.5)))
    assert math.isnan(second.pitch)  # not repeated
    assert math.isnan(read("WIXDR,C,20.1,C,PTCH", "APHDT,10.0,T")[0].pitch)


def test_the_attitude_of_two_antennas_has_a_time() -> None:
    data = b"".join(sentence(b) for b in ("PSTI,036,003832.000,290322,244.28,2.77,0.00,R", "PSTI,035,003832.000,,A"))
    ((sample, _, t_device),) = nmea.Decoder().feed(data, 1_648_514_400.0)
    assert isinstance(sample, Ahrs)
    assert math.degrees(sample.yaw) == pytest.approx(244.28 - 360.0)
    assert (sample.pitch, sample.roll) == (pytest.approx(math.radians(2.77)), 0.0)
    assert t_device == 1_648_514_312.0


@pytest.mark.parametrize("body", ["APXDR,A,x,D,ROLL", "GPHDT,x,T", "GPHDT,1e3,T", "PASHR,0,1.0,T,x,0", "APROT,?,A"])
def test_a_sentence_with_a_field_that_is_not_a_number_is_refused(body: str) -> None:
    decoder = nmea.Decoder()
    assert decoder.feed(sentence(body), 5.0) == []
    assert decoder.frames == 0
    assert decoder.unparsed_bytes > 0


def test_transducers_are_samples_with_the_name_of_their_signal() -> None:
    """A live log lacked them. Pitch and roll are values of the next heading, not signals."""
    body = "IIXDR,T,900,R,ENGINE#0,A,2.0,D,PTCH,C,x,C,OIL,P,1.5,B,Oil Pressure,G,7,,"
    decoder = nmea.Decoder(None, "_bow")
    first, second = decoder.feed(sentence(body), 5.0)
    assert first[:2] == (Transducer(900.0, "xdr_ENGINE_0_bow", "rev/min"), 5.0)
    assert second[:2] == (Transducer(1.5e5, "xdr_Oil_Pressure_bow", "Pa"), 5.0)
    assert nmea.Decoder().feed(sentence(body), 5.0) == []


@pytest.mark.parametrize(("protocols", "name"), [(["nmea"], "xdr_CELL"), (["nmea", "ubx"], "xdr_CELL_a")])
def test_a_live_log_has_the_transducers_as_signals(protocols: list[str], name: str, tmp_path: Path) -> None:
    text = 'format = "seatrial-rig 1"\nname = "boat"\n'
    for device, protocol in zip("ab", protocols, strict=False):
        text += f'[[device]]\nname = "{device}"\nprotocol = "{protocol}"\nport = "-{device}"\nrate_hz = 1.0\n'
    rig = parse_rig(text, "-")
    frames = make_decoder(rig.devices[0], rig).feed(sentence("IIXDR,U,12.5,V,CELL"), T0)
    log = recorder(tmp_path / "run.mcap")
    for frame in frames:
        log.write("a", frame, T0)
    log.close()
    with open_log(tmp_path / "run.mcap") as opened:
        assert opened.sources(Scalar) == [name]
        assert opened.table(Scalar, name)["value"].tolist() == [12.5]
        assert (opened.unit(name), opened.role(name)) == ("V", "output")


def test_splits() -> None:
    stream = b"".join(sentence(f"GPHDT,{10.0 * k},T") + sentence("APROT,6.0,A") for k in range(4))
    assert len(check_splits(nmea.Decoder, stream)) == 4


@pytest.mark.measured
@pytest.mark.parametrize(("name", "n", "low", "high"), [("bundg_zeus_9", 1457, 210, 250), ("hemi", 2, 0, 360)])
def test_headings_of_gpsds_captures(name: str, n: int, low: float, high: float) -> None:
    decoder = nmea.Decoder()
    frames = decoder.feed(measured(f"gpsd/daemon/{name}.log").read_bytes(), 0.0)
    found = [math.degrees(f.sample.yaw) % 360.0 for f in frames if isinstance(f.sample, Ahrs)]
    assert len(found) >= n
    assert low < min(found) <= max(found) < high


def test_a_logged_heading_without_pitch_and_roll_is_read_back(tmp_path: Path) -> None:
    log = recorder(tmp_path / "compass.mcap")
    for sample in (Ahrs(1.25, math.nan, math.nan, r=0.5), Ahrs(1.5, 0.0, 0.0)):
        log.write("compass", Frame(sample, T0, math.nan), T0)
    log.close()
    with open_log(tmp_path / "compass.mcap") as opened:
        table = opened.table(Ahrs, "compass")
    assert table["yaw"] == pytest.approx([1.25, 1.5])
    assert table["r"][0] == 0.5
    assert [math.isnan(v) for v in (*table["pitch"], *table["roll"])] == [True, False, True, False]
