"""Benchmarks of the acquisition.

They measure the jitter beside a busy program, the loss at full rate, the error of the device time behind a slow
adapter, the loss after kill -9, and the continuity of segments.

`python -m benchmarks.acquisition --seconds 600 --kills 50 --days 7` is the acceptance test. A day takes 72 min.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.logging import SPEED, mock_boat
from benchmarks.measure import Figure, table
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import ClockMap, RunClock
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.log.mcap_reader import RawLog
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.schema import DEVICE_TIME, TYPES
from seatrial.daq.log.segments import segments as later_segments
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Ahrs

ROOT = Path(__file__).parents[1]
JITTER_S, LOSS_S, SOAK_S = 10.0, 20.0, 240.0  # s, default durations of the measurements
LOSS_RATE = 1250.0  # frames per second of each device
NUMBERED = {DEVICE_TIME, *TYPES.values()}  # types of the first message of a sample, which has the sample's number
# Program that records one device and writes the time of each recorded sample to stdout
RECORD = """
import os, struct, sys, time
from pathlib import Path
from seatrial.daq.clock import RunClock
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.samples import Ahrs, Frame
from tests.daq.logs import rig
clock, period = RunClock(), 1.0 / float(sys.argv[2])
log = Recorder(Path(sys.argv[1]), rig=rig(), clock=clock, attachments={"mission.toml": b"n = 1"})
due = time.monotonic()
while True:
    t = clock.now()
    log.write("ahrs", Frame(Ahrs(0.0, 0.0, 0.0), t, 0.0), t)
    os.write(1, struct.pack("<d", t))
    due += period
    while True:
        log.tick()
        left = due - time.monotonic()
        if left <= 0.0:
            break
        time.sleep(min(left, 0.02))
