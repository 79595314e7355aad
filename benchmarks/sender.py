"""Simulated devices that send on ptys like a UART: on time, and unread bytes are lost.

The kernel buffers 64 kB or more for a real port, but a pty buffers only 4 kB. This program therefore buffers 64 kB for
each port before messages are lost.

`python -m benchmarks.sender FOLDER DEVICES RATE SECONDS` creates the links FOLDER/d0, d1, ..., prints `ready` and waits
for a line on stdin. It then sends VectorNav messages. The device time of a message is the time of `RunClock`, and its
roll rate is its number. At the end the program prints a line of JSON: the number of sent messages, the number of
messages that the port refused, and the largest delay of the sender [s].
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
import tty
from pathlib import Path

from seatrial.daq.clock import RunClock
from seatrial.daq.protocol import vectornav
from seatrial.daq.samples import Ahrs

TICK_S = 1e-3
HELD_BYTES = 65536  # buffer of each port
# The raw clock of the system. The monotonic clock is adjusted by time servers and differs from it by 0.14 s in a day.
CLOCK = RunClock(origin=(0.0, 0.0))


def main() -> None:
    """Open the ports, send the messages, and print the report. The arguments are in the docstring of the module.

    After the report the program waits for another line on stdin, so that the ports stay open.
    """
    folder, n_devices, rate, seconds = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4])
    pairs = [os.openpty() for _ in range(n_devices)]
    for k, (master, slave) in enumerate(pairs):
        tty.setraw(slave)
        os.set_blocking(master, False)
        (folder / f"d{k}").symlink_to(os.ttyname(slave))
    print("ready", flush=True)
    sys.stdin.readline()
    held = [bytearray() for _ in pairs]
    sent, refused, late = 0, 0, 0.0
    begun = time.monotonic()
    total = round(rate * seconds)
    while sent < total:
        now = time.monotonic()
        due = min(int((now - begun) * rate) + 1, total)
        late = max(late, (due - sent) / rate)
        for number in range(sent, due):
            refused += sum(not _buffer_message(waiting, number) for waiting in held)
        sent = due
        for (master, _), waiting in zip(pairs, held, strict=True):
            _write_buffered(master, waiting)
        time.sleep(max(TICK_S - (time.monotonic() - now), 0.0))
    while any(held):
        for (master, _), waiting in zip(pairs, held, strict=True):
            _write_buffered(master, waiting)
        time.sleep(TICK_S)
    time.sleep(0.5)
    print(json.dumps({"sent": sent * n_devices, "refused": refused, "late": late}), flush=True)
    sys.stdin.readline()


def _buffer_message(waiting: bytearray, number: int) -> bool:
    """Add the message with this number to the buffer ``waiting`` of a port, which is changed in place.

    Return False if the buffer holds more than 64 kB, so that the message is lost.
    """
    if len(waiting) > HELD_BYTES:
        return False
    sample = Ahrs(0.0, 0.0, 0.0, float(number), 0.0, 0.0, 0.0, 0.0, -9.8)
    waiting += vectornav.encode_binary(sample, CLOCK.now())
    return True


def _write_buffered(master: int, waiting: bytearray) -> None:
    """Write buffered bytes to the pty ``master`` until it accepts no more, and remove them from ``waiting``."""
    with contextlib.suppress(BlockingIOError):
        while waiting:
            del waiting[: os.write(master, waiting)]


if __name__ == "__main__":
    main()
