"""Tests of NMEA: epochs with any order of sentences, captures of real receivers, and truncated or damaged streams."""

from __future__ import annotations

import datetime
import itertools
import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.daq.protocol.framing import sentence
from seatrial.daq.protocol.nmea import Decoder, encode
from seatrial.daq.samples import NAN, Gnss
from tests.daq.streams import COLD, check_garbage, check_splits, counters, is_close
from tests.measured.data import measured

T = 1_700_000_000.0  # 2023-11-14 22:13:20 UTC
GNSS = Gnss(T, 41.1, -8.6, 12.3, 0.5, -0.25, fix=5, n_sat=12, hdop=0.8, sigma_h=0.015)
GGA = "GPGGA,{time},4106.0000,N,00836.0000,W,{quality},09,1.1,5.0,M,,M,,"
RMC = "GPRMC,{time},A,4106.0000,N,00836.0000,W,1.0,90.0,{date},,,A"


def gga(time: str, quality: int = 1) -> bytes:
    return sentence(GGA.format(time=time, quality=quality))


def rmc(time: str, date: str = "141123") -> bytes:
    return sentence(RMC.format(time=time, date=date))


def read(data: bytes, t_rx: float = T) -> list[Gnss]:
    decoder = Decoder()
    frames = decoder.feed(data, t_rx) + decoder.flush()
    return [frame.sample for frame in frames if isinstance(frame.sample, Gnss)]


def at(hour: int, minute: int, second: float, day: int = 14) -> float:
    return datetime.datetime(2023, 11, day, hour, minute, 0, tzinfo=datetime.UTC).timestamp() + second


def epochs(count: int, rate: float = 5.0) -> list[bytes]:
    return [
        encode(Gnss(T + k / rate, 41.0 + 1e-6 * k, -8.6, 1.0, 0.1, 0.0, fix=3, n_sat=9, hdop=1.0)) for k in range(count)
    ]


def test_an_epoch_in_the_form_of_the_standard_is_read() -> None:
    data = (
        b"$GPGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,*5B\r\n"
        b"$GPRMC,092725.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A*57\r\n"
    )
    decoder = Decoder()
    assert decoder.feed(data.replace(b"*57", b"*5F"), 3.0) == []
    assert decoder.checksum_errors == 1  # RMC with a wrong checksum
    (frame,) = decoder.flush()
    assert isinstance(frame.sample, Gnss)
    assert frame.sample.lat == pytest.approx(47 + 17.11399 / 60, abs=1e-9)
    assert frame.sample.lon == pytest.approx(8 + 33.91590 / 60, abs=1e-9)
    assert (frame.sample.alt, frame.sample.hdop, frame.sample.n_sat, frame.sample.fix) == (499.6, 1.01, 8, 3)
    assert math.isnan(frame.sample.vel_n)
    assert math.isnan(frame.sample.sigma_h)


@pytest.mark.parametrize("order", ["gga first", "rmc first"])
def test_sentences_are_grouped_by_time_not_by_order(order: str) -> None:
    stream = b""
    for k in range(5):
        pair = [gga(f"22132{k}.00"), rmc(f"22132{k}.00")]
        stream += b"".join(pair if order == "gga first" else reversed(pair))
    samples = read(stream)
    assert [sample.utc for sample in samples] == [T + k for k in range(5)]
    for sample in samples:
        assert sample.n_sat == 9  # the altitude of GGA
        assert sample.vel_e == pytest.approx(1852 / 3600)  # the velocity of RMC
        assert abs(sample.vel_n) < 1e-12


