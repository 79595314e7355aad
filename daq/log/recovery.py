"""What a killed or damaged log still holds -> a whole log that any MCAP tool opens."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

from daq.errors import SeatrialError
from daq.log.mcap_chunk import by_chunk
from daq.log.mcap_reader import RawLog
from daq.log.mcap_writer import RecordWriter
from daq.log.segments import SegmentedLog, discard_note, open_raw

CHUNK_BYTES = 1024 * 1024


class RecoveredLog(NamedTuple):
    """What came of it."""

    messages: int
    files: int  # segments that it was read from
    warnings: list[str]  # what is wrong with them; nothing where the log was whole


def recover_log(path: Path, out: Path, force: bool = False) -> RecoveredLog:
    """Copy everything readable of the log that begins at `path`, all its segments, to `out`. Raises SeatrialError."""
    log = open_raw(path)
    try:
        if not len(log.messages):
            raise SeatrialError(f"{path}: no message is readable; there is nothing to recover")
        if out.exists() and any(out.samefile(raw.path) for raw in log.files):
            raise SeatrialError(f"{out}: is the log itself, which is not changed; -o names another")
        if out.exists() and not force:
            raise SeatrialError(f"{out}: the file exists already; --force replaces it, -o names another")
        part = out.with_name(f".{out.name}.{os.getpid()}.part")
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            _copy(log, part)
            os.replace(part, out)
            discard_note(out)
        except OSError as error:
            raise SeatrialError(f"{out}: cannot be written: {error.strerror}") from error
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
        return RecoveredLog(len(log.messages), len(log.files), log.warnings)
    finally:
        log.close()


def _copy(log: RawLog | SegmentedLog, part: Path) -> None:
    with part.open("xb") as file:
        writer = RecordWriter(file, chunk_bytes=CHUNK_BYTES, profile=log.profile, library="seatrial")
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
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
