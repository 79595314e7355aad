"""Shaft speed, current, voltage and temperature from any CAN bus, as a DBC file lays its messages out.

The fields are unpacked by cantools. NMEA 2000 and J1939 identifiers hold a priority and the sender beside the number
of the message (PGN), so there a message is known by its PGN (SAE J1939-21, 5.2); there, too, the highest numbers of a
field are "error" and "not available": from 0xFB in the highest byte on (SAE J1939-71, 5.1), or in NMEA 2000 the last
three (canboat). One PGN ships with seatrial: nmea2000.dbc, 127488, engine parameters.
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

STALE = 2.0  # s; values of other messages are not repeated for longer than this
_PDU_1 = 0x03FF_0000  # PGN below 0xF000: its low byte is an address
_PDU_2 = 0x03FF_FF00
_PAGE_1 = 0x0100_0000  # NMEA 2000 has its own PGNs there
_SPEED_UNITS = ("rpm", "1/min", "r/min", "rev/min")
LARGEST = 1e100  # of a value in any unit; squares of it are numbers, too
_RESERVED = 0xFB  # of J1939: from here on the highest byte means that there is no value


class _Wanted(NamedTuple):
    """A message and the signals read from it."""

    message: Any  # cantools.database.can.Message
    signals: tuple[DbcSignal, ...]


def load_dbc(path: str) -> Any:
    """The database in a DBC file. Raises SeatrialError where it is none."""
    import cantools  # takes a while to import, and only CAN needs it

    require_file(Path(path))  # a rig or a map of somebody else may name a pipe or a device
    try:
        found: Any = cantools.database.load_file(path, database_format="dbc")
    except OSError as error:
        raise SeatrialError(f"{path}: {error.strerror}") from error
    except Exception as error:  # cantools' parser has errors of many kinds
        raise SeatrialError(f"{path}: no DBC file: {' '.join(str(error).split())}") from error
    for message in found.messages:
        for signal in message.signals:
            if not abs(signal.scale) * 2.0**signal.length + abs(signal.offset) < LARGEST:
                raise SeatrialError(
                    f"{path}: signal '{printable(signal.name)}' of {printable(message.name)} has the factor "
                    f"{signal.scale:g} and the offset {signal.offset:g}; no value is so large, correct the DBC file"
                )
    return found


def is_j1939(message: Any) -> bool:
    """Whether a message is known by its PGN rather than by its whole identifier."""
    return bool(message.protocol == "j1939")


def pgn_bits(identifier: int) -> int:
    """The bits of a 29-bit identifier that identify the message, without priority, sender and destination."""
    return identifier & (_PDU_1 if identifier >> 16 & 0xFF < 0xF0 else _PDU_2)


def number(message: Any, name: str, raw: float, field: str = "") -> float:
    """A field in its unit, of its raw number; NaN where J1939 or NMEA 2000 says that there is none.

    A shaft speed (by its unit, or `field` rpm) is held to the rule of J1939 in both: gateways pass its codes on, and
    no shaft turns at 16,000 rev/min.
    """
    about = message.get_signal_by_name(name)
    is_speed = field == "rpm" or (about.unit or "").lower() in _SPEED_UNITS
    if is_j1939(message) and not about.is_float and raw >= _first_code(message, about, is_speed):
        return NAN
    return float(about.raw_to_scaled(raw, decode_choices=False))


def _first_code(message: Any, about: Any, is_speed: bool) -> int:
    """The lowest raw number of a field that is no value."""
    own = bool(message.frame_id & _PAGE_1)  # NMEA 2000's; other PGNs, and those of manufacturers, may be of either
    length, is_signed = int(about.length), bool(about.is_signed)
    if length >= 8 and not is_signed and (is_speed or not own):
        return _RESERVED << length - 8
    return (1 << length - is_signed) - (3 if length >= 8 else 2 if length >= 4 else 1)


class Decoder(FrameDecoder):
    """CAN frames -> `Esc`, by `signals`: one sample for each message that holds an rpm.

    Without one, each configured message gives one. Values from other messages of the same node (current, voltage,
    temperature, duty) are the newest received, NaN when older than `STALE`. Raises SeatrialError for a message
    or signal that `database` has not.
    """

    def __init__(self, database: Any, signals: Sequence[DbcSignal]) -> None:
        super().__init__()
        self._exact: dict[tuple[int, bool], _Wanted] = {}
        self._by_pgn: dict[int, _Wanted] = {}
        self._heard: dict[int, dict[str, tuple[float, float]]] = {}  # node -> field -> value, t_rx
        self._has_rpm = any(signal.field == "rpm" for signal in signals)
        for name in dict.fromkeys(signal.message for signal in signals):
            message = _find(name, database.messages, "message")
            mine = tuple(signal for signal in signals if signal.message == name)
            for signal in mine:
                for wanted in [signal.signal, *([signal.node] if isinstance(signal.node, str) else [])]:
                    if wanted != SOURCE:
                        _find(wanted, message.signals, f"signal of {name}")
            if is_j1939(message):
                self._by_pgn[pgn_bits(message.frame_id)] = _Wanted(message, mine)
            else:
                self._exact[message.frame_id, message.is_extended_frame] = _Wanted(message, mine)

    def _take(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        wanted = self._exact.get((identifier, extended))
        if wanted is None and extended:
            wanted = self._by_pgn.get(pgn_bits(identifier))
        if wanted is None:
            return []
        try:
            raw = wanted.message.decode(data, decode_choices=False, scaling=False)
        except Exception:  # too short, or a multiplexer that the DBC does not know
            self.unparsed_bytes += FRAME_BYTES
            return []
        self.frames += 1
        nodes: dict[int, None] = {}
        for signal in wanted.signals:
            node = identifier & 0xFF if signal.node == SOURCE else raw.get(signal.node, signal.node)
            value = self._value(wanted.message, signal, raw)
            if isinstance(node, int) and value is not None:
                self._heard.setdefault(node, {})[signal.field] = (value, t_rx)
                if signal.field == "rpm" or not self._has_rpm:
                    nodes[node] = None
        return [Frame(self._esc(node, t_rx), t_rx, NAN) for node in nodes]

    def _value(self, message: Any, signal: DbcSignal, raw: dict[str, Any]) -> float | None:
        if signal.signal not in raw:  # of another multiplexer
            return None
        value = number(message, signal.signal, raw[signal.signal], signal.field)
        return signal.scale * value + signal.offset

    def _esc(self, node: int, t_rx: float) -> Esc:
        heard = self._heard[node].items()
        return Esc(node, **{name: value for name, (value, t) in heard if t_rx - t <= STALE})

    def _forget(self) -> None:
        self._heard.clear()


def _find(name: str | int, rows: Sequence[Any], what: str) -> Any:
    for row in rows:
        if row.name == name:
            return row
    there = ", ".join(row.name for row in rows) or "none"
    raise SeatrialError(f"the DBC file has no {what} '{name}'; there is: {there}")