def test_the_position_is_that_of_gga_if_rmc_repeats_an_older_one() -> None:
    """In RMC and GLL a chart plotter sends the position of the previous second with the time of this second."""
    decoder = Decoder()
    frames = []
    for k in range(5):
        minutes = [f"{30.0 + 0.001 * j:.4f}" for j in (k, max(k - 1, 0))]
        for body in (
            f"GPRMC,12000{k},A,59{minutes[1]},N,01000.0000,E,5.0,90.0,120524,,,A",
            f"GPGGA,12000{k},59{minutes[0]},N,01000.0000,E,1,12,0.6,1.0,M,40.0,M,,",
            f"GPGLL,59{minutes[1]},N,01000.0000,E,12000{k},A,A",
        ):
            frames += decoder.feed(sentence(body), float(k))
    frames += decoder.flush()
    lat = [frame.sample.lat for frame in frames if isinstance(frame.sample, Gnss)]
    assert lat == pytest.approx([59.5 + 0.001 * k / 60.0 for k in range(5)], abs=1e-9)


def test_an_epoch_is_complete_with_the_sentences_of_the_last_epochs() -> None:
    decoder = Decoder()
    first, second, third = epochs(3)
    assert decoder.feed(first, 1.0) == []  # the sentences of an epoch are not known yet
    assert [frame.t_rx for frame in decoder.feed(second, 2.0)] == [1.0, 2.0]
    lines = third.splitlines(keepends=True)
    assert [len(decoder.feed(line, 3.0 + k)) for k, line in enumerate(lines)] == [0, 0, 0, 1]
    assert decoder.flush() == []


def test_a_rare_sentence_is_not_lost() -> None:
    stream = b""
    for k in range(20):
        time = f"22132{k // 10}.{k % 10}0"
        stream += gga(time) + rmc(time) + (sentence(f"GPGST,{time},,,,,3.0,4.0,") if k % 5 == 0 else b"")
    sigmas = [sample.sigma_h for sample in read(stream)]
    assert [k for k, sigma in enumerate(sigmas) if sigma == pytest.approx(5.0 / math.sqrt(2))] == [0, 5, 10, 15]


def test_the_receive_time_of_a_sample_is_that_of_its_first_sentence() -> None:
    decoder = Decoder()
    decoder.feed(gga("221320.00"), 1.0)
    decoder.feed(rmc("221320.00"), 1.1)
    (frame,) = decoder.feed(gga("221321.00"), 2.0)
    assert (frame.t_rx, frame.t_device) == (1.0, T)


def test_without_a_date_the_last_day_or_the_day_of_the_clock_is_used() -> None:
    assert [s.utc for s in read(rmc("235959.00") + gga("000000.00") + gga("000001.00"))] == [
        at(23, 59, 59.0),
        at(0, 0, 0.0, day=15),
        at(0, 0, 1.0, day=15),
    ]
    assert read(gga("235959.50"), t_rx=at(0, 0, 1.0, day=15))[0].utc == at(23, 59, 59.5)
    assert read(gga("000001.00"), t_rx=at(23, 59, 59.0))[0].utc == at(0, 0, 1.0, day=15)


def test_a_leap_second_has_a_time() -> None:
    assert read(gga("221260.00") + rmc("221260.00"))[0].utc == T - 20.0


def test_zda_gives_the_date() -> None:
    data = gga("221320.00") + sentence("GPZDA,221320.00,14,11,2023,00,00")
    assert read(data, t_rx=0.0)[0].utc == T


def test_void_fixes_have_no_position_and_a_zda_alone_gives_no_sample() -> None:
    void = sentence("GPGGA,221320.00,,,,,0,00,99.9,,M,,M,,") + sentence("GPRMC,221320.00,V,,,,,,,141123,,,N")
    (sample,) = read(void)
    assert is_close(sample, Gnss(T, NAN, NAN, n_sat=0))
    assert read(sentence("GPZDA,221320.00,14,11,2023,00,00")) == []


def test_a_receiver_that_has_never_had_a_fix_gives_one_sample_an_epoch() -> None:
    decoder = Decoder()
    frames = [frame for k in range(4) for frame in decoder.feed(COLD, 10.0 + k)] + decoder.flush()
    assert [frame.t_rx for frame in frames] == [10.0, 11.0, 12.0, 13.0]
    for frame in frames:
        assert isinstance(frame.sample, Gnss)
        assert (frame.sample.fix, frame.sample.n_sat) == (0, 0)
        assert math.isnan(frame.sample.utc)
        assert math.isnan(frame.t_device)
    # The first time of day ends the epochs without a time.
    (sample,) = read(COLD + gga("221320.00") + rmc("221320.00"))[-1:]
    assert (sample.fix, sample.utc) == (3, T)


