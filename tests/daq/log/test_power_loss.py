"""Tests of a log after a power loss: a disk drops data that was not synced, and the rest of the log is readable."""

from __future__ import annotations

import os
import random
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from seatrial.daq.log.mcap_writer import FLUSH_S, SYNC_S
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.record_stream import FileSyncer
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.rig import Segments
from seatrial.daq.samples import Ahrs, Frame
from tests.daq.logs import T0, StoppedClock, rig

SECTOR, PERIOD = 512, 0.02


class ForgetfulDisk:
    """Replacement of `os` in the writer that records the synced content of each file.

    A file name persists once its folder was synced. Any sectors of the data written since the last sync may persist.
    """

    def __init__(self) -> None:
        self._names: dict[int, Path] = {}  # keys are file descriptors
        self._synced: dict[Path, bytes] = {}
        self._named: set[Path] = set()

    def __getattr__(self, name: str) -> object:
        return getattr(os, name)

    def open(self, path: Path, flags: int, mode: int = 0o777) -> int:
        fd = os.open(path, flags, mode)
        self._names[fd] = Path(path)
        if flags & os.O_CREAT:
            self._synced[Path(path)] = b""
        return fd

    def fsync(self, fd: int) -> None:
        path = self._names[fd]
        if path.is_dir():
            self._named |= {other for other in self._synced if other.parent == path}
        else:
            self._synced[path] = path.read_bytes()

    def after_power_loss(self, folder: Path, rng: random.Random) -> None:
        """Write the remaining content of every file into `folder`."""
        for path in self._named:
            if not path.exists():  # a file whose name was not synced, or a deleted segment
                continue
            new, old = path.read_bytes(), self._synced[path]
            size = rng.randint(len(old), max(len(old), len(new)))
            sectors = [
                (new if rng.random() < 0.5 else old.ljust(len(new), b"\0"))[at : at + SECTOR]
                for at in range(0, len(new), SECTOR)
            ]
            (folder / path.name).write_bytes(b"".join(sectors)[:size])


@pytest.mark.parametrize("seed", range(12))
def test_a_power_loss_affects_only_data_since_the_last_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    rng, now = random.Random(seed), [0.0]
    monkeypatch.setattr("seatrial.daq.log.mcap_writer.time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(FileSyncer, "request", lambda self: self._stream.sync())
    for trial in range(5):
        before, after = tmp_path / f"before{trial}", tmp_path / f"after{trial}"
        after.mkdir()
        disk = ForgetfulDisk()
        monkeypatch.setattr("seatrial.daq.log.record_stream.os", disk)
        segments = Segments(seconds=2.0)
        log = Recorder(before / "run.mcap", rig=replace(rig(), segments=segments), clock=StoppedClock())
        n = rng.randrange(60, 400)  # after the first sync; before it there may be no file
        for i in range(n):
            now[0] += PERIOD
            t = T0 + i * PERIOD
            log.write("ahrs", Frame(Ahrs(0.0, 0.0, 0.0, r=float(i)), t, t), t)
            log.tick()
        disk.after_power_loss(after, rng)
        log.close()
        kept = []
        with open_log(after / "run.mcap") as opened:
            if opened.sources(Ahrs):
                kept = opened.table(Ahrs, "ahrs")["r"].tolist()
        assert kept == sorted(set(kept))
        assert set(kept) <= set(range(n))
        whole = next((i for i in range(n) if i >= len(kept) or kept[i] != i), n)  # no sample up to this time is missing
        assert (n - whole) * PERIOD <= SYNC_S + FLUSH_S + 2 * PERIOD
