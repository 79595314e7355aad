"""Rig and logs for the tests of recorder and reader."""

from __future__ import annotations

import math
from pathlib import Path

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.log.reader import Log
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Ahrs, Command, Esc, Frame, Gnss, LoadCell, PortHealth, Sample, Scalar

NAN = math.nan
N_ROUNDS = 12  # rounds of samples of every kind in the log `whole`
T0 = 1_700_000_000.0  # run time at which these logs begin
RIG = """
format = "seatrial-rig 1"
name = "test rig"

[[device]]
name = "ahrs"
protocol = "vectornav"
port = "ports/ahrs"
rate_hz = 50.0
"""
SAMPLES: list[tuple[str, Sample]] = [
    ("ahrs", Ahrs(0.1, 0.2, -0.3, 0.01, 0.02, 0.03, 0.1, 0.2, -9.81, 1e-5, 2e-5, 4e-5)),
    ("ahrs", Ahrs(3.1, -0.2, 0.3)),
    ("imu", Ahrs(NAN, NAN, NAN, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
    ("gnss", Gnss(1.7e9, 63.4, 10.3, 41.0, 1.0, -0.5, 0.1, 5, 17, 0.7, 0.014)),
    ("gnss", Gnss(1.7e9, NAN, NAN)),
    ("esc", Esc(1, -1234.5, 3.5, -0.25, 24.1, 31.0)),
    ("esc", Esc(2, 77.0)),
    ("esc", Command(1, -0.5)),
    ("loadcell", LoadCell(123456.0, -42.5, 1)),
    ("loadcell", LoadCell(-5.0)),
    ("surge", Scalar(1.25)),
]
HEALTH = PortHealth("/dev/ttyUSB0", 10, 9, 8, 7, 6, 5, 0.004, 0.001)


def rig() -> Rig:
    """A rig with one device."""
    return parse_rig(RIG, Path("rig.toml"))


class StoppedClock:
    """Run clock that stands still."""

    speed = 1.0
    origin = (0.0, T0)

    def now(self) -> float:
        return T0


def recorder(path: Path, **extra: object) -> Recorder:
    """Return a recorder with a clock that stands at T0."""
    return Recorder(path, rig=rig(), clock=StoppedClock(), **extra)  # type: ignore[arg-type]


def write_everything(path: Path, n_rounds: int = 1) -> None:
    """Write a log with every kind of message, one round a second and one chunk a round."""
    log = recorder(path, attachments={"mission.toml": b"n = 1\n"}, metadata={"operator": "Ada"})
    for i in range(n_rounds):
        for k, (device, sample) in enumerate(SAMPLES):
            t = T0 + i + 0.01 * k
            log.write(device, Frame(sample, t + 0.001, float(i)), t)
        log.write_raw("ahrs", "rx", bytes(range(256)), T0 + i + 0.5)
        log.write_raw("ahrs", "tx", b"", T0 + i + 0.5)
        log.event(T0 + i + 0.6, "mark", f"round {i}: Trondheimsfjorden, blåsende")
        log.health("ahrs", HEALTH, T0 + i + 0.7)
        log._writer.flush()
    log.close()


def tables(log: Log) -> dict[str, list[tuple[object, ...]]]:
    """Return all content of a log as rows that can be compared."""
    found: dict[str, list[tuple[object, ...]]] = {"events": list(log.events())}
    for kind in (Ahrs, Gnss, LoadCell, Scalar):
        for source in log.sources(kind):
            found[f"{kind.__name__} {source}"] = [tuple(row) for row in log.table(kind, source)]
    for kind in (Esc, Command):
        for source in log.sources(kind):
            for node in log.nodes(kind, source):
                found[f"{kind.__name__} {source} {node}"] = [tuple(row) for row in log.table(kind, source, node)]
    for device in log.sources(PortHealth):
        found[f"health {device}"] = list(log.health(device))
    for device in ("ahrs",):
        if f"/raw/{device}" in log.counts:
            found[f"raw {device}"] = list(log.raw(device))
    return found


def same(left: tuple[object, ...], right: tuple[object, ...]) -> bool:
    """Return whether two rows are equal, with NaN equal to NaN."""
    return repr(left) == repr(right)


def is_prefix(part: dict[str, list[tuple[object, ...]]], all_of_it: dict[str, list[tuple[object, ...]]]) -> bool:
    """Return whether every table is the beginning of the table in ``all_of_it``."""
    return all(
        len(rows) <= len(all_of_it[name]) and all(map(same, rows, all_of_it[name])) for name, rows in part.items()
    )