def test_a_sentence_without_a_time_belongs_to_no_epoch() -> None:
    old = sentence("GPGLL,4916.45,N,12311.12,W")
    assert read(gga("221320.00") + old + rmc("221320.00")) == read(gga("221320.00") + rmc("221320.00"))


@pytest.mark.parametrize(("quality", "fix"), [(1, 3), (2, 4), (4, 5), (5, 6), (6, 1), (3, 3)])
def test_the_kind_of_a_fix_follows_from_the_quality_of_gga(quality: int, fix: int) -> None:
    assert read(gga("221320.00", quality))[0].fix == fix


def test_gsa_defines_a_2d_fix() -> None:
    two = sentence("GPGSA,A,2,23,29,07,,,,,,,,,,1.94,1.18,1.54")
    assert read(two + gga("221320.00"))[0].fix == 2
    flat, *_ = read(two + gga("221320.00", 4))
    assert (flat.fix, flat.dimensions) == (5, 2)
    assert read(gga("221320.00", 4))[0].dimensions == 3
    assert read(rmc("221320.00"))[0].dimensions == 2  # a position without a height


def test_vtg_is_used_without_rmc() -> None:
    vtg = sentence("GPVTG,180.0,T,,M,1.0,N,3.6,K,A")
    assert read(gga("221320.00") + vtg)[0].vel_n == pytest.approx(-1.0)
    assert read(gga("221320.00") + vtg + rmc("221320.00"))[0].vel_e == pytest.approx(1852 / 3600)


def test_a_vtg_before_its_epoch_belongs_to_the_next_sentences() -> None:
    decoder = Decoder()
    found = []
    for k in range(8):
        t = T + k
        found += decoder.feed(sentence(f"GPVTG,0.0,T,,M,,N,{float(k)},K,A"), t + 0.1)
        found += decoder.feed(gga(f"22132{k}.00"), t + 0.12)
    rows = [(f.t_device - T, f.t_rx - T - 0.1, f.sample.speed * 3.6) for f in found[2:] if isinstance(f.sample, Gnss)]
    assert sum(rows, ()) == pytest.approx([k for k in range(2, 8) for _ in range(3)], abs=1e-5)  # and each at once
    decoder, found = Decoder(), []
    for k in range(8):  # on a slow line VTG comes after its GGA
        found += decoder.feed(gga(f"22132{k}.00"), T + 0.15 + k)
        found += decoder.feed(sentence(f"GPVTG,0.0,T,,M,,N,{float(k)},K,A"), T + 0.3 + k)
    speeds = [f.sample.speed * 3.6 for f in found if isinstance(f.sample, Gnss)]
    assert speeds == pytest.approx(range(8))


def test_a_pause_of_the_line_does_not_change_the_learned_order() -> None:
    decoder, found = Decoder(), []
    for k in range(9):  # the VTG of the fourth epoch is read late, together with the position of the fifth
        found += decoder.feed(gga(f"22132{k}.00"), T + 0.02 + k)
        found += decoder.feed(sentence(f"GPVTG,0.0,T,,M,,N,{float(k)},K,A"), T + (k + 0.04 if k != 4 else 5.01))
    found += decoder.flush()
    assert [f.sample.speed * 3.6 for f in found if isinstance(f.sample, Gnss)] == pytest.approx(range(9))


