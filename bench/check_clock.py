"""Time stamps: steps back, repeats, sections that are missing, and a device's clock against the time of receipt."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.findings import FAULT, OK, WARNING, Finding
from daq.errors import counted

FloatArray = npt.NDArray[np.float64]
REPEATED = 0.02  # part of the samples that may share their time with the one before
BUNCHED = 0.1  # the same of a device without a clock of its own
GAP_S, GAP_PERIODS = 1.0, 10.0  # a pause longer than both is a section that is missing
SILENT_S = 5.0  # a device that ends so long before the log has fallen silent
TICK_S = 1e-3  # two messages of one moment may say it in ms and in us; a clock that restarts goes back further
BLOCK_S = 2.0  # the earliest arrival in each block carries the device's clock
JUMP_S, SPREAD_S, DRIFT = 0.1, 0.1, 500e-6  # s, s, 1
WALL_JITTER_S = 0.05  # wall s by which a busy machine is late at the best of times
LEAST = 200  # samples that the digits of the time stamps are judged by


def stamps(name: str, table: Any, end: float | None, speed: float = 1.0) -> Iterator[Finding]:
    """Findings on the times of one table (t, t_rx, t_device).

    ``end``: of the log, None for an imported signal, whose times are what its file says and which may be a command that
    ends when nobody changes it any more; ``speed``: run seconds a wall second.
    """
    t, imported = table["t"], end is None
    if len(t) < 3:
        return
    pauses = np.diff(t)
    repeated = float(np.mean(pauses <= 0.0))
    if imported and repeated > REPEATED:
        text = f"{100 * repeated:.0f} % of the samples are not later than the one before"
        yield Finding(FAULT, "time", name, text, "its clock runs back or stands; import with its own rate instead")
    elif repeated > BUNCHED:
        text = f"{100 * repeated:.0f} % of the samples came in bunches, their times are those of receipt"
        yield Finding(WARNING, "time", name, text, "a busy computer, a bunching adapter (latency_timer)")
    else:
        yield from _gaps(name, t, pauses, speed)
    if end is not None and end - t[-1] > SILENT_S * max(1.0, 0.2 * speed):
        text = f"nothing for the last {end - t[-1]:.0f} s of the log"
        yield Finding(FAULT, "silent", name, text, "power, cable, bus")
    yield from _clock(name, table, speed)


def _gaps(name: str, t: FloatArray, pauses: FloatArray, speed: float) -> Iterator[Finding]:
    least = max(GAP_S, GAP_PERIODS * float(np.median(pauses)), 4.0 * WALL_JITTER_S * speed)
    long = np.flatnonzero(pauses > least)
    # A signal that is written when it changes has pauses by nature.
    if long.size and long.size < 0.02 * t.size + 1.0:
        k = int(long[np.argmax(pauses[long])])
        missing = f"missing: {counted(long.size, 'section')}, {pauses[long].sum():.1f} s in all"
        text = f"{missing}, the longest at {t[k] - t[0]:.1f} s"
        yield Finding(WARNING, "gap", name, text, "cable, range of the link, a busy computer")


def _clock(name: str, table: Any, speed: float) -> Iterator[Finding]:
    known = np.isfinite(table["t_device"])
    if np.count_nonzero(known) < 50:
        return
    device, received = table["t_device"][known], table["t_rx"][known]
    if back := int(np.count_nonzero(np.diff(device) < -TICK_S)):
        text = f"its clock ran back {counted(back, 'time')}"
        yield Finding(FAULT, "clock", name, text, "it restarted: power? a clock set by GNSS in the middle of the run?")
        return
    offset = received - device
    earliest = _earliest(received, offset)
    jitter = 2.0 * WALL_JITTER_S * max(speed, 1.0)
    late = float(np.quantile(offset - np.interp(received, *earliest), 0.95))
    steps = np.abs(np.diff(earliest[1]))
    if steps.size and steps.max() > max(JUMP_S, jitter):
        text = f"its clock jumps by {steps.max():.2f} s against the computer's"
        yield Finding(
            FAULT, "clock", name, text, "a clock set in the middle of the run: leave that out, or start later"
        )
        return
    if late > max(SPREAD_S, jitter):
        text = f"one sample in twenty comes {late:.2f} s late"
        yield Finding(
            WARNING, "clock", name, text, "a bunching adapter (latency_timer), a busy computer; its own clock is used"
        )
    span = float(received[-1] - received[0])
    drift = float(np.polyfit(earliest[0] - received[0], earliest[1], 1)[0]) if earliest[0].size > 3 else 0.0
    if span > 60.0 and abs(drift) > max(DRIFT, jitter / span):
        yield Finding(
            WARNING, "clock", name, f"its clock drifts by {1e6 * drift:.0f} ppm", "the crystal; its clock is followed"
        )
    elif late <= max(SPREAD_S, jitter):
        yield Finding(OK, "clock", name, f"samples arrive within {1e3 * max(late, 0.0):.0f} ms of each other's delay")


def _earliest(received: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Time and offset of the earliest arrival in each block."""
    block = ((received - received[0]) / BLOCK_S).astype(int)
    best = [rows[np.argmin(offset[rows])] for k in np.unique(block) if (rows := np.flatnonzero(block == k)).size > 2]
    return received[best], offset[best]


def lost_zeros(name: str, t: FloatArray) -> Iterator[Finding]:
    """Stamps whose fraction was written without its leading zeros: none of them is in the first tenth of a second."""
    tenth = np.floor(np.mod(t, 1.0) * 10.0).astype(int)
    share = np.bincount(tenth, minlength=10)[:10] / max(t.size, 1)
    if t.size >= LEAST and share[0] < 0.002 and share[1:].min() > 0.03:
        text = f"none of {t.size} time stamps is in the first tenth of its second: leading zeros were lost"
        yield Finding(FAULT, "time", name, text, '`fraction = "unpadded-ns"` in the import\'s map')
