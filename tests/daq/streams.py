"""Different ways to feed a decoder the same bytes, and checks that the result does not depend on the way."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import astuple
from typing import Any

from seatrial.daq.protocol.decoder import Decoder
from seatrial.daq.protocol.framing import sentence
from seatrial.daq.samples import Frame

# Bytes on a serial line that are not frames: text, starts of frames, every byte value.
GARBAGE = (
    b"",
    b"boot: ok\r\n",
    b"$",
    b"\xfa",
    b"\xfa\x01\x29\x01",
    b"$GPGGA,12*",
    b"T00000901",
    bytes(range(256)),
)

# One second of a receiver that has never had a fix, so that time and position are unknown.
COLD = b"".join(
    sentence(body) for body in ("GNRMC,,V,,,,,,,,,,N", "GNVTG,,,,,,,,,N", "GNGGA,,,,,,0,00,99.9,,,,,,", "GPGSV,1,1,00")
)


def comparable(frames: list[Frame]) -> list[tuple[Any, ...]]:
    """Return the frames as values that compare equal, including NaN."""
    return [tuple(map(repr, (type(f.sample), astuple(f.sample), f.t_rx, f.t_device))) for f in frames]


def counters(decoder: Decoder) -> tuple[int, int, int]:
    """Return the counters of a decoder."""
    return decoder.frames, decoder.checksum_errors, decoder.unparsed_bytes


def cuts(data: bytes, seed: int) -> Iterator[bytes]:
    """Yield `data` in random pieces."""
    rng = random.Random(seed)
    at = 0
    while at < len(data):
        size = rng.choice((1, 2, 3, 7, 20, 90, 300))
        yield data[at : at + size]
        at += size


def check_splits(make: Callable[[], Decoder], data: bytes) -> list[Frame]:
    """Feed data whole, byte by byte and in random pieces.

    Check for the same samples and counters, and return the samples.
    """
    whole = make()
    frames = whole.feed(data, 5.0)
    ways = [[data[i : i + 1] for i in range(len(data))], *(list(cuts(data, seed)) for seed in range(5))]
    for pieces in ways:
        decoder = make()
        found = [frame for piece in pieces for frame in decoder.feed(piece, 5.0)]
        assert comparable(found) == comparable(frames)
        assert counters(decoder) == counters(whole)
    return frames


def check_garbage(make: Callable[[], Decoder], messages: list[bytes], expected: int, ending: bytes = b"") -> None:
    """Add garbage before, between and after the messages, and check that the samples are those of the clean stream.

    `expected` is the number of samples. `ending` ends garbage that a protocol could otherwise take for a message.
    """
    clean = make().feed(b"".join(messages), 5.0)
    assert len(clean) == expected
    for garbage in GARBAGE:
        for where in ("before", "between", "after"):
            parts = list(messages)
            junk = garbage + ending
            if where == "before":
                parts.insert(0, junk)
            elif where == "after":
                parts.append(junk)
            else:
                parts = [part for message in messages for part in (message, junk)]
            decoder = make()
            frames = check_splits(make, b"".join(parts))
            decoder.feed(b"".join(parts), 5.0)
            assert comparable(frames) == comparable(clean), (garbage, where)


def is_close(a: object, b: object, rel: float = 1e-9, tolerance: float = 1e-9) -> bool:
    """Return whether two samples agree field by field, with NaN equal to NaN."""
    pairs = zip(astuple(a), astuple(b), strict=True)  # type: ignore[call-overload]
    return all(
        (math.isnan(x) and math.isnan(y)) or math.isclose(x, y, rel_tol=rel, abs_tol=tolerance) for x, y in pairs
    )
