"""Benchmark of the codecs of seatrial and of libraries on the same bytes (docs/decisions/0025-own-codecs.md).

The figures are messages per second. The libraries are called as in their documentation. The codecs of seatrial return
samples in SI units; the libraries return their own message objects.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cantools
import dronecan as pydronecan
import numpy as np
from can.interfaces.slcan import slcanBus
from dronecan.transport import Frame as CanFrame
from dronecan.transport import Transfer
from mcap.writer import CompressionType, Writer
from nmea2000.decoder import NMEA2000Decoder
from pynmeagps import NMEAReader
from pyubx2 import UBXReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.measure import Figure, best_ms
from seatrial.daq.log.cdr import NANO, cdr_layout, definition
from seatrial.daq.log.mcap_writer import CHUNK_BYTES, RecordWriter
from seatrial.daq.log.schema import TYPES, messages
from seatrial.daq.protocol import dronecan, mip, nmea, nmea2000, slcan, ubx, vectornav, vesc
from seatrial.daq.protocol.canframe import pack_can
from seatrial.daq.protocol.decoder import Decoder
from seatrial.daq.samples import Ahrs, Esc, Frame, Gnss

N = 2000  # messages of each kind
READ_BYTES = 4096  # bytes in each call of a decoder
T = 1_700_000_000.0  # s since 1970
AHRS = Ahrs(1.5, 0.1, -0.2, 0.01, -0.02, 0.03, 0.1, -0.2, -9.8, 2e-5, 1e-6, 4e-5)
GNSS = Gnss(T, 41.1234567, -8.7654321, 12.345, 0.5, -0.25, 0.125, 5, 12, 0.9, 0.014)
ESC = Esc(1, 1234.0, 12.0, 0.5, 15.9, 31.0)
Call = Callable[[], object]
CanFrames = list[tuple[int, bytes]]


def figures(seed: int) -> list[Figure]:
    """Return the rates of all codecs [messages/s], with those of libraries as peers.

    The seed has no effect, since the messages are not random.
    """
    found = []
    for name, n_messages, ours, library, note in codecs():
        rate = 1e3 * n_messages / best_ms(ours, 3)
        peer = None if library is None else 1e3 * n_messages / best_ms(library, 3)
        found.append(Figure("codecs", name, rate, "messages/s", peer, note))
    return found


def codecs() -> Iterator[tuple[str, int, Call, Call | None, str]]:
    """Yield the benchmark of each codec.

    Each has its name, the number of messages in a call, the call of seatrial, the call of a library (None without a
    library) and a note. A call is a function without arguments that handles all messages once.
    """
    yield "slcan, reading", N, *_slcan(), "peer: python-can"
    yield "VESC, reading", N, *_vesc(), "peer: cantools, which seatrial also uses"
    yield "UBX NAV-PVT, reading", N, *_ubx(), "peer: pyubx2"
    yield "NMEA 0183, sentences of epochs, reading", 4 * N, *_nmea(), "peer: pynmeagps, which seatrial also uses"
    yield "DroneCAN esc.Status, reading", N, *_dronecan_reading(), "peer: dronecan"
    yield "DroneCAN esc.RawCommand, writing", N, *_dronecan_writing(), "peer: dronecan"
    yield "NMEA 2000 heading and fix, reading", 2 * N, *_nmea2000(), "peer: nmea2000"
    yield "MIP filter packets, reading", N, _mip(), None, "no peer: MSCL reads from ports only"
    yield "VectorNav binary, reading", N, _vectornav(), None, "no peer: libraries read from ports only"
    yield "MCAP records, writing", N, *_mcap(), "peer: mcap"
    yield "CDR of Gnss, packing", N, *_cdr_packing(), "peer: rosbags"
    yield "CDR of Gnss, reading a column", N, *_cdr_reading(), "peer: rosbags"


def _decode_call(make: Callable[[], Decoder], data: bytes) -> Call:
    """Return a function that decodes ``data`` in blocks of 4096 bytes, with a new decoder of ``make``.

    It asserts that at least 1000 samples are found, and no checksum error.
    """

    def call() -> None:
        """Decode all bytes once."""
        decoder, n_found = make(), 0
        for at in range(0, len(data), READ_BYTES):
            n_found += len(decoder.feed(data[at : at + READ_BYTES], T))
        assert n_found >= N // 2
        assert decoder.checksum_errors == 0

    return call


def _can_bytes(frames: CanFrames) -> bytes:
    """Return CAN frames (identifier and data) as one byte string in the format of the decoders."""
    return b"".join(pack_can(*frame) for frame in frames)


class _SerialBytes(io.BytesIO):
    """Bytes with the interface of a serial port, for the library python-can."""

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have not been read yet."""
        return len(self.getbuffer()) - self.tell()


def _slcan() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read frames of a CAN adapter by the slcan protocol."""
    data = b"".join(slcan.encode(0x901, bytes(8)) for _ in range(N))

    def library() -> None:
        with slcanBus("loop://", bitrate=500_000, sleep_after_open=0.0) as bus:
            bus.serialPortOrig.close()
            bus.serialPortOrig = _SerialBytes(data)
            assert sum(1 for _ in iter(lambda: bus.recv(0.0), None)) == N

    def ours() -> None:
        decoder = slcan.Decoder()
        assert sum(len(decoder.feed(data[at : at + READ_BYTES], T)) for at in range(0, len(data), READ_BYTES)) == N

    return ours, library


def _vesc() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read STATUS 1 frames of a VESC."""
    frame = vesc.encode_status(ESC, 7)[0]
    database = cantools.database.load_file(Path(vesc.__file__).with_name("vesc.dbc"))
    assert isinstance(database, cantools.database.can.Database)
    status = database.get_message_by_name("STATUS_1")
    return _decode_call(lambda: vesc.Decoder({1: 7}), _can_bytes([frame] * N)), lambda: [
        status.decode(frame[1], decode_choices=False) for _ in range(N)
    ]


