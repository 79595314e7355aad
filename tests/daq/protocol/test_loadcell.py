"""Tests of load cell lines: patterns, flags, and truncated or damaged streams."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.daq.protocol.loadcell import Decoder, encode
from seatrial.daq.protocol.text_lines import LINE_MAX, SATURATED, SPIKE
from seatrial.daq.samples import LoadCell
from tests.daq.streams import check_garbage, check_splits, counters


def read(decoder: Decoder, data: bytes) -> list[LoadCell]:
    return [frame.sample for frame in decoder.feed(data, 0.0) if isinstance(frame.sample, LoadCell)]


def test_counts_become_force_by_the_calibration() -> None:
    decoder = Decoder(force=lambda counts: (counts - 100.0) * 0.5)
    assert read(decoder, b"84210\r\n-12\n") == [LoadCell(84210.0, 42055.0, 0), LoadCell(-12.0, -56.0, 0)]
    (uncalibrated,) = read(Decoder(), b"7\n")
    assert math.isnan(uncalibrated.force)


def test_a_pattern_reads_the_lines_of_openscale() -> None:
    decoder = Decoder(r"^\d+,(?P<counts>-?\d+\.\d+),kg,\d+,$")
    assert read(decoder, b"1048575,-1.25,kg,23,\r\nready\r\n") == [
        LoadCell(-1.25, pytest.approx(math.nan, nan_ok=True), 0)
    ]
    assert decoder.unparsed_bytes == 5


def test_a_match_without_a_number_is_skipped_and_a_pattern_without_counts_refused() -> None:
    assert read(Decoder(r"^(?P<counts>\w+)?"), b"abc\n\n5\n")[0].counts == 5.0
    with pytest.raises(ValueError, match="counts"):
        Decoder(r"^\d+$")


@pytest.mark.parametrize("pattern", [r"(?P<counts>(?:-?\d+)+)x", r"^(?P<counts>(?:\d|\d\d)+)+x"])
def test_a_pattern_cannot_hold_up_the_driver(pattern: str) -> None:
    """Python's own regular expressions would practically never finish on this pattern."""
    before = time.process_time()
    (sample,) = read(Decoder(pattern), b"1" * 250 + b"\n" + b"12x\n")
    assert sample.counts == 12.0
    assert time.process_time() - before < 1.0


@pytest.mark.parametrize("pattern", [r"(?P<counts>((\d{1000}){1000}){1000})", r"(?P<counts>\d+)(?=x)", r"(?P<counts>["])
def test_a_pattern_that_re2_cannot_bound_is_refused(pattern: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="not a regular expression"):
        Decoder(pattern)
    assert capfd.readouterr().err == ""


def test_saturation_is_flagged_on_both_sides() -> None:
    decoder = Decoder(saturation=8388607)
    flags = [sample.flags for sample in read(decoder, b"8388607\n-8388608\n8388606\n-8388607\n")]
    assert flags == [SATURATED, SATURATED, 0, SPIKE]


def test_spikes_far_from_their_neighbours_are_flagged() -> None:
    values = (84210, 65535, 84213, -131071, 84220, 131071, 84200)
    flags = [sample.flags for sample in read(Decoder(), b"".join(encode(v) for v in values))]
    assert flags == [0, SPIKE, 0, SPIKE, 0, SPIKE, 0]
    # A force that passes 65535 while it changes is no spike, nor are small numbers like 255.
    assert [s.flags for s in read(Decoder(), b"65500\n65535\n65560\n255\n")] == [0, 0, 0, 0]


def test_the_first_line_after_opening_may_be_half_a_line() -> None:
    decoder = Decoder(skip_first=True)
    decoder.reset()  # the port is opened
    assert [s.counts for s in read(decoder, b"210\n84211\n84212\n842")] == [84211.0, 84212.0]
    decoder.reset()
    assert [s.counts for s in read(decoder, b"13\n84214\n")] == [84214.0]


def test_splits_and_garbage() -> None:
    messages = [encode(84210 + k) for k in range(4)]
    assert len(check_splits(Decoder, b"".join(messages))) == 4
    check_garbage(Decoder, messages, 4, ending=b"~\n")  # the start of a line cannot be recognised


@pytest.mark.parametrize("length", [LINE_MAX - 1, LINE_MAX, LINE_MAX + 1, 3 * LINE_MAX, 5 * LINE_MAX - 1])
def test_a_line_without_end_is_cut_the_same_way_for_any_pieces(length: int) -> None:
    frames = check_splits(Decoder, b"1" * length + b"\r\n" + b"x" * length + b"\r\n5\r\n")
    assert frames[-1].sample == LoadCell(5.0, pytest.approx(math.nan, nan_ok=True), 0)


@given(st.integers(-(2**23), 2**23))
@settings(max_examples=300, deadline=None)
def test_round_trip(counts: int) -> None:
    assert read(Decoder(), encode(counts))[0].counts == counts


@given(st.lists(st.one_of(st.binary(max_size=300), st.text("0123456789-\r\n", max_size=300).map(str.encode))))
@settings(max_examples=1000, deadline=None)
def test_random_bytes_raise_no_exception(pieces: list[bytes]) -> None:
    decoder = Decoder(saturation=1000.0)
    for piece in pieces:
        decoder.feed(piece, 0.0)
    total = b"".join(pieces)
    assert decoder.unparsed_bytes <= len(total)
    before = counters(decoder)
    assert read(decoder, b"\n5\n")[-1].counts == 5.0
    assert decoder.frames > before[0]
