"""Tests of load cells with their own protocol: OpenScale and Mantracourt."""

from __future__ import annotations

import math

import pytest

from seatrial.daq.protocol import mantracourt, openscale
from seatrial.daq.protocol.text_lines import SATURATED, SPIKE
from seatrial.daq.samples import Frame, LoadCell
from tests.daq.streams import check_splits, counters

G = 9.80665


def cell(frame: Frame) -> LoadCell:
    assert isinstance(frame.sample, LoadCell)
    return frame.sample


@pytest.mark.parametrize(
    ("line", "counts", "newton", "t"),
    [
        (b"21024,4.11,kg,8421504,25.06,0,", 8421504.0, 4.11 * G, 21.024),
        (b"21024,4.11,kg,25.06,0,", 4.11, 4.11 * G, 21.024),
        (b"21024,25.06,0,4.11,lbs", 4.11, 4.11 * 4.4482216152605, 21.024),  # firmware 1.0
        (b"-4.1100,kg,", -4.11, -4.11 * G, math.nan),
        (b"-4.11,kg,-8000,", -8000.0, -4.11 * G, math.nan),
        (b"0,4.11,kg", 4.11, 4.11 * G, math.nan),  # a remote sensor that is not connected
    ],
)
def test_a_line_of_openscale_is_read(line: bytes, counts: float, newton: float, t: float) -> None:
    (frame,) = openscale.Decoder().feed(line + b"\r\n", 5.0)
    assert (cell(frame).counts, cell(frame).force) == (counts, pytest.approx(newton))
    assert frame.t_device == pytest.approx(t, nan_ok=True)


def test_openscale_with_a_calibration_takes_the_raw_reading() -> None:
    decoder = openscale.Decoder(8388607, lambda counts: 0.01 * counts)
    data = openscale.encode(4.11, "kg", 1000, 1000) + openscale.encode(9.0, "kg", 1100, 8388607)
    first, second = decoder.feed(data + openscale.encode(9.0, "kg", 1200, 65535), 5.0)[:2]
    assert cell(first).force == pytest.approx(10.0)
    assert cell(second).flags == SATURATED
    assert cell(decoder.feed(openscale.encode(9.0, "kg", 1300, 131071), 5.0)[0]).flags == SPIKE


def test_the_time_of_openscale_continues_after_its_overflow() -> None:
    decoder = openscale.Decoder()
    frames = decoder.feed(b"4294967290,1.0,kg\r\n5,1.0,kg\r\n", 5.0)
    assert frames[1].t_device - frames[0].t_device == pytest.approx(0.011)


def test_other_lines_of_openscale_are_counted_as_unparsed() -> None:
    menu = b"OpenScale v1.2\r\nPress x to bring up settings\r\nReadings:\r\n,,kg\r\n1,2,3,4,5,6,7,kg\r\n"
    decoder = openscale.Decoder()
    assert decoder.feed(menu, 5.0) == []
    assert counters(decoder) == (0, 0, len(menu.translate(None, b"\r\n")))
    assert len(check_splits(openscale.Decoder, menu + openscale.encode(1.0) * 4)) == 4


def test_answers_of_mantracourt_are_read() -> None:
    decoder = mantracourt.Decoder(force=lambda counts: 2.0 * counts)
    assert decoder.request == b"!001:SYS?\r"
    found = [cell(frame) for frame in decoder.feed(b"123.456\r-00001.5000\r+7\r", 5.0)]
    assert [(c.counts, c.force) for c in found] == [(123.456, 246.912), (-1.5, -3.0), (7.0, 14.0)]
    assert math.isnan(cell(mantracourt.Decoder().feed(b"1\r", 5.0)[0]).force)


def test_a_refusal_is_reported_until_the_next_answer() -> None:
    decoder = mantracourt.Decoder(query="!001:FOO?")
    assert decoder.feed(b"!001:FOO?\r?\r", 5.0) == []  # the echo of a half-duplex adapter, and then the refusal
    assert "refuses the request !001:FOO?" in decoder.remark
    assert len(decoder.feed(mantracourt.encode(1.5), 5.0)) == 1
    assert decoder.remark == ""


def test_splits_of_mantracourt() -> None:
    assert len(check_splits(mantracourt.Decoder, b"".join(mantracourt.encode(float(k)) for k in range(9)))) == 9