def test_a_receiver_before_its_first_fix_has_no_device_time() -> None:
    decoder = Decoder()
    void = "GPRMC,22132{}.00,V,,,,,,,141123,,,N"
    found = [f for k in (0, 1) for f in decoder.feed(sentence(void.format(k)), 1.0 + k)]
    found += decoder.feed(sentence("PASHR,221321.50,10.0,T,0.0,0.0,0.0"), 2.5)
    for k in (2, 3):
        found += decoder.feed(rmc(f"22132{k}.00"), 1.0 + k)
    found += decoder.feed(sentence("PASHR,221323.50,10.0,T,0.0,0.0,0.0"), 4.5)
    found += decoder.feed(sentence(void.format(4)), 5.0) + decoder.flush()  # the receiver keeps its time without a fix
    assert [f.t_device - T for f in found] == pytest.approx([NAN, NAN, NAN, 2.0, 3.0, 3.5, 4.0], nan_ok=True)
    assert [f.sample.utc - T for f in found if isinstance(f.sample, Gnss)] == [0.0, 1.0, 2.0, 3.0, 4.0]
    decoder.reset()
    (again,) = decoder.feed(sentence(void.format(5)), 6.0)
    assert math.isnan(again.t_device)  # another receiver may be on the port


def test_a_receiver_at_rest_has_a_velocity() -> None:
    still = sentence("GPRMC,221320.00,A,4106.0000,N,00836.0000,W,0.0,,141123,,,A")
    assert (read(still)[0].vel_n, read(still)[0].vel_e) == (0.0, 0.0)
    slow = sentence("GPRMC,221320.00,A,4106.0000,N,00836.0000,W,0.1,,141123,,,A")
    assert math.isnan(read(slow)[0].vel_n)
    assert read(slow)[0].speed == pytest.approx(0.1 * 1852 / 3600)
    assert read(encode(read(slow)[0]))[0].speed == pytest.approx(0.1 * 1852 / 3600, abs=1e-4)


def test_a_double_dollar_and_unknown_sentences_are_skipped() -> None:
    decoder = Decoder()
    ais = b"!AIVDM,1,1,,A,14eG;o@034o8sd<L9i:a;WF>062D,0*7D\r\n"
    decoder.feed(b"$" + gga("221320.00") + sentence("PUBX,00,1") + sentence("GPGSV,1,1,00") + ais, 0.0)
    assert counters(decoder) == (3, 0, 1 + len(ais) - 2)


def test_fields_that_are_not_numbers_make_no_fix() -> None:
    bad = sentence("GPGGA,221320.00,41xx.0000,N,00836.0000,W,1,09,1.1,5.0,M,,M,,")
    first, second = read(bad + gga("221321.00"))
    assert math.isnan(first.lat)
    assert first.fix == 0
    assert second.lat == pytest.approx(41.1)


@given(
    st.floats(0, 2e9),
    st.floats(-90, 90),
    st.floats(-180, 180),
    st.floats(-500, 9000),
    st.floats(-30, 30),
    st.floats(-30, 30),
    st.sampled_from((1, 3, 4, 5, 6)),
)
@settings(max_examples=500, deadline=None)
def test_round_trip(utc: float, lat: float, lon: float, alt: float, vel_n: float, vel_e: float, fix: int) -> None:
    sample = Gnss(utc, lat, lon, alt, vel_n, vel_e, fix=fix, n_sat=11, hdop=1.25, sigma_h=0.5)
    (back,) = read(encode(sample))
    assert back.utc == pytest.approx(utc, abs=0.00051)
    assert back.lat == pytest.approx(lat, abs=1e-9)
    assert back.lon == pytest.approx(lon, abs=1e-9)
    assert back.alt == pytest.approx(alt, abs=0.00051)
    assert math.hypot(back.vel_n - vel_n, back.vel_e - vel_e) < 1e-4
    assert (back.fix, back.n_sat, back.hdop, back.sigma_h) == (fix, 11, 1.25, pytest.approx(0.5))


def test_round_trip_of_a_receiver_without_a_fix() -> None:
    (back,) = read(encode(Gnss(T, NAN, NAN)))
    assert is_close(back, Gnss(T, NAN, NAN))


def test_splits_and_garbage() -> None:
    assert len(check_splits(Decoder, b"".join(epochs(4)))) == 4
    check_garbage(Decoder, epochs(4), 4)