"""


def figures(seed: int) -> list[Figure]:
    """Return the figures of all measurements with short durations. ``seed`` selects random times and the boat."""
    return [*jitter(JITTER_S), *loss(LOSS_S), *device_time(seed), *kills(2, seed), *soak(SOAK_S, seed)]


def rig_of(folder: Path, n_devices: int, rate: float) -> Rig:
    """Return a rig of ``n_devices`` VectorNav devices d0, d1, ... at ptys in the folder.

    ``rate`` is the rate of each device [Hz].
    """
    devices = "".join(
        f'[[device]]\nname = "d{k}"\nprotocol = "vectornav"\nport = "d{k}"\nrate_hz = {rate}\n'
        for k in range(n_devices)
    )
    return parse_rig(f'format = "seatrial-rig 1"\nname = "bench"\n{devices}', folder / "rig.toml")


def record(folder: Path, n_devices: int, rate: float, seconds: float, busy: bool) -> tuple[dict[str, float], int]:
    """Record the messages of simulated devices (`benchmarks.sender`) to `log.mcap` in the folder.

    Parameters
    ----------
    folder : Path
        Folder for ports and log.
    n_devices : int
        Number of devices.
    rate : float
        Messages per second of each device.
    seconds : float
        Duration of the recording [s].
    busy : bool
        Whether a thread of this process computes in pure Python meanwhile.

    Returns
    -------
    dict of str to float
        Report of the sender: numbers of sent and refused messages, and its largest delay [s].
    int
        Number of samples that the acquisition counts as dropped.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-m", "benchmarks.sender", str(folder), str(n_devices), str(rate), str(seconds)]
    ended = threading.Event()

    def compute() -> None:
        """Compute in pure Python until the recording has ended."""
        while not ended.is_set():
            sum(k * k for k in range(1000))

    with subprocess.Popen(
        words, env=environment, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as sender:
        assert sender.stdin is not None
        assert sender.stdout is not None
        sender.stdout.readline()
        rig = rig_of(folder, n_devices, rate)
        with Acquisition(rig, folder / "log.mcap", clock=RunClock()) as acquisition:
            time.sleep(0.5)
            thread = threading.Thread(target=compute)
            if busy:
                thread.start()
            sender.stdin.write("go\n")
            sender.stdin.flush()
            report: dict[str, float] = json.loads(sender.stdout.readline())
            ended.set()
            dropped = sum(port.dropped for port in acquisition.status().ports.values())
        sender.stdin.write("end\n")
    return report, dropped


def jitter(seconds: float) -> Iterator[Figure]:
    """Yield the delay from sending to receive time for one device at 1 kHz, while this process computes in Python.

    ``seconds`` is the duration of the recording [s].
    """
    with tempfile.TemporaryDirectory() as name:
        record(Path(name), 1, 1000.0, seconds, busy=True)
        with open_log(Path(name) / "log.mcap") as log:
            rows = log.table(Ahrs, "d0")
            raw, run = json.loads(log.metadata["origin"])
    delay = 1e6 * (rows["t_rx"] - run + raw - rows["t_device"])
    group = f"receive time at 1 kHz beside a busy Python program, {seconds:g} s"
    yield Figure(group, "delay, median", float(np.median(delay)), "us")
    yield Figure(group, "delay, 99 %", float(np.quantile(delay, 0.99)), "us", note="sender and scheduler included")
    yield Figure(group, "delay, largest", float(delay.max()), "us")


def loss(seconds: float) -> Iterator[Figure]:
    """Yield the number of lost frames of four devices with 5,000 frames per second in total.

    ``seconds`` is the duration of the recording [s].
    """
    with tempfile.TemporaryDirectory() as name:
        report, dropped = record(Path(name), 4, LOSS_RATE, seconds, busy=False)
        with open_log(Path(name) / "log.mcap") as log:
            logged = sum(len(log.table(Ahrs, f"d{k}")) for k in range(4))
    group = f"four devices, {4 * LOSS_RATE:,.0f} frames/s for {seconds:g} s"
    yield Figure(group, "sent", report["sent"], "frames")
    yield Figure(group, "not in the log", report["sent"] - logged, "frames", note=f"{dropped} counted as dropped")
    note = f"sender at most {report['late']:.3f} s late"
    yield Figure(group, "not accepted by the port", report["refused"], "frames", note=note)


def device_time(seed: int, minutes: float = 5.0) -> Iterator[Figure]:
    """Yield the error of device times that `ClockMap` maps to run time, at 200 Hz.

    The simulated adapter delivers every 16 ms, and the clock of the device has an error of 30 ppm. ``seed`` selects the
    random delays, and ``minutes`` is the simulated duration.
    """
    rng = np.random.default_rng(seed)
    truth = np.arange(round(60.0 * minutes * 200)) / 200.0
    received = np.maximum.accumulate(np.ceil(truth / 0.016) * 0.016 + rng.exponential(50e-6, truth.size))
    clock_map = ClockMap()
    estimates = [clock_map.update(d, r) for d, r in zip(12.5 + truth * (1.0 - 30e-6), received, strict=True)]
    error = 1e6 * (np.array(estimates) - truth)[truth > 10.0]
    group = "device time behind a 16 ms adapter, 30 ppm"
    yield Figure(group, "bias", float(error.mean()), "us", note="from 10 s after the start")
    yield Figure(group, "spread", float(error.std()), "us")
    yield Figure(group, "bias of the receive time", 1e6 * float((received - truth).mean()), "us")


def kills(count: int, seed: int) -> Iterator[Figure]:
    """Yield the largest time [s] that is lost by kill -9 at random times, ``count`` times at 5 Hz and at 1 kHz."""
    rng = random.Random(seed)
    for rate in (5.0, 1000.0):
        lost = [_loss_by_kill(rate, rng.uniform(0.8, 3.0)) for _ in range(count)]
        group = f"kill -9, {count} times at {rate:g} Hz"
        yield Figure(group, "largest loss", max(lost), "s", note="only at the end of the log; metadata complete")


def _loss_by_kill(rate: float, after: float) -> float:
    """Record one device at ``rate`` [Hz], kill the recording ``after`` [s], and return the time [s] lost at its end.

    An AssertionError is raised if an earlier sample, an attachment or metadata are missing.
    """
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "run.mcap"
        words = [sys.executable, "-c", RECORD, str(path), str(rate)]
        with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            output = process.stdout.read(8)
            threading.Timer(after, os.kill, (process.pid, signal.SIGKILL)).start()
            output += process.stdout.read()
        written = np.frombuffer(output[: len(output) // 8 * 8], "<f8")
        with open_log(path) as log:
            kept = log.table(Ahrs, "ahrs")["t"]
            assert set(log.attachments) == {"rig.toml", "mission.toml"}
            assert {"git", "host", "operator"} <= set(log.metadata)
        np.testing.assert_allclose(kept, written[: len(kept)], atol=1e-6)
        return float(written[-1] - kept[-1])


def soak(seconds: float, seed: int) -> Iterator[Figure]:
    """Yield the continuity of a log of several files (segments), recorded from the mock boat at 20 times real time.

    The disk budget holds only about half of the segments. ``seconds`` is the duration [run s], and ``seed`` selects the
    boat.
    """
    keep = min(9000.0 * seconds, 2e9)  # bytes; the boat sends 18 kB per run second, so about half of the log is kept
    with tempfile.TemporaryDirectory() as name, mock_boat(Path(name), seed) as boat:
        path, largest, memory = Path(name) / "run.mcap", 0, list[float]()
        limits = f"segment_s = {min(seconds / 16, 3600.0)}\nkeep_gb = {keep / 1e9}\n"
        limits += f"segment_mb = {keep / 9e6}\n" if keep > 9e6 else ""
        text, clock = boat.text.replace("[log]\n", f"[log]\n{limits}"), RunClock(SPEED)
        with Acquisition(parse_rig(text, boat.path), path, clock=clock) as acquisition:
            end = clock.now() + seconds
            while clock.now() < end:
                time.sleep(0.5)
                largest = max(largest, acquisition.status().bytes)
                memory.append(rss_mb(acquisition._process.pid))
        last = acquisition.status()
        missing, written, kept = continuity(path)
    group = f"mock boat for {seconds:g} run s at {SPEED:g} times"
    yield Figure(group, "samples", last.messages, "")
    yield Figure(group, "counted as dropped", sum(port.dropped for port in last.ports.values()), "")
    yield Figure(group, "written, but not in order", last.messages - written, "samples")
    yield Figure(group, "missing or twice within what is kept", missing, "samples")
    yield Figure(group, "segments kept", kept[0], "", note=f"of {kept[1]}")
    yield Figure(group, "largest size", largest / keep, "of keep_gb")
    yield Figure(group, "memory of the process, growth", memory[-1] - memory[len(memory) // 4], "MB")


def continuity(path: Path) -> tuple[int, int, tuple[int, int]]:
    """Check the numbers of the samples in a log of several files (segments).

    The samples of a topic are numbered through all segments. ``path`` is the first segment.

    Returns
    -------
    int
        Number of gaps and repetitions within the kept segments.
    int
        Number of samples that were written, including those in deleted segments.
    tuple of two ints
        Number of kept segments, and number of all segments.
    """
    last: dict[str, tuple[int, int]] = {}  # topic -> segment and number of its last sample
    wrong = 0
    for segment, file in {0: path, **later_segments(path)}.items():
        raw = RawLog(file)
        first = {n: c.topic for n, c in raw.channels.items() if raw.schemas[c.schema_id].name in NUMBERED}
        for messages in raw.read(first):
            for number, topic in first.items():
                found = messages.heads["sequence"][messages.heads["channel"] == number].astype(int)
                if len(found) and topic in last and last[topic][0] in (segment, segment - 1):
                    found = np.append(last[topic][1], found)
                wrong += int(np.sum(np.diff(found) != 1))
                if len(found):
                    last[topic] = segment, int(found[-1])
        raw.close()
    numbers = later_segments(path)
    return wrong, sum(n for _, n in last.values()), (1 + len(numbers), 1 + max(numbers, default=0))


def rss_mb(pid: int) -> float:
    """Return the resident memory [MB] of the process ``pid``; NaN if the system does not report it."""
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return float("nan")


def main() -> int:
    """Measure with the durations of the command line and print the table."""
    parser = argparse.ArgumentParser("python -m benchmarks.acquisition", description=__doc__)
    parser.add_argument("--seconds", type=float, default=LOSS_S, help="duration of the loss measurement")
    parser.add_argument("--kills", type=int, default=2, help="number of kills at each rate")
    parser.add_argument(
        "--days", type=float, default=SOAK_S / 86_400, help="run time of the mock boat for the segments"
    )
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    seed = options.seed
    found = [*jitter(JITTER_S), *loss(options.seconds), *device_time(seed), *kills(options.kills, seed)]
    found += soak(86_400 * options.days, seed)
    print(table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
