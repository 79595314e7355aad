"""What a killed or damaged log still holds -> a whole log that any MCAP tool opens."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from mcap.writer import CompressionType, Writer

from daq.errors import SeatrialError
from daq.mcap_chunk import by_chunk
from daq.mcap_read import RawLog


def salvage(path: Path, out: Path, force: bool = False) -> tuple[int, list[str]]:
    """Copy everything readable to `out`; returns how many messages and what was found wrong. Raises SeatrialError."""
    log = RawLog(path)
    if not len(log.messages):
        raise SeatrialError(f"{path}: no message is readable; there is nothing to salvage")
    if out.exists() and (not force or out.samefile(path)):
        raise SeatrialError(f"{out}: there is such a file already; -o names another")
    part = out.with_name(f".{out.name}.{os.getpid()}.part")
    try:
        _copy(log, part)
        os.replace(part, out)
    except OSError as error:
        raise SeatrialError(f"{out}: cannot be written: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        log.close()
    return len(log.messages), log.warnings


def _copy(log: RawLog, part: Path) -> None:
    with part.open("xb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile=log.profile, library="seatrial")
        for record in log.metadata:
            writer.add_metadata(record.name, record.metadata)
        for one in log.attachments:
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        schemas = {key: writer.register_schema(s.name, s.encoding, s.data) for key, s in log.schemas.items()}
        channels = {
            key: writer.register_channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0), c.metadata)
            for key, c in log.channels.items()
        }
        for _, messages in by_chunk(log.messages):
            for message in messages:
                writer.add_message(
                    channels[int(message["channel"])],
                    int(message["log_ns"]) % 2**64,
                    bytes(log.payload(message)),
                    int(message["stamp_ns"]) % 2**64,
                    int(message["sequence"]),
                )
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        os.fsync(file.fileno())