def _ubx() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read NAV-PVT messages of u-blox receivers."""
    data = b"".join(ubx.encode(Gnss(T + k / 10, 41.1, -8.7, 12.0, 0.5, 0.2, 0.1, 3, 9)) for k in range(N))
    return _decode_call(ubx.Decoder, data), lambda: sum(1 for _ in UBXReader(io.BytesIO(data)))


def _nmea() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read the NMEA sentences of GNSS fixes."""
    data = b"".join(nmea.encode(Gnss(T + k / 10, 41.1, -8.7, 12.0, 0.5, 0.2, 0.1, 3, 9)) for k in range(N))
    return _decode_call(nmea.Decoder, data), lambda: sum(1 for _ in NMEAReader(io.BytesIO(data)))


def _dronecan_reading() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read DroneCAN esc.Status messages from their CAN frames."""
    transfers = [dronecan.encode(ESC, 42, k % 32) for k in range(N)]

    def library() -> None:
        for frames in transfers:
            Transfer().from_frames([CanFrame(identifier, data, ts_monotonic=0.0) for identifier, data in frames])

    return _decode_call(dronecan.Decoder, _can_bytes([frame for frames in transfers for frame in frames])), library


def _dronecan_writing() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that write DroneCAN esc.RawCommand messages."""
    kind = pydronecan.uavcan.equipment.esc.RawCommand

    def library() -> None:
        for k in range(N):
            made = Transfer(payload=kind(cmd=[4096, -4096]), source_node_id=42, transfer_id=k % 32)
            made.to_frames()

    return lambda: [dronecan.encode_command({0: 0.5, 1: -0.5}, 42, k % 32) for k in range(N)], library


def _nmea2000() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read NMEA 2000 messages with heading and position.

    The library reads them as lines of candump.
    """
    heading, fix = Ahrs(1.5, math.nan, math.nan), Gnss(T, 41.1, -8.7, 12.0, fix=3, n_sat=9, hdop=1.0)
    frames = [f for k in range(N) for f in (*nmea2000.encode(heading), *nmea2000.encode(fix, k % 250))]
    lines = [f"can0  {word:08X}   [{len(data)}]  {data.hex(' ').upper()}" for word, data in frames]

    def library() -> None:
        decoder = NMEA2000Decoder()
        for line in lines:
            decoder.decode(line)

    return _decode_call(lambda: nmea2000.Decoder(settle=0.0), _can_bytes(frames)), library


def _mip() -> Call:
    """Return the call of seatrial that reads MIP packets with attitudes."""
    fields = {0x05: struct.pack(">3fH", 0.1, 0.2, 1.5, 1)}
    return _decode_call(mip.Decoder, mip.packet(mip.FILTER, fields) * N)


def _vectornav() -> Call:
    """Return the call of seatrial that reads binary messages of a VectorNav."""
    return _decode_call(vectornav.Decoder, vectornav.encode_binary(AHRS, 1.0) * N)


def _mcap() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that write an MCAP file in memory."""
    body = np.random.default_rng(1).bytes(120)

    def ours() -> None:
        writer = RecordWriter(io.BytesIO(), chunk_bytes=CHUNK_BYTES, profile="ros2", library="")
        channel = writer.register_channel("/a", "cdr", writer.register_schema("a", "ros2msg", b""), {})
        for k in range(N):
            writer.add_message(channel, k, body, k, k)
        writer.finish()

    def library() -> None:
        writer = Writer(io.BytesIO(), chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/a", "cdr", writer.register_schema("a", "ros2msg", b""))
        for k in range(N):
            writer.add_message(channel, k, body, k, k)
        writer.finish()  # type: ignore[no-untyped-call]

    return ours, library


def _cdr_packing() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that encode Gnss messages in CDR."""
    name, values = TYPES[Gnss], messages("gnss", Frame(GNSS, T, T))[0].values
    store, kinds = _typestore(name)
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](1, 2), "gnss")
    ours, theirs = cdr_layout(name, b"gnss"), kinds[name](header, *values)
    return lambda: [ours.pack(NANO, *values) for _ in range(N)], lambda: [
        store.serialize_cdr(theirs, name) for _ in range(N)
    ]


def _cdr_reading() -> tuple[Call, Call]:
    """Return the calls (seatrial, library) that read the latitudes of Gnss messages in CDR."""
    name = TYPES[Gnss]
    found = cdr_layout(name, b"gnss")
    body = found.pack(NANO, *messages("gnss", Frame(GNSS, T, T))[0].values)
    store, _ = _typestore(name)
    return lambda: np.frombuffer(body * N, found.dtype)["lat"].sum(), lambda: [
        store.deserialize_cdr(body, name).lat for _ in range(N)
    ]


def _typestore(name: str) -> tuple[Any, dict[str, Any]]:
    """Return a type store of rosbags with the message type ``name`` of seatrial, and all its types by name."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(definition(name), name))
    return store, store.types