@given(
    st.lists(
        st.one_of(
            st.binary(max_size=80), st.sampled_from(epochs(2)), st.text("$GPGARMC,*0123456789.\r\n").map(str.encode)
        )
    )
)
@settings(max_examples=500, deadline=None)
def test_random_bytes_raise_no_exception(pieces: list[bytes]) -> None:
    decoder = Decoder()
    for piece in pieces:
        decoder.feed(piece, T)
    decoder.flush()
    assert decoder.unparsed_bytes <= sum(map(len, pieces))


@given(
    st.sampled_from(["GGA", "RMC", "VTG", "GST", "ZDA", "GLL", "GNS", "GSA"]),
    st.text("0123456789.,-ANSEW", max_size=70),
)
@settings(max_examples=1000, deadline=None)
def test_random_fields_with_a_valid_checksum_raise_no_exception(kind: str, fields: str) -> None:
    decoder = Decoder()
    frames = decoder.feed(sentence(f"GP{kind},{fields}"), T) + decoder.flush()
    for frame in frames:
        assert isinstance(frame.sample, Gnss)
        assert not abs(frame.sample.lat) > 90.0


@pytest.mark.measured
@pytest.mark.parametrize("name", ["nmea.bin", "gnmea.bin"])
def test_captures_of_ardupilots_simulated_receivers_are_read(name: str) -> None:
    decoder = Decoder()
    frames = decoder.feed(measured(f"ardurover/{name}").read_bytes(), 0.0) + decoder.flush()
    times = [frame.t_device for frame in frames if math.isfinite(frame.t_device)]  # from the first fix on
    assert len(times) > 40
    assert all(0.05 < b - a < 0.45 for a, b in itertools.pairwise(times))
    fixes = [frame.sample for frame in frames if isinstance(frame.sample, Gnss) and frame.sample.fix]
    assert len(fixes) > 40
    for sample in fixes:
        assert sample.lat == pytest.approx(42.358, abs=0.001)
        assert sample.lon == pytest.approx(-71.08705, abs=0.001)


# Receivers whose NMEA gpsd reads too: RMC or GGA first, one or several talkers, with or without GST.
RECEIVERS = (
    "bt-q818", "gr601-w", "hemi", "iTrek", "mtk-3301", "neo-m8n", "nl551e", "nokia-ld-4w", "rx210",
    "quectel-l76k-nmea", "sirfstarv-nmea", "skytraq-fix", "telit-pls83-w", "tn204", "venus634lp",
)  # fmt: skip


@pytest.mark.measured
@pytest.mark.parametrize("name", RECEIVERS)
def test_positions_equal_those_of_gpsd(name: str) -> None:
    log = measured(f"gpsd/daemon/{name}.log")
    lines = log.read_bytes().splitlines(keepends=True)
    raw = b"".join(line for line in lines if not line.startswith(b"#"))
    decoder = Decoder()
    frames = decoder.feed(raw, 0.0) + decoder.flush()
    ours = {
        (round(f.sample.lat, 7), round(f.sample.lon, 7)) for f in frames if isinstance(f.sample, Gnss) and f.sample.fix
    }
    theirs = gpsd_positions(log.with_name(log.name + ".chk"))
    assert theirs
    found = sum(any(near(a, b, 2e-7) for b in ours) for a in theirs)
    # gpsd reports some positions from half an epoch, whose RMC may have fewer digits than GGA.
    assert found >= 0.8 * len(theirs), f"{found} of {len(theirs)}"
    assert all(any(near(a, b, 2e-3) for b in theirs) for a in ours)


def gpsd_positions(path: Path) -> set[tuple[float, float]]:
    """Return latitude and longitude of every TPV report."""
    positions = set()
    for line in path.read_bytes().splitlines():
        if line.startswith(b'{"class":"TPV"'):
            report = json.loads(line)
            if "lat" in report and "lon" in report:
                positions.add((report["lat"], report["lon"]))
    return positions


def near(a: tuple[float, float], b: tuple[float, float], degrees: float) -> bool:
    return abs(a[0] - b[0]) < degrees and abs(a[1] - b[1]) < degrees
