"""PX4 logs for tests, written by the specification of the format."""

from __future__ import annotations

import importlib.util
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

needs_pyulog = pytest.mark.skipif(
    importlib.util.find_spec("pyulog") is None, reason="reads PX4 logs, which needs the extra ulog"
)


class Topic(NamedTuple):
    """Topic of a log: declared fields after the timestamp, struct format, times [s] (n,), rows."""

    fields: str
    form: str
    t: np.ndarray
    rows: np.ndarray  # (n, numbers)


def message(kind: bytes, body: bytes) -> bytes:
    """Return a message of the format."""
    return struct.pack("<Hc", len(body), kind) + body


def write_ulog(path: Path, topics: Mapping[str, Topic], boot: float = 0.0) -> None:
    """Write header, definitions, and data in order of time; see docs.px4.io, "ULog file format".

    `boot` is the time of the first byte [s].
    """
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", round(boot * 1e6)) + message(b"B", bytes(40))
    for name, topic in topics.items():
        out += message(b"F", f"{name}:uint64_t timestamp;{topic.fields};".encode())
    data = []
    for number, (name, topic) in enumerate(topics.items()):
        out += message(b"A", struct.pack("<BH", 0, number) + name.encode())
        form = struct.Struct(f"<HQ{topic.form}")
        whole = [letter in "BbHhIiQq" for letter in _letters(topic.form)]
        for t, row in zip(topic.t.tolist(), topic.rows.tolist(), strict=True):
            values = (int(value) if is_whole else value for value, is_whole in zip(row, whole, strict=True))
            data.append((t, number, message(b"D", form.pack(number, round(t * 1e6), *values))))
    path.write_bytes(out + b"".join(row[2] for row in sorted(data, key=lambda row: row[:2])))


def _letters(form: str) -> str:
    """Return a form of struct with its repetitions written out: 2f -> ff."""
    out, count = "", ""
    for letter in form:
        if letter.isdigit():
            count += letter
        else:
            out, count = out + letter * int(count or 1), ""
    return out
