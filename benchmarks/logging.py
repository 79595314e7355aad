"""Benchmarks of the recorder, the reader and the acquisition process, and of reading a part of a log of 24 h.

`python -m benchmarks.logging FILE` is a child process of the benchmark. It reads ten minutes of one topic of a log of
24 h and prints the number of samples and its peak memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.measure import Figure, child, peak_mb
from seatrial.bench.demo import write_demo_rig
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.log.cdr import NANO, cdr_layout
from seatrial.daq.log.mcap_writer import LogWriter
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.log.schema import TYPES, topic
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Ahrs, Esc, Frame, Gnss, LoadCell, Sample, Scalar
from tests.missions import T0, StandingClock, rig_of

N_ROUNDS = 20_000  # of the recorder
SPEED, WALL_S = 20.0, 6.0  # run seconds per wall second of the mock boat; wall s of the measurement
ROOT = Path(__file__).parents[1]
DAY_S, CHUNK_S, TOPICS = 86_400, 0.25, ("surge", "sway", "heave", "yaw")
# The log has all chunks of a day, but the full rate only in the interval that is read and around it.
FULL_HZ, THIN_HZ, FULL_FROM_S, FULL_TO_S = 1000, 20, 43_000, 44_200
READ_FROM_S, READ_TO_S = 43_200, 43_800


def figures(seed: int) -> Iterator[Figure]:
    """Yield the figures of the recorder, the readers and the acquisition process. ``seed`` selects the mock boat."""
    with tempfile.TemporaryDirectory() as folder:
        yield from record_and_read(Path(folder))
        yield from read_part_of_a_day(ROOT / "build" / "day.mcap")
        yield from acquire(Path(folder), seed)


def read_part_of_a_day(path: Path) -> Iterator[Figure]:
    """Yield time and memory to read ten minutes of one topic from a log of 24 h with four topics at 1 kHz.

    The reader runs in a new process. ``path`` is the log, which is written if it does not exist, and kept.
    """
    if not path.exists():
        write_day(path)
    done = child([sys.executable, "-m", "benchmarks.logging", str(path)], ROOT, os.environ)
    group = f"a day of 4 x 1 kHz ({path.stat().st_size / 1e6:.0f} MB, full rate only in {FULL_TO_S - FULL_FROM_S} s)"
    note = "target: 2; includes the start of Python"
    yield Figure(group, "open and read one topic, 10 min: wall", done.wall, "s", note=note)
    yield Figure(group, "open and read one topic, 10 min: CPU", done.cpu, "s")
    yield Figure(group, "peak memory", done.report["peak_mb"], "MB", note="target: 200")
    yield Figure(group, "samples", done.report["n"], "")


def write_day(path: Path) -> None:
    """Write a log of 24 h with as many chunks as at 1 kHz, of which only 20 minutes have all messages.

    The file appears at ``path`` when it is complete. Its folder is made if it does not exist.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part.mcap")
    partial.unlink(missing_ok=True)
    log = LogWriter(partial, metadata={"format": "seatrial-log 1"}, attachments={}, time_ns=0)
    channels = [(log.channel(topic(Scalar, name), TYPES[Scalar]), name) for name in TOPICS]
    packs = [(channel, cdr_layout(TYPES[Scalar], name.encode()).pack) for channel, name in channels]
    for k in range(round(DAY_S / CHUNK_S)):
        begin = k * CHUNK_S
        rate = FULL_HZ if FULL_FROM_S <= begin < FULL_TO_S else THIN_HZ
        for i in range(round(CHUNK_S * rate)):
            t = T0 + begin + i / rate
            stamp = round(t * NANO)
            for channel, pack in packs:
                log.add(channel, stamp, stamp, i, pack(stamp, t, NAN, (i * 0.618) % 1.0))
        log.flush()
    log.close()
    partial.replace(path)


