"""Check of the end of a run: whether it ended early, for which reason, and which devices were silent then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from seatrial.daq.checks.findings import WARNING, Finding
from seatrial.daq.log import Log
from seatrial.daq.rig import Rig

STOP = "stop"  # kind of the event of a run that ended early
SILENT_WALL_S = 0.5  # wall s without a sample before the end of the log; after a lost port, recording goes on for 1 s
PERIODS = 10.0  # periods of its rate for which a device has to be silent, at least


def check_run_end(log: Log, last_samples: Sequence[tuple[str, float]]) -> Iterator[Finding]:
    """Yield one warning for a log whose run ended early, with the reason in the log and the silent devices; or none.

    Parameters
    ----------
    log : Log
        The log. A run that ended early has an event "stop" in it.
    last_samples : sequence of tuple
        Name of each device, or of each of its nodes, and time of its last sample [s since 1970].
    """
    reasons = [text for _, kind, text in log.events() if kind == STOP]
    if not reasons:
        return
    silent = _silent_at_the_end(log, log.rig, last_samples)
    text = f"the run ended early: {reasons[0]}"
    if silent:
        text += f"; silent at the end: {', '.join(silent)}"
    advice = "remove the cause, and repeat the run; what was recorded until then can be used"
    yield Finding(WARNING, "run-ended-early", "log", log.path.name, text, advice)


def _silent_at_the_end(log: Log, rig: Rig | None, last_samples: Sequence[tuple[str, float]]) -> list[str]:
    """Return the devices that sent nothing at the end of a log, each with the time of silence [run s]."""
    speed = rig.speed if rig else 1.0
    rates = {device.name: device.rate_hz for device in rig.devices} if rig else {}
    found = []
    for name, t in last_samples:
        device = name.split(" ")[0]
        # The rate of a bus is that of all its nodes together.
        nodes = sum(other.startswith(f"{device} node ") for other, _ in last_samples)
        rate = rates.get(device, PERIODS) / max(nodes, 1)
        if log.end - t > max(SILENT_WALL_S * speed, PERIODS / rate):
            found.append(f"{name} ({log.end - t:.1f} s)")
    return found
