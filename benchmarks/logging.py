"""Recorder, reader and the acquisition process: what a message costs."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.demo import write_demo_rig
from benchmarks.measure import Figure
from daq.acquisition.session import Acquisition
from daq.clock import RunClock
from daq.config.rig_file import load_rig
from daq.log.reader import open_log
from daq.log.recorder import Recorder
from daq.samples import NAN, Ahrs, Esc, Frame, Gnss, LoadCell, Sample
from tests.missions import T0, StandingClock, rig_of

N_ROUNDS = 20_000
SPEED, WALL_S = 20.0, 6.0


def figures(seed: int) -> Iterator[Figure]:
    """All of them; ``seed`` draws the boat."""
    with tempfile.TemporaryDirectory() as folder:
        yield from record_and_read(Path(folder))
        yield from acquire(Path(folder), seed)


def record_and_read(folder: Path) -> Iterator[Figure]:
    """One sample each of AHRS, ESC and load cell a round, every tenth a GNSS fix."""
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
    yield Figure(group, "recorder", 1e6 * took / n, "us a sample")
    yield Figure(group, "file", path.stat().st_size / n, "bytes a sample")
    yield Figure(group, "recorder, a message", 1e6 * took / n_messages, "us")
    yield from read_all(path, n_messages)


def read_all(path: Path, n_messages: int) -> Iterator[Figure]:
    """Every message of the log as numbers: our reader, mcap's own (bytes only) and rosbags', in one run."""
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
    yield Figure("log", "reader, all tables", ours, "messages/s", mcap, "peer: mcap's own, undecoded")


def acquire(folder: Path, seed: int) -> Iterator[Figure]:
    """The acquisition process on the mock boat at twenty times the speed of the world."""
    write_demo_rig("boat", folder, SPEED)
    rig = load_rig(folder / "boat-rig.toml")
    words = [sys.executable, "-m", "seatrial", "mock", "boat", "boat-rig.toml", "--seed", str(seed)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    with subprocess.Popen(
        words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as mock:
        try:
            assert mock.stdout is not None
            while mock.stdout.readline() not in ("ready\n", ""):
                pass
            with Acquisition(rig, folder / "acquired.mcap", clock=RunClock(SPEED)) as acquisition:
                time.sleep(1.0)
                first, cpu = acquisition.status(), cpu_of(acquisition._process.pid)
                began = time.monotonic()
                time.sleep(WALL_S)
                last, cpu = acquisition.status(), cpu_of(acquisition._process.pid) - cpu
                took = time.monotonic() - began
        finally:
            mock.terminate()
    messages = last.messages - first.messages
    group = f"acquisition process, mock boat at speed {SPEED:g}"
    yield Figure(group, "samples", messages / took, "1/s wall")
    yield Figure(group, "CPU", 100 * cpu / took, "% of a core")
    yield Figure(group, "CPU a sample", 1e6 * cpu / max(messages, 1), "us", note="reading, decoding, writing, status")
    yield Figure(group, "samples lost", float(sum(port.dropped for port in last.ports.values())), "")


def cpu_of(pid: int) -> float:
    """CPU seconds of another process so far; NaN where the system does not say."""
    with contextlib.suppress(OSError, AttributeError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))
    return float("nan")
