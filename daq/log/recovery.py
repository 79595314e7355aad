"""Recovery of killed or damaged logs: all readable records are copied to a new log that any MCAP tool opens."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import new_file
from seatrial.daq.log.mcap_reader import RawLog
from seatrial.daq.log.mcap_writer import RecordWriter
from seatrial.daq.log.segments import SegmentedLog, open_raw
from seatrial.daq.log.watchdog_note import discard_note

CHUNK_BYTES = 1024 * 1024


class RecoveredLog(NamedTuple):
    """Result of the recovery of a damaged log.

    Attributes
    ----------
    messages
        Number of copied messages.
    files
        Number of segments (files of the log) that were read.
    warnings
        Faults of these segments, and segments that are missing or left out, one line each; empty if the log was whole.
    """

    messages: int
    files: int
    warnings: list[str]


def recover_log(path: Path, out: Path, force: bool = False) -> RecoveredLog:
    """Recover a killed or damaged log: copy all readable records of all its segments (files) to one new log.

    Metadata and attachments are those of the first segment. A watchdog's note beside an earlier log `out` is deleted.
    After an error there is no new file, and an existing file `out` is unchanged.

    Parameters
    ----------
    path
        First segment of the log. The log is not changed.
    out
        File of the new log. Its folder is created if it does not exist.
    force
        Whether an existing file `out` may be replaced.

    Returns
    -------
    RecoveredLog
        Numbers of messages and segments, and the faults of the log.

    Raises
    ------
    SeatrialError
        If `path` is no log, if no message is readable, if `out` is one of the segments, if `out` exists and `force` is
        False, or if `out` cannot be written.
    """
    log = open_raw(path)
    try:
        if out.exists() and any(out.samefile(raw.path) for raw in log.files):
            raise SeatrialError(
                f"{out}: belongs to the log itself, which must not be changed; use -o to name another file"
            )
        try:
            with new_file(out, force) as part:
                n_messages = _copy_records(log, part)
                if not n_messages:
                    raise SeatrialError(
                        f"{path}: no message is readable, so nothing can be recovered; use another copy of the log"
                    )
            discard_note(out)
        except OSError as error:
            raise SeatrialError(f"{out}: cannot be written: {error.strerror}; give another file with -o") from error
        return RecoveredLog(n_messages, len(log.files), log.warnings)
    finally:
        log.close()


def _copy_records(log: RawLog | SegmentedLog, part: Path) -> int:
    """Copy metadata, attachments, schemas, channels and messages of a log to the new MCAP file `part`.

    Of a log with several segments, metadata and attachments of the first one are copied. Schemas and channels get new
    numbers; a channel whose schema is lost gets the number 0 for it. `part` must not exist; FileExistsError is raised
    otherwise. The file is synced to the disk. Return the number of copied messages, which may be 0.
    """
    n_messages = 0
    with part.open("xb") as file:
        writer = RecordWriter(file, chunk_bytes=CHUNK_BYTES, profile=log.profile, library="seatrial")
        for record in log.metadata:
            writer.add_metadata(record.name, record.metadata)
        for item in log.attachments:
            writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
        schemas = {key: writer.register_schema(s.name, s.encoding, s.data) for key, s in log.schemas.items()}
        channels = {
            key: writer.register_channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0), c.metadata)
            for key, c in log.channels.items()
        }
        for batch in log.read():
            heads = (batch.heads[name].tolist() for name in ("channel", "log_ns", "stamp_ns", "sequence"))
            for channel, log_ns, stamp_ns, sequence, data in zip(*heads, batch.payloads(), strict=True):
                writer.add_message(channels[channel], log_ns, bytes(data), stamp_ns, sequence)
            n_messages += len(batch.heads)
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
    return n_messages