def record_and_read(folder: Path) -> Iterator[Figure]:
    """Yield the CPU time of the recorder, the size of its file, and the rates of readers. The log is in ``folder``.

    Each round records one sample of an AHRS, a speed controller and a load cell. Every tenth round adds a GNSS fix.
    """
    path = folder / "speed.mcap"
    recorder = Recorder(path, rig=rig_of("boat"), clock=StandingClock())
    samples: list[tuple[str, Sample]] = [
        ("ahrs", Ahrs(0.1, 0.2, -0.3, 0.01, 0.02, 0.03, 0.1, 0.2, -9.81, 1e-5, 2e-5, 4e-5)),
        ("esc", Esc(1, 1234.5, 3.5, 0.25, 24.1, 31.0)),
        ("loadcell", LoadCell(123456.0, -42.5)),
    ]
    began = time.process_time()
    n = 0
    for k in range(N_ROUNDS):
        t = T0 + 0.01 * k
        for device, sample in samples:
            recorder.write(device, Frame(sample, t, t), t)
        if k % 10 == 0:
            fix = Gnss(t, 41.0 + 1e-7 * k, -8.7, 1.0, 0.5, 0.1, 0.0, 5, 17, 0.7, 0.02)
            recorder.write("gnss", Frame(fix, t, NAN), t)
        recorder.tick()
        n += 3 + (k % 10 == 0)
    recorder.close()
    took = time.process_time() - began
    with open_log(path) as log:
        n_messages = sum(log.counts.values())
    group = "log"
    yield Figure(group, "recorder", 1e6 * took / n, "us per sample")
    yield Figure(group, "file", path.stat().st_size / n, "bytes per sample")
    yield Figure(group, "recorder, per message", 1e6 * took / n_messages, "us")
    yield from read_all(path, n_messages)


def read_all(path: Path, n_messages: int) -> Iterator[Figure]:
    """Yield the rates of reading all messages of a log: seatrial and rosbags (decoded), and mcap (bytes only).

    ``n_messages`` is the number of messages in the log. rosbags reads a fifth of them.
    """
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader

    began = time.process_time()
    with open_log(path) as log:
        rows = sum(len(log.table(kind, device)) for kind, device in ((Ahrs, "ahrs"), (Gnss, "gnss")))
        rows += len(log.table(LoadCell, "loadcell")) + len(log.table(Esc, "esc", node=1))
        assert sum(log.counts.values()) == n_messages
    ours = n_messages / (time.process_time() - began)
    began = time.process_time()
    with path.open("rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages(log_time_order=False)) == n_messages
    mcap = n_messages / (time.process_time() - began)
    began, n_read = time.process_time(), 0
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            n_read += 1
            if n_read >= n_messages // 5:
                break
    yield Figure(
        "log", "reader, all tables", ours, "messages/s", n_read / (time.process_time() - began), "peer: rosbags"
    )
    yield Figure("log", "reader, all tables", ours, "messages/s", mcap, "peer: mcap, without decoding")


@contextlib.contextmanager
def mock_boat(folder: Path, seed: int) -> Iterator[Rig]:
    """Run the mock boat of a seed at 20 times real time in a new process, and yield its rig when it is ready.

    The rig file is written to ``folder``. The process is ended at the end of the context.
    """
    write_demo_rig("boat", folder, SPEED)
    words = [sys.executable, "-m", "seatrial", "mock", "boat", "boat-rig.toml", "--seed", str(seed)]
    with subprocess.Popen(
        words, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as mock:  # fmt: skip
        try:
            assert mock.stdout is not None
            while mock.stdout.readline() not in ("ready\n", ""):
                pass
            yield load_rig(folder / "boat-rig.toml")
        finally:
            mock.terminate()


def acquire(folder: Path, seed: int) -> Iterator[Figure]:
    """Yield the load of the acquisition process that records the mock boat at 20 times real time for 6 s (wall).

    ``folder`` is for the rig and the log. ``seed`` selects the boat.
    """
    with (
        mock_boat(folder, seed) as rig,
        Acquisition(rig, folder / "acquired.mcap", clock=RunClock(SPEED)) as acquisition,
    ):
        time.sleep(1.0)
        first, cpu = acquisition.status(), cpu_of(acquisition._process.pid)
        began = time.monotonic()
        time.sleep(WALL_S)
        last, cpu = acquisition.status(), cpu_of(acquisition._process.pid) - cpu
        took = time.monotonic() - began
    messages = last.messages - first.messages
    group = f"acquisition process, mock boat at speed {SPEED:g}"
    yield Figure(group, "samples", messages / took, "1/s wall")
    yield Figure(group, "CPU", 100 * cpu / took, "% of a core")
    yield Figure(group, "CPU per sample", 1e6 * cpu / max(messages, 1), "us", note="reading, decoding, writing, status")
    yield Figure(group, "samples lost", float(sum(port.dropped for port in last.ports.values())), "")


def cpu_of(pid: int) -> float:
    """Return the CPU time [s] that the process ``pid`` has used so far; NaN if the system does not report it."""
    with contextlib.suppress(OSError, AttributeError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))
    return float("nan")


def main() -> None:
    """Read ten minutes of one topic of the log in the first argument, as a child process of the benchmark.

    Print the number of samples and the peak memory [MB] as JSON.
    """
    with open_log(sys.argv[1]) as log:
        rows = log.table(Scalar, TOPICS[1], begin=log.start + READ_FROM_S, end=log.start + READ_TO_S)
    print(json.dumps({"n": len(rows), "peak_mb": peak_mb()}))


if __name__ == "__main__":
    main()
