"""Tests of `seatrial view` and of `seatrial log --view` as processes."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from seatrial.bench.demo import write_demo_rig
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Gnss
from tests.bench.mock_process import mock_process
from tests.daq.logs import write_everything

SEATRIAL = [sys.executable, "-m", "seatrial"]


@contextlib.contextmanager
def command(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [*SEATRIAL, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def address_of(process: subprocess.Popen[str]) -> str:
    """Return the address of the page in the first lines that a command prints."""
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.search(r"http://127\.0\.0\.1:\d+/[\w-]+/", line):
            return found[0]
    assert process.stderr is not None
    raise AssertionError(process.stderr.read())


def ask(address: str, path: str) -> Any:
    url = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", url.port or 0, timeout=10.0)
    try:
        connection.request("GET", f"{url.path}api/{path}")
        answer = connection.getresponse()
        content = answer.read()
        assert answer.status == 200, content
        return json.loads(content)
    finally:
        connection.close()


def test_the_command_serves_until_ctrl_c_and_changes_no_log(tmp_path: Path) -> None:
    write_everything(tmp_path / "a.mcap", 3)
    write_everything(tmp_path / "b.mcap", 2)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with command(tmp_path, "view", "a.mcap", "b.mcap", "--no-browser") as process:
        address = address_of(process)
        assert ask(address, "logs") == ["a.mcap", "b.mcap"]
        assert [ask(address, f"log?log={k}")["name"] for k in (0, 1)] == ["a.mcap", "b.mcap"]
        assert ask(address, "check?log=1")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=10)
        assert (process.returncode, err) == (0, "")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_page_may_be_served_longer_than_a_file_may_be_read(tmp_path: Path) -> None:
    """The processor time of other commands that read a file from a stranger is limited; a server has none."""
    write_everything(tmp_path / "a.mcap")
    with command(tmp_path, "view", "a.mcap", "--no-browser") as process:
        address_of(process)
        children = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=True
        )
        (child,) = map(int, children.stdout.split())
        limits = Path(f"/proc/{child}/limits").read_text()
    cpu = re.search(r"Max cpu time +(\S+)", limits)
    memory = re.search(r"Max address space +(\d+)", limits)
    assert cpu is not None
    assert cpu[1] == "unlimited" or int(cpu[1]) > 10 * 365 * 86_400
    assert memory is not None
    assert int(memory[1]) < 4_000_000_000


@pytest.mark.parametrize("content", [b"", b"no log", b"\x89MCAP0\r\n" + bytes(50)], ids=["empty", "text", "zeros"])
def test_a_file_of_another_format_gives_a_one_line_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    os.utime(tmp_path / "a.mcap", (time.time() - 60.0,) * 2)  # nobody writes it any more
    with command(tmp_path, "view", "a.mcap", "--no-browser") as process:
        if content.endswith(bytes(50)):  # damaged, but a log: it is shown as such
            assert ask(address_of(process), "log")["warnings"]
            return
        out, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert out == ""
    assert err.count("\n") == 1
    assert "a.mcap" in err


@pytest.mark.parametrize("kind", ["boat", "bench"])
def test_log_with_view_serves_the_page_of_its_recording(tmp_path: Path, kind: str) -> None:
    write_demo_rig(kind, tmp_path, 2.0)
    with (
        mock_process(tmp_path, kind, f"{kind}-rig.toml", "--seed", "3"),
        command(tmp_path, "log", f"{kind}-rig.toml", "--view", "-o", "run.mcap") as process,
    ):
        address = address_of(process)
        end, ends = time.monotonic() + 20.0, set[float]()
        while len(ends) < 4:
            with contextlib.suppress(OSError):
                content = ask(address, "log")
                if content["state"] == "live" and content["tables"]:
                    ends.add(content["end"])
            assert time.monotonic() < end
            time.sleep(0.2)
        signals = {signal["id"]: signal["unit"] for table in content["tables"] for signal in table["signals"]}
        assert content["tracks"] == (["/gnss/gnss"] if kind == "boat" else [])
        wanted = "/gnss/gnss:speed" if kind == "boat" else "/loadcell/counts:force"
        assert signals[wanted] == ("m/s" if kind == "boat" else "N")
        curve = ask(address, f"data?signal={wanted}&from=0&to=1000&points=500")[wanted]
        assert len(curve["t"]) > 10
        assert ask(address, "check") is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert process.returncode == 0, err
    assert "run.mcap: " in out
    with pytest.raises(OSError, match="refused"):
        ask(address, "log")
    with open_log(tmp_path / "run.mcap") as log:
        assert log.complete
        assert not log.warnings
        if kind == "boat":
            assert len(log.table(Gnss, "gnss")) > 10
