"""Devices that send on ptys as a UART does: on time, and what nobody reads is lost.

A pty holds 4 kB; the kernel holds 64 kB and more of a real port, so as much waits here before anything is lost.

`python -m benchmarks.sender FOLDER DEVICES RATE SECONDS`: links FOLDER/d0, d1, ...; says `ready`, waits for a line,
sends VectorNav messages whose device time is the clock of `RunClock` from zero and whose roll rate is their number,
then says in a line of JSON how many went out, how many the line did not take, and how late it was itself.
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
HELD_BYTES = 65536
CLOCK = RunClock(origin=(0.0, 0.0))  # raw: time servers slew the monotonic clock away from it, by 0.14 s in a day


def main() -> None:
    """Serve, send, report."""
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
            refused += sum(not _queue(waiting, number) for waiting in held)
        sent = due
        for (master, _), waiting in zip(pairs, held, strict=True):
            _send(master, waiting)
        time.sleep(max(TICK_S - (time.monotonic() - now), 0.0))
    while any(held):
        for (master, _), waiting in zip(pairs, held, strict=True):
            _send(master, waiting)
        time.sleep(TICK_S)
    time.sleep(0.5)
    print(json.dumps({"sent": sent * n_devices, "refused": refused, "late": late}), flush=True)
    sys.stdin.readline()


def _queue(waiting: bytearray, number: int) -> bool:
    if len(waiting) > HELD_BYTES:
        return False
    sample = Ahrs(0.0, 0.0, 0.0, float(number), 0.0, 0.0, 0.0, 0.0, -9.8)
    waiting += vectornav.encode_binary(sample, CLOCK.now())
    return True


def _send(master: int, waiting: bytearray) -> None:
    with contextlib.suppress(BlockingIOError):
        while waiting:
            del waiting[: os.write(master, waiting)]


if __name__ == "__main__":
    main()
