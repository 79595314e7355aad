"""Decoder of shaft speed, current, voltage and temperature from any CAN bus whose messages a DBC file describes.

The library cantools unpacks the fields. J1939 and NMEA 2000 differ from other buses in two points. Their identifiers
contain a priority and the sender's address beside the number of the message (PGN), so the decoder compares only the PGN
(SAE J1939-21, 5.2). The highest numbers of a field mean "error" or "not available": in J1939 from 0xFB in the highest
byte on (SAE J1939-71, 5.1), in NMEA 2000 the last three (canboat). One DBC file is part of seatrial: nmea2000.dbc, for
PGN 127488, engine parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from seatrial.daq.errors import SeatrialError, printable
from seatrial.daq.files import require_file
from seatrial.daq.protocol.canframe import FRAME_BYTES, FrameDecoder
from seatrial.daq.rig import SOURCE, DbcSignal
from seatrial.daq.samples import NAN, Esc, Frame

STALE = 2.0  # s; older values of other messages become NaN in a sample
_PDU_1 = 0x03FF_0000  # PGN below 0xF000: its low byte is an address
_PDU_2 = 0x03FF_FF00
_PAGE_1 = 0x0100_0000  # bit of the data page; the PGNs that NMEA 2000 defines are in page 1
_SPEED_UNITS = ("rpm", "1/min", "r/min", "rev/min")
LARGEST = 1e100  # bound of a value in any unit; its square is still a finite number
_RESERVED = 0xFB  # J1939: a highest byte from here on means that there is no value


class _MessageSignals(NamedTuple):
    """A message of the DBC file and the signals to read from it.

    Attributes
    ----------
    message
        The message, of the class cantools.database.can.Message.
    signals
        Signals to read from the message.
    """

    message: Any
    signals: tuple[DbcSignal, ...]


def load_dbc(path: str) -> Any:
    """Return the database (of the library cantools) that a DBC file contains.

    Raises
    ------
    SeatrialError
        If the file cannot be read, is not a regular file or not a DBC file, or if a signal has a factor or an offset
        with which its values could exceed 1e100 (LARGEST).
    """
    import cantools  # imported here because the import is slow and only CAN needs it

    require_file(Path(path))  # a rig file from another person may name a pipe or a device, which would block
    try:
        database: Any = cantools.database.load_file(path, database_format="dbc")
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error
    except Exception as error:  # cantools' parser has errors of many kinds
        raise SeatrialError(
            f"{path}: not a DBC file: {' '.join(str(error).split())}; correct this file, or give another"
        ) from error
    for message in database.messages:
        for signal in message.signals:
            if not abs(signal.scale) * 2.0**signal.length + abs(signal.offset) < LARGEST:
                raise SeatrialError(
                    f"{path}: signal '{printable(signal.name)}' of {printable(message.name)} has the factor "
                    f"{signal.scale:g} and the offset {signal.offset:g}; this is implausibly large, correct it"
                )
    return database


def is_j1939(message: Any) -> bool:
    """Return whether a message of a DBC file belongs to J1939 or NMEA 2000.

    The file states this by its attributes (VFrameFormat). Such a message is identified by its PGN alone, not by the
    whole CAN identifier.
    """
    return bool(message.protocol == "j1939")


def pgn_bits(identifier: int) -> int:
    """Return the bits of a 29-bit CAN identifier that contain the message number of J1939 (PGN), without shifting them.

    The bits of priority, sender and destination are zero in the result. The low byte of a PGN below 0xF000 is a
    destination.
    """
    return identifier & (_PDU_1 if identifier >> 16 & 0xFF < 0xF0 else _PDU_2)


def number(message: Any, name: str, raw: float, field: str = "") -> float:
    """Convert the raw number of a signal in a DBC file to its unit.

    Parameters
    ----------
    message
        The message of cantools that contains the signal.
    name
        Name of the signal.
    raw
        Raw number of the signal, without factor and offset.
    field
        Field of `Esc` that the signal is mapped to; empty if there is none. A signal of the field "rpm", or with a unit
        such as "rpm" or "1/min", is a shaft speed.

    Returns
    -------
    float
        Value in the unit of the DBC file. It is NaN if the message belongs to J1939 or NMEA 2000 and the raw number of
        a whole-number signal means "error" or "not available".

    Notes
    -----
    The codes of J1939 apply to a shaft speed (by its unit, or by `field`) also in NMEA 2000: gateways forward the codes
    unchanged, and no shaft turns at 16,000 rev/min.
    """
    signal = message.get_signal_by_name(name)
    is_speed = field == "rpm" or (signal.unit or "").lower() in _SPEED_UNITS
    if is_j1939(message) and not signal.is_float and raw >= _first_code(message, signal, is_speed):
        return NAN
    return float(signal.raw_to_scaled(raw, decode_choices=False))


def _first_code(message: Any, signal: Any, is_speed: bool) -> int:
    """Return the lowest raw number of a signal in a DBC file that means "error" or "not available".

    In J1939, and for a shaft speed (`is_speed`), an unsigned signal of 8 bits or more has such numbers from 0xFB in its
    highest byte on. Of other signals, these numbers are the highest 3 of the signal, or 2 with 4 to 7 bits, or 1 with
    fewer bits. The highest number of a signed signal is its largest positive one. `message` and `signal` are objects of
    cantools.
    """
    # PGNs of page 1 belong to NMEA 2000. Other PGNs, and those of manufacturers, occur in both standards.
    is_nmea2000 = bool(message.frame_id & _PAGE_1)
    length, is_signed = int(signal.length), bool(signal.is_signed)
    if length >= 8 and not is_signed and (is_speed or not is_nmea2000):
        return _RESERVED << length - 8
    return (1 << length - is_signed) - (3 if length >= 8 else 2 if length >= 4 else 1)


class Decoder(FrameDecoder):
    """Decoder of CAN frames to `Esc` samples, by a DBC database and the signals to read from it.

    Each CAN frame that contains an rpm gives one sample for each node (speed controller) whose rpm it contains. If no
    signal is mapped to rpm, each frame of a configured message gives one sample for each of its nodes. A value that
    the message reports as "error" or "not available" is NaN, also the rpm. Current, voltage, temperature and duty from
    other messages of the same node are the newest received values, or NaN if they are older than 2 s (`STALE`). Frames
    of other messages are ignored. A message of J1939 or NMEA 2000 is recognised by its PGN, any other message by its
    whole CAN identifier. `t_device` of the samples is NaN.

    Parameters
    ----------
    database
        Database of cantools (`load_dbc`).
    signals
        Signals to read, with the fields of `Esc` that they are mapped to.

    Raises
    ------
    SeatrialError
        If the database lacks a message or a signal.
    """

    def __init__(self, database: Any, signals: Sequence[DbcSignal]) -> None:
        """Find the messages of the signals to read in the cantools database.

        Messages of J1939 and NMEA 2000 are stored by their PGN, others by their identifier. A node that is given by
        name has to be a signal of the message. Raise SeatrialError if the database lacks a message or a signal.
        """
        super().__init__()
        self._exact: dict[tuple[int, bool], _MessageSignals] = {}
        self._by_pgn: dict[int, _MessageSignals] = {}
        self._newest: dict[int, dict[str, tuple[float, float]]] = {}  # node -> field -> value, t_rx [s]
        self._has_rpm = any(signal.field == "rpm" for signal in signals)
        for name in dict.fromkeys(signal.message for signal in signals):
            message = _find_by_name(name, database.messages, "message")
            selected = tuple(signal for signal in signals if signal.message == name)
            for signal in selected:
                for required in [signal.signal, *([signal.node] if isinstance(signal.node, str) else [])]:
                    if required != SOURCE:
                        _find_by_name(required, message.signals, f"signal of {name}")
            if is_j1939(message):
                self._by_pgn[pgn_bits(message.frame_id)] = _MessageSignals(message, selected)
            else:
                self._exact[message.frame_id, message.is_extended_frame] = _MessageSignals(message, selected)

    def _decode_can_frame(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        """Decode one CAN frame if the rig reads signals from its message; return no sample otherwise.

        The values are stored by node: the node is a fixed number, the source address (low 8 bits of the identifier), or
        the value of a signal of the frame. A signal that the frame lacks is skipped. Return one sample for each node
        (speed controller) whose rpm the frame contains, or, if the rig reads no rpm, for each node with any value in
        it. A frame that cannot be decoded counts as unparsed bytes.
        """
        configured = self._exact.get((identifier, extended))
        if configured is None and extended:
            configured = self._by_pgn.get(pgn_bits(identifier))
        if configured is None:
            return []
        try:
            raw = configured.message.decode(data, decode_choices=False, scaling=False)
        except Exception:  # the frame is too short, or the DBC file lacks its multiplexer value
            self.unparsed_bytes += FRAME_BYTES
            return []
        self.frames += 1
        nodes: dict[int, None] = {}
        for signal in configured.signals:
            node = identifier & 0xFF if signal.node == SOURCE else raw.get(signal.node, signal.node)
            value = self._scaled_value(configured.message, signal, raw)
            if isinstance(node, int) and value is not None:
                self._newest.setdefault(node, {})[signal.field] = (value, t_rx)
                if signal.field == "rpm" or not self._has_rpm:
                    nodes[node] = None
        return [Frame(self._newest_sample(node, t_rx), t_rx, NAN) for node in nodes]

    def _scaled_value(self, message: Any, signal: DbcSignal, raw: dict[str, Any]) -> float | None:
        """Return the value of a signal, times the scale and plus the offset that the rig gives for this signal.

        Scale and offset convert the unit of the DBC file to the unit of the field of `Esc`; there is no other
        conversion. Return None if the frame lacks the signal, and NaN if the signal reports "not available". `message`
        is the message of cantools, and `raw` are the raw numbers of the frame's signals by name.
        """
        if signal.signal not in raw:  # the signal belongs to another multiplexer value
            return None
        value = number(message, signal.signal, raw[signal.signal], signal.field)
        return signal.scale * value + signal.offset

    def _newest_sample(self, node: int, t_rx: float) -> Esc:
        """Return a sample of the newest values of a speed controller, given by its number `node`.

        Values that are older than 2 s (STALE) at the run time `t_rx` [s], or were never received, are NaN. The node
        must have a value already.
        """
        newest = self._newest[node].items()
        return Esc(node, **{name: value for name, (value, t) in newest if t_rx - t <= STALE})

    def _forget_state(self) -> None:
        """Discard the newest values of all speed controllers, because the port was reopened."""
        self._newest.clear()


def _find_by_name(name: str | int, rows: Sequence[Any], label: str) -> Any:
    """Return the first message or signal of cantools in `rows` whose name is exactly `name`.

    If there is none, raise SeatrialError with all names in `rows`. `label` is the word for the missing thing in this
    message, such as "message".
    """
    for row in rows:
        if row.name == name:
            return row
    known = ", ".join(row.name for row in rows) or "none"
    raise SeatrialError(f"the DBC file has no {label} '{name}'; name one in the rig that it has: {known}")
