"""CDR encoding (little endian, XCDR1) of the messages in daq/msg: layouts, packing and unpacking.

The layouts are derived from the message definitions. A message consists of a part of fixed size and, for a few types,
of strings or bytes after it. The `frame_id` of the header belongs to the fixed part, because a channel never changes
its `frame_id`. One precompiled `struct` therefore writes the fixed part, and one numpy dtype reads it.
Source: OMG DDS-XTypes 1.3, 7.4.1 (PLAIN_CDR). Alignment counts from the first byte after the four encapsulation bytes.
"""

from __future__ import annotations

import struct
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ENCAPSULATION = b"\x00\x01\x00\x00"
NANO = 1_000_000_000
_CODES = {
    "int8": "b",
    "uint8": "B",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "uint64": "Q",
    "float64": "d",
}
_FRAME_LENGTH = 12  # offset of the length of frame_id, after encapsulation and stamp
HEAD = np.dtype(
    {"names": ["endian", "n_frame"], "formats": ["<u2", "<u4"], "offsets": [0, _FRAME_LENGTH], "itemsize": 16}
)


class Field(NamedTuple):
    """Field of a message type, after nested types have been replaced by their fields.

    Attributes
    ----------
    name
        Name with dots for nested types, such as "header.stamp.sec".
    primitive
        Type of one element, such as "float64" or "string".
    length
        Number of elements of an array; 1 for a single value, and 0 for a sequence of variable length.
    """

    name: str
    primitive: str
    length: int = 1

    @property
    def variable(self) -> bool:
        """Whether the encoded size of the field differs from message to message.

        True for a string and for a sequence (`length` 0); False for a number and for an array of fixed length.
        """
        return self.primitive == "string" or self.length == 0


@cache
def definition(type_name: str) -> str:
    """Return the text of the file in daq/msg that defines a message type `package/msg/Name`.

    Raise FileNotFoundError if there is no such file. Each file is read once for each process.
    """
    package, _, name = type_name.split("/")
    return resources.files("seatrial.daq").joinpath("msg", package, f"{name}.msg").read_text(encoding="utf-8")


def _parse_fields(type_name: str) -> list[tuple[str, str]]:
    """Return (type, name) of each field in the definition of a message type `package/msg/Name`, in their order.

    The type is as in the definition, such as "float64[9]" or "std_msgs/Header". Comments, empty lines and constants
    are left out. Raise FileNotFoundError if daq/msg has no definition of the type.
    """
    lines = (line.partition("#")[0] for line in definition(type_name).splitlines())
    pairs = [line.split(maxsplit=1) for line in lines if line.strip() and "=" not in line]
    return [(kind, name.strip()) for kind, name in pairs]


def _full_type_name(kind: str) -> str | None:
    """Return the full name `package/msg/Name` of a message type `package/Name`; None for a primitive type."""
    return "/msg/".join(kind.split("/")) if "/" in kind else None


@cache
def full_definition(type_name: str) -> str:
    """Return the definition of a message type and of all types that it uses, in the form of MCAP's `ros2msg` encoding.

    Parameters
    ----------
    type_name
        Name of the type, `package/msg/Name`.

    Returns
    -------
    str
        The text of the definition of the type, then of each type that it uses, directly or by another type, after a
        line of 80 "=" and a line "MSG: package/Name". A type that is used several times is written once.

    Raises
    ------
    FileNotFoundError
        If daq/msg has no definition of one of these types.
    """
    parts, pending, seen = [definition(type_name)], [type_name], {type_name}
    while pending:
        for kind, _ in _parse_fields(pending.pop(0)):
            nested = _full_type_name(kind)
            if nested is not None and nested not in seen:
                seen.add(nested)
                pending.append(nested)
                parts.append(f"{'=' * 80}\nMSG: {kind}\n{definition(nested)}")
    return "".join(parts)


def flatten(type_name: str, prefix: str = "") -> list[Field]:
    """Return all fields of a message type `package/msg/Name` in the order of the CDR encoding.

    A nested type is replaced by its fields, which get dotted names such as "header.stamp.sec". `prefix` stands in front
    of each name. Raise FileNotFoundError if daq/msg has no definition of the type or of a nested one.
    """
    found: list[Field] = []
    for kind, name in _parse_fields(type_name):
        nested = _full_type_name(kind)
        base, bracket, size = kind.partition("[")
        if nested is not None:
            found += flatten(nested, f"{prefix}{name}.")
        else:
            found.append(Field(prefix + name, base, int(size.rstrip("]") or 0) if bracket else 1))
    return found


class CdrLayout:
    """Byte layout of one message type in CDR, for one `frame_id`: it packs and unpacks messages.

    A message consists of a part of fixed size, with the header and its `frame_id`, and of strings or bytes after it.

    Parameters
    ----------
    type_name
        Name of the type, `package/msg/Name`.
    frame_id
        The `frame_id` of the header, without the final NUL.
    lacking
        Names of fields that the messages do not have, because an older version of the type lacked them.

    Attributes
    ----------
    dtype
        numpy type of the fixed part, which includes the encapsulation bytes.
    type_name
        Name of the type.
    fixed
        Fields after the header up to the first field of variable size.
    tail
        The first field of variable size (string or sequence of bytes) and all fields after it. All of them are packed
        and unpacked as fields of variable size.

    Raises
    ------
    ValueError
        If the message type does not begin with a header.
    FileNotFoundError
        If daq/msg has no definition of the type.
    """

    def __init__(self, type_name: str, frame_id: bytes, lacking: tuple[str, ...] = ()) -> None:
        """Compute the byte layout of the message type `type_name` whose header has this `frame_id`.

        The fields in `lacking` are left out. Raise ValueError if the type does not begin with a header.
        """
        fields = [field for field in flatten(type_name) if field.name not in lacking]
        if [field.name for field in fields[:3]] != [
            "header.stamp.sec",
            "header.stamp.nanosec",
            "header.frame_id",
        ]:
            raise ValueError(f"{type_name} does not begin with a header")
        body = fields[3:]
        n_fixed = next((i for i, field in enumerate(body) if field.variable), len(body))
        self.type_name, self.fixed, self.tail = type_name, body[:n_fixed], body[n_fixed:]
        frame = frame_id + b"\0"
        names, formats = ["endian", "sec", "nanosec", "n_frame"], ["<u2", "<i4", "<u4", "<u4"]
        offsets = [0, 4, 8, 12]
        code, end = f"<4siII{len(frame)}s", 16 + len(frame)
        for field in self.fixed:
            size = struct.calcsize(f"<{_CODES[field.primitive]}")
            pad = -(end - len(ENCAPSULATION)) % size
            # The caller passes an array as bytes: a covariance that never changes is packed once for all messages.
            code += f"{pad}x{_CODES[field.primitive]}" if field.length == 1 else f"{pad}x{size * field.length}s"
            names.append(field.name)
            numpy_code = f"<{_CODES[field.primitive]}" if size > 1 else _CODES[field.primitive]
            formats.append(numpy_code if field.length == 1 else f"({field.length},){numpy_code}")
            offsets.append(end + pad)
            end += pad + size * field.length
        self._pack, self._n_frame, self._frame = struct.Struct(code).pack, len(frame), frame
        self.dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})

    def pack(self, stamp_ns: int, *values: float | bytes, tail: tuple[bytes, ...] = ()) -> bytes:
        """Encode one message of this layout as bytes in CDR.

        Parameters
        ----------
        stamp_ns
            Time stamp of the header [ns since 1970].
        values
            Values of the fixed fields after the header, in order; arrays as bytes (see `doubles`). The length of an
            array is not checked: too few bytes are filled up with zeros, and too many are cut off.
        tail
            Bytes of each field of variable size. Strings are given without the final NUL, which is added.

        Raises
        ------
        struct.error
            If the number of values is wrong, or a value does not fit its field.
        ValueError
            If the number of fields in `tail` is wrong.
        """
        sec, nanosec = divmod(stamp_ns, NANO)
        message = self._pack(ENCAPSULATION, sec, nanosec, self._n_frame, self._frame, *values)
        if not (tail or self.tail):
            return message
        for field, data in zip(self.tail, tail, strict=True):
            text = data + b"\0" if field.primitive == "string" else data
            message += b"\0" * (-len(message) % 4) + struct.pack("<I", len(text)) + text
        return message

    def unpack_tail(self, message: bytes | memoryview) -> tuple[bytes, ...]:
        """Return the bytes of each string or sequence of variable size at the end of a message.

        `message` is the whole message in CDR. One final NUL of a string is removed. Bytes after the last field are
        ignored. The tuple is empty for a type without such fields.

        Raises
        ------
        ValueError
            If the message ends before the end of its last field.
        """
        parts, at = [], self.dtype.itemsize
        for field in self.tail:
            at += -at % 4
            if at + 4 > len(message):
                raise ValueError("message ends too early")
            (length,) = struct.unpack_from("<I", message, at)
            at += 4
            if at + length > len(message):
                raise ValueError("message ends too early")
            data = bytes(message[at : at + length])
            parts.append(data.removesuffix(b"\0") if field.primitive == "string" else data)
            at += length
        return tuple(parts)


def doubles(*values: float) -> bytes:
    """Return numbers as the bytes of a float64 array (little endian), as `CdrLayout.pack` needs an array."""
    return struct.pack(f"<{len(values)}d", *values)


@cache
def cdr_layout(type_name: str, frame_id: bytes, lacking: tuple[str, ...] = ()) -> CdrLayout:
    """Return the byte layout of a message type in CDR for a `frame_id`. Each layout is computed once.

    Raise ValueError if the type does not begin with a header, and FileNotFoundError if it has no definition in daq/msg.

    Parameters
    ----------
    type_name
        Name of the type, `package/msg/Name`.
    frame_id
        The `frame_id` of the header, without the final NUL.
    lacking
        Names of fields that the messages do not have, because an older version of the type lacked them.
    """
    return CdrLayout(type_name, frame_id, lacking)


def stamps(rows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the time stamps in the headers of decoded messages, shape (n,) [s since 1970].

    `rows` are the messages, shape (n,), with the columns "sec" and "nanosec".
    """
    return np.asarray(rows["sec"] + rows["nanosec"] / NANO, dtype=np.float64)
